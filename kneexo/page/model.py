"""Makes the data with which a page runs the closed loop of a scenario in a browser.

`web_model` returns values, formulas and names of modules as data for JSON. `web_modules` returns
these modules. `kneexo.page.modules` makes the modules.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from diagramc import CSource, InputTable, input_table
from kneexo.analysis.frequency.sine_estimate import motor_limits
from kneexo.analysis.tracking.limit_cycle import REST_RAD, SMALLEST_CYCLE_DEG, SUSTAINED
from kneexo.analysis.tracking.verdict import ERROR_SHARE, LARGEST_COUNT_DEG
from kneexo.common.result import Array
from kneexo.diagrams.closed_loop import plant_start
from kneexo.diagrams.wearer import moment_of, moment_spline
from kneexo.errors import KneexoError
from kneexo.geometry.linkage import pose
from kneexo.geometry.rod_polynomial import completed
from kneexo.page.faults import (
    direct_maps,
    fault_data,
    is_protected,
    sizes_of,
    with_thrown_faults,
)
from kneexo.page.maps import Map, fit_maps
from kneexo.page.modules import (
    REFERENCES,
    TORQUE_MODES,
    loop_source,
    module_of,
    modules,
    reference_source,
    require_slow_modes,
)
from kneexo.page.sliders import Slider, sliders_of
from kneexo.parameters import (
    LegParameters,
    PushParameters,
    SampledReference,
    Scenario,
    StepReference,
    TorqueParameters,
)
from kneexo.parameters.criteria import SETTLING_BAND
from kneexo.parameters.fields.fields import source_of as provenance_of, unit_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.paths import changed, value_at
from kneexo.simulation.compiled import reference_table, scenario_values, structure_key
from kneexo.systems.cylinder import PA_PER_MPA
from kneexo.systems.knee_reference import context_values, start_angle_rad, start_motion
from kneexo.systems.push import SAME_S

START = "start_angle_rad"
"""Name of the value of the reference at t = 0, which sets the initial state of the plant."""

START_RATE = "start_rate_rad_s"
"""Name of the rate of the reference at t = 0. An active leg of a wearer starts with this rate."""


def with_structure(scenario: Scenario, controller: str, load: str) -> Scenario:
    """Return a scenario with these kinds of controller and load.

    ``controller`` is ``smc``, ``pid`` or one of `TORQUE_MODES`, and ``load`` is ``none`` or
    ``knee``. A part of another kind is replaced by a part with default values. A part of the given
    kind keeps its values.
    """
    mode = {"controller.mode": controller} if controller in TORQUE_MODES else {}
    kinds = {"controller.kind": "torque" if mode else controller, "plant.load.kind": load}
    if scenario.nominal is not None:
        kinds["nominal.load.kind"] = load
    changes = {p: kind for p, kind in kinds.items() if value_at(scenario, p) != kind}
    return scenario.changed(changes | mode)


def web_modules(models: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return a dictionary from key to module, for all modules that results of `web_model` name.

    A module has its ``code`` as base64 and its ``table``; see `diagramc.WasmModule`.
    """
    keys = set()
    for model in models:
        loops = [model[name] for name in _LOOPS if name in model]
        parts = [*loops, *model["references"].values()]
        keys |= {part["module"] for part in parts if "module" in part}
    return {key: modules[key] for key in sorted(keys)}


# --------------------------------------------------------------------------------- models


