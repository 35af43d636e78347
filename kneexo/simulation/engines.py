"""Runs closed loops by the compiled engine or by Drake's Simulator, alone or in batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from diagramc import ROUGH_STEP_S, Reduction
from kneexo.common.result import Array
from kneexo.diagrams import make_closed_loop
from kneexo.diagrams.closed_loop import chosen_signals, signal_columns
from kneexo.errors import (
    KneexoError,
    ParameterError,
    SimulationError,
    StiffnessError,
    UnstableStepError,
    shortened,
)
from kneexo.law.decision import makers_called_once
from kneexo.law.python_law import sign_hint
from kneexo.parameters import Scenario
from kneexo.parameters.scenario import require_scenario
from kneexo.simulation.drake import simulate_diagram
from kneexo.simulation.lockstep import ask, needs_runs
from kneexo.simulation.run import Run


@dataclass(frozen=True)
class RunRequest:
    """A request to simulate a scenario; the answer is a `Run`. `simulate` describes the fields.

    ``reductions`` are numbers that the compiled engine computes from output ports of the closed
    loop. ``reductions`` must be empty if `can_reduce` refuses the scenario.
    """

    scenario: Scenario
    signals: Sequence[str] | None = None
    progress: Callable[[float], Any] | None = None
    reductions: tuple[Reduction, ...] = ()


# Four vectors of eight lanes. Half of an earlier 64, for half of the memory under way; larger lots
# of calls in lockstep (`LARGEST_LOT`) keep the lanes full.
LARGEST_BATCH = 32
"""Largest number of runs in a batch of the compiled engine."""

_LARGEST_RECORD = 4_000_000  # numbers that a batch may log: 32 MB

LARGEST_RUN_BYTES = 2 * 2**30
"""Largest size of the logged signals of a run in bytes."""

# About half a minute: RK4 takes 30 ns a step of the loop without load (docs/engine.md).
MOST_STEPS = 1_000_000_000
"""Largest number of steps of a run with a fixed step size."""

MOST_STEPS_OF_A_SAMPLE = 2000.0
"""Largest number of steps of RK4 in a control period where RK4 repeats a run."""


def serve_runs(requests: Mapping[int, RunRequest]) -> Iterator[tuple[int, Run | KneexoError]]:
    """Yield the index of each request and its run or its error, as soon as the run ends.

    The compiled engine simulates scenarios that differ only in numbers in batches. If the
    integrator ``exact_hold`` fails in a run, RK4 repeats the run with steps of 20 µs, or with the
    steps that its fastest mode requires, and ``rosenbrock`` if these are too many. The result of a
    run does not depend on the other runs in its batch.
    """
    ways: dict[Any, list[int]] = {}
    for index, request in requests.items():
        settings = request.scenario.simulation
        try:
            fault, compiled = _too_large(request), is_compiled(request.scenario)
        except KneexoError as error:  # of a part of the user that does not fit
            yield index, error
            continue
        if fault:
            yield index, fault
        elif compiled:
            signals = None if request.signals is None else tuple(request.signals)
            way = (settings.integrator, settings.step_s, settings.tolerance)
            kinds = tuple((r.kind, r.output, r.minus, r.magnitude) for r in request.reductions)
            ways.setdefault((signals, kinds, way), []).append(index)
        else:
            yield index, _drake_run(request)
    rough: dict[Any, list[int]] = {}
    for (signals, kinds, way), indices in ways.items():
        for index, run in _compiled_runs(requests, indices, signals, way):
            # Such as valves that chatter; the substeps of rosenbrock that the user chose stay.
            if isinstance(run, StiffnessError) and way[0] == "exact_hold":
                rough.setdefault((signals, kinds), []).append(index)
            else:
                yield index, run
    for (signals, _), indices in rough.items():
        for index, run in _compiled_runs(requests, indices, signals, ("rk4", ROUGH_STEP_S)):
            yield index, _repeated(requests, index, signals, run)


def _repeated(
    requests: Mapping[int, RunRequest], index: int, signals: Any, run: Run | KneexoError
) -> Run | KneexoError:
    """Repeat a run of RK4 with shorter steps as long as its steps are unstable.

    If RK4 would need too many steps, ``rosenbrock`` makes the run. Return the last run or its
    error. ``index`` selects the request of the run.
    """
    settings = requests[index].scenario.simulation
    sample_time_s = requests[index].scenario.controller.sample_time_s
    while isinstance(unstable := run, UnstableStepError):
        steps = sample_time_s / unstable.step_s
        way = ("rk4", unstable.step_s)
        if steps > MOST_STEPS_OF_A_SAMPLE:
            way = ("rosenbrock", settings.step_s)
        ((_, run),) = _compiled_runs(requests, [index], signals, way)
        if isinstance(run, StiffnessError):
            # The repr of a plant has the values that differ from their defaults.
            plant = shortened(repr(requests[index].scenario.plant), 300)
            error = StiffnessError(
                f"{str(unstable).split('; ')[0]}, and neither can exact_hold nor rosenbrock; "
                f"change plant = {plant}, or set simulation.integrator = rk4 and step_s = "
                f"{unstable.step_s:.1e}, which takes {steps:.0f} steps a sample"
            )
            error.time_s, error.state = unstable.time_s, unstable.state
            return error
    return run


def _too_large(request: RunRequest) -> ParameterError | None:
    """Return an error if the run would require too much memory or time, otherwise None."""
    settings, duration_s = request.scenario.simulation, request.scenario.duration_s
    duration = f"simulation.duration_s = {duration_s:g} s"
    samples, width = _records(request), max(_width(request), 1)  # at least the times
    size = 8.0 * samples * width
    if size > LARGEST_RUN_BYTES:
        return ParameterError(
            f"{duration} at sample_time_s = {request.scenario.controller.sample_time_s:g} s: "
            f"{samples:.0f} samples of {width} columns take {size / 2**30:.3g} GiB, must be at "
            f"most {LARGEST_RUN_BYTES / 2**30:g} GiB; reduce duration_s or log fewer signals"
        )
    steps = duration_s / settings.step_s
    controlled = settings.integrator in ("exact_hold", "rosenbrock")
    if not controlled and steps > MOST_STEPS:
        return ParameterError(
            f"{duration} at step_s = {settings.step_s:g} s: takes {steps:.3g} steps, must be at "
            f"most {MOST_STEPS:g}"
        )
    return None


def _records(request: RunRequest) -> float:
    """Return the number of samples that a run logs."""
    scenario = request.scenario
    return scenario.duration_s / scenario.controller.sample_time_s


def _width(request: RunRequest) -> int:
    """Return the number of columns that a run logs. An unknown signal has no column."""
    available = signal_columns(request.scenario)
    names = available if request.signals is None else request.signals
    return sum(len(available.get(name, ())) for name in names)


def _drake_run(request: RunRequest) -> Run | KneexoError:
    scenario = request.scenario
    settings = scenario.with_duration().simulation
    try:
        signals = chosen_signals(scenario, request.signals)
        diagram = make_closed_loop(scenario, signals=tuple(signals))
        columns = [column for names in signals.values() for column in names]
        context = diagram.CreateDefaultContext()
        return simulate_diagram(diagram, context, columns, settings, request.progress)
    except KneexoError as error:
        fixed = settings.integrator == "runge_kutta3" and not settings.error_controlled
        if isinstance(error, SimulationError) and fixed:
            from kneexo.simulation.compiled import simulate_compiled

            try:  # the same steps, but the compiled engine tells steps that are too long
                simulate_compiled(
                    scenario, signals=(), integrator=settings.integrator, step_s=settings.step_s
                )
            except UnstableStepError as unstable:
                return unstable
            except KneexoError:
                pass
        return error


def _compiled_runs(
    requests: Mapping[int, RunRequest], indices: Sequence[int], signals: Any, way: Any
) -> Iterator[tuple[int, Run | KneexoError]]:
    from kneexo.simulation import compiled

    # Only runs of one structure have the same equations, and so the same machine code.
    groups: dict[str, list[int]] = {}
    for index in indices:
        groups.setdefault(compiled.structure_key(requests[index].scenario), []).append(index)
    for group in groups.values():
        for batch in _batches(group, requests):
            scenarios = [requests[index].scenario for index in batch]
            reductions = [requests[index].reductions for index in batch]
            runs = compiled.simulate_together(scenarios, signals, *way, reductions=reductions)
            for index, run in zip(batch, runs, strict=True):
                if (progress := requests[index].progress) is not None and isinstance(run, Run):
                    progress(requests[index].scenario.duration_s)
                yield index, run


def _batches(group: Sequence[int], requests: Mapping[int, RunRequest]) -> Iterator[list[int]]:
    """Divide requests into batches of similar duration and yield the indices of each batch.

    The logged signals of a batch fit into memory.
    """
    width = _width(requests[group[0]])
    # By duration, because a lane whose run has ended waits for the longest run of its batch.
    waiting = sorted(group, key=lambda index: _records(requests[index]), reverse=True)
    while waiting:
        most = max(1, int(_LARGEST_RECORD / (width * _records(requests[waiting[0]]) + 1.0)))
        size = min(LARGEST_BATCH, most)
        yield waiting[:size]
        del waiting[:size]


@needs_runs
def simulate(
    scenario: Scenario = Scenario(),
    *,
    signals: Sequence[str] | None = None,
    progress: Callable[[float], Any] | None = None,
    law: Any = None,
    initial_state: Sequence[float] = (),
) -> Run:
    """Run the closed loop of ``scenario`` and return the logged signals.

    ``scenario.simulation.integrator`` chooses between the compiled engine and Drake's Simulator. If
    the integrator ``exact_hold`` fails because the valves make the equations too stiff, RK4 repeats
    the run with steps of 20 µs, or with the steps that the fastest mode of the run requires. If
    these are more than `MOST_STEPS_OF_A_SAMPLE`, ``rosenbrock`` repeats the run. The ``settings``
    of the returned run then name that integrator.

    Parameters
    ----------
    scenario
        The closed loop, its duration and its solver.
    signals
        Names in `kneexo.diagrams.SIGNALS` of the signals to log. None: all available signals.
    progress
        Function that is called with the simulated time in s. The compiled engine calls it once, at
        the end of the run.
    law, initial_state
        A control law that replaces the law of ``scenario``: see `Scenario.with_law`.

    Raises
    ------
    SimulationError
        The run diverges or leaves its range. The message says so if a ``law`` has the wrong sign.
    ParameterError, LinkageError
        For the same reasons as in `kneexo.diagrams.make_closed_loop`. `ParameterError` also if the
        run would require too much memory or time.
    """
    require_scenario(scenario)
    if law is not None:
        scenario = scenario.with_law(law, initial_state=initial_state)
    if isinstance(signals, str):
        chosen_signals(scenario, signals)  # raises the error
    return _run(RunRequest(scenario, signals, progress))


@makers_called_once()
def _run(request: RunRequest) -> Run:
    """Return the run that answers a request.

    If the run fails and the law seems to have a wrong sign, the message of the error says so.
    """
    try:
        run: Run = ask(serve_runs, request)
        return run
    except SimulationError as error:
        if hint := sign_hint(request.scenario):
            error.args = (f"{error}; {hint}",)
        raise


def is_compiled(scenario: Scenario) -> bool:
    """Return True if the compiled engine runs a scenario, and False if Drake's Simulator does.

    Drake's Simulator also runs a scenario with a part of the user that has no symbolic equations.
    Raises the errors of `make_closed_loop` for a part that does not fit.
    """
    from kneexo.simulation.compiled import why_not_compiled

    return scenario.simulation.compiled and not why_not_compiled(scenario)


def can_reduce(scenario: Scenario) -> bool:
    """Return True if the engine and the control law of a scenario are compiled."""
    from kneexo.simulation.compiled import why_python_in_run

    return is_compiled(scenario) and not why_python_in_run(scenario)


@needs_runs
def reduce_run(scenario: Scenario, reductions: tuple[Reduction, ...]) -> Array:
    """Run the closed loop of a scenario that `can_reduce`; return the values of ``reductions``.

    The outputs of the reductions are names of `kneexo.diagrams.SIGNALS`, and a sample is taken at
    each control period. The run logs no signals. Raises the errors of `simulate`.
    """
    return _run(RunRequest(scenario, (), reductions=reductions)).reduced
