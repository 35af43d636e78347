"""How fast and how exact: 30 s of closed loop by kneexo, by hand-written code and by other tools.

    python benchmarks/compare.py [--quick] [--only PATTERN] [--json FILE]

A table for each scenario, a row for each way to run it on one core: processor time (the shortest
of several, without compilation), its ratio to C with RK4 at 0.2 ms, the largest errors at the
samples, and how far the run lies from kneexo's compiled RK4 at 0.2 ms. There is no hand-written C
of a loop with a wearer, so the exported C is the base of its ratios. The last lines compare the
figures with their requirements.

The error of the rod's extension is relative to the stroke, that of the load pressure to its peak;
the reference is RK4 at 2 µs, its own error the change from 4 µs. Errors and differences are taken
without quantizer: a count that flips would hide the error of the integrator. A slow way runs for a
shorter time, as its row says, and its time is scaled to 30 s.

The other tools come with ``pip install ".[peers]"``; what is not there is said in its row.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from exported import FLAGS, Replay, exported_source
from hand_written import C_FLAGS, NoCompilerError, c_compiler, parameters_of, run_c
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from diagramc import Simulation
from kneexo.diagrams import columns, make_closed_loop
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import compile_scenario, scenario_run
from kneexo.simulation.drake import simulate_diagram
from kneexo.studies.paper import PID_TUNED

Array = NDArray[np.float64]
Runner = Callable[[], Array]
"""Runs once and returns rod extension in m and load pressure in Pa at each sample, (n, 2)."""

SIGNALS = ("rod_extension", "load_pressure")
DURATION_S = 30.0
STEP_S = 2e-4
BATCH = 1000
VARIED = {"plant/cylinder.mass_kg": (0.875, 1.125), "plant/cylinder.bulk_modulus_pa": (0.8, 1.2)}
"""Parameters of the runs of a batch, and by what they are multiplied."""


class UnavailableError(RuntimeError):
    """A way cannot run here; the text tells why."""


# ------------------------------------------------------------------------- ways to run it


@dataclass(frozen=True)
class Way:
    """One way to run a scenario; ``prepare(scenario, duration_s)`` compiles what it needs."""

    name: str
    prepare: Callable[[Scenario, float], Runner]
    duration_s: float = DURATION_S
    note: str = ""
    rk4: bool = False
    """RK4 at `STEP_S`: must agree with kneexo's."""


def compiled(integrator: str, step_s: float = STEP_S) -> Callable[[Scenario, float], Runner]:
    """The compiled model, with one of its integrators."""

    def prepare(scenario: Scenario, duration_s: float) -> Runner:
        model = compile_scenario(scenario)
        parameters, state, inputs = scenario_run(scenario, model)

        def run() -> Array:
            result = model.simulate(
                parameters,
                state,
                duration_s,
                outputs=SIGNALS,
                integrator=integrator,
                step_s=step_s,
                inputs=inputs,
            )
            return np.hstack([result[name] for name in SIGNALS])

        return run

    return prepare


def idiomatic(scenario: Scenario, duration_s: float) -> Runner:
    """The diagram of Python LeafSystems in Drake's Simulator, with RK3 at 0.2 ms."""
    settings = {"integrator": "runge_kutta3", "step_s": STEP_S, "duration_s": duration_s}
    settings = changed(scenario, {f"simulation.{k}": v for k, v in settings.items()}).simulation
    diagram = make_closed_loop(scenario, signals=SIGNALS)
    names = columns(SIGNALS)

    def run() -> Array:
        result = simulate_diagram(diagram, diagram.CreateDefaultContext(), names, settings)
        return np.column_stack([result[name] for name in names])

    return run


def wrapped(scenario: Scenario, duration_s: float) -> Runner:
    """The compiled model as one LeafSystem in Drake's Simulator, with its logs."""
    model = compile_scenario(scenario)
    parameters, state, _ = scenario_run(scenario, model)
    builder = DiagramBuilder()
    system = builder.AddSystem(model.as_system(parameters, state, integrator="exact_hold"))
    period = scenario.controller.sample_time_s
    sinks = [
        LogVectorOutput(system.GetOutputPort(name), builder, publish_period=period)
        for name in SIGNALS
    ]
    diagram = builder.Build()

    def run() -> Array:
        simulator = Simulator(diagram)
        simulator.AdvanceTo(duration_s)
        return np.vstack([sink.FindLog(simulator.get_context()).data() for sink in sinks]).T

    return run


