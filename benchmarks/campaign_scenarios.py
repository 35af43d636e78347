"""Random scenario files and random runs: none may end in a traceback, a hang or a nan.

These are parts of ``campaign.py``. *files*: the built-in scenarios as YAML, damaged in their text
or with other values; each is loaded, and a valid one is dumped, loaded again, and made into
parameters and start of its compiled model. *corners*: every number of a scenario at both ends of
its range, in several structures. *random*: some numbers at random or at an end of their range, in
random structures. *linear*: the corners again, linearized, with margins. Runs last 0.05…0.5 s, log
all signals and are measured. They go in lanes, in a process of their own that a hang does not
survive.
"""

from __future__ import annotations

import math
import multiprocessing
import random
import signal
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from kneexo.analysis import linearize_loop, track
from kneexo.errors import (
    KneexoError,
    LinearizationError,
    LinkageError,
    ParameterError,
    SimulationError,
)
from kneexo.parameters import UNCERTAIN_KNEE, Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.quantity import Parameters
from kneexo.parameters.scenario_file import dump_scenario, load_scenario
from kneexo.simulation import awaitable
from kneexo.simulation.compiled import scenario_start, scenario_values
from kneexo.simulation.engines import serve_runs
from kneexo.studies.paper import FIG_12, IDEAL_SMC

FILE_LIMIT_S = 5.0
RUN_LIMIT_S = 120.0  # the first run of a structure compiles it
BATCH = 32
LONGEST_LINE = 1200
BAD = ("traceback", "hang", "not one line", "nan", "not equal after dump")

SAMPLES = {
    "kind": "samples",
    "times_s": (0.0, 0.1, 0.3, 0.6),
    "angles_deg": (10.0, 12.0, 30.0, 20.0),
}
BUILT_IN = (
    *FIG_12.values(),
    IDEAL_SMC,
    UNCERTAIN_KNEE,
    changed(UNCERTAIN_KNEE, {"plant.full_order": {}, "plant.linkage": "G2"}),
    changed(Scenario(), {"reference": {"kind": "step"}, "nominal": {"linkage": "G3"}}),
    changed(Scenario(), {"reference": {"kind": "ramp"}, "estimator": {"kind": "difference"}}),
    changed(Scenario(), {"reference": SAMPLES, "bus.latency_samples": 2}),
)

CHOSEN = ("sample_time_s", "duration_s", "step_s", "velocity_unit_rpm")
"""Numbers that structures and lengths of runs decide, or that have a few values alone."""

# ---------------------------------------------------------------------------------- files

WORDS = (
    *("0", "-1", ".nan", ".inf", "-.inf", "1e300", "-1e300", "1e-300", "5e-324", "1e5", "12345678"),
    *("true", "null", "~", "text", "''", "[]", "{}", "[1, 2]", "{kind: smc}", "{a: 1}", "&a 1"),
    *("*a", "!!str 1", "|", "> x", "- 1", "'", '"', "9" * 400, "λ", "\u2028", "\x00", "%", "@"),
    *("pid", "knee", "step", "samples", "exact", "G2", "polynomial", "drake", "rk4", "radau1"),
)


def damaged_text(text: str, rng: random.Random) -> str:
    """A scenario file with some values, lines or characters replaced, added or left out."""
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        place = rng.randrange(len(lines))
        line, way = lines[place], rng.randrange(8)
        if way <= 3:  # another value
            lines[place] = f"{line.split(':')[0]}: {rng.choice(WORDS)}"
        elif way == 4:
            lines.insert(place, rng.choice(lines))
        elif way == 5 and len(lines) > 1:
            del lines[place]
        elif way == 6:
            cut = rng.randrange(len(line) + 1)
            lines[place] = line[:cut] + rng.choice(WORDS) + line[cut + rng.randrange(3) :]
        else:
            lines[place] = " " * rng.randrange(5) + line.lstrip()
    return "\n".join(lines)


def file_outcome(path: Path) -> tuple[str, str]:
    """What becomes of a scenario file, and the message."""
    try:
        with time_limit(FILE_LIMIT_S):
            scenario = load_scenario(path)
            path.write_text(dump_scenario(scenario), encoding="utf-8")
            if load_scenario(path) != scenario:
                return "not equal after dump", ""
            values = [*scenario_values(scenario).values(), *scenario_start(scenario).values()]
            return ("valid" if np.isfinite(values).all() else "nan"), ""
    except BaseException as error:  # a campaign counts whatever comes
        return outcome_of(error)


def files(count: int, seed: int) -> Iterator[tuple[str, str, str]]:
    """Outcome, message and text of damaged files."""
    rng = random.Random(seed)
    texts = [dump_scenario(scenario) for scenario in BUILT_IN]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.yaml"
        for _ in range(count):
            text = damaged_text(rng.choice(texts), rng)
            path.write_bytes(text.encode("utf-8", "surrogatepass"))
            yield *file_outcome(path), text


