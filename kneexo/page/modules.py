"""Makes the WebAssembly modules of closed loops and references.

Modules of common structures come with the package. Zig compiles all others.
``python -m kneexo.page.modules`` compiles the modules of the package again.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args

import numpy as np

from diagramc import (
    CSource,
    Interface,
    read_diagram,
    source_of,
    wasm_files,
    wasm_module,
    wasm_table,
    write_files,
)
from kneexo.common import PACKAGE
from kneexo.diagrams.closed_loop import available_signals, make_closed_loop
from kneexo.diagrams.plant import moving_masses_kg
from kneexo.diagrams.signals import SIGNALS
from kneexo.errors import ParameterError
from kneexo.geometry.linkage import moment_arm
from kneexo.page.faults import with_thrown_faults
from kneexo.parameters import (
    LegParameters,
    RampReference,
    Scenario,
    SineReference,
    StepReference,
    TorqueParameters,
)
from kneexo.parameters.paths import value_at
from kneexo.parameters.presets import with_preset
from kneexo.simulation.compiled import why_python_in_run
from kneexo.systems import IntervalReference, make_knee_reference

PERTURBATION = "plant:motor_speed_command"
"""Name of the port at which an input of the module perturbs the loop."""

OUTPUTS = (
    *("knee_angle", "rod_extension", "sliding_variable", "motor_speed_command", "motor_speed"),
    *("load_pressure", "rod_force", "moment_arm", "shaft_power", "hydraulic_power"),
    *("motor_current", "motor_temperatures"),
    *("chamber_pressures", "relief_flow", "interaction_torque", "wearer_motion"),
)
"""Names of the signals that the module of a loop outputs, if the scenario has them."""

PROTECTED_OUTPUTS = ("safety_state", "safety_reason")
"""Names of the further signals that the module of a loop with protection outputs."""

INTERVAL = (
    "interval_start_s",
    "interval_break_s",
    *(f"before_{n}_rad" for n in range(8)),
    *(f"after_{n}_rad" for n in range(4)),
)
"""Names of the elements of the input ``interval`` of `IntervalReference`."""

REFERENCES: Mapping[str, Any] = {
    "sine": SineReference,
    "step": StepReference,
    "ramp": RampReference,
}
"""The references that have a module."""

TORQUE_MODES: tuple[str, ...] = get_args(TorqueParameters.model_fields["mode"].annotation)
"""The modes of the torque controller. On a page each mode is a kind of controller."""

_INTERVAL_S = 0.002
_STEPS = 15
"""Number of steps of RK4 in `_INTERVAL_S` for the reduced order of the cylinder.

The fastest oscillation of the reduced order, 447 Hz, turns by 0.37 rad in a step, so the load
pressure of a saturating loop has an error of 0.4 %.
"""

_SMOOTH_STEPS = 200
"""Number of steps of RK4 in 2 ms for the loop without quantizers, whose short runs give margins.

Without leakage the oil is nearly undamped, and its resonance sets the gain margin. With 30 steps,
RK4 would add 60 % to this damping.
"""

_TOLERANCE, _SMOOTH_TOLERANCE = 1e-6, 1e-12
"""Tolerances of the Rosenbrock method for the full order, with and without quantizers.

At 1e-6 the load pressure of the presets ``leg`` and ``wearer`` has errors up to 7e-4 of its peak,
and the metrics up to 2e-5. A page shows three digits. The loop without quantizers makes short runs,
whose differences give the margins.
"""

_OIL_ANGLE, _STABLE = 0.56, 2.7
"""Largest accepted product of step and rate, for the resonance of the oil and for a decaying mode.

At 0.56 the errors of RK4 reach 10 % of the load pressure; see `rk4_step_s`. Beyond 2.78 RK4 is
unstable.
"""

SHIPPED: Mapping[str, Mapping[str, Any]] = {
    "paper": {},
    "paper with load": {"plant": {"load": "knee"}},
    "bench": with_preset("bench", {}),
    "leg": with_preset("leg", {}),
    "leg without load": with_preset("leg", {"plant": {"load": "none"}}),
    "protected": with_preset("protected", {}),
}
"""Scenarios whose modules come with the package, with sliding mode and with PID.