def hand_written(
    run: Callable[..., Array], scenario: Scenario, duration_s: float, step_s: float = STEP_S
) -> Runner:
    """The loop in C or numba."""
    parameters = parameters_of(scenario)
    options = {
        "pid": scenario.controller.kind == "pid",
        "loaded": scenario.plant.load.kind == "knee",
        "steps": round(parameters.sample_time_s / step_s),
        "samples": round(duration_s / parameters.sample_time_s),
    }
    return lambda: run(parameters, **options)


def in_c(scenario: Scenario, duration_s: float) -> Runner:
    """The hand-written C program."""
    return hand_written(run_c, scenario, duration_s)


def exported_c(scenario: Scenario, duration_s: float) -> Runner:
    """The loop as `kneexo export c` prints it."""
    _, source = exported_source(scenario, "loop", outputs=SIGNALS, step_s=STEP_S)
    replay = Replay(source)
    steps = round(duration_s / source.plan.schedule.tick_s)
    return lambda: replay.from_start(np.zeros((steps, len(source.plan.inputs))))


def in_numba(scenario: Scenario, duration_s: float) -> Runner:
    """The hand-written numba program."""
    try:
        from hand_written_numba import run_numba
    except ImportError as error:
        raise UnavailableError(f"not installed ({error})") from None
    return hand_written(run_numba, scenario, duration_s)


C = Way("C, RK4 0.2 ms", in_c, rk4=True)
KNEEXO = (
    Way("kneexo compiled, RK4 0.2 ms", compiled("rk4"), rk4=True),
    Way("kneexo compiled, RK3 0.2 ms", compiled("runge_kutta3")),
    Way("kneexo compiled, exact hold", compiled("exact_hold")),
)
DRAKE = (
    Way("kneexo wrapped in Drake's Simulator, exact hold", wrapped, note="with logging"),
    Way("Drake, idiomatic Python LeafSystems, RK3 0.2 ms", idiomatic, 3.0),
)
EXPORTED = Way("kneexo exported as C, RK4 0.2 ms", exported_c, rk4=True, note=" ".join(FLAGS))
OURS = (
    C,
    Way("numba, RK4 0.2 ms", in_numba, rk4=True),
    *KNEEXO,
    EXPORTED,
    *DRAKE,
)
WITH_WEARER = (EXPORTED, *KNEEXO, *DRAKE)
FULL_ORDER = (
    Way("kneexo compiled, RK4 0.02 ms", compiled("rk4", 2e-5)),
    Way("kneexo compiled, exact hold", compiled("exact_hold")),
)

COMPLETE = "complete: linkage, quantizer, observer, SMC, 0.1 Hz"
LOADED = "complete with the shank's weight, 0.1 Hz"
FASTER_THAN_C = {COMPLETE: 3.0, LOADED: 6.0}
FULL_ORDER_LIMITS_MS = {"complete, full order": 20.0}

PEERS = {  # name, module, seconds that it runs
    "CasADi": ("casadi", 30.0),
    "heyoka": ("heyoka", 30.0),
    "jaxonomy": ("jaxonomy", 30.0),
    "pathsim": ("pathsim", 3.0),
    "python-control": ("control", 1.0),
    "bdsim": ("bdsim", 1.0),
}


def peer(name: str) -> Way:
    """One of the other tools; its module says how it does it."""
    module_name, duration_s = PEERS[name]
    try:
        module = importlib.import_module(f"peers.with_{module_name}")
    except ImportError as error:
        why = f"not installed ({error})"

        def missing(scenario: Scenario, duration_s: float) -> Runner:
            raise UnavailableError(why)

        return Way(name, missing, duration_s)

    def prepare(scenario: Scenario, duration_s: float) -> Runner:
        p = parameters_of(scenario)
        return module.prepare(p, round(p.sample_time_s / STEP_S), duration_s)

    return Way(f"{name}, {module.HOW}", prepare, duration_s, module.NOTE, module.RK4)


# ------------------------------------------------------------------------------ scenarios


@dataclass(frozen=True)
class Case:
    """A scenario and the ways to run it; ``fine_s`` is the step of its reference."""

    name: str
    scenario: Scenario
    ways: tuple[Way, ...]
    fine_s: float = 2e-6
    batch: bool = False


