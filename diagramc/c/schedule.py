"""Computes tick, update periods and Runge-Kutta steps of a model in C."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..equations.equations import Equations
from ..errors import CompilationError
from ..native.timing import timing
from ..run_data import Array, State
from .checks import require_positive
from .step_size import rk4_step_s

_LONGEST_CYCLE = 2**31  # an uint32_t counts the ticks of a cycle
_MOST_STEPS = 2**16 - 1  # an uint16_t counts them


@dataclass(frozen=True)
class Schedule:
    """Times of a model in C. One call of ``NAME_step`` simulates one tick."""

    tick_s: float
    """Length of a tick in s: the sample time of the model."""
    periods: tuple[int, ...]
    """Period in ticks of each group of updates that have the same sample time and offset."""
    offsets: tuple[int, ...]
    """For each group of updates, the first tick at which the group is due."""
    largest_step_s: float
    """Largest allowed step of the Runge-Kutta method in s; infinite for the Rosenbrock method."""

    @property
    def steps(self) -> int:
        """Number of Runge-Kutta steps in a tick."""
        # 0.003 s / 0.0003 s is 10.000000000000002, and must not become eleven steps.
        return max(1, math.ceil(self.tick_s / self.largest_step_s - 1e-9))

    @property
    def step_s(self) -> float:
        """Length of a Runge-Kutta step in s."""
        return self.tick_s / self.steps

    @property
    def counts_ticks(self) -> bool:
        """Whether the model must count ticks, because some updates are not due at every tick."""
        return any(self.offsets) or any(period > 1 for period in self.periods)

    @property
    def cycle(self) -> tuple[int, int]:
        """First ticks of two successive cycles. Every cycle has the same updates at its ticks."""
        first = max(self.offsets, default=0)
        return first, first + math.lcm(1, *self.periods)


def schedule_of(
    name: str,
    equations: Equations,
    parameters: Array,
    state: State,
    tick_s: float | None,
    step_s: float | None,
    integrator: str = "rk4",
) -> Schedule:
    """Return the schedule of the model ``name``. For the arguments see `CSource`.

    Raises `CompilationError` if the diagram has no sample time and ``tick_s`` is None, if
    ``tick_s`` or ``step_s`` is not finite and positive, if a tick has too many steps, or if the
    updates repeat only after 2³¹ ticks.
    """
    if not equations.updates and tick_s is None:
        raise CompilationError(f"{name}: tick_s is needed, for it has no sample time")
    for time, value in {"tick_s": tick_s, "step_s": step_s}.items():
        if value is not None:
            require_positive(time, value, "s")
    periods: list[int] = []
    offsets: list[int] = []
    if equations.updates:
        try:
            times = timing(tuple((u.period_s, u.offset_s) for u in equations.updates), tick_s)
        except OverflowError:  # a sample time has more than 2^63 ticks
            raise CompilationError(
                f"tick_s = {tick_s:g} s: is too short beside the sample times of {name}; must be "
                f"a usual fraction of them"
            ) from None
        tick_s, periods, offsets = times.tick, times.periods.tolist(), times.offsets.tolist()
    assert tick_s is not None
    if integrator == "rosenbrock":  # chooses its substeps while it runs
        largest_s = math.inf
    else:
        largest_s = rk4_step_s(equations, parameters, state) if step_s is None else step_s
    result = Schedule(tick_s, tuple(periods), tuple(offsets), largest_s)
    if equations.states and result.steps > _MOST_STEPS:
        raise CompilationError(
            f"step_s = {largest_s:g} s: makes {result.steps} steps in a sample time of "
            f"{tick_s:g} s; must be at most {_MOST_STEPS}"
        )
    if result.cycle[1] >= _LONGEST_CYCLE:
        raise CompilationError(f"{name}: sample times repeat only after 2^31 ticks")
    return result