The modules of the preset ``wearer`` come too, with the modes that need no biological moment.
"""

_FOLDER = ("data", "web")


def loop_source(scenario: Scenario, *, smooth: bool = False) -> CSource:
    """Return the closed loop of a scenario in C. The reference is an input.

    Another input perturbs the motor speed that the plant receives. ``smooth`` leaves out the
    quantizers. The leg of a wearer moves between two samples, so a loop with a wearer has the input
    of `IntervalReference` in place of a reference. Such a loop also has the biological moment at
    the samples as an input. Raises `ParameterError` for a law that is called as Python, and for a
    motion of the wearer that a page cannot follow. Raises the errors of `make_closed_loop`.
    """
    if reason := why_python_in_run(scenario):
        raise ParameterError(
            f"controller: the law has no web module, because it is called as Python: {reason}"
        )
    scenario = scenario.without_quantizers() if smooth else scenario
    if value_at(scenario, "plant.load.kind") == "knee":
        # With a fixed factor of zero the equations suit every value of the parameters.
        scenario = scenario.changed({"plant.load.disturbance_amplitude_n": 0.0})
    outputs = OUTPUTS if scenario.protection is None else OUTPUTS + PROTECTED_OUTPUTS
    names = [name for name in outputs if name in available_signals(scenario)]
    diagram, inputs = _diagram(scenario)
    inputs |= {PERTURBATION: ("command_perturbation_rad_s",)}
    method: dict[str, Any] = {"step_s": _INTERVAL_S / (_SMOOTH_STEPS if smooth else _STEPS)}
    if scenario.plant.full_order is not None:  # has valves and friction
        tolerance = _SMOOTH_TOLERANCE if smooth else _TOLERANCE
        method = {"integrator": "rosenbrock", "tolerance": tolerance}
    return source_of(
        read_diagram(diagram, inputs=[*inputs]),
        "loop",
        outputs=names,
        interface=Interface({name: SIGNALS[name] for name in names} | inputs),
        tick_s=scenario.controller.sample_time_s,
        checks_steps=False,  # `require_slow_modes` has refused fast modes
        **method,
    )


def _diagram(scenario: Scenario) -> tuple[Any, dict[str, tuple[str, ...]]]:
    """Return the diagram of a loop, and its open ports with the names of their elements."""
    if scenario.wearer.kind == "none":
        diagram = make_closed_loop(scenario, signals=(), external_reference=True)
        return diagram, {"knee_reference": SIGNALS["knee_reference"]}
    _require_motion(scenario)
    reference = IntervalReference(scenario.controller.sample_time_s)
    diagram = make_closed_loop(scenario, reference=reference, signals=(), external_moment=True)
    inputs = {"reference:interval": INTERVAL}
    if (moment := "biological_moment") in available_signals(scenario):
        inputs[moment] = SIGNALS[moment]
    return diagram, inputs


def _require_motion(scenario: Scenario) -> None:
    """Raise `ParameterError` if a page cannot follow the motion of a wearer between samples."""
    reference, leg, period = scenario.reference, scenario.wearer, scenario.controller.sample_time_s
    if reference.kind not in ("sine", "samples"):
        raise ParameterError(
            f"reference.kind = {reference.kind!r}: must be 'sine' or 'samples' on a page with a "
            f"wearer, because the page has only their motion between two samples"
        )
    if reference.kind == "samples" and (gap := min(np.diff(reference.times_s))) < period:
        raise ParameterError(
            f"reference.times_s: rises by {gap:g} s; must rise by at least the control period "
            f"{period:g} s on a page with a wearer"
        )
    if isinstance(leg, LegParameters) and leg.motion == "active" and leg.moment is not None:
        raise ParameterError(
            "wearer.motion = 'active': a page gets the biological moment at the samples only; "
            "must be 'prescribed' or 'passive' with wearer.moment; kneexo simulate runs this leg"
        )


def require_slow_modes(scenario: Scenario) -> None:
    """Raise `ParameterError` if the steps of RK4 are too long for the plant's fastest mode.

    RK4 serves the reduced order of the cylinder. Its oil resonates at √(4β_e Ā²/(V_t m)) (Eq. 15,
    16), where m is the least mass that moves with the rod in the range of motion. The damping b_c
    of a cuff makes a mode of b_c/(m r²), largest at the least moment arm r. A rod swings at √(k/m)
    on an end stop k. A motor with shorted windings slows down with k_t²/(R J).
    """
    if scenario.plant.full_order is not None:
        return
    for name, unit, rate, angle, power in _modes(scenario):
        highest = angle * _STEPS / _INTERVAL_S
        if rate > highest:
            value = value_at(scenario, name)
            raise ParameterError(
                f"{name} = {value:g} {unit}: makes a mode of {rate:.3g} 1/s, "
                f"which a page cannot follow; must be at {'least' if power > 0 else 'most'} "
                f"{value * (rate / highest) ** power:.3g} {unit} here"
            )


def _modes(scenario: Scenario) -> Iterator[tuple[str, str, float, float, int]]:
    """Yield path and unit of a parameter, the rate of its mode in 1/s, an angle, and a power.

    The angle is the largest accepted product of step and rate. A value of the parameter is
    multiplied by (rate/accepted rate)^power to give the limit of the parameter.
    """
    plant = scenario.plant
    cylinder = plant.cylinder
    mass_kg, _ = moving_masses_kg(plant)
    spring = 4.0 * cylinder.bulk_modulus_pa * cylinder.mean_area_m2**2
    rate = math.sqrt(spring / (cylinder.total_volume_m3 * mass_kg))
    name, unit = "plant.cylinder.mass_kg", "kg"
    if plant.knee_inertia_kg_m2 is not None:
        name, unit = "plant.load.inertia_kg_m2", "kg·m²"
    yield name, unit, rate, _OIL_ANGLE, 2
    if plant.end_stops is not None:
        rate = math.sqrt(plant.end_stops.stiffness_n_per_m / mass_kg)
        yield "plant.end_stops.stiffness_n_per_m", "N/m", rate, _STABLE, -2
    motor, protection = plant.motor, scenario.protection
    if motor is not None and protection is not None and protection.safe_state == "dynamic_brake":
        rate = motor.torque_constant_n_m_per_a**2 / (motor.resistance_ohm * motor.inertia_kg_m2)
        yield "plant.motor.inertia_kg_m2", "kg·m²", rate, _STABLE, 1
    if isinstance(leg := scenario.wearer, LegParameters):
        knee = plant.knee
        angles = np.radians(np.linspace(knee.flexion_min_deg, knee.flexion_max_deg, 91))
        arms = moment_arm(plant.linkage, angles)
        inertia = float(np.min(plant.moving_mass_kg(arms) * arms**2))
        rate = leg.cuff.damping_n_m_s_per_rad / inertia
        yield "wearer.cuff.damping_n_m_s_per_rad", "N·m·s/rad", rate, _STABLE, -1


@lru_cache(maxsize=16)
def reference_source(kind: str, sample_time_s: float) -> CSource:
    """Return one of the `REFERENCES` in C, which outputs the reference at each sample."""
    system = make_knee_reference(REFERENCES[kind]())
    interface = Interface({"knee_reference": SIGNALS["knee_reference"]})
    return source_of(read_diagram(system), kind, tick_s=sample_time_s, interface=interface)


def module_key(source: CSource) -> str:
    """Return a digest of a model's C without comments and without the values of the parameters.

    Versions of Python and Drake do not change the digest.
    """
    texts = [text for name, text in wasm_files(source).items() if not name.endswith("_params.c")]
    code = re.sub(r"/\*.*?\*/|\s+", " ", "".join(texts), flags=re.DOTALL)
    return hashlib.sha256(code.encode()).hexdigest()[:16]


modules: dict[str, dict[str, Any]] = {}
"""The modules that `module_of` has provided, by key: ``code`` as base64, and ``table``."""


def module_of(source: CSource) -> str:
    """Provide the module of a model in `modules`; return the module's key."""
    key = module_key(source)
    if key not in modules:
        # From the package where possible, because Zig is an extra.
        file = files("kneexo").joinpath(*_FOLDER, f"{key}.wasm")
        code = file.read_bytes() if file.is_file() else wasm_module(source).code
        table = wasm_table(source) | {"sha256": hashlib.sha256(code).hexdigest()}
        del table["defaults"]  # another scenario of the same structure may have made the module
        modules[key] = {"code": base64.b64encode(code).decode(), "table": table}
    return key