def web_model(scenario: Scenario) -> dict[str, Any]:
    """Return the data with which a page runs the closed loop of a scenario, ready for JSON.

    ``loop`` and ``smooth``
        The loop with and without quantizers. With a wearer there is no ``smooth``, because the page
        shows margins and bandwidth of position control only. ``module`` is the key of the module.
        ``base`` has the values of the module's ``params``. Each of ``maps`` is a formula, see
        `map_value`, for the parameter with the number ``index``.
    ``quantities``
        The numbers that a user varies, with label, unit, range and source. The numbers of a push
        come last. The page changes the torque on the knee at the samples where a push starts or
        ends.
    ``references``
        ``sine``, ``step`` and ``ramp``, each with module, base, maps and quantities. A sampled
        reference is ``samples``. Its angle is a piecewise polynomial with ``breaks`` and
        ``powers``, both as base64 of doubles; see `InputTable`.
    ``limits``
        Bounds of the signals, each a number, None, or a formula.
    ``faults``
        Faults, protection and safety state machine; see `fault_data`. None for a scenario without
        ``protection`` and ``faults``.
    ``criteria``
        The constants of the metrics, `CRITERIA`.
    ``controller``, ``load``
        The kinds of these parts. A torque controller has its mode in place of the kind.
    ``wearer``, ``moment``
        Whether the loop has a wearer, and the biological moment as a piecewise polynomial or None.
        A loop with a wearer has the input of `IntervalReference`, followed by the moment.

    Raises `ParameterError` for a law that is called as Python, for faults that a page cannot throw,
    and for a mode of the plant that the steps of a module cannot follow. Raises the errors of
    `make_closed_loop`. Raises `CompilationError` if a module must be compiled and Zig is not
    installed.
    """
    faults = fault_data(scenario) if is_protected(scenario) else None
    if faults:
        scenario = with_thrown_faults(scenario, {})
    push = scenario.push or PushParameters()
    scenario = completed(scenario.changed({"push": None}))  # the page pushes between two samples
    require_slow_modes(scenario)
    sliders = dict(sliders_of(scenario))
    if scenario.plant.knee_inertia_kg_m2 is not None:
        del sliders["plant.cylinder.mass_kg"]  # has no effect
    direct = [path for path in sliders if path.startswith("protection.")]  # see `direct_maps`
    ranges = {path: (s.low, s.high) for path, s in sliders.items() if path not in direct}
    values = {path: value_at(scenario, path) for path in ranges}
    required = [START]
    if faults:
        # The detector of the range depends on the size |e| of the error e, which has no formula.
        ranges.pop("encoder.mounting_error_rad", None)
        for size in sizes_of(faults):
            required.append(size["name"])
            ranges[size["name"]] = size["low"], size["high"]
            values[size["name"]] = size["value"]
    ranges[START] = _start_range(scenario)
    values[START], rate = start_motion(scenario.reference)
    leg = scenario.wearer
    if isinstance(leg, LegParameters) and leg.motion == "active":
        required.append(START_RATE)
        ranges[START_RATE], values[START_RATE] = _RATES_RAD_S, rate
    loops = _LOOPS if leg.kind == "none" else _LOOPS[:1]
    can_push = scenario.plant.load.kind == "knee" and leg.kind == "none"  # as `Scenario` requires
    sources = {name: _loop_source(structure_key(scenario), scenario, name) for name in loops}
    numbers = _Numbers(scenario, sources)
    maps, names = fit_maps(numbers, ranges, values, required, scenario.bus.velocity_unit_rad_s)
    base = numbers(values, bounded=True)
    parts = numbers.split(maps)
    if faults:
        parts["loop"] |= direct_maps(scenario, (name for name, _ in _columns(sources["loop"])))
    return {
        **{
            name: {
                # The module has the equations and the page the numbers, so that scenarios of one
                # structure share a module, and a slider needs no server.
                "module": module_of(source),
                "base": base[numbers.places[name]].tolist(),
                "maps": [{"index": index} | formula for index, formula in parts[name].items()],
            }
            for name, source in sources.items()
        },
        "controller": controller_of(scenario),
        "load": scenario.plant.load.kind,
        "wearer": leg.kind != "none",
        "moment": (moment := moment_of(scenario)) and _table(input_table(moment_spline(moment))),
        "quantities": [
            *(_quantity(scenario, p, sliders[p]) for p in (*names, *direct) if p not in required),
            *(_quantity(push, p, s, "push.") for p, s in sliders_of(push) if can_push),
        ],
        "references": _references(scenario),
        "faults": faults,
        "criteria": CRITERIA,
        "limits": _limits(scenario, base[numbers.places["limits"]], parts["limits"]),
    }


