"""Exports controller, plant or loop of a scenario as C for a microcontroller."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from diagramc import (
    CSource,
    Measurement,
    Sil,
    SilMeasurement,
    Vectors,
    read_diagram,
    recorded_vectors,
    require_export_folder,
    require_sil_folder,
    source_of,
    write_c,
    write_sil,
)
from kneexo.common.result import Array
from kneexo.diagrams.wearer import moment_of
from kneexo.errors import ParameterError
from kneexo.export.target import (
    ENCODER_COUNT,
    TOOL,
    Target,
    largest_step_s,
    make_target,
    released_step_s,
    require_step,
)
from kneexo.geometry.rod_polynomial import completed
from kneexo.parameters import SampledReference, Scenario
from kneexo.parameters.device.safety_states import RELEASES
from kneexo.parameters.scenario_file import scenario_files
from kneexo.parameters.task.fault import OPERATOR_INPUTS
from kneexo.simulation.compiled import compile_scenario, scenario_run

OUTSIDE = ("disturbance_force", "knee_torque", *RELEASES, *OPERATOR_INPUTS)
"""Names of the input ports that no part of the closed loop drives. Test vectors have zeros."""

VECTORS_S = 2.0
"""Default length of the test vectors in simulated s. A shorter scenario limits the length."""


def make_firmware(
    scenario: Scenario = Scenario(),
    what: str = "controller",
    *,
    precision: str = "double",
    vectors_s: float | None = None,
    integrator: str = "rk4",
    tolerance: float | None = None,
    step_s: float | None = None,
    look_up: bool = False,
    name: str | None = None,
    outputs: Sequence[str] | None = None,
    run_options: Mapping[str, Any] = MappingProxyType({}),
) -> tuple[CSource, Vectors]:
    """Return controller, plant or loop of a scenario as C99, with test vectors.

    The inputs of the test vectors come from a run of the compiled closed loop.

    Parameters
    ----------
    scenario
        The closed loop. A law of the user that compiles is allowed.
    what
        ``controller``, ``plant`` or ``loop``: see `make_target`. The input of a controller with a
        quantized encoder is the encoder count, an int32_t.
    precision
        ``double`` or ``float``.
    vectors_s
        Length of the test vectors in s, at most the duration of the scenario; by default
        `VECTORS_S`.
    integrator
        ``rk4`` with fixed steps, or ``rosenbrock`` for stiff plants, with error control. A diagram
        without continuous states ignores it.
    tolerance
        Largest error estimate of a substep of ``rosenbrock``: see `CSource`.
    step_s
        Largest step of RK4 in s; by default that of `largest_step_s`. A diagram without continuous
        states ignores ``step_s``.
    look_up
        If True, the code looks up knee angle and rod extension in tables by the encoder count, and
        does not compute them.
    name
        Prefix of all C names and file names, by default ``what``. Two controllers with different
        names link into one program.
    outputs
        Names of the output ports to export, by default all. The code computes nothing that only
        other outputs need.
    run_options
        Options ``integrator`` and ``step_s`` of `CompiledModel.simulate` for the run that gives
        the inputs of the test vectors. For software in the loop, give the integrator and step of
        the exported plant.

    Raises
    ------
    ParameterError
        ``what``, ``vectors_s`` or ``step_s`` is wrong, or ``what`` is ``loop`` and the reference is
        sampled or the wearer's moment is a table, or there is ``look_up`` for a controller with
        protection. `make_closed_loop` raises this error too.
    CompilationError
        The diagram cannot be exported: see `CSource`.
    SimulationError
        The run of the closed loop or of the exported diagram fails.
    """
    require_step(step_s)
    if what == "loop" and moment_of(scenario) is not None:
        raise ParameterError(
            "wearer.moment: a loop in C must not have a table of the moment; export the controller "
            "in C, or the loop as FMU"
        )
    if what == "loop" and isinstance(scenario.reference, SampledReference):
        raise ParameterError(
            f"reference.kind = {scenario.reference.kind!r}: a loop in C computes its reference, "
            f"which must not be sampled; export plant and controller, or the loop as FMU"
        )
    duration_s = scenario.duration_s
    if vectors_s is None:
        vectors_s = min(VECTORS_S, duration_s)
    sample_time_s = scenario.controller.sample_time_s
    if duration_s < sample_time_s:
        raise ParameterError(
            f"simulation.duration_s = {duration_s:g} s: must be at least {sample_time_s:g} s, the "
            f"sample time, for test vectors"
        )
    if not sample_time_s <= vectors_s <= duration_s:
        raise ParameterError(
            f"vectors_s = {vectors_s:g} s: must be {sample_time_s:g} … {duration_s:g} s, the "
            f"scenario's sample time and duration"
        )
    if look_up and scenario.protection is not None:
        raise ParameterError(
            "look_up: the tables have no row for a count at which the linkage cannot close, which "
            "protection accepts; leave out look_up or protection"
        )
    target = make_target(scenario, what, counts=True)
    files: dict[str, Any] = scenario_files(completed(scenario), "scenario.yaml")
    diagram = read_diagram(target.diagram, inputs=target.inputs)
    if step_s is None and integrator == "rk4":
        step_s = released_step_s(scenario, diagram)
    source = source_of(
        diagram,
        target.what if name is None else name,
        precision=precision,
        outputs=target.outputs if outputs is None else outputs,
        interface=target.interface,
        tick_s=target.tick_s,
        integrator=integrator,
        tolerance=tolerance,
        step_s=step_s,
        look_up=look_up,
        subject=f"{target.what} in {precision} precision",
        origin=("scenario.yaml", files.pop("scenario.yaml")),
        beside=files,
        tool=TOOL,
    )
    steps = round(vectors_s / source.plan.schedule.tick_s)
    inputs = loop_inputs(scenario, target, source, steps, **run_options)
    return source, recorded_vectors(target.diagram, source, inputs)


def export_firmware(
    scenario: Scenario,
    directory: str | os.PathLike[str],
    what: str = "controller",
    *,
    name: str | None = None,
    **options: Any,
) -> Measurement:
    """Write the C code of a scenario to a folder, with test harness, build files and README.

    Parameters
    ----------
    scenario
        The closed loop.
    directory
        The folder to write.
    what
        ``controller``, ``plant`` or ``loop``: the part of the scenario to write.
    name
        Prefix of all C names and file names. None: ``what``.
    options
        Further options of `make_firmware`, such as ``precision="float"``.

    Raises
    ------
    ParameterError, CompilationError
        As in `make_firmware`.
    OutputError
        The folder cannot be written, has files that no export wrote, or has an export with another
        name.
    """
    name = what if name is None else name
    require_export_folder(directory, name)  # before the run, which may take long
    return write_c(directory, *make_firmware(scenario, what, name=name, **options))


def make_sil(
    scenario: Scenario = Scenario(),
    *,
    precision: str = "double",
    vectors_s: float | None = None,
    step_s: float | None = None,
    look_up: bool = False,
) -> Sil:
    """Return controller and plant of a scenario as two models in C, and the program of their loop.

    The plant is in double precision, so ``precision`` and ``look_up`` belong to the controller. The
    test vectors come from a run of the compiled loop by RK4 with the steps of the plant in C. For
    all options and errors see `make_firmware`. Raises `ParameterError` too if the controller reads
    the state of the rod, or the scenario has a bus or a push, which neither model contains.
    """
    require_step(step_s)
    if scenario.push is not None:
        raise ParameterError(
            "push: neither controller nor plant contains the push; leave it out for software in "
            "the loop (--set push=null)"
        )
    if scenario.bus.kind != "none" or scenario.bus.latency_samples:
        raise ParameterError(
            f"bus.kind = {scenario.bus.kind!r}, bus.latency_samples = "
            f"{scenario.bus.latency_samples}: neither controller nor plant contains the bus; must "
            f"be none and 0 for software in the loop"
        )
    if scenario.has_load_cell:
        raise ParameterError(
            f"wearer.kind = {scenario.wearer.kind!r}, controller.kind = "
            f"{scenario.controller.kind!r}: the plant contains neither wearer nor load cell; "
            f"software in the loop needs wearer.kind = none and controller.kind other than torque"
        )
    if "rod_state" in make_target(scenario, "controller", counts=True).inputs:
        raise ParameterError(
            f"estimator.kind = {scenario.estimator.kind!r}: no sensor measures the state of the "
            f"rod; must be observer or difference for software in the loop"
        )
    if step_s is None:
        step_s = largest_step_s(scenario, "plant")
    # Both models get test vectors from the same run.
    shared: dict[str, Any] = {
        "vectors_s": vectors_s,
        "step_s": step_s,
        # The method and the steps of the plant in C, so that a loop without counts of the encoder
        # agrees too.
        "run_options": {"integrator": "rk4", "step_s": step_s},
    }
    controller = make_firmware(
        scenario, "controller", precision=precision, look_up=look_up, **shared
    )
    plant = make_firmware(scenario, "plant", **shared)
    encoder = {ENCODER_COUNT: ("encoder_reading_rad", scenario.encoder.resolution_rad)}
    return Sil(controller, plant, encoder)


def export_sil(
    scenario: Scenario, directory: str | os.PathLike[str], **options: Any
) -> SilMeasurement:
    """Write controller and plant of a scenario in C, and the program of their loop, to a folder.

    Controller and plant have a subfolder each.

    Parameters
    ----------
    scenario
        The closed loop.
    directory
        The folder to write.
    options
        Options of `make_sil`, such as ``precision="float"``.

    Raises
    ------
    ParameterError, CompilationError
        As in `make_sil`.
    OutputError
        The folder cannot be written, or has files that no export of a loop wrote.
    """
    require_sil_folder(directory, "controller", "plant")  # before the run, which may take long
    return write_sil(directory, make_sil(scenario, **options))


def loop_inputs(
    scenario: Scenario, target: Target, source: CSource, steps: int, **run_options: Any
) -> Array:
    """Run the compiled closed loop; return the inputs that ``target`` receives at each step.

    The result has the shape (steps, input elements). Inputs in `OUTSIDE` are zero.
    ``run_options`` has the options ``integrator`` and ``step_s`` of
    `CompiledModel.simulate`.
    """
    sample_time_s = source.plan.schedule.tick_s
    signal_of = {name: name for name in target.inputs if name not in OUTSIDE}
    # The port rod_state is the plant's state, which the loop has as the exact estimate.
    for name, signal in ((ENCODER_COUNT, "encoder_reading"), ("rod_state", "estimated_state")):
        if name in signal_of:
            signal_of[name] = signal
    model = compile_scenario(scenario)
    parameters, state, input_table = scenario_run(scenario, model)
    run = model.simulate(
        parameters,
        state,
        (steps + 1) * sample_time_s,
        outputs=tuple(dict.fromkeys(signal_of.values())),
        record_period_s=sample_time_s,
        inputs=input_table,
        **run_options,
    )
    columns = []
    for name, size in source.equations.inputs.items():
        if name in OUTSIDE:
            values = np.zeros((steps, size))
        elif name == "motor_speed_command":  # a record at t is the command up to t
            values = run[name][1 : steps + 1]
        else:
            values = run[signal_of[name]][:steps]
        if name == ENCODER_COUNT:
            values = np.round(values / scenario.encoder.resolution_rad)
        columns.append(values)
    return np.hstack([*columns, np.zeros((steps, 0))])