def outcome_of(error: BaseException) -> tuple[str, str]:
    """Kind and message of what was raised."""
    if isinstance(error, TimeoutError):
        return "hang", ""
    if not isinstance(error, KneexoError):
        return "traceback", "".join(traceback.format_exception(error))
    message = str(error)
    if not message.isprintable() or len(message) > LONGEST_LINE:
        return "not one line", message
    for kind, name in (
        (LinkageError, "no such linkage"),
        (ParameterError, "refused"),
        (SimulationError, "failed run"),
        (LinearizationError, "no linear loop"),
    ):
        if isinstance(error, kind):
            return name, message
    return type(error).__name__, message


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` after that time."""

    def stop(*_: Any) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


# ----------------------------------------------------------------------------------- runs


def numbers(holder: Parameters, path: str = "") -> Iterator[tuple[str, float, float, float]]:
    """Path, value, lower and upper bound of each number that does not decide the structure."""
    for name, field in type(holder).model_fields.items():
        value = getattr(holder, name)
        if isinstance(value, Parameters):
            yield from numbers(value, f"{path}{name}.")
        elif isinstance(value, float) and name not in CHOSEN:
            low, high = -math.inf, math.inf
            for bound in field.metadata:
                low = max(low, getattr(bound, "ge", low), getattr(bound, "gt", low))
                high = min(high, getattr(bound, "le", high))
            yield path + name, value, low, high


def structure(rng: random.Random) -> Scenario:
    """A scenario of a random structure; its numbers have their defaults."""
    exact = rng.random() < 0.3
    estimator = "exact" if exact else rng.choice(("observer", "difference"))
    controller: dict[str, Any] = {"kind": rng.choice(("smc", "smc", "pid"))}
    controller["sample_time_s"] = rng.choice((0.002, 0.002, 0.002, 1e-5, 5e-4, 0.005, 0.02, 1.0))
    if controller["kind"] == "smc":
        controller["switching"] = rng.choice(("saturation", "saturation", "signum"))
        controller["continuous"] = exact and rng.random() < 0.5
    else:
        controller["anti_windup_s"] = 2.0
    kind = rng.choice(("sine", "sine", "step", "ramp", "samples"))
    values: dict[str, Any] = {
        "plant.linkage": rng.choice(("G1", "G1", "G2", "G3")),
        "plant.load": {"kind": rng.choice(("none", "knee"))},
        "plant.rod_map": rng.choice(("linkage", "linkage", "polynomial")),
        "plant.ideal_motor": rng.random() < 0.2,
        "plant.full_order": rng.choice((None, None, {})),
        "encoder.quantized": rng.random() < 0.7,
        "encoder.counts_per_revolution": rng.choice((4096, 4096, 2, 2**24)),
        "estimator": {"kind": estimator},
        "controller": controller,
        "bus": {
            "kind": "none" if controller.get("continuous") else rng.choice(("none", "cia402")),
            "latency_samples": 0 if controller.get("continuous") else rng.choice((0, 0, 1, 10)),
        },
        "reference": SAMPLES if kind == "samples" else {"kind": kind},
        "simulation.integrator": rng.choice(("exact_hold",) * 10 + ("rk4",) * 3 + ("radau3",)),
    }
    if rng.random() < 0.2:
        values["nominal"] = {"linkage": rng.choice(("G1", "G2"))}
    return changed(Scenario(), values)


def with_duration(scenario: Scenario, rng: random.Random) -> Scenario:
    """The scenario with a short duration: of a few thousand samples at most, of two at least.

    Drake, a thousand times slower, takes ten samples and no short steps.
    """
    compiled, sample_time = scenario.simulation.compiled, scenario.controller.sample_time_s
    most = 3000.0 if compiled else 10.0
    duration = max(2.0 * sample_time, min(rng.uniform(0.05, 0.5), most * sample_time))
    step = rng.choice((1e-6, 1e-4, 1.0)) if compiled else 0.002
    return changed(scenario, {"simulation.duration_s": duration, "simulation.step_s": step})


def corners(templates: Sequence[Scenario], seed: int) -> Iterator[tuple[str, Scenario | None]]:
    """Every number at both ends of its range, one at a time; None where a check refuses that."""
    rng = random.Random(seed)
    for template in templates:
        for path, _, low, high in numbers(template):
            for value in {low, high, 1e-300 if low == 0.0 else low}:
                yield vary(template, {path: value}, rng)


def randoms(
    templates: Sequence[Scenario], count: int, seed: int
) -> Iterator[tuple[str, Scenario | None]]:
    """Some numbers of a template at random or at an end of their range."""
    rng = random.Random(seed)
    for n in range(count):
        template = templates[n * len(templates) // count]
        # Most other linkages cannot be assembled, which the corners have tried.
        links = rng.random() < 0.1
        candidates = [row for row in numbers(template) if links or ".linkage." not in row[0]]
        values = {
            path: drawn(rng, value, low, high)
            for path, value, low, high in rng.sample(candidates, rng.choice((1, 2, 3, 5, 10, 20)))
        }
        yield vary(template, values, rng)


def drawn(rng: random.Random, value: float, low: float, high: float) -> float:
    """Draw a number near its default, anywhere in its range, or at an end of the range."""
    way = rng.randrange(6)
    if way == 0:
        return low
    if way == 1:
        return high
    if way <= 3:
        near = value * 10.0 ** rng.uniform(-1.0, 1.0)
        return min(max(near, low), high)
    if low > 0.0:
        return low * (high / low) ** rng.random()
    return rng.uniform(low, high)


def vary(
    template: Scenario, values: dict[str, float], rng: random.Random
) -> tuple[str, Scenario | None]:
    """Return a text with the changes, and the changed scenario or None if it is refused."""
    subject = ", ".join(f"{path} = {value!r}" for path, value in values.items())
    try:
        return subject, with_duration(changed(template, values), rng)
    except ParameterError:
        return subject, None


def run_outcomes(scenarios: Sequence[Scenario]) -> list[tuple[str, str]]:
    """What becomes of runs that go together."""
    found: dict[int, tuple[str, str]] = {}
    calls = [awaitable(track, scenario, all_signals=True) for scenario in scenarios]
    try:
        for n, run in serve_runs({n: call.send(None) for n, call in enumerate(calls)}):
            if isinstance(run, KneexoError):
                found[n] = outcome_of(run)
                continue
            finite = all(np.isfinite(values).all() for values in run.data.values())
            if not finite:
                found[n] = "nan", ""
                continue
            found[n] = "valid", ""
            try:
                calls[n].send(run)  # ends with the metrics
            except StopIteration:
                pass
            except KneexoError as error:
                found[n] = outcome_of(error)
    except Exception as error:  # of one scenario of several: each alone tells which
        if len(scenarios) == 1:
            return [outcome_of(error)]
        return [outcome for scenario in scenarios for outcome in run_outcomes([scenario])]
    finally:
        for call in calls:
            call.close()
    return [found[n] for n in range(len(scenarios))]


class Process:
    """A process that runs batches, and is replaced where one takes too long or dies."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=serve, args=(other,), daemon=True)
        self._process.start()
        other.close()

    def outcomes(self, scenarios: Sequence[Scenario]) -> list[tuple[str, str]]:
        """`run_outcomes` of each, or hang."""
        self._pipe.send(scenarios)
        reason = "hang"
        try:
            # The first run of a structure compiles it.
            if self._pipe.poll(RUN_LIMIT_S + 0.5 * len(scenarios)):
                result: list[tuple[str, str]] = self._pipe.recv()
                return result
        except EOFError:
            reason = "traceback"
        self._process.kill()
        self._process.join()
        self._begin()
        if len(scenarios) == 1:
            return [(reason, f"the process {'died' if reason == 'traceback' else 'did not end'}")]
        return [outcome for scenario in scenarios for outcome in self.outcomes([scenario])]

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()


def serve(pipe: Any) -> None:
    """Answer batches until the other end goes away."""
    while True:
        try:
            pipe.send(run_outcomes(pipe.recv()))
        except EOFError:
            return


def run_all(
    drawn_scenarios: Iterator[tuple[str, Scenario | None]], process: Any
) -> Iterator[tuple[str, str, str]]:
    """Outcome, message and changes of runs; neighbours, which share a structure, go together."""
    batch: list[tuple[str, Scenario]] = []

    def flush() -> Iterator[tuple[str, str, str]]:
        outcomes = process.outcomes([scenario for _, scenario in batch])
        for (told, scenario), (kind, message) in zip(batch, outcomes, strict=True):
            text = f"{told}\n{dump_scenario(scenario)}" if kind in BAD else told
            yield kind, message, text
        batch.clear()

    for told, scenario in drawn_scenarios:
        if scenario is None:
            yield "refused", "", told
            continue
        batch.append((told, scenario))
        if len(batch) == BATCH:
            yield from flush()
    if batch:
        yield from flush()


def linear_outcome(scenario: Scenario) -> tuple[str, str]:
    """What becomes of the linear loop of a scenario, and the message."""
    try:
        with time_limit(RUN_LIMIT_S):
            linearize_loop(scenario).margins()
        return "valid", ""
    except BaseException as error:  # a campaign counts whatever comes
        return outcome_of(error)


def linearized(scenarios: Iterator[tuple[str, Scenario | None]]) -> Iterator[tuple[str, str, str]]:
    """Outcome, message and changes of linearizations."""
    for told, scenario in scenarios:
        if scenario is None:
            yield "refused", "", told
        else:
            yield *linear_outcome(scenario), told


# ------------------------------------------------------------------------------- campaign


STRUCTURES = 60


def outcomes(part: str, count: int, seed: int) -> Iterator[tuple[str, str, str]]:
    """Outcome, message and changes of each case of ``files``, ``linear``, ``corners``, ``random``.

    ``count`` files or random runs; the corners are as many as there are.
    """
    if part == "files":
        yield from files(count, seed)
        return
    rng = random.Random(seed)
    templates = [structure(rng) for _ in range(STRUCTURES)]
    some = templates[: STRUCTURES // 6]
    if part == "linear":
        yield from linearized(corners(some[:5], seed))
        return
    process = Process()
    try:
        scenarios = corners(some, seed) if part == "corners" else randoms(templates, count, seed)
        yield from run_all(scenarios, process)
    finally:
        process.end()
