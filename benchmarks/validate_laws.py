"""Check generated control laws: alone, in the loop of any session, and against Drake's Simulator.

    python benchmarks/validate_laws.py [--count 500] [--seed 0] [--processes 2]

The grammar is ``tests/shared/generated_laws.py``; a seed gives a law. Each law runs for 0.1 s in
the preset paper, bench or leg.

- *Law*: the recorded inputs of a run go to the plain Python function, and to what kneexo makes of
  it: `FunctionLaw` compiled alone, or `PythonLaw`. The commands that the loop recorded are compared
  too. The bus of bench and leg rounds these commands to its unit.
- *Session*: one process runs all laws in random order, and a second process runs them in another
  order with the disk cache of the first. Each run must have the bits of the law alone, in a fork
  that has run no law, with an empty cache. Laws that run as Python share a cache of plants.
- *Drake*: the difference from Drake's Simulator, as a multiple of the change of either program when
  its tolerance is divided by ten. The exact hold of a linear plant has no error, so that it is
  Drake's change that counts there. The comparison ends where a law decides otherwise, because its
  inputs differ by the error of integration.

Prints the table "what | required | found", the failures, and the share of failed laws for each
feature of the grammar. The exit status is 1 if any law fails.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import multiprocessing
import os
import random
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.symbolic import Expression, Variable
from pydrake.systems.primitives import SymbolicVectorSystem

from diagramc import InputTable, compile_diagram, truth_of_scalars
from kneexo.diagrams import make_closed_loop
from kneexo.diagrams.signals import SIGNALS, columns
from kneexo.errors import KneexoError
from kneexo.law import FunctionLaw
from kneexo.law.decision import why_python
from kneexo.law.python_law import SIGNAL_OF, PythonLaw
from kneexo.parameters import Scenario
from kneexo.simulation import simulate
from kneexo.simulation.run import Run

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "shared"))

from generated_laws import PRESETS, GeneratedLaw, generated_law

COMPARED = (
    *("knee_angle", "rod_extension", "rod_velocity", "load_pressure"),
    *("motor_speed", "motor_speed_command"),
)
SETTINGS = {
    "simulation.duration_s": 0.1,
    "simulation.tolerance": 1e-8,
    # Steps of encoder and bus would hide small errors.
    "encoder.quantized": False,
    "reference": {"kind": "sine", "amplitude_deg": 2.0, "frequency_hz": 2.0},
    "initial_offset_m": 2e-4,
}
FINE_BUS = {"bus.velocity_unit_rpm": 1e-5}  # a finer unit limits the command to 2³¹ units
DRAKE = {
    "simulation.integrator": "runge_kutta3",
    "simulation.error_controlled": True,
    "simulation.accuracy": 1e-5,
}
LAW_TOLERANCE = 1e-12  # of the command limit
CHANGES = 10.0  # changes by a tenth of the tolerance
ROUNDING = 1e-11  # of the largest value of a signal
JUMP = 0.5  # rad/s, or of a state: laws jump by more, and errors of integration change less
LIMIT_S = 60  # for one run; a law that never returns ends there


@dataclass
class Findings:
    """What was found for one law alone."""

    seed: int
    python: bool = False
    digest: str = ""
    law: float = 0.0
    """Largest difference of commands of the law alone, relative to the limit."""
    in_loop: float = 0.0
    """Largest difference of commands of the loop beyond the bus's rounding, relative to limit."""
    changes: float = 0.0
    """Largest difference from Drake's Simulator in changes by a tenth of the tolerance."""
    compared: float = 0.0
    """Share of the samples before a law decides otherwise."""
    faults: list[str] = field(default_factory=list)


def scenario_of(law: GeneratedLaw, folder: Path) -> Scenario:
    """Write the files of a law into ``folder`` and return its scenario."""
    base = Scenario.preset(law.preset).changed(SETTINGS)
    if base.bus.kind == "cia402":
        base = base.changed(FINE_BUS)
    return base.with_law(f"{law.write(folder)}:law" if law.in_file else law.function(folder))


