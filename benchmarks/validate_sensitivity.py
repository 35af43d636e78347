"""Check sensitivities by AutoDiff against central differences of changed scenarios.

    python benchmarks/validate_sensitivity.py

Prints the table "what | required | found" in a minute. The differences are extrapolated to a
step of zero (Ridders), which also tells how well they are known; derivatives that they do not know
to 1e-6, because the value hardly matters, are counted and left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.sensitivity import (
    Sensitivities,
    differentiable,
    loop_sensitivities,
    tracking_sensitivities,
)
from kneexo.parameters import UNCERTAIN_KNEE, UNCERTAINTY, Scenario
from kneexo.parameters.paths import changed, value_at
from kneexo.simulation.compiled import simulate_compiled
from kneexo.studies.paper import PID_TUNED

REQUIRED = 1e-5
KNOWN = 1e-6
ROWS = 6
LARGEST_STEP = 0.1  # of the uncertain interval

LEAKY = changed(
    UNCERTAIN_KNEE,
    {
        "plant.pump.internal_leakage_m3_per_s_pa": 2e-12,
        "plant.cylinder.damping_n_s_per_m": 400.0,
        "plant.cylinder.bulk_modulus_pa": 1e9,
        "plant.load.knee_torque_n_m": 4.0,
        "encoder.mounting_error_rad": 1e-3,
        # A sine that grows smoothly: neither speed nor acceleration meets its limit.
        "reference": {
            "kind": "sine",
            "amplitude_deg": 2.0,
            "frequency_hz": 1.0,
            "ramp_s": 0.3,
        },
        "simulation.duration_s": 1.0,
    },
)
"""A loop in which every value matters."""

SCENARIOS = {
    "SMC": LEAKY,
    "SMC, two samples of latency": changed(LEAKY, {"bus.latency_samples": 2}),
    "PID": changed(LEAKY, {"controller": PID_TUNED.model_dump()}),
    "SMC, full order": changed(
        LEAKY,
        {
            "plant.full_order": {"coulomb_friction_n": 40.0},
            "plant.load.knee_torque_n_m": -4.0,
            "simulation.duration_s": 0.3,
        },
    ),
}


def extrapolated(function: Callable[[float], Any], step: float) -> tuple[Any, Any]:
    """Derivative at 0 of a function that returns an array, and its error."""
    steps = step / 1.6 ** np.arange(ROWS)
    table = np.array([(function(h) - function(-h)) / (2.0 * h) for h in steps])
    best, error, factor = table[0], np.full_like(table[0], math.inf), 1.6**2
    for _ in range(1, ROWS):
        finer = table[1:] + (table[1:] - table[:-1]) / (factor - 1.0)
        for value, coarse, fine in zip(finer, table[:-1], table[1:], strict=True):
            change = np.maximum(abs(value - coarse), abs(value - fine))
            best, error = np.where(change < error, value, best), np.minimum(change, error)
        table, factor = finer, factor * 1.6**2
    return best, error


def margins(scenario: Scenario) -> Any:
    """Largest eigenvalue and margins, in the order of `loop_sensitivities`."""
    loop = linearize_loop(scenario, knee_angle_deg=0.5 * sum(scenario.reference.range_deg))
    m = loop.margins()
    values = (m.phase_margin_deg, m.delay_margin_s, m.gain_margin, m.disk_margin)
    return np.array([abs(loop.eigenvalues[0]), *values])


def tracking(scenario: Scenario) -> Any:
    """Root mean square error in deg, with the steps of `tracking_sensitivities`."""
    run = simulate_compiled(
        changed(scenario, {"encoder.quantized": False}),
        signals=("knee_reference", "knee_angle"),
        integrator="runge_kutta3",
        step_s=5e-4 if scenario.plant.full_order is None else 5e-5,
    )
    error = np.degrees(run["knee_reference_rad"] - run["knee_angle_rad"])
    return np.array([math.sqrt(np.mean(error**2))])


def compare(
    what: str, scenario: Scenario, found: Sensitivities, measure: Callable[[Scenario], Any]
) -> None:
    """Print the largest relative difference over all values and figures."""
    believing = scenario.model_copy(update={"nominal": scenario.believed_plant})
    worst, where, unknown, count = 0.0, "", 0, 0
    for path in found.paths:
        one, start = UNCERTAINTY.values[path], value_at(scenario, path)
        step = LARGEST_STEP * min((one.high or 0.0) - (one.low or 0.0), abs(start))
        expected, error = extrapolated(
            lambda h, p=path, x=start: measure(changed(believing, {p: x + h})), step
        )
        for figure, value, uncertain in zip(found.metrics, expected, error, strict=True):
            ours = found.of(figure)[path]
            count += 1
            if not uncertain < KNOWN * abs(value):
                unknown += ours != 0.0 or value != 0.0
            elif abs(ours / value - 1.0) > worst:
                worst, where = abs(ours / value - 1.0), f"{figure}, {path}"
    note = f"{count} derivatives, {unknown} not known well enough"
    print(f"{what} | ≤ {REQUIRED:g} | {worst:.1e} ({where}; {note})", flush=True)


def main() -> None:
    """Print the table."""
    print("what | required | found")
    print("---|---|---")
    for name, scenario in SCENARIOS.items():
        paths = [path for path in UNCERTAINTY.values if differentiable(scenario, path)]
        compare(f"margins, {name}", scenario, loop_sensitivities(scenario, paths), margins)
        run = tracking_sensitivities(scenario, paths)
        compare(f"rms error, {name}", scenario, run, tracking)


if __name__ == "__main__":
    main()