def shipped_sources() -> Iterator[tuple[str, CSource]]:
    """Yield description and C of each module that comes with the package."""
    for name, values in SHIPPED.items():
        for controller in ("smc", "pid"):
            scenario = Scenario.model_validate({**values, "controller": controller})
            if scenario.protection is not None:
                scenario = with_thrown_faults(scenario, {})
            for smooth in (False, True):
                kind = "without quantizers" if smooth else "with quantizers"
                yield f"{name}, {controller}, {kind}", loop_source(scenario, smooth=smooth)
    for mode in TORQUE_MODES:
        if mode != "assist":
            law = {"kind": "torque", "mode": mode}
            worn = Scenario.model_validate(with_preset("wearer", {"controller": law}))
            yield f"wearer, {mode}", loop_source(worn)
    period = Scenario().controller.sample_time_s
    for kind in REFERENCES:
        yield f"reference {kind}, {period:g} s", reference_source(kind, period)


def write_shipped(folder: Path) -> None:
    """Compile the modules that come with the package, and write them and their list to a folder.

    The folder gets ``KEY.wasm`` for each module, and ``modules.json`` with the version of Zig and a
    description by key. Other modules in the folder are deleted.
    """
    shipped = {module_key(source): (name, source) for name, source in shipped_sources()}
    compiled = {f"{key}.wasm": wasm_module(source).code for key, (_, source) in shipped.items()}
    listed = {"zig": version("ziglang"), "modules": {k: name for k, (name, _) in shipped.items()}}
    write_files(folder, compiled | {"modules.json": json.dumps(listed, indent=1) + "\n"})
    for file in folder.glob("*.wasm"):
        if file.name not in compiled:
            file.unlink()


if __name__ == "__main__":
    write_shipped(PACKAGE.joinpath(*_FOLDER))