def run_of(scenario: Scenario) -> Run:
    """Run a scenario. A run that takes too long raises `KneexoError`, as a failed one does."""
    read = (SIGNAL_OF[name] for name in scenario.controller.function.arguments.inputs)
    signal.alarm(LIMIT_S)
    try:
        return simulate(scenario, signals=tuple(dict.fromkeys((*COMPARED, *read))))
    finally:
        signal.alarm(0)


def digest(run: Run) -> str:
    """Return a digest of the bits of all columns of a run."""
    bits = hashlib.sha256()
    for name, values in run.columns.items():
        bits.update(name.encode() + values.tobytes())
    return bits.hexdigest()


# ---------------------------------------------------------------------------- law alone


def replayed(law: GeneratedLaw, folder: Path, run: Run) -> Any:
    """Return command and states that the plain function gives for the inputs of a run, (n, 1 + m).

    The states are those that the function returned at the sample before.
    """
    function = law.function(folder)
    arguments = {
        name: parameter.default
        for name, parameter in inspect.signature(function).parameters.items()
    }
    state, rows = arguments.get("state"), []
    inputs = {name: signal_values(run, SIGNAL_OF[name]) for name in law.inputs.split(", ")}
    for sample, time_s in enumerate(run.time_s):
        for name, values in inputs.items():
            row = values[sample].copy()
            arguments[name] = row if row.size > 1 else float(row[0])
        if "time_s" in arguments:
            arguments["time_s"] = float(time_s)
        if state is None:
            rows.append([number(called(function, arguments))])
        else:
            arguments["state"] = np.array(state, dtype=float)
            command, state = called(function, arguments)
            state = [number(value) for value in state]
            rows.append([number(command), *state])
    return np.array(rows)


def called(function: Any, arguments: dict[str, Any]) -> Any:
    """Call a law with numbers. For Drake 1.58's if_then_else they are constant Expressions.

    A branch on a constant Expression then follows its value, as a branch on a number does.
    """
    try:
        return function(**arguments)
    except TypeError as error:
        if "if_then_else()" not in str(error):
            raise
    constants = {
        name: Expression(value) if np.ndim(value) == 0 else np.array(list(map(Expression, value)))
        for name, value in arguments.items()
    }
    with truth_of_scalars():
        return function(**constants)


def number(value: Any) -> float:
    """Return a number of a law as float; Drake's if_then_else returns constant Expressions."""
    return value.Evaluate() if hasattr(value, "Evaluate") else float(value)


def signal_values(run: Run, name: str) -> Any:
    """Return the values of a signal of a run, (n, size)."""
    return np.column_stack([run[column] for column in SIGNALS[name]])


def alone(scenario: Scenario, run: Run) -> Any:
    """Return the commands of kneexo's own form of the law for the inputs of a run, (n - 1,)."""
    law = scenario.controller
    inputs = law.function.arguments.inputs
    values = {name: signal_values(run, SIGNAL_OF[name]) for name in inputs}
    if why_python(scenario):
        function = PythonLaw(scenario, announce=False)
        return np.array(
            [
                function(float(time_s), {SIGNAL_OF[n]: v[sample] for n, v in values.items()})
                for sample, time_s in enumerate(run.time_s[:-1])
            ]
        )
    limited = law.model_copy(update={"command_limit_rad_s": scenario.command_limit_rad_s})
    model = compile_diagram(FunctionLaw(limited), inputs=inputs)
    table = np.column_stack([values[name] for name in model.inputs])[:, :, None]
    middles = 0.5 * (run.time_s[1:] + run.time_s[:-1])
    parameters = model.parameters()
    simulation = model.simulate(
        parameters,
        model.initialized(parameters, model.state()),
        run.time_s[-1],
        inputs=InputTable(middles, table),
        outputs=["motor_speed_command"],
        record_period_s=law.sample_time_s,
    )
    return simulation["motor_speed_command"][1:, 0]


