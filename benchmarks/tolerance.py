"""The error and the time of the exact hold at several tolerances, which decide its default.

    python benchmarks/tolerance.py [--runs N] [--duration SECONDS]

Each line is a batch of runs whose moving mass, bulk modulus and frequency of the reference are
drawn at random. The comparison is with a tolerance of 1e-11. Errors are the largest of a run at the
samples, in strokes of the rod and in parts of the peak of the load pressure; the table has their
medians. In a run with an error of the pressure above 1e-3, the encoder has another count at some
sample, or the controller takes another sign. The time is the processor time of a run of the batch.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from compare import ACTIVE, FULL, VARIED, WEARER
from numpy.typing import NDArray

from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import compile_scenario, scenario_run

OUTPUTS = ("rod_extension", "load_pressure")
TOLERANCES = (1e-6, 1e-7, 1e-8, 1e-9)
OTHER_DECISION = 1e-3
"""Error of the pressure, in parts of its peak, that no error of the integrator alone makes."""
RANDOM = {**VARIED, "reference.frequency_hz": (0.9, 1.1)}
"""Parameters of the runs of a batch, and by what they are multiplied."""
BASE = Scenario()
CASES = {
    "paper, 1 Hz": changed(BASE, {"reference.frequency_hz": 1.0}),
    "paper, signum": changed(BASE, {"controller.switching": "signum"}),
    "bench": Scenario.preset("bench"),
    "full order": changed(BASE, FULL),
    "leg": Scenario.preset("leg"),
    "prescribed leg": changed(BASE, WEARER),
    "active leg": changed(BASE, WEARER | ACTIVE),
}


def batch(
    scenario: Scenario, runs: int, duration_s: float, tolerance: float
) -> NDArray[np.float64]:
    """Outputs at the samples (runs, samples, outputs) of plants that are drawn at random."""
    model = compile_scenario(scenario)
    parameters, state, inputs = scenario_run(scenario, model)
    varied = np.tile(parameters, (runs, 1))
    draw = np.random.default_rng(3)
    for path, bounds in RANDOM.items():
        if path in model.parameter_names:
            varied[:, model.parameter_names.index(path)] *= draw.uniform(*bounds, runs)
    results = model.simulate_batch(
        varied, state, duration_s, inputs=inputs, outputs=OUTPUTS, tolerance=tolerance, threads=1
    )
    return np.array([np.hstack([run[output] for output in OUTPUTS]) for run in results])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=32)
    parser.add_argument("--duration", type=float, default=15.0, metavar="SECONDS")
    options = parser.parse_args()
    print("case | tolerance | ms a run | rod | pressure | runs with another decision")
    for name, scenario in CASES.items():
        exact = batch(scenario, options.runs, options.duration, 1e-11)
        scale = scenario.plant.cylinder.stroke_m, np.abs(exact[:, :, 1]).max(axis=1)
        for tolerance in TOLERANCES:
            start = time.process_time()
            runs = batch(scenario, options.runs, options.duration, tolerance)
            taken_s = time.process_time() - start
            error = np.abs(runs - exact).max(axis=1)
            rod, pressure = (errors / one for errors, one in zip(error.T, scale, strict=True))
            print(
                f"{name} | {tolerance:g} | {1e3 * taken_s / options.runs:.2f} | "
                f"{np.median(rod):.1e} | {np.median(pressure):.1e} | "
                f"{np.count_nonzero(pressure > OTHER_DECISION)} of {options.runs}",
                flush=True,
            )


if __name__ == "__main__":
    main()
