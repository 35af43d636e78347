"""The Rosenbrock method beside RK4 at its largest stable step and the exact hold, on stiff presets.

The rows are those of exported C, and then those of the compiled engine.

``python benchmarks/stiff.py`` runs the closed loops of the presets without quantizers, which would
make a count of the encoder of the smallest error. The largest step of RK4 is the longest of
0.002 s / n with which no call of 30 s reports an unstable step. The reference is the Rosenbrock
method with a tolerance of 1e-11. The error is that of the rod, in strokes, and of the load
pressure, in parts of its peak. The table has the shortest of the CPU times, taken in turns.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial

import numpy as np
from exported import Replay, exported_source
from exported_speed import shortest_times

from kneexo.export.firmware import loop_inputs
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import with_preset
from kneexo.simulation import simulate_compiled

OUTPUTS = ("rod_extension", "load_pressure")
TOLERANCES = (1e-5, 1e-6, 1e-7)
COMPILED = (("exact_hold", 1e-8), *(("rosenbrock", tolerance) for tolerance in TOLERANCES))
REQUIRED = 5.0
"""Smallest speed-up of preset leg by the coarsest tolerance that meets `ERROR`."""
ERROR = 1e-6
"""Largest error of the rod in strokes."""
STEPS = range(20, 80, 2)
"""Numbers of steps of RK4 in 2 ms that are tried."""


def compiled(scenario, ticks, integrator, tolerance):
    """Outputs (ticks, outputs) of a run by machine code, at the ends of the ticks."""
    run = simulate_compiled(
        changed(scenario, {"simulation.duration_s": ticks * scenario.controller.sample_time_s}),
        signals=OUTPUTS,
        integrator=integrator,
        tolerance=tolerance,
    )
    return np.column_stack([run["rod_extension_m"], run["load_pressure_pa"]])[-ticks:]


def main(arguments: list[str] | None = None) -> int:
    """Print the table; return 1 if preset leg misses the speed-up."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=30.0, help="simulated s (default 30)")
    parser.add_argument("--turns", type=int, default=10, help="runs of each program (default 10)")
    options = parser.parse_args(arguments)
    print("preset | integrator | ms | times RK4 | error of the rod | of the pressure")
    verdicts = []
    for preset in ("leg", "wearer"):
        scenario = Scenario.model_validate(with_preset(preset, {})).without_quantizers()
        sourced = partial(exported_source, scenario, "loop", outputs=OUTPUTS)
        target, source = sourced(integrator="rosenbrock", tolerance=1e-11)
        ticks = round(options.duration / source.plan.schedule.tick_s)
        inputs = loop_inputs(scenario, target, source, ticks)
        exact = Replay(source)(inputs)
        for steps in STEPS:
            rk4 = Replay(sourced(step_s=source.plan.schedule.tick_s / steps)[1])
            try:
                rk4(inputs)
                break
            except RuntimeError:  # unstable
                continue
        programs = {f"rk4, {steps} steps": rk4}
        for tolerance in TOLERANCES:
            stiff = sourced(integrator="rosenbrock", tolerance=tolerance)[1]
            programs[f"rosenbrock, {tolerance:g}"] = Replay(stiff)
        runs = {name: partial(program, inputs) for name, program in programs.items()}
        for integrator, tolerance in COMPILED:
            run = partial(compiled, scenario, ticks, integrator, tolerance)
            runs[f"compiled: {integrator}, {tolerance:g}"] = run
        times_s = shortest_times(list(runs.values()), options.turns)
        met = []
        for (name, run), time_s in zip(runs.items(), times_s, strict=True):
            error = np.abs(run() - exact).max(axis=0)
            error /= scenario.plant.cylinder.stroke_m, np.abs(exact[:, 1]).max()
            ratio = times_s[0] / time_s
            met.append(ratio >= REQUIRED and error[0] <= ERROR)
            print(f"{preset} | {name} | {1e3 * time_s:.1f} | {ratio:.1f} | ", end="")
            print(f"{error[0]:.1e} | {error[1]:.1e}", flush=True)
        verdicts.append(any(met) or preset != "leg")
    return 0 if all(verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