def check_law(law: GeneratedLaw, scenario: Scenario, run: Run, plain: Any, found: Findings) -> None:
    """Compare the commands of kneexo with those of the plain function."""
    limit = scenario.command_limit_rad_s
    expected = np.clip(plain[:-1, 0], -limit, limit)
    found.law = np.max(np.abs(alone(scenario, run) - expected)) / limit
    if not found.law <= LAW_TOLERANCE:
        found.faults.append(f"law alone: {found.law:.2g} of the limit")
    delay = 1 + scenario.bus.latency_samples  # a hold, and the bus
    recorded = run["motor_speed_command_rad_s"][delay:]
    expected = expected[: len(recorded)]
    rounding = 0.5001 * scenario.bus.velocity_unit_rad_s
    found.in_loop = max(np.max(np.abs(recorded - expected)) - rounding, 0.0) / limit
    if not found.in_loop <= LAW_TOLERANCE:
        found.faults.append(f"law in the loop: {found.in_loop:.2g} of the limit")


# --------------------------------------------------------------------------------- Drake


def check_drake(
    law: GeneratedLaw, folder: Path, scenario: Scenario, run: Run, plain: Any, found: Findings
) -> None:
    """Compare the run with that of Drake's Simulator, until the law decides otherwise."""
    finer = run_of(scenario.changed({"simulation.tolerance": 1e-9}))
    drake = run_of(scenario.changed(DRAKE))
    rougher = run_of(scenario.changed(DRAKE | {"simulation.accuracy": 1e-4}))
    end = len(run.time_s)
    for other in (finer, drake, rougher):
        differs = np.abs(replayed(law, folder, other) - plain).max(axis=1) > JUMP
        if differs.any():
            end = min(end, int(np.argmax(differs)) + 1)
    found.compared = end / len(run.time_s)
    for column in columns(COMPARED):
        values, best = run[column][:end], drake[column][:end]
        difference = np.abs(values - best).max()
        change = max(
            np.abs(best - rougher[column][:end]).max(),
            np.abs(values - finer[column][:end]).max(),
        )
        change = max(change, ROUNDING * np.abs(best).max())
        if difference > 0.0:
            found.changes = max(found.changes, difference / change)
            if not difference <= CHANGES * change:
                sample = int(np.argmax(np.abs(values - best) > CHANGES * change))
                found.faults.append(
                    f"Drake: {column} differs by {difference:.2g}, {difference / change:.2g} "
                    f"changes, first at {run.time_s[sample]:g} s"
                )


# ------------------------------------------------------------------------------ processes


def check_alone(seed: int, plants: Path) -> Findings:
    """Check one law in a process that has run no law, with an empty cache.

    ``plants`` is a cache without laws: only laws that run as Python, beside a compiled plant, use
    it.
    """
    law, found = generated_law(seed), Findings(seed)
    with tempfile.TemporaryDirectory() as name:
        folder, plain_folder = Path(name, "law"), Path(name, "plain")
        folder.mkdir()
        plain_folder.mkdir()
        try:
            scenario = scenario_of(law, folder)
            found.python = bool(why_python(scenario))
            os.environ["DIAGRAMC_CACHE_DIR"] = str(plants if found.python else Path(name, "cache"))
            run = run_of(scenario)
            found.digest = digest(run)
            plain = replayed(law, plain_folder, run)
            check_law(law, scenario, run, plain, found)
            check_drake(law, plain_folder, scenario, run, plain, found)
        except Exception as error:  # a generated law is right, so that any error is a fault
            found.faults.append(f"alone: {type(error).__name__}: {str(error)[:200]}")
    return found


def session(seeds: Sequence[int], folder: Path) -> dict[int, str]:
    """Run laws one after another; return the digest of each run, or the text of its error."""
    os.environ["DIAGRAMC_CACHE_DIR"] = str(folder / "cache")
    results = {}
    for seed in seeds:
        try:
            results[seed] = digest(run_of(scenario_of(generated_law(seed), folder)))
        except Exception as error:  # counted as a fault of the session
            results[seed] = f"{type(error).__name__}: {str(error)[:200]}"
    return results


