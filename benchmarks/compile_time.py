"""How long a user waits: cold compilation, and a whole process until its first result.

    python benchmarks/compile_time.py [--repeats N] [--json FILE]

A cold compilation begins with the scenario, or with the diagram, and ends behind the first sample
of a run, in a process that has imported everything and compiled something else before. Chains of
20 and 50 states are nonlinear springs and dampers in a row. A process is measured from its start
to its end: it imports kneexo, compiles the default scenario and runs 30 s of it, with an empty
cache (cold) and with that which it has left (warm). Each figure is the shortest wall time of some
runs, each in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydrake.systems.framework import DiagramBuilder, LeafSystem_
from pydrake.systems.primitives import Integrator
from pydrake.systems.scalar_conversion import TemplateSystem

from diagramc import compile_diagram
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import compile_scenario, scenario_run
from kneexo.studies.paper import EQ_27_DIFFERENCES, EQ_27_EXACT_STATES, FIG_12, IDEAL_SMC

PROCESS = """
import kneexo
from kneexo.parameters import Scenario
from kneexo.simulation import scenario_run
scenario = Scenario()
model = kneexo.compile(scenario)
parameters, state, inputs = scenario_run(scenario, model)
print(model.simulate(parameters, state, 30.0, inputs=inputs)["knee_angle"][-1, 0])
"""


@TemplateSystem.define("Springs_")
def Springs_(T: Any) -> Any:
    """A row of masses; each is pulled by its neighbours through springs of third order."""

    class Impl(LeafSystem_[T]):
        def _construct(self, size: int, *, converter: Any = None) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.size = size
            state = self.DeclareContinuousState(size)
            self.DeclareStateOutputPort("x", state)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.size, converter=converter)

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
            x = context.get_continuous_state_vector().CopyToVector()
            half = self.size // 2
            rates = list(x[half:])
            for i in range(half):
                before = x[i - 1] if i else 0.0
                after = x[i + 1] if i + 1 < half else 1.0
                stretch, pull = x[i] - before, after - x[i]
                rates.append(pull + pull**3 - stretch - stretch**3 - 0.1 * x[half + i])
            derivatives.get_mutable_vector().SetFromVector(rates)

    return Impl


def spring_chain(states: int) -> Any:
    """A diagram with a row of springs and an integrator."""
    builder = DiagramBuilder()
    springs = builder.AddNamedSystem("springs", Springs_[float](states - 1))
    integrator = builder.AddNamedSystem("integrator", Integrator(states - 1))
    builder.Connect(springs.get_output_port(), integrator.get_input_port())
    builder.ExportOutput(springs.get_output_port(), "x")
    return builder.Build()


def of_scenario(scenario: Scenario) -> None:
    """From a scenario to its first sample."""
    model = compile_scenario(scenario)
    parameters, state, inputs = scenario_run(scenario, model)
    settings = scenario.simulation
    model.simulate(
        parameters,
        state,
        scenario.controller.sample_time_s,
        inputs=inputs,
        record_period_s=scenario.controller.sample_time_s,
        integrator=settings.integrator,
        step_s=settings.step_s,
    )


def of_diagram(states: int) -> None:
    """From a diagram to its first millisecond."""
    model = compile_diagram(spring_chain(states))
    model.simulate(model.parameters(), model.state(), 1e-3, record_period_s=1e-3)


STRUCTURES: dict[str, Callable[[], None]] = {
    "Fig. 9: continuous SMC": lambda: of_scenario(IDEAL_SMC),
    "Fig. 12: SMC": lambda: of_scenario(FIG_12["smc"]),
    "Fig. 12: PID": lambda: of_scenario(FIG_12["pid"]),
    "Eq. 27, exact states": lambda: of_scenario(next(iter(EQ_27_EXACT_STATES.values()))),
    "Eq. 27, differences": lambda: of_scenario(next(iter(EQ_27_DIFFERENCES.values()))),
    "full order, weight": lambda: of_scenario(
        changed(Scenario(), {"plant.full_order": {}, "plant.load": {"kind": "knee"}})
    ),
    "20 states": lambda: of_diagram(20),
    "50 states": lambda: of_diagram(50),
}


def in_a_process(arguments: list[str], cache: Path) -> tuple[float, str]:
    """Wall time in s and output of a Python process with that cache."""
    start = time.perf_counter()
    run = subprocess.run(
        [sys.executable, *arguments],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"DIAGRAMC_CACHE_DIR": str(cache)},
    )
    return time.perf_counter() - start, run.stdout


def measure(repeats: int) -> dict[str, float]:
    """Seconds by what was measured."""
    seconds: dict[str, float] = {}

    def note(name: str, value: float) -> None:
        seconds[name] = min(value, seconds.get(name, value))

    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            for name in STRUCTURES:
                cache = Path(folder) / name.replace(" ", "_")
                note(name, float(in_a_process([__file__, "--structure", name], cache)[1]))
            for name in ("process, cold", "process, warm"):
                note(name, in_a_process(["-c", PROCESS], Path(folder) / "process")[0])
    return seconds


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", metavar="FILE", help="also write all figures to a file")
    parser.add_argument("--structure", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.structure:
        of_diagram(2)
        start = time.perf_counter()
        STRUCTURES[options.structure]()
        print(time.perf_counter() - start)
        return
    seconds = measure(options.repeats)
    limits = dict.fromkeys(STRUCTURES, 1.0) | {"process, cold": 2.0, "process, warm": 0.7}
    print("what | required (s) | measured (s)")
    for name, value in seconds.items():
        verdict = "OK" if value <= limits[name] else "MISSED"
        print(f"{name} | ≤ {limits[name]:g} | {value:.2f} | {verdict}")
    if options.json:
        Path(options.json).write_text(json.dumps(seconds, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
