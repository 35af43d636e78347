"""How much eight lanes save, for equal plants and for plants of the uncertainty set.

    python benchmarks/lanes.py [--duration SECONDS] [--pairs N]

Each line has the processor time of eight runs alone, divided by that of the same runs in lanes: the
medians of pairs. The values of the unlike plants are drawn from `UNCERTAINTY`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
from compare import FULL

from diagramc import CompiledModel
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import UNCERTAINTY, UncertaintySet, applicable, draw
from kneexo.simulation import compile_scenario, scenario_run

LANES = 8
BASE = Scenario()
CASES = {"paper": BASE, "full order": changed(BASE, FULL), "leg": Scenario.preset("leg")}


def seconds(model: CompiledModel, runs: Sequence[tuple], duration_s: float) -> float:
    """Processor time of runs that start together, in lanes if there are eight."""
    parameters, states, inputs = (list(column) for column in zip(*runs, strict=True))
    start = time.process_time()
    model.simulate_batch(
        parameters, states, duration_s, inputs=inputs, outputs=["rod_extension"], threads=1
    )
    return time.process_time() - start


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--duration", type=float, default=15.0, metavar="SECONDS")
    parser.add_argument("--pairs", type=int, default=7)
    options = parser.parse_args()
    print("case | plants | alone / lanes | ms alone")
    for name, scenario in CASES.items():
        numbers = {p: span for p, span in UNCERTAINTY.values.items() if not span.options}
        kept, _ = applicable(scenario, UncertaintySet(values=numbers))
        unlike = [changed(scenario, values) for values in draw(kept, LANES, 1)]
        model = compile_scenario(scenario)
        for plants, scenarios in {"equal": [scenario] * LANES, "unlike": unlike}.items():
            runs = [scenario_run(one, model) for one in scenarios]
            ratios = []
            for _ in range(options.pairs + 1):
                alone = sum(seconds(model, [run], options.duration) for run in runs)
                ratios.append(alone / seconds(model, runs, options.duration))
            ratio = np.median(ratios[1:])  # the first pair compiles
            print(f"{name} | {plants} | {ratio:.2f} | {1e3 * alone:.0f}", flush=True)


if __name__ == "__main__":
    main()