CRITERIA = {
    "errorShare": ERROR_SHARE,
    "largestCountDeg": LARGEST_COUNT_DEG,
    "settlingBand": SETTLING_BAND,
    "smallestCycleDeg": SMALLEST_CYCLE_DEG,
    "restRad": REST_RAD,
    "sustained": SUSTAINED,
    "samePushTimeS": SAME_S,
}
"""Constants of the metrics, so that a run on the page is judged as `track` judges it."""


def controller_of(scenario: Scenario) -> str:
    """Return the kind of a scenario's controller, or the mode of a torque controller."""
    controller = scenario.controller
    return controller.mode if isinstance(controller, TorqueParameters) else controller.kind


_RATES_RAD_S = (-20.0, 20.0)
"""Range of the rates with which a leg can start. In walking the largest is about 8 rad/s."""

_LOOPS = ("loop", "smooth")

_sources: dict[tuple[str, str], CSource] = {}


def _loop_source(key: str, scenario: Scenario, name: str) -> CSource:
    """Return the loop ``name`` of `_LOOPS`. Scenarios of the structure ``key`` share this loop."""
    if (key, name) not in _sources:
        _sources[key, name] = loop_source(scenario, smooth=name == "smooth")
    return _sources[key, name]


class _Numbers:
    """Computes the parameters of the modules, and the `_LIMITS`, from values of a scenario.

    ``places`` has the slice of each part of the vector: ``loop``, ``smooth`` and ``limits``.
    """

    def __init__(self, scenario: Scenario, sources: Mapping[str, CSource]) -> None:
        self._scenario = scenario
        self._columns = {name: list(_columns(source)) for name, source in sources.items()}
        self._known: dict[Any, tuple[Scenario, dict[str, Any], list[float]]] = {}
        self.places: dict[str, slice] = {}
        start = 0
        sizes = {name: len(columns) for name, columns in self._columns.items()}
        for name, size in (*sizes.items(), ("limits", len(_LIMITS))):
            self.places[name] = slice(start, start + size)
            start += size

    def __call__(self, values: Mapping[str, float], *, bounded: bool = False) -> Array:
        """Return the vector at ``values``, which has the dotted paths and `START`.

        Unless ``bounded``, the initial pressures of a full order are those of
        `_without_reservoir`, which are smooth functions.
        """
        paths = tuple(
            (name, float(value))
            for name, value in values.items()
            if name not in (START, START_RATE)
        )
        if paths not in self._known:
            change = with_thrown_faults if self._scenario.faults else changed
            self._known[paths] = self._parameters(change(self._scenario, dict(paths)))
        scenario, parameters, limits = self._known[paths]
        start = plant_start(_started_at(scenario, values[START]))
        if START_RATE in values:
            start[_LEG_RATE] = values[START_RATE]
        if scenario.plant.full_order is not None and not bounded:
            start |= _without_reservoir(scenario, start)
        row: list[float] = []
        for name, columns in self._columns.items():
            known = parameters[name] | start
            row += [known.get(column, default) for column, default in columns]
        return np.array(row + limits)

    def _parameters(self, scenario: Scenario) -> tuple[Scenario, dict[str, Any], list[float]]:
        """Return a scenario, the parameters of each loop, and the limits."""
        variants = {"loop": scenario, "smooth": scenario.without_quantizers()}
        parameters = {name: scenario_values(variant) for name, variant in variants.items()}
        return scenario, parameters, [limit(scenario) for limit in _LIMITS.values()]

    def split(self, maps: Mapping[int, Map]) -> dict[str, dict[int, Map]]:
        """Return the formulas of each part of the vector, with indices that start at the part."""
        parts: dict[str, dict[int, Map]] = {}
        for name, place in self.places.items():
            inside = {i - place.start: m for i, m in maps.items() if place.start <= i < place.stop}
            bounds = self._bounds(name)
            parts[name] = {i: m | bounds.get(i, {}) for i, m in inside.items()}
        return parts

    def _bounds(self, name: str) -> dict[int, dict[str, float]]:
        """Return the lower bounds of formulas: no initial pressure is below the reservoir's.

        The result is a dictionary from the index of a parameter to an addition to its formula.
        """
        full = self._scenario.plant.full_order
        if full is None or name not in self._columns:
            return {}
        columns = [column for column, _ in self._columns[name]]
        bound = {"at_least": full.reservoir_pressure_pa / PA_PER_MPA}
        return {columns.index(state): bound for state in _PRESSURES}