def warm_up() -> None:
    """Import what every run needs, and start LLVM, without a law."""
    for preset in PRESETS:
        make_closed_loop(Scenario.preset(preset)).ToSymbolic()
    x = Variable("x")
    with tempfile.TemporaryDirectory() as name:
        os.environ["DIAGRAMC_CACHE_DIR"] = name
        model = compile_diagram(SymbolicVectorSystem(state=[x], dynamics=[-x], output=[x]))
        model.simulate(model.parameters(), model.state(), 0.1, record_period_s=0.1)


def start_of_process() -> None:
    """Let an alarm raise an error, and write no line for each law."""

    def too_long(number: int, frame: Any) -> None:
        raise KneexoError(f"runs for {LIMIT_S} s")

    signal.signal(signal.SIGALRM, too_long)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def validate(seeds: Sequence[int], processes: int) -> list[Findings]:
    """Check laws in forks of this process, which must not have run any law."""
    warm_up()
    fork = multiprocessing.get_context("fork")
    orders = [random.Random(number).sample(list(seeds), len(seeds)) for number in range(2)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with fork.Pool(processes, start_of_process, maxtasksperchild=1) as pool:
            first = pool.apply_async(session, (orders[0], folder))
            findings = pool.starmap(check_alone, [(s, folder / "plants") for s in seeds], 1)
            sessions = {"session": first.get()}
            sessions["session with the cache"] = pool.apply(session, (orders[1], folder))
    for found in findings:
        for where, results in sessions.items():
            result = results[found.seed]
            if result != found.digest and not any("alone: " in text for text in found.faults[:1]):
                text = result if " " in result else "other bits than alone"
                found.faults.append(f"{where}: {text}")
    return findings


# --------------------------------------------------------------------------------- report


def report(findings: Sequence[Findings]) -> None:
    """Print the table, the failures, and the features of the laws that fail."""
    python = sum(found.python for found in findings)
    print(f"{len(findings)} laws: {len(findings) - python} compiled, {python} run as Python")
    print("what | required | found")
    print("---|---|---")
    rows: list[tuple[str, str, str, Sequence[str]]] = [
        ("runs", "0 errors", "", ("alone: ",)),
        (
            "law alone",
            f"≤ {LAW_TOLERANCE:g}",
            f"{max(f.law for f in findings):.2g}",
            ("law alone",),
        ),
        (
            "law in the loop",
            f"≤ {LAW_TOLERANCE:g}",
            f"{max(f.in_loop for f in findings):.2g}",
            ("law in",),
        ),
        ("session, equal bits", "all", "", ("session",)),
        (
            "Drake, changes",
            f"≤ {CHANGES:g}",
            f"{max(f.changes for f in findings):.2g}, "
            f"{np.mean([f.compared for f in findings]):.0%} of the samples",
            ("Drake",),
        ),
    ]
    for what, required, worst, prefixes in rows:
        failed = sum(any(t.startswith(tuple(prefixes)) for t in f.faults) for f in findings)
        print(f"{what} | {required} | {', '.join(filter(None, (worst, f'{failed} laws fail')))}")
    for found in findings:
        if found.faults:
            law = generated_law(found.seed)
            way = "Python" if found.python else "compiled"
            print(f"seed {found.seed} ({way}, {law.preset}; {', '.join(law.features)})")
            for fault in found.faults:
                print(f"    {fault}")
    used: Counter[str] = Counter()
    failed_with: Counter[str] = Counter()
    for found in findings:
        features = set(generated_law(found.seed).features)
        used.update(features)
        failed_with.update(features if found.faults else ())
    if failed_with:
        print("feature | laws that fail")
        print("---|---")
        for feature in sorted(failed_with, key=lambda name: -failed_with[name] / used[name]):
            print(f"{feature} | {failed_with[feature]} of {used[feature]}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the laws and print the report; return 1 if any law fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args(arguments)
    findings = validate(range(options.seed, options.seed + options.count), options.processes)
    report(findings)
    return int(any(found.faults for found in findings))


if __name__ == "__main__":
    sys.exit(main())
