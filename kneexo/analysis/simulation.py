"""One run of a closed loop through Drake's Simulator, as arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram

from kneexo.diagrams import available_signals, columns, make_closed_loop
from kneexo.errors import SimulationError, StiffnessError
from kneexo.parameters import Scenario, SimulationParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """Logged signals of one simulation: ``time_s`` (n,) and ``data`` by column name, each (n,).

    A command at time t is the one held up to t. ``settings`` are those of the solver.
    """

    time_s: Array
    data: dict[str, Array]
    settings: SimulationParameters

    def __getitem__(self, column: str) -> Array:
        """The column of that name, (n,)."""
        return self.data[column]


def simulate_diagram(
    diagram: Diagram,
    context: Context,
    names: Sequence[str],
    settings: SimulationParameters,
    progress: Callable[[float], Any] | None = None,
) -> Run:
    """Run a diagram that has a `VectorLogSink` named ``log`` with the columns ``names``.

    ``context`` is the root Context to start from; it is changed. ``progress`` gets the simulated
    time every 0.25 s. Drake's `radau3` stands in for the compiled engine's integrators. Raises
    `SimulationError` when the run diverges, stalls or leaves the range of motion.
    """
    settings = settings.with_drake()
    log = diagram.GetSubsystemByName("log").FindMutableLog(context)
    log.Clear()
    simulator = Simulator(diagram, context)
    ApplySimulatorConfig(
        SimulatorConfig(
            integration_scheme=settings.integrator,
            max_step_size=settings.step_s,
            accuracy=settings.accuracy,
            use_error_control=settings.error_controlled,
            start_time=context.get_time(),
        ),
        simulator,
    )
    start = end = context.get_time()
    while end < start + settings.duration_s:
        end = min(end + 0.25, start + settings.duration_s)
        try:
            simulator.AdvanceTo(end)  # initializes, the first time
        except (RuntimeError, ValueError) as error:
            if isinstance(error, SimulationError):
                raise
            reason = str(error).splitlines()[0]
            raise SimulationError(
                f"t = {context.get_time():.6g} s: {diagram.get_name()}: the integrator "
                f"{settings.integrator} gave up at step_s = {settings.step_s:g} s ({reason}); "
                f"reduce the step"
            ) from None
        if progress is not None:
            progress(end - start)
    values = log.data().copy()
    finite = np.isfinite(values)
    if not finite.all():
        row, sample = (int(i[0]) for i in np.nonzero(~finite))
        raise SimulationError(
            f"t = {log.sample_times()[sample]:.6g} s: {names[row]} is not finite; reduce the step "
            f"or check the parameters"
        )
    return Run(log.sample_times().copy(), dict(zip(names, values, strict=True)), settings)


def simulate(
    scenario: Scenario = Scenario(),
    *,
    signals: Sequence[str] | None = None,
    progress: Callable[[float], Any] | None = None,
) -> Run:
    """Run the closed loop of ``scenario``; all available signals by default.

    ``scenario.simulation.integrator`` chooses between the compiled engine and Drake's Simulator.
    Where the exact hold cannot follow, RK4 with steps of 20 µs goes on in its place (the run's
    ``settings`` say so). Raises what `make_closed_loop` and `simulate_diagram` raise.
    """
    settings = scenario.simulation
    if settings.compiled:
        from kneexo.compilation.runner import ROUGH_STEP_S
        from kneexo.simulation.compiled import simulate_compiled

        try:
            run = simulate_compiled(
                scenario,
                signals=signals,
                integrator=settings.integrator,
                step_s=settings.step_s,
                tolerance=settings.tolerance,
            )
        except StiffnessError:  # valves that open and close all the time: small steps, no error
            run = simulate_compiled(
                scenario, signals=signals, integrator="rk4", step_s=ROUGH_STEP_S
            )
        if progress is not None:
            progress(settings.duration_s)
        return run
    names = available_signals(scenario) if signals is None else tuple(signals)
    diagram = make_closed_loop(scenario, signals=names)
    return simulate_diagram(
        diagram, diagram.CreateDefaultContext(), columns(names), scenario.simulation, progress
    )


def period_s(scenario: Scenario) -> float:
    """Period of a sinusoidal reference in s; zero for every other one."""
    reference = scenario.reference
    return 1.0 / reference.frequency_hz if reference.kind == "sine" else 0.0


def rms(values: Array) -> float:
    """Root mean square of ``values`` (n,)."""
    return float(np.sqrt(np.mean(np.square(values))))


def to_rpm(speed: Any) -> Any:
    """Speed in rpm from rad/s."""
    return speed * 30.0 / math.pi