def _columns(source: CSource) -> Iterable[tuple[str, float]]:
    """Yield name and default of each member of a module's parameters.

    The name is that of a parameter or continuous state in the compiled model. The default is the
    value of a member that has no such name.
    """
    plan = source.plan
    names = dict(zip(plan.members, plan.equations.parameters, strict=True))
    names |= {f"initial_x[{i}]": state for i, state in enumerate(plan.equations.states)}
    for member, text in source.struct_values.items():
        yield names.get(member, member), float(text)


_PRESSURES = ("plant/cylinder.x[2]", "plant/cylinder.x[3]")
"""Names of the states P_1 and P_2 of a full-order cylinder."""

_LEG_RATE = "wearer.x[1]"
"""Name of the state dθ_h/dt of a leg that is not prescribed."""


def _without_reservoir(scenario: Scenario, start: Mapping[str, float]) -> dict[str, float]:
    """Return the pressure with which each chamber would hold the force at the start by itself.

    The other chamber then has the pressure P_r of the reservoir. The force F = P_1 A_1 − P_2 A_2
    gives P_1 = (F + P_r A_2)/A_1 and P_2 = (P_r A_1 − F)/A_2, smooth functions of the user's
    numbers. One of them is below P_r, unless both are equal to P_r. The page raises this one to P_r
    by ``at_least`` of its formula.
    """
    cylinder, full = scenario.plant.cylinder, scenario.plant.full_order
    assert full is not None
    cap, rod_side = cylinder.cap_area_m2, cylinder.rod_side_area_m2
    first, second = (start[name] for name in _PRESSURES)
    reservoir = full.reservoir_pressure_pa / PA_PER_MPA
    force = first * cap - second * rod_side
    alone = (force + reservoir * rod_side) / cap, (reservoir * cap - force) / rod_side
    return dict(zip(_PRESSURES, alone, strict=True))


def _started_at(scenario: Scenario, angle_rad: float) -> Scenario:
    """Return a scenario whose reference stays at ``angle_rad``."""
    angle_deg = math.degrees(angle_rad)
    reference = StepReference.model_construct(start_deg=angle_deg, end_deg=angle_deg)
    return scenario.model_copy(update={"reference": reference})


def _start_range(scenario: Scenario) -> tuple[float, float]:
    """Return the knee angles in rad around the scenario's start at which the plant can start."""
    knee = scenario.plant.knee
    angles = np.radians(np.linspace(knee.flexion_min_deg, knee.flexion_max_deg, 181))

    def starts(angle: float) -> bool:
        with suppress(KneexoError):
            plant_start(_started_at(scenario, angle))
            return True
        return False

    start = int(np.argmin(np.abs(angles - start_angle_rad(scenario.reference))))
    low = high = start
    while low > 0 and starts(angles[low - 1]):
        low -= 1
    while high < angles.size - 1 and starts(angles[high + 1]):
        high += 1
    return float(angles[low]), float(angles[high])


def _quantity(
    parameters: Parameters, path: str, slider: Slider, prefix: str = ""
) -> dict[str, Any]:
    """Return a quantity that a user varies, as data. Its name is its path behind ``prefix``."""
    parent, _, name = path.rpartition(".")
    holder = value_at(parameters, parent) if parent else parameters
    field, value = type(holder).model_fields[name], getattr(holder, name)
    return slider.quantity(f"{prefix}{path}", value, unit_of(field), provenance_of(field))


