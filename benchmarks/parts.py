"""Where the time of one run goes: 30 s of closed loop, with one part after the other left out.

    python benchmarks/parts.py

Each row has the processor time of a run on one core, the shortest of many, and per sample of 2 ms.
"""

from __future__ import annotations

import time
from typing import Any

from compare import PID_TUNED, SIGNALS, WEIGHT

from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import compile_scenario, scenario_run

DURATION_S = 30.0


def shortest_s(scenario: Scenario, duration_s: float, **options: Any) -> float:
    """Return the shortest processor time of a run in s."""
    model = compile_scenario(scenario)
    parameters, state, inputs = scenario_run(scenario, model)
    runs, best = 10, float("inf")
    for _ in range(31):  # the first one compiles
        start = time.process_time()
        for _ in range(runs):
            model.simulate(parameters, state, duration_s, inputs=inputs, **options)
        best = min(best, (time.process_time() - start) / runs)
    return best


def main() -> None:
    """Print the table."""
    whole = Scenario()
    sample_s = whole.controller.sample_time_s
    loaded, rk4 = changed(whole, WEIGHT), {"integrator": "rk4", "step_s": 2e-4}
    pid = changed(whole, {"controller": PID_TUNED.model_dump()})
    for name, scenario, duration_s, options in (
        ("complete, exact hold", whole, DURATION_S, {"outputs": SIGNALS}),
        ("without records", whole, DURATION_S, {"outputs": ()}),
        ("one sample alone", whole, sample_s, {"outputs": SIGNALS}),
        ("PID in place of SMC", pid, DURATION_S, {"outputs": SIGNALS}),
        ("without quantizer", whole.without_quantizers(), DURATION_S, {"outputs": SIGNALS}),
        ("complete, RK4 0.2 ms", whole, DURATION_S, {"outputs": SIGNALS, **rk4}),
        ("with the shank's weight, exact hold", loaded, DURATION_S, {"outputs": SIGNALS}),
        ("with the shank's weight, RK4 0.2 ms", loaded, DURATION_S, {"outputs": SIGNALS, **rk4}),
    ):
        run_s = shortest_s(scenario, duration_s, **options)
        print(f"{name:36} {1e3 * run_s:7.3f} ms {1e9 * run_s * sample_s / duration_s:8.0f} ns")


if __name__ == "__main__":
    main()