SIMPLE = changed(
    Scenario(),
    {
        "controller": PID_TUNED.model_dump(),
        "plant.rod_map": "polynomial",
        "encoder.quantized": False,
    },
)
SATURATED = changed(Scenario(), {"reference.frequency_hz": 0.21})
WEIGHT = {"plant.load": {"kind": "knee"}}
FULL = {"plant.full_order": {}}
WEARER = WEIGHT | {"wearer": {"kind": "leg"}, "controller": {"kind": "torque"}}
ACTIVE = {"wearer.motion": "active", "controller.mode": "impedance"}


def make_cases() -> tuple[Case, ...]:
    """All tables; imports the other tools."""
    peers = tuple(peer(name) for name in PEERS)
    base = Scenario()
    return (
        Case("simple: PID, Table 1, no quantizer, 0.1 Hz", SIMPLE, (*OURS, *peers)),
        Case(COMPLETE, base, OURS, batch=True),
        Case("complete, 0.21 Hz, saturated", SATURATED, OURS),
        Case(LOADED, changed(base, WEIGHT), OURS, batch=True),
        Case("complete with the shank's weight, 0.21 Hz", changed(SATURATED, WEIGHT), OURS),
        Case("complete, 1 Hz", changed(base, {"reference.frequency_hz": 1.0}), KNEEXO),
        Case("complete, signum", changed(base, {"controller.switching": "signum"}), KNEEXO),
        Case("complete, full order", changed(base, FULL), FULL_ORDER, 2.5e-6),
        Case(
            "complete, full order, 40 N friction",
            changed(base, {"plant.full_order": {"coulomb_friction_n": 40.0}}),
            FULL_ORDER,
            2.5e-6,
        ),
        Case("wearer, zero torque", changed(base, WEARER), WITH_WEARER),
        Case("wearer, active leg", changed(base, WEARER | ACTIVE), WITH_WEARER),
    )


# ---------------------------------------------------------------------------- measurement


@dataclass(frozen=True)
class Row:
    """One row of a table; times in s of 30 s, nan where there is no figure."""

    case: str
    way: str
    time_s: float = np.nan
    ratio: float = np.nan
    error_extension: float = np.nan
    error_pressure: float = np.nan
    difference: float = np.nan
    """From kneexo's compiled RK4 at 0.2 ms, relative to the largest value."""
    rk4: bool = False
    note: str = ""


@dataclass(frozen=True)
class Effort:
    """How long to run; ``share`` of the usual durations."""

    share: float = 1.0
    budget_s: float = 1.0
    most_runs: int = 20
    batches: int = 3

    def duration_s(self, way: Way) -> float:
        """What a way runs, in whole samples of 2 ms."""
        return round(500.0 * self.share * way.duration_s) / 500.0


QUICK = Effort(share=0.02, budget_s=0.02, most_runs=3, batches=1)


def shortest_times(runners: dict[str, Runner], effort: Effort) -> dict[str, float]:
    """Return the shortest processor time of each runner in s.

    The runners take turns until each has used its budget of time.
    """
    shortest = dict.fromkeys(runners, np.inf)
    spent, active = dict.fromkeys(runners, 0.0), dict(runners)
    for _ in range(effort.most_runs):
        for name, run in list(active.items()):
            start = time.process_time()
            run()
            taken = time.process_time() - start
            shortest[name] = min(shortest[name], taken)
            spent[name] += taken
            if spent[name] > effort.budget_s:
                del active[name]
    return shortest


def largest(difference: Array, scale: Any) -> float:
    """Return the largest absolute difference divided by ``scale``."""
    return float(np.max(np.abs(difference)) / scale)