# ----------------------------------------------------------------------------- references


def _references(scenario: Scenario) -> dict[str, Any]:
    kinds = REFERENCES if scenario.wearer.kind == "none" else ("sine",)  # see `loop_source`
    references: dict[str, Any] = {kind: _reference(kind, scenario) for kind in kinds}
    if isinstance(scenario.reference, SampledReference):
        references["samples"] = _table(reference_table(scenario.reference))
    return references


def _table(table: InputTable) -> dict[str, str]:
    """Return the first input of a table. The further inputs of a reference are derivatives."""
    return {"breaks": _base64(table.breaks), "powers": _base64(table.coefficients[:, 0])}


def _base64(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def _reference(kind: str, scenario: Scenario) -> dict[str, Any]:
    """Return a reference of ``kind``, with the scenario's values if its reference has this kind."""
    present: Any = scenario.reference
    if present.kind != kind:
        present = REFERENCES[kind]()
    source = reference_source(kind, scenario.controller.sample_time_s)
    sliders = dict(sliders_of(present))

    def evaluate(values: Mapping[str, float]) -> Array:
        parameters = context_values(present.model_copy(update=dict(values)))
        return np.array([parameters[name.partition(".")[2]] for name in source.plan.members])

    ranges = {name: (slider.low, slider.high) for name, slider in sliders.items()}
    maps, names = fit_maps(evaluate, ranges, {name: getattr(present, name) for name in ranges})
    prefix = "reference."
    named = [m | {"of": [prefix + name for name in m["of"]]} for m in maps.values()]
    return {
        "module": module_of(source),
        "base": evaluate({}).tolist(),
        "maps": [{"index": index} | m for index, m in zip(maps, named, strict=True)],
        "quantities": [_quantity(present, name, sliders[name], prefix) for name in names],
    }


# --------------------------------------------------------------------------------- limits


def _relief_pressure(scenario: Scenario) -> float:
    full = scenario.plant.full_order
    return math.inf if full is None else full.relief_pressure_pa


_LIMITS: Mapping[str, Callable[[Scenario], float]] = {
    "command_limit_rad_s": lambda scenario: scenario.command_limit_rad_s,
    "motor_speed_limit_rad_s": lambda scenario: motor_limits(scenario)[0],
    "motor_acceleration_limit_rad_s2": lambda scenario: motor_limits(scenario)[1],
    "pressure_rating_pa": lambda scenario: scenario.plant.cylinder.pressure_rating_pa,
    "relief_pressure_pa": _relief_pressure,
}
"""Functions that return a bound of a signal; inf: the scenario has no such bound."""


def _limits(scenario: Scenario, values: Array, maps: Mapping[int, Map]) -> dict[str, Any]:
    """Return the bound of each signal: a formula, a number, or None without a bound."""
    knee = scenario.plant.knee
    numbers = [None if math.isinf(value) else value for value in values.tolist()]
    return {
        **{name: maps.get(n, numbers[n]) for n, name in enumerate(_LIMITS)},
        "knee_low_rad": math.radians(knee.flexion_min_deg),
        "knee_high_rad": math.radians(knee.flexion_max_deg),
        "encoder_count_knee_deg": _encoder_count(scenario),
    }


def _encoder_count(scenario: Scenario) -> dict[str, Any] | None:
    """Return the knee angle in deg of one count over the range of motion; None if not quantized."""
    if not scenario.encoder.quantized:
        return None
    knee = scenario.plant.knee
    angles = np.linspace(knee.flexion_min_deg, knee.flexion_max_deg, 91)
    sensitivity = pose(scenario.plant.linkage, np.radians(angles)).encoder_sensitivity
    count_deg = math.degrees(scenario.encoder.resolution_rad) * np.abs(sensitivity)
    return {
        "low_deg": knee.flexion_min_deg,
        "high_deg": knee.flexion_max_deg,
        # One value a degree: the page takes a cubic between them. A straight line was off by 3e-5.
        "values": count_deg.tolist(),
    }
