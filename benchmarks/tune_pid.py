"""Find the best PID for Fig. 12 within a budget of chattering; prints the gains.

The search that `kneexo.studies.paper.PID_TUNED` and `PID_FEEDFORWARD` come from:

    python benchmarks/tune_pid.py                           # error feedback alone
    python benchmarks/tune_pid.py --start 14 400 0 0.015    # the same without derivative
    python benchmarks/tune_pid.py --feedforward             # with the reference's velocity

Pattern search on the logarithm of the gains: every gain is tried a factor up and down, the best
improvement is taken, and the factor shrinks when there is none. The objective is the largest
error after the first period of 10…70° at 0.1 Hz; a run beyond the budget (mean change of command
per sample) is refused. Same encoder, same sample time and same speed limit as the
sliding-mode controller, whose own mean change is the budget.
"""

from __future__ import annotations

import argparse
import math
from itertools import product

from kneexo.analysis import track
from kneexo.errors import SimulationError
from kneexo.parameters import PidParameters, Scenario, SimulationParameters
from kneexo.sweeps import parallel_map

NAMES = ("proportional_per_s", "integral_per_s2", "derivative", "filter_s")
START = (10.0, 20.0, 0.02, 0.02)  # a start of 0 stays 0
DURATION_S = 30.0


def scenario(gains: tuple[float, ...], feedforward: float) -> Scenario:
    """Fig. 12 with a PID of those gains."""
    values = dict(zip(NAMES, gains, strict=True))
    return Scenario(
        controller=PidParameters(velocity_feedforward=feedforward, **values),
        simulation=SimulationParameters(duration_s=DURATION_S),
    )


def measure(case: Scenario) -> tuple[float, float]:
    """Largest error in deg and mean change of command in rpm; infinite when the run fails."""
    try:
        metrics = track(case).metrics
    except SimulationError:
        return math.inf, math.inf
    return metrics.max_error_deg, metrics.mean_command_change_rpm


def main() -> None:
    """Search and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--feedforward", action="store_true", help="feed the rod velocity forward")
    parser.add_argument("--budget", type=float, help="rpm per sample; default: that of the SMC")
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--start", type=float, nargs=4, default=START, metavar=NAMES)
    parser.add_argument("--factor", type=float, default=2.0)
    options = parser.parse_args()
    budget = options.budget
    if budget is None:
        budget = measure(Scenario(simulation=SimulationParameters(duration_s=DURATION_S)))[1]
    print(f"budget: {budget:.2f} rpm per sample")
    feedforward = 1.0 if options.feedforward else 0.0

    best, best_error, factor = tuple(options.start), math.inf, options.factor
    for step in range(options.rounds):
        single = [
            tuple(g * factor ** (s * (i == j)) for i, g in enumerate(best))
            for j, s in product(range(len(best)), (-1, 1))
        ]
        pairs = [
            tuple(g * factor ** {a: s, b: t}.get(i, 0) for i, g in enumerate(best))
            for a, b in ((0, 3), (0, 1))
            for s, t in product((-1, 1), repeat=2)
        ]
        candidates = [
            gains
            for gains in ([best] if math.isinf(best_error) else []) + single + pairs
            if gains[3] >= 1e-3
        ]
        measured = parallel_map(
            measure, [scenario(gains, feedforward) for gains in candidates], workers=None
        )
        allowed = [(e, g) for (e, c), g in zip(measured, candidates, strict=True) if c <= budget]
        error, gains = min(allowed, default=(math.inf, best))
        if error < best_error:
            best, best_error = gains, error
        else:
            factor = math.sqrt(factor)
        shown = ", ".join(f"{n} = {g:.4g}" for n, g in zip(NAMES, best, strict=True))
        print(f"{step + 1:2d}: {best_error:.4f} deg  {shown}  (factor {factor:.3f})", flush=True)


if __name__ == "__main__":
    main()
