"""C for the microcontroller: a target of a scenario, with test vectors of its closed loop."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from kneexo.compiler.c.export import (
    Measurement,
    exported,
    require_export_folder,
    source_of,
    write_export,
)
from kneexo.compiler.c.source import CSource
from kneexo.compiler.c.vectors import Vectors, recorded_vectors
from kneexo.compiler.model import compile_diagram
from kneexo.errors import ParameterError
from kneexo.export.target import ENCODER_COUNT, Target, require_step, target
from kneexo.parameters import SampledReference, Scenario
from kneexo.result import Array
from kneexo.simulation.compiled import compile_scenario, scenario_run

OUTSIDE = ("disturbance_force", "knee_torque")
"""Inputs that nothing in the closed loop feeds."""

VECTORS_S = 2.0
"""Time that the test vectors cover by default, or the whole run where that is shorter."""


def make_firmware(
    scenario: Scenario = Scenario(),
    what: str = "controller",
    *,
    precision: str = "double",
    vectors_s: float | None = None,
    step_s: float | None = None,
    look_up: bool = False,
) -> tuple[CSource, Vectors]:
    """A target of a scenario as C99, and test vectors: steps of its compiled closed loop.

    Parameters
    ----------
    scenario
        The closed loop; a custom controller too.
    what
        ``controller``, ``plant`` or ``loop``: see `target`. A controller that reads a quantized
        encoder takes its count as int32_t.
    precision
        ``double`` or ``float``.
    vectors_s
        Time that the test vectors cover; at most the duration of the scenario. `VECTORS_S` by
        default.
    step_s
        Largest step of RK4, where there are continuous states; `rk4_step_s` by default.
    look_up
        Knee angle and rod extension of each count come from a table: see `CSource`.

    Raises
    ------
    ParameterError
        ``what``, ``vectors_s`` or ``step_s`` is wrong, the reference of a loop is sampled, and as
        `make_closed_loop`.
    CompilationError
        The target cannot be printed: as `CSource`.
    SimulationError
        The closed loop does not run.
    """
    require_step(step_s)
    if what == "loop" and isinstance(scenario.reference, SampledReference):
        raise ParameterError(
            f"reference.kind = {scenario.reference.kind!r}: a loop in C computes its reference, "
            f"which must not be sampled; export plant and controller, or the loop as FMU"
        )
    duration_s = scenario.simulation.duration_s
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
    to_print = target(scenario, what, counts=True)
    model = compile_diagram(to_print.diagram, inputs=to_print.inputs)
    source = source_of(
        model,
        to_print.what,
        precision=precision,
        outputs=to_print.outputs,
        interface=to_print.interface,
        tick_s=to_print.tick_s,
        step_s=step_s,
        look_up=look_up,
        subject=f"{to_print.what} in {precision} precision",
    )
    steps = round(vectors_s / source.plan.schedule.tick_s)
    inputs = loop_inputs(scenario, to_print, source, steps)
    return source, recorded_vectors(to_print.diagram, source, inputs)


def export_firmware(
    scenario: Scenario,
    directory: str | os.PathLike[str],
    what: str = "controller",
    **options: Any,
) -> Measurement:
    """Write `make_firmware` into a folder: sources, vectors, harness, build files, README.

    ``options`` are those of `make_firmware`. Raises `OutputError` where the folder has other files,
    and what `make_firmware` raises.
    """
    require_export_folder(directory)
    files, measurement = exported(*make_firmware(scenario, what, **options))
    write_export(directory, files)
    return measurement


def loop_inputs(scenario: Scenario, of: Target, source: CSource, steps: int) -> Array:
    """Inputs of each step of a target in the scenario's closed loop, (steps, input elements).

    What comes from outside, such as a disturbance, is zero.
    """
    sample_time = source.plan.schedule.tick_s
    ports = {ENCODER_COUNT: "encoder_reading", "rod_state": "estimated_state"}
    wanted = [ports.get(name, name) for name in of.inputs if name not in OUTSIDE]
    model = compile_scenario(scenario)
    parameters, state, table = scenario_run(scenario, model)
    run = model.simulate(
        parameters,
        state,
        (steps + 1) * sample_time,
        outputs=tuple(dict.fromkeys(wanted)),
        record_period_s=sample_time,
        inputs=table,
    )
    columns = []
    for name, size in source.equations.inputs.items():
        if name in OUTSIDE:
            values = np.zeros((steps, size))
        elif name == "motor_speed_command":  # a record at t is the command up to t
            values = run[name][1 : steps + 1]
        else:
            values = run[ports.get(name, name)][:steps]
        if name == ENCODER_COUNT:
            values = np.round(values / scenario.encoder.resolution_rad)
        columns.append(values)
    return np.hstack([*columns, np.zeros((steps, 0))])
