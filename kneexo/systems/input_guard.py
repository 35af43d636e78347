"""Guard before the fault detectors: replaces input values that no sensor or reference can give."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

from kneexo.parameters.device.protection import LARGEST_THRESHOLDS
from kneexo.parameters.device.safety_states import DETECTORS
from kneexo.parameters.wearer.wearer import LARGEST_MOMENT_N_M
from kneexo.systems._leaf import (
    NamedLeaf,
    discrete_state,
    leaf_template,
    where_positive,
    where_within,
)


class _Signal(NamedTuple):
    """An input that the guard watches."""

    size: int
    held: slice
    """Places of the last good values of the first elements in the discrete state of the guard.

    They take the place of bad values. The other elements of a bad input become zero.
    """
    detector: str = ""
    """The detector that counts the bad values."""
    largest: float = 0.0
    """Largest magnitude of the first element in SI units."""


SIGNALS = {
    "knee_reference": _Signal(4, slice(0, 1), "following"),
    "measured_force": _Signal(2, slice(1, 3), "load_cell", LARGEST_THRESHOLDS["load_cell"]),
    "biological_moment": _Signal(1, slice(0), largest=LARGEST_MOMENT_N_M),
    # flow, not speed: a bad reading is implausible and stops the motor in each state, while speed
    # says that the motor does not obey.
    "motor_speed": _Signal(1, slice(3, 4), "flow", LARGEST_THRESHOLDS["speed"]),
}
"""The inputs that a guard can watch, by the name of their ports."""


def context_values(reference_range_rad: tuple[float, float]) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `InputGuard`."""
    low, high = reference_range_rad
    return {"reference_min_rad": low, "reference_max_rad": high}


class InputGuard(NamedLeaf):
    """Replaces bad inputs of a controller, so that all parts behind the guard get finite numbers.

    An input is bad if one of its elements is not finite or out of its range. The range of the knee
    reference is ``reference_range_rad``. Motor speed, force and moment are within the largest
    values that a user can choose: 10⁶ rpm, 10⁶ N and 10³ N·m. The element n places behind the
    first one is within ±(high − low)/Tⁿ, with the range of the first one and the sample time T. A
    larger derivative would carry the knee from one end of its range to the other in a sample.

    =================  ==========================================  ==============================
    input              what takes the place of a bad one           detector that counts it
    =================  ==========================================  ==============================
    knee_reference     its last good angle, with derivatives of 0  following
    measured_force     the last good one                           load_cell
    biological_moment  0                                           none
    motor_speed        the last good one                           flow
    =================  ==========================================  ==============================

    If the reference is bad at the start, the knee angle of the start takes its place, so the law
    keeps the knee there. The other inputs are 0 before their first good value.

    =================  ====  =============  =======================================================
    input port         size  unit
    =================  ====  =============  =======================================================
    knee_angle         1     rad            measured angle, for the start
    knee_reference     4     rad, rad/s, …  θ_ref and derivatives
    measured_force     2     N, s           reading and its age; if in ``names``
    biological_moment  1     N·m            if in ``names``
    motor_speed        1     rad/s          as the drive reports it
    **output port**
    …                                       each input but ``knee_angle``, without bad values
    bad                6     1              in the order of `DETECTORS`: 1 where a detector has to
                                            count a bad input, else 0
    =================  ====  =============  =======================================================

    Discrete states, updated every ``sample_time_s``: reference angle, force, its age, and motor
    speed. Context parameters by name: ``reference_min_rad`` and ``reference_max_rad``. Source: an
    assumption. Lee et al. 2020 have no guard.

    Parameters
    ----------
    reference_range_rad
        Least and largest reference of the knee angle in rad.
    sample_time_s
        Time T between two samples in s.
    names
        The inputs, of `SIGNALS`; knee reference and motor speed are among them.
    """

    def __init__(
        self,
        reference_range_rad: tuple[float, float] = (0.0, 0.5 * math.pi),
        sample_time_s: float = 0.002,
        names: tuple[str, ...] = tuple(SIGNALS),
    ) -> None:
        self._declare_parameters(context_values(reference_range_rad))
        self._sample_time = sample_time_s
        self._angle = self.DeclareVectorInputPort("knee_angle", 1)
        self._inputs = {n: self.DeclareVectorInputPort(n, SIGNALS[n].size) for n in names}
        self._declare_update(sample_time_s, 4, self._update)
        self._declare_initialization(self._initialize)
        self._good = {}
        for name, port in self._inputs.items():
            calc, state = partial(self._calc_good, name), self.xd_ticket()
            self._good[name] = self._declare_output(name, port.size(), calc, port, state)
        self._declare_output("bad", len(DETECTORS), self._calc_bad, *self._inputs.values())

    def _is_good(self, name: str, context: Any) -> Any:
        """Return 1 if all elements of an input are good, else 0."""
        largest = SIGNALS[name].largest
        low, high = (-largest, largest) if largest else self.parameters(context)
        good: Any = 1.0
        span = high - low
        for value in self._inputs[name].Eval(context):
            good = where_within(value, low, high, good, 0.0)
            span = span / self._sample_time
            low, high = -span, span
        return good

    def _calc_good(self, name: str, context: Any) -> list[Any]:
        good, values = self._is_good(name, context), self._inputs[name].Eval(context)
        held = discrete_state(context)[SIGNALS[name].held]
        held += [0.0] * (len(values) - len(held))
        return [where_positive(good, *pair) for pair in zip(values, held, strict=True)]

    def _calc_bad(self, context: Any) -> list[Any]:
        good = {SIGNALS[name].detector: self._is_good(name, context) for name in self._inputs}
        return [1.0 - good.get(detector, 1.0) for detector in DETECTORS]

    def _update(self, context: Any) -> list[Any]:
        state = discrete_state(context)
        for name, port in self._good.items():
            held = SIGNALS[name].held
            state[held] = port.Eval(context).tolist()[: len(state[held])]
        return state

    def _initialize(self, context: Any) -> list[Any]:
        angle = self._inputs["knee_reference"].Eval(context)[0]
        good = self._is_good("knee_reference", context)
        angle = where_positive(good, angle, self._angle.Eval(context)[0])
        return [angle, *self._update(context)[1:]]


InputGuard_ = leaf_template(InputGuard)
"""Template of `InputGuard` classes by scalar type of Drake."""
