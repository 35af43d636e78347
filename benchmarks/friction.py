"""Print the error of the exact hold where friction or a controller changes its sign.

    python benchmarks/friction.py [--duration SECONDS]

All runs have the encoder's quantizer and a reference of 0.1 Hz. Cases with friction take the
full-order plant. Errors are the largest at the samples, of the load pressure relative to its peak
and of the knee angle. They are relative to a run of RK4 with a fine step. The first row of each
case shows RK4 with twice that step, which estimates the error of the fine run. Times are processor
times of one run.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import compile_scenario, scenario_run

CASES = {
    "Stribeck 15 N, Coulomb 20 N, 1.5 % air": (
        {
            "plant.full_order": {
                "stribeck_friction_n": 15.0,
                "coulomb_friction_n": 20.0,
                "entrained_air": 0.015,
            }
        },
        2.5e-6,
    ),
    "Stribeck 15 N, Coulomb 20 N, no air": (
        {"plant.full_order": {"stribeck_friction_n": 15.0, "coulomb_friction_n": 20.0}},
        5e-7,
    ),
    "Stribeck 15 N, Coulomb 21 N, no air": (
        {"plant.full_order": {"stribeck_friction_n": 15.0, "coulomb_friction_n": 21.0}},
        5e-7,
    ),
    "Coulomb 40 N, no air": ({"plant.full_order": {"coulomb_friction_n": 40.0}}, 2.5e-6),
    "controller with signum": ({"controller.switching": "signum"}, 2.5e-6),
}
"""Changes of the default scenario, and the step of the fine run in s."""

WAYS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("RK4, 20 µs", {"integrator": "rk4", "step_s": 2e-5}),
    *((f"exact hold, {t:.0e}", {"tolerance": t}) for t in (1e-8, 1e-9, 1e-10)),
)


def run(scenario: Scenario, **options: Any) -> tuple[NDArray[np.float64], float]:
    """Load pressure in Pa and knee angle in deg at each sample, (n, 2), and processor time in s."""
    model = compile_scenario(scenario)
    parameters, state, inputs = scenario_run(scenario, model)
    outputs = ("load_pressure", "knee_angle")
    for _ in range(2):  # the first run compiles
        start = time.process_time()
        result = model.simulate(
            parameters, state, scenario.duration_s, inputs=inputs, outputs=outputs, **options
        )
        taken_s = time.process_time() - start
    return np.column_stack(
        [result["load_pressure"][:, 0], np.rad2deg(result["knee_angle"][:, 0])]
    ), taken_s


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--duration", type=float, default=10.0, metavar="SECONDS")
    duration_s = parser.parse_args().duration
    print("case | way | pressure error by peak | angle error (deg) | processor time (s)")
    for name, (changes, fine_s) in CASES.items():
        scenario = changed(Scenario(), {**changes, "simulation.duration_s": duration_s})
        reference, _ = run(scenario, integrator="rk4", step_s=fine_s)
        peak = np.abs(reference[:, 0]).max()
        coarser = (f"RK4, {2e6 * fine_s:g} µs", {"integrator": "rk4", "step_s": 2.0 * fine_s})
        for way, options in (coarser, *WAYS):
            record, taken_s = run(scenario, **options)
            pressure, angle = np.abs(record - reference).max(axis=0)
            print(
                f"{name} | {way} | {pressure / peak:.1e} | {angle:.0e} | {taken_s:.3f}", flush=True
            )


if __name__ == "__main__":
    main()