def measure(case: Case, ways: tuple[Way, ...], effort: Effort) -> tuple[list[Row], str]:
    """Return the rows of the table of a case, and a line about its reference."""
    free = case.scenario.without_quantizers()
    duration_s = effort.duration_s(Way("", compiled("rk4")))
    reference = compiled("rk4", case.fine_s)(free, duration_s)()
    coarser = compiled("rk4", 2.0 * case.fine_s)(free, duration_s)()
    same = None
    if case.scenario.plant.full_order is None:  # whose valves are beyond RK4 at 0.2 ms
        same = compiled("rk4")(free, duration_s)()
    stroke, peak = case.scenario.plant.cylinder.stroke_m, np.abs(reference[:, 1]).max()
    reference_line = (
        f"reference: RK4 at {1e6 * case.fine_s:g} µs, own error "
        f"{largest((reference - coarser)[:, 0], stroke):.0e} of the stroke and "
        f"{largest((reference - coarser)[:, 1], peak):.0e} of the peak pressure, "
        f"{1e-3 * peak:.3g} kPa"
    )
    rows, runners = {}, {}
    for way in ways:
        row = Row(case.name, way.name, rk4=way.rk4, note=way.note)
        try:
            own_s = effort.duration_s(way)
            record = way.prepare(free, own_s)()  # the first run may compile
            runners[way.name] = way.prepare(case.scenario, own_s)
            if free != case.scenario:
                runners[way.name]()
        except (UnavailableError, NoCompilerError) as error:
            rows[way.name] = replace(row, note=str(error))
            continue
        except Exception as error:  # of another tool: its row tells
            text = f"{type(error).__name__}: {error}".splitlines()[0]
            rows[way.name] = replace(row, note=f"fails: {text}")
            runners.pop(way.name, None)
            continue
        n = len(record)
        assert n == round(own_s / case.scenario.controller.sample_time_s) + 1
        error = record - reference[:n]
        if same is not None:
            scale = np.abs(same[:n]).max(axis=0)
            row = replace(row, difference=largest((record - same[:n]) / scale, 1.0))
        notes = [way.note] * bool(way.note)
        if own_s < duration_s:
            notes.append(f"ran {own_s:g} s")
        rows[way.name] = replace(
            row,
            error_extension=largest(error[:, 0], stroke),
            error_pressure=largest(error[:, 1], peak),
            note="; ".join(notes),
        )
    times = shortest_times(runners, effort)
    in_c_s = next((times[way.name] for way in (C, EXPORTED) if way.name in times), np.nan)
    for way in ways:
        if way.name in times:
            seconds = times[way.name] * DURATION_S / effort.duration_s(way)
            ratio = seconds / (in_c_s * DURATION_S / effort.duration_s(C))
            rows[way.name] = replace(rows[way.name], time_s=seconds, ratio=ratio)
    return list(rows.values()), reference_line


# ---------------------------------------------------------------------------------- batch


@dataclass(frozen=True)
class Batch:
    """Many runs with other parameters: processor time of one, and how cores share the work."""

    case: str
    runs: int
    cores: int
    run_s: float
    """Processor time of one run of 30 s, on one core."""
    c_s: float
    """The same of C with RK4 at 0.2 ms; nan without a compiler."""
    scaling: float
    """Wall time on one core by that on all."""
    equal_alone: bool
    """Whether runs of the batch have the bits that they have alone."""
    avx2_s: float = np.nan
    """As ``run_s``, with machine code for AVX2; nan where it was not measured."""
    avx2_equal: bool | None = None
    """Whether that code gives the same bits."""

    def __str__(self) -> str:
        return (
            f"{self.case}: batch of {self.runs} runs with other parameters, exact hold: "
            f"{1e3 * self.run_s:.3f} ms a run and core, {1e3 * self.avx2_s:.3f} ms with AVX2 code; "
            f"{self.cores} cores are {self.scaling:.2f} times as fast as one"
        )


