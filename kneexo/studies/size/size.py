"""Sizing: bandwidth and error for different hardware, and the smallest hardware that walks.

The closed forms are in `kneexo.studies.hardware`. This study simulates: it varies a scenario's
hardware, and searches for the smallest hardware with which the closed loop walks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Unpack

import numpy as np

from kneexo.analysis.frequency.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.frequency.frequency_response import require_sine
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.signals import to_rpm
from kneexo.analysis.tracking.tracking import track
from kneexo.analysis.walking.stride import smallest_piston_factor
from kneexo.analysis.walking.walking import walk, walking_demand, walking_metrics
from kneexo.common.result import Array
from kneexo.errors import KneexoError, ParameterError, failure_noted
from kneexo.parameters import (
    UNCERTAIN_KNEE,
    FullCylinderParameters,
    KneeLoadParameters,
    Scenario,
)
from kneexo.parameters.paths import changed, value_at
from kneexo.simulation import needs_runs
from kneexo.studies.assessment import assess
from kneexo.studies.hardware import (
    ACCELERATION_LIMIT,
    DISPLACEMENT,
    HARDWARE,
    expected_bandwidth_hz,
    scaled,
    tuned,
    with_piston,
)
from kneexo.studies.size.result import Search, SizeResult, WalkingDesign
from kneexo.studies.size.settings import SizeSettings
from kneexo.sweeps import SweepOptions, open_sweep

_IMPLICIT_STEP_S = 1e-3


# ------------------------------------------------------- pieces of work: plain data in, out


@needs_runs
def _at_reference(scenario: Scenario) -> dict[str, Any]:
    """Return a dictionary with bandwidths and errors at the scenario's sine.

    If a computation fails, its numbers are nan, and ``failure`` has the reason.
    """
    errors = ("max_error_deg", "rms_error_deg", "mean_command_change_rpm")
    names = ("expected_bandwidth_hz", "bandwidth_hz", "small_signal_bandwidth_hz", *errors)
    row: dict[str, Any] = dict.fromkeys(names, math.nan)
    failures: dict[str, str] = {}
    row["expected_bandwidth_hz"] = expected_bandwidth_hz(scenario)
    with failure_noted(failures, "large signal"):
        row["bandwidth_hz"] = large_signal_bandwidth_hz(scenario)
    with failure_noted(failures, "small signal"):
        loop = linearize_loop(scenario, knee_angle_deg=require_sine(scenario).mean_deg)
        row["small_signal_bandwidth_hz"] = loop.bandwidth_hz() if loop.stable else math.nan
    with failure_noted(failures, "tracking"):
        metrics = track(scenario).metrics
        row |= {name: getattr(metrics, name) for name in errors}
    return row | {"failure": "; ".join(filter(None, failures.values()))}


# ---------------------------------------------------------------------------------- search


def smallest(
    error_deg: Callable[[float], float],
    low: float,
    high: float,
    *,
    bound_deg: float,
    tolerance: float,
) -> Search:
    """Search for the smallest value in ``low`` … ``high`` (> 0) with an error up to ``bound_deg``.

    The search bisects the value's logarithm until the result is known to the relative
    ``tolerance``. The search assumes that the error does not increase with the value. A nan error
    exceeds every bound. If the error at ``high`` exceeds the bound, the search tries nine values
    from ``low`` to ``high`` and returns the value of least error.
    """
    at_low, at_high = error_deg(low), error_deg(high)
    if at_low <= bound_deg:
        return Search(low, at_low, True, low, high)
    if not at_high <= bound_deg:
        values = np.geomspace(low, high, 9)[1:-1].tolist()
        errors = [at_low, *(error_deg(value) for value in values), at_high]
        best = int(np.argmin([math.inf if math.isnan(error) else error for error in errors]))
        value = [low, *values, high][best]
        return Search(value, errors[best], errors[best] <= bound_deg, low, high)
    value, worse = high, low
    while value > worse * (1.0 + tolerance):
        middle = math.sqrt(value * worse)
        error = error_deg(middle)
        if error <= bound_deg:
            value, at_high = middle, error
        else:
            worse = middle
    return Search(value, at_high, True, low, high)


# ---------------------------------------------------------------------------------- results


def size_study(
    scenario: Scenario = UNCERTAIN_KNEE,
    settings: SizeSettings = SizeSettings(),
    **options: Unpack[SweepOptions],
) -> SizeResult:
    """Vary the hardware of a scenario, then size the hardware for walking.

    1. Vary one hardware value at a time, then flow and acceleration limit together. Measure
       bandwidth and error with the scenario's own sine.
    2. Compute the motion and load that the measured gait requires (`walking_demand`).
    3. Choose λ, k/Φ and T_f for walking at the highest stride frequency, with ample flow and
       acceleration. Among the gains that keep the disk margin and do not chatter, choose the gains
       with the least error.
    4. For each stride frequency, search for the smallest flow (by the pump's displacement) with
       ample acceleration. Then, with a margin on this flow, search for the smallest acceleration
       limit.
    5. Measure pressure and power of these designs at a small step. Enlarge piston and pump if the
       piston cannot carry the share of the measured moment in a whole stride, with the margin
       (`kneexo.analysis.stride_load`). Let the first design walk on other plants, and with its
       hardware values varied.

    Parameters
    ----------
    scenario
        A scenario with a sine as reference and a sliding-mode controller behind an observer.
    settings
        Hardware values, stride frequencies, limits on error and margin, and the other plants.
    options
        Workers, checkpoint and progress: see `kneexo.sweeps.SweepOptions`.

    Raises
    ------
    ParameterError
        The reference is not a sine that moves, the controller is not a sliding mode with an
        observer, the motor has no limits, or no gains let the knee walk.
    """
    scenario = scenario.undisturbed()
    require_sine(scenario)
    if scenario.controller.kind != "smc" or scenario.estimator.kind != "observer":
        raise ParameterError(
            f"controller.kind = {scenario.controller.kind}, estimator.kind = "
            f"{scenario.estimator.kind}: sizing needs smc and observer, which it tunes for walking"
        )
    if scenario.plant.ideal_motor:
        raise ParameterError("plant.ideal_motor = true: has no limits to size; must be false")
    with open_sweep(**options) as sweep:

        def run(function: Callable[[Any], Any], items: Sequence[Any], text: str = "") -> list[Any]:
            """Map like the sweep, but compute equal items once."""
            distinct = list(dict.fromkeys(items))
            by_item = dict(zip(distinct, sweep.map(function, distinct, text), strict=True))
            return [by_item[item] for item in items]

        return _sizing(scenario, settings, run)


def _sizing(scenario: Scenario, settings: SizeSettings, run: Any) -> SizeResult:
    frequencies = settings.stride_frequencies_hz
    walking = partial(walking_metrics, cycles=settings.cycles)
    walking_first = partial(walking, frequency_hz=frequencies[0])

    demands = [walking_demand(scenario, f) for f in frequencies]
    segment_demands, torque_demands = [], {}
    if inertia := _shank_inertia(scenario):
        shank = changed(scenario, inertia)
        segment_demands = [walking_demand(shank, f) for f in frequencies]
        for torque in settings.wearer_torques_n_m:
            other = changed(shank, {"plant.load.knee_torque_n_m": torque})
            torque_demands[torque] = walking_demand(other, frequencies[0])

    nominal, *swept = run(
        _at_reference,
        [scenario, *(scaled(scenario, factors) for factors in _one_at_a_time(settings.factors))],
        "hardware: bandwidth and error",
    )
    bandwidths = run(
        partial(assess, tracking=False, margins=False, bandwidth=True),
        [scaled(scenario, factors) for factors in _pairs(settings.factors)],
        "flow and acceleration: bandwidth",
    )

    piston = max(1.0, settings.margin * smallest_piston_factor(scenario, settings.moment_share))
    largest = {
        DISPLACEMENT: settings.largest_flow_factor,
        ACCELERATION_LIMIT: settings.acceleration_limit_max_rad_s2
        / scenario.plant.pump.acceleration_limit_rad_s2,
    }
    ample = scaled(scenario, largest)
    gains = _tried_gains(ample, settings, run)
    best = _best(gains)

    unchanged = changed(scenario, {p: value_at(scenario, p) * f for p, f in largest.items()})
    stages = {
        "hardware as it is": scenario,
        "ample hardware, controller as it is": unchanged,
        "and η, Φ grown with the flow": ample,
        "and λ, k/Φ, T_f for walking": tuned(ample, best),
    }
    by_frequency = [
        run(partial(walking, frequency_hz=f), list(stages.values())) for f in frequencies
    ]
    steps = dict(zip(stages, map(list, zip(*by_frequency, strict=True)), strict=True))

    designs = [_design(scenario, settings, best, f, piston, run) for f in frequencies]
    first = designs[0].scenario
    variations = _variations(first, designs[0].flow.value * settings.margin, settings)
    results = run(walking_first, list(variations.values()))
    factors = settings.walking_factors
    around = [*_one_at_a_time(factors), *_pairs(factors)]
    walks = run(walking_first, [scaled(first, values) for values in around], "around the design")
    traces: dict[str, Mapping[str, Array]] = {"nominal": {}, "sized": {}}
    finely = first.with_steps(settings.check_step_s)
    for name, plant in (("nominal", scenario), ("sized", finely)):
        with suppress(KneexoError):
            traces[name] = walk(plant, frequencies[0], settings.cycles)
    return SizeResult(
        scenario=scenario,
        settings=settings,
        nominal=nominal,
        sweeps=_by_path(swept, settings.factors),
        bandwidth_map_hz=np.reshape(
            [metrics["bandwidth_hz"] for metrics in bandwidths], (len(settings.factors), -1)
        ),
        demands=demands,
        segment_demands=segment_demands,
        torque_demands=torque_demands,
        gains=gains,
        best_gains=best,
        steps=steps,
        designs=designs,
        design_at_reference=run(_at_reference, [first])[0],
        variations=dict(zip(variations, results, strict=True)),
        walking_sweeps=_by_path(walks[: len(HARDWARE) * len(factors)], factors),
        walking_map_deg=np.reshape(
            [w["max_error_deg"] for w in walks[len(HARDWARE) * len(factors) :]], (len(factors), -1)
        ),
        traces=traces,
    )


def _tried_gains(ample: Scenario, settings: SizeSettings, run: Any) -> list[dict[str, Any]]:
    """Return a row for each set of gains, with metrics and margins at the highest stride frequency.

    ``ample`` has the hardware with ample flow and acceleration. The row has ``meets``, the result
    of `_meets`.
    """
    tried = [
        {"lambda_per_s": lambda_, "slope_per_s": slope, "observer_s": observer}
        for observer in settings.observer_s
        for slope in settings.slope_per_s
        for lambda_ in settings.lambda_per_s
    ]
    highest_hz = max(settings.stride_frequencies_hz)
    walking = partial(walking_metrics, cycles=settings.cycles, frequency_hz=highest_hz)
    loops = [tuned(ample, gains) for gains in tried]
    walks = run(walking, loops, "gains for walking")
    margins = run(partial(assess, tracking=False), loops)
    peaks = walking_demand(ample, highest_hz).peaks()
    mean_acceleration_rad_s2 = peaks["mean_motor_acceleration_rad_s2"]
    asked_change_rpm = to_rpm(mean_acceleration_rad_s2 * ample.controller.sample_time_s)
    rows = []
    for gains, walk_values, margin_values in zip(tried, walks, margins, strict=True):
        row = gains | walk_values | margin_values
        rows.append(row | {"meets": _meets(row, settings, asked_change_rpm)})
    return rows


def _one_at_a_time(factors: Sequence[float]) -> list[dict[str, float]]:
    return [{path: factor} for path in HARDWARE for factor in factors]


def _by_path(results: Sequence[Any], factors: Sequence[float]) -> dict[str, Sequence[Any]]:
    """Return a dictionary from a hardware value's path to its results.

    ``results`` has the order of ``_one_at_a_time``.
    """
    count = len(factors)
    return {path: results[n * count : (n + 1) * count] for n, path in enumerate(HARDWARE)}


def _pairs(factors: Sequence[float]) -> list[dict[str, float]]:
    return [{ACCELERATION_LIMIT: a, DISPLACEMENT: flow} for a in factors for flow in factors]


def _meets(result: Mapping[str, Any], settings: SizeSettings, asked_change_rpm: float) -> bool:
    """Return True if the gains keep the required disk margin and the knee walks without chattering.

    ``asked_change_rpm`` is the mean change of command per sample that the motion itself requires.
    """
    allowed = settings.command_change_ratio_max * asked_change_rpm
    return bool(
        result["disk_margin"] >= settings.disk_margin_min
        and result["mean_command_change_rpm"] <= allowed
    )


def _best(gains: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Choose gains: return the gains of least error among the gains that meet the requirements.

    The row of such gains has ``meets``. If there are none, return the gains of least error among
    all gains that let the knee walk. Raises `ParameterError` if no gains let the knee walk.
    """
    walk_at_all = [row for row in gains if not math.isnan(row["max_error_deg"])]
    if not walk_at_all:
        raise ParameterError(
            f"none of {len(gains)} gains lets the knee walk; widen lambda_per_s, slope_per_s or "
            f"observer_s (the last run: {gains[-1]['failure']})"
        )
    candidates = [row for row in walk_at_all if row["meets"]] or walk_at_all
    return min(candidates, key=lambda row: float(row["max_error_deg"]))


def _design(
    scenario: Scenario,
    settings: SizeSettings,
    gains: Mapping[str, Any],
    frequency_hz: float,
    piston: float,
    run: Any,
) -> WalkingDesign:
    walking = partial(walking_metrics, frequency_hz=frequency_hz, cycles=settings.cycles)
    own_limit = scenario.plant.pump.acceleration_limit_rad_s2

    def sized(flow: float, limit: float) -> Scenario:
        factors = {DISPLACEMENT: flow, ACCELERATION_LIMIT: limit / own_limit}
        return tuned(scaled(scenario, factors), gains)

    def error_deg(flow: float, limit: float) -> float:
        return float(run(walking, [sized(flow, limit)])[0]["max_error_deg"])

    low, high = settings.acceleration_limit_min_rad_s2, settings.acceleration_limit_max_rad_s2
    needed = {"bound_deg": settings.error_bound_deg, "tolerance": settings.search_tolerance}
    flow = smallest(lambda f: error_deg(f, high), 1.0, settings.largest_flow_factor, **needed)
    sized_flow = settings.margin * flow.value
    acceleration = smallest(lambda a: error_deg(sized_flow, a), low, high, **needed)
    design = sized(sized_flow, settings.margin * acceleration.value)
    check = settings.check_step_s  # small enough for the oil's mode
    solvers = [design, *(design.with_steps(step) for step in (check, 0.5 * check))]
    carrying = with_piston(design, piston)
    walks = run(walking, [*solvers, carrying])
    return WalkingDesign(frequency_hz, flow, acceleration, design, carrying, *walks)


def _shank_inertia(scenario: Scenario) -> dict[str, float]:
    """Return the change of a scenario that gives its load the inertia of a point mass, m l².

    An inertia of the load is not changed. The change is empty without load or mass.
    """
    load = scenario.plant.load
    if not isinstance(load, KneeLoadParameters):
        return {}
    inertia = load.inertia_kg_m2 or load.segment_mass_kg * load.centre_of_mass_m**2
    return {"plant.load.inertia_kg_m2": inertia} if inertia else {}


def _variations(
    design: Scenario, flow_factor: float, settings: SizeSettings
) -> dict[str, Scenario]:
    """Return a dictionary from name to scenario, for walking with the design on other plants.

    The controller keeps the nominal plant, from which these plants differ.
    """
    valves = FullCylinderParameters()
    full_order = {
        name: getattr(valves, name) * flow_factor
        for name in ("makeup_conductance_m3_per_s_pa", "relief_conductance_m3_per_s_pa")
    }
    friction = {"coulomb_friction_n": settings.seal_friction_n}
    # Valves and friction this stiff need an implicit integrator, whatever the engine.
    implicit = {"simulation.integrator": "radau3", "simulation.step_s": _IMPLICIT_STEP_S}
    reduced = {"plant.full_order": None, "plant.bypass": None}
    variations: dict[str, Any] = {
        "reduced order (Eq. 15)": reduced,
        "full order (Eq. 14), valves grown with the flow": {
            "plant.full_order": full_order,
            **implicit,
        },
        f"the same, {settings.seal_friction_n:g} N of seal friction": {
            "plant.full_order": full_order | friction,
            **implicit,
        },
    }
    if inertia := _shank_inertia(design):
        (value,) = inertia.values()
        name = f"reduced order, inertia of the shank {value:.3g} kg·m² in place of the mass"
        variations[name] = {**reduced, **inertia}
    return {name: changed(design, values) for name, values in variations.items()}
