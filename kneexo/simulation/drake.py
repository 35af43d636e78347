"""Runs diagrams by Drake's Simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram

from kneexo.common.user_code import cause_of, place_in_user_code
from kneexo.errors import KneexoError, SimulationError
from kneexo.parameters import DEFAULT_DURATION_S, SimulationParameters
from kneexo.simulation.run import Run


def simulate_diagram(
    diagram: Diagram,
    context: Context,
    names: Sequence[str],
    settings: SimulationParameters,
    progress: Callable[[float], Any] | None = None,
) -> Run:
    """Run a diagram by Drake's Simulator and return the logged signals.

    Parameters
    ----------
    diagram
        A diagram with a `VectorLogSink` named ``log``.
    context
        Root Context from which the run starts; the run changes it.
    names
        Names of the columns of the log.
    settings
        Duration (None: `DEFAULT_DURATION_S`) and integrator. Drake's ``radau3`` replaces an
        integrator of the compiled engine.
    progress
        Function that is called with the simulated time in s after every 0.25 s of simulated time.

    Raises
    ------
    SimulationError
        The run diverges, the integrator fails, a system leaves its range of motion, or the code of
        a user's system fails.
    """
    # radau3 at 2 ms is stable for the 447 Hz mode of the oil, and damps it: a residual oscillation
    # of the pressure is less than half as large (docs/validation.md).
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
    duration_s = DEFAULT_DURATION_S if settings.duration_s is None else settings.duration_s
    while end < start + duration_s:
        end = min(end + 0.25, start + duration_s)
        try:
            simulator.AdvanceTo(end)  # the first call initializes the Context
        except (Exception, SystemExit) as error:
            if isinstance(error, KneexoError):
                raise
            time = f"t = {context.get_time():.6g} s"
            if place_in_user_code(error) is not None or isinstance(error, SystemExit):
                raise SimulationError(f"{time}: {cause_of(error)}; correct that code") from error
            if not isinstance(error, RuntimeError | ValueError):
                raise
            reason = str(error).splitlines()[0]
            raise SimulationError(
                f"{time}: {diagram.get_name()}: the integrator "
                f"{settings.integrator} gave up at step_s = {settings.step_s:g} s ({reason}); "
                f"reduce the step"
            ) from None
        if progress is not None:
            progress(end - start)
    times, data = log.sample_times().copy(), log.data().copy()
    finite = np.isfinite(data)
    if not finite.all():
        row = int(np.argmin(finite.all(axis=0)))
        raise SimulationError(
            f"t = {times[row]:.6g} s: {names[int(np.argmin(finite[:, row]))]} is not finite; "
            f"reduce the step or check the parameters"
        )
    return Run(times, dict(zip(names, data, strict=True)), settings)