def measure_batch(case: Case, effort: Effort, cores: set[int]) -> tuple[Batch, str]:
    """Run the exact hold with mass and bulk modulus drawn at random, on one core and on all.

    Also returns a fingerprint of what the runs gave.
    """
    model = compile_scenario(case.scenario)
    parameters, state, _ = scenario_run(case.scenario, model)
    runs = max(10, round(BATCH * effort.share))
    varied = np.tile(parameters, (runs, 1))
    draw = np.random.default_rng(1)
    for name, (low, high) in VARIED.items():
        varied[:, model.parameter_names.index(name)] *= draw.uniform(low, high, runs)

    final: list[bytes] = []

    def batch(threads: int) -> tuple[float, float]:
        start, processor = time.perf_counter(), time.process_time()
        final[:] = model.simulate_batch(
            varied, state, DURATION_S, outputs=SIGNALS, threads=threads, reduce=last_bits
        )
        return time.perf_counter() - start, time.process_time() - processor

    try:
        in_c_alone = {"C": in_c(case.scenario, DURATION_S)}
    except (NoCompilerError, OSError):
        in_c_alone = {}
    batch(1)  # compiles
    alone, together, c_s = [], [], np.nan
    for _ in range(effort.batches):  # in turns: the machine may have other work
        c_s = float(np.fmin(shortest_times(in_c_alone, effort).get("C", np.nan), c_s))
        alone.append(batch(1))
        one_core = restrict(cores)
        together.append(batch(len(cores)))
        restrict(one_core)
    alone_s, processor_s = (min(values) for values in zip(*alone, strict=True))
    together_s = min(wall for wall, _ in together)
    some = range(0, runs, max(1, runs // 20))
    equal = all(
        last_bits(model.simulate(varied[i], state, DURATION_S, outputs=SIGNALS)) == final[i]
        for i in some
    )
    measured = Batch(
        case.name, runs, len(cores), processor_s / runs, c_s, alone_s / together_s, equal
    )
    return measured, hashlib.sha256(b"".join(final)).hexdigest()


def last_bits(run: Simulation) -> bytes:
    """The last sample of each signal, and the last state."""
    parts = [*(run[name][-1] for name in SIGNALS), run.final.continuous, run.final.discrete]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


def measure_batch_with_avx2(case: Case, quick: bool, cores: set[int]) -> Batch:
    """`measure_batch`, and the same in a process whose machine code is for AVX2."""
    measured, bits = measure_batch(case, QUICK if quick else Effort(), cores)
    command = [sys.executable, __file__, "--batch", case.name, *["--quick"] * quick]
    environment = os.environ | {"DIAGRAMC_CPU": "x86-64-v3"}
    run = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if run.returncode:  # another processor
        return measured
    avx2_s, avx2_bits = json.loads(run.stdout)
    return replace(measured, avx2_s=avx2_s, avx2_equal=avx2_bits == bits)


def restrict(cores: set[int]) -> set[int]:
    """Run on these cores only, where the system can do that; returns those until now."""
    if not hasattr(os, "sched_setaffinity"):
        return cores
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    return before


# -------------------------------------------------------------------------------- targets


@dataclass(frozen=True)
class Target:
    """A required and a measured figure; ``found`` is nan if it was not measured."""

    what: str
    required: str
    found: float
    met: bool

    def __str__(self) -> str:
        if np.isnan(self.found):
            return f"{self.what} | {self.required} | not measured"
        verdict = "OK" if self.met else "MISSED"
        return f"{self.what} | {self.required} | {self.found:.3g} | {verdict}"


def targets(rows: list[Row], batches: list[Batch]) -> Iterator[Target]:
    """Judge the batches, and the rows of the tables that have C and kneexo."""

    def at_most(what: str, limit: float, found: float) -> Target:
        return Target(what, f"≤ {limit:g}", found, bool(found <= limit))

    def at_least(what: str, limit: float, found: float) -> Target:
        return Target(what, f"≥ {limit:g}", found, bool(found >= limit))

    tables: dict[str, dict[str, Row]] = {}
    for row in rows:
        tables.setdefault(row.case, {})[row.way] = row
    for case, table in tables.items():
        if case in FULL_ORDER_LIMITS_MS:
            hold = table.get(KNEEXO[-1].name, Row(case, ""))
            what = f"{case}: exact hold, ms"
            yield at_most(what, FULL_ORDER_LIMITS_MS[case], 1e3 * hold.time_s)
        if C.name not in table:
            continue
        rk4, _, hold, wrap, python = (
            table.get(way.name, Row(case, way.name)) for way in (*KNEEXO, *DRAKE)
        )
        others = [r.difference for r in table.values() if r.rk4 and r is not rk4]
        others = [difference for difference in others if not np.isnan(difference)]
        what = f"{case}: other programs with RK4 ({len(others)}), from kneexo's"
        yield at_most(what, 1e-9, max(others, default=np.nan))
        yield at_most(f"{case}: compiled RK4, time by C's", 1.2, rk4.ratio)
        if case in FASTER_THAN_C:
            what = f"{case}: exact hold, times faster than C"
            yield at_least(what, FASTER_THAN_C[case], 1.0 / hold.ratio)
        yield at_most(f"{case}: exact hold, error of x", 1e-6, hold.error_extension)
        faster = python.time_s / wrap.time_s
        yield at_least(f"{case}: wrapped, times faster than idiomatic", 50.0, faster)
    for one in batches:
        ms, c_ms = 1e3 * one.run_s, 1e3 * one.c_s
        limit = 0.7 if "weight" in one.case else 0.3
        yield Target(
            f"{one.case}: batch, ms a run and core",
            f"≤ {limit:g}, or a 15th of C's {c_ms:.3g}",
            ms,
            bool(ms <= limit or ms <= c_ms / 15.0),
        )
        if "weight" not in one.case:
            yield at_most(f"{one.case}: batch, ms with AVX2 code", 0.5, 1e3 * one.avx2_s)
        yield at_least(f"{one.case}: runs of the batch equal those alone", 1.0, one.equal_alone)
        equal = np.nan if one.avx2_equal is None else float(one.avx2_equal)
        yield at_least(f"{one.case}: AVX2 code gives the same bits", 1.0, equal)
        scaling = one.scaling / one.cores if one.cores > 1 else np.nan
        yield at_least(f"{one.case}: batch, scaling by cores", 0.9, scaling)


# --------------------------------------------------------------------------------- output


def machine() -> dict[str, str]:
    """Processor, and versions of what made the machine code."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        processor = re.findall(r"model name\s*: (.*)", text)[0]
    except (OSError, IndexError):
        processor = platform.processor()
    try:
        compiler = c_compiler()
        run = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False)
        c_code = f"{run.stdout.splitlines()[0]}, {' '.join(C_FLAGS)}"
    except (NoCompilerError, OSError, IndexError) as error:
        c_code = str(error)
    packages = ", ".join(f"{name} {version(name)}" for name in ("drake", "llvmlite", "numpy"))
    return {
        "processor": processor,
        "python": f"{platform.python_version()}, {packages}",
        "c": c_code,
        "load": ", ".join(f"{load:.1f}" for load in os.getloadavg()),
    }


def shown(value: float, form: str) -> str:
    """A figure, or a dash."""
    return "–" if np.isnan(value) else format(value, form)


def print_table(case: Case, rows: list[Row], told: str) -> None:
    """Print one table."""
    print(f"\n{case.name}\n{told}")
    heads = ("time (ms)", "× C", "error x", "error p", "from RK4")
    print(f"{'':50}" + "".join(f"{head:>11}" for head in heads))
    for row in rows:
        figures = (
            shown(1e3 * row.time_s, ".2f"),
            shown(row.ratio, ".2f"),
            shown(row.error_extension, ".0e"),
            shown(row.error_pressure, ".1e"),
            shown(row.difference, ".0e"),
        )
        note = f"  {row.note}" if row.note else ""
        print(f"{row.way:50}" + "".join(f"{figure:>11}" for figure in figures) + note)
    sys.stdout.flush()


def plain(figures: Row | Batch | Target) -> dict[str, Any]:
    """A dictionary for JSON, which has no nan."""
    return {name: None if value != value else value for name, value in asdict(figures).items()}


def main(arguments: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a fiftieth of each run; a trial")
    parser.add_argument(
        "--only",
        metavar="PATTERN",
        default="",
        help="rows whose 'table: way' contains this regular expression, and the base of the ratio",
    )
    parser.add_argument("--json", metavar="FILE", help="also write all figures to a file")
    parser.add_argument("--batch", metavar="TABLE", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    effort = QUICK if options.quick else Effort()
    cores = (
        os.sched_getaffinity(0)
        if hasattr(os, "sched_getaffinity")
        else set(range(os.cpu_count() or 1))
    )
    restrict({max(cores)})  # before any thread starts
    if options.batch:
        (case,) = (case for case in make_cases() if case.name == options.batch)
        measured, bits = measure_batch(case, effort, cores)
        print(json.dumps([measured.run_s, bits]))
        return
    facts = machine()
    for name, text in facts.items():
        print(f"{name}: {text}")
    if options.quick:
        print("quick: the runs are too short for their times to count")
    rows: list[Row] = []
    cases = make_cases()
    for case in cases:
        chosen = {w for w in case.ways if re.search(options.only, f"{case.name}: {w.name}")}
        if chosen:
            ways = tuple(way for way in case.ways if way in chosen or way is case.ways[0])
            new_rows, reference_line = measure(case, ways, effort)
            print_table(case, new_rows, reference_line)
            rows += new_rows
    batches = []
    for case in cases:
        if case.batch and re.search(options.only, f"{case.name}: batch"):
            batches.append(measure_batch_with_avx2(case, options.quick, cores))
            print(f"\n{batches[-1]}")
    judged = list(targets(rows, batches))
    print("\nwhat | required | found")
    for target in judged:
        print(target)
    if options.json:
        data = {
            "machine": facts,
            "rows": [plain(row) for row in rows],
            "batches": [plain(batch) for batch in batches],
            "targets": [plain(target) for target in judged],
        }
        Path(options.json).write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
