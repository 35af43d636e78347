"""Estimators of rod position, velocity and acceleration from one measured position.

Lee et al. 2020 do not say how their law (Eq. 27) gets velocity and acceleration; it decides
whether the law works at all. `TrackingObserver` is the default; `BackwardDifference` is the plain
attempt that quantization ruins.
"""

from __future__ import annotations

import math
from typing import Any

import pydrake.math as drake_math

from kneexo.errors import ParameterError
from kneexo.parameters import ObserverParameters, SlidingModeParameters
from kneexo.systems._leaf import NamedLeaf, discrete_state, leaf_template, values_of

_SAMPLE_TIME_S = SlidingModeParameters().sample_time_s


def tracking_gains(time_constant: Any, sample_time: float) -> tuple[Any, Any, Any]:
    """Gains on x, v and a of the α-β-γ observer whose three poles lie at z = e^(−T/T_f).

    1 − z³, 1.5(1 − z²)(1 − z)/T, (1 − z)³/T²; times in s.
    """
    z = drake_math.exp(-sample_time / time_constant)
    return (
        1.0 - z * z * z,
        1.5 * (1.0 - z * z) * (1.0 - z) / sample_time,
        (1.0 - z) * (1.0 - z) * (1.0 - z) / (sample_time * sample_time),
    )


def _checked(sample_time_s: float) -> float:
    if not 0.0 < sample_time_s < math.inf:
        raise ParameterError(f"sample_time_s = {sample_time_s} s: must be finite and > 0")
    return sample_time_s


class TrackingObserver(NamedLeaf):
    """Discrete third-order tracking observer (α-β-γ filter with a triple pole).

    Correct with the innovation y − x̂⁻ and the gains of `tracking_gains`, use the corrected
    estimate at once, then predict with constant acceleration over the sample time.

    =================  ====  ===============  ============================================
    input port         size  unit
    =================  ====  ===============  ============================================
    measured_position  1     m                y
    **output port**
    estimated_state    3     m, m/s, m/s²     x̂, v̂, â, corrected by the present y
    =================  ====  ===============  ============================================

    Discrete state, every ``sample_time_s``: the prediction x̂⁻, v̂⁻, â⁻.
    ``Simulator.Initialize()`` sets it to y at rest. Context parameter: ``time_constant_s``
    (T_f), by name. Raises `ParameterError` for a sample time that is not positive.
    """

    def __init__(
        self,
        parameters: ObserverParameters = ObserverParameters(),
        sample_time_s: float = _SAMPLE_TIME_S,
    ) -> None:
        self._declare_parameters(values_of(parameters, "time_constant_s"))
        self._sample_time = _checked(sample_time_s)
        self._position = self.DeclareVectorInputPort("measured_position", 1)
        sources = (self._position, self.xd_ticket(), self.all_parameters_ticket())
        self._estimate = self._declare_output("estimated_state", 3, self._correct, *sources)
        self._declare_update(sample_time_s, 3, self._predict)
        self._declare_initialization(lambda c: [self._position.Eval(c)[0], 0.0, 0.0])

    def _correct(self, context: Any) -> list[Any]:
        gains = tracking_gains(self.parameters(context).time_constant_s, self._sample_time)
        predicted = discrete_state(context)
        innovation = self._position.Eval(context)[0] - predicted[0]
        return [p + gain * innovation for p, gain in zip(predicted, gains, strict=True)]

    def _predict(self, context: Any) -> list[Any]:
        x, v, a = self._estimate.Eval(context)
        dt = self._sample_time
        return [x + dt * v + 0.5 * dt * dt * a, v + dt * a, a]


TrackingObserver_ = leaf_template(TrackingObserver)
"""`TrackingObserver` by scalar type."""


class BackwardDifference(NamedLeaf):
    """Velocity and acceleration by plain backward differences.

    v_k = (y_k − y_{k−1})/T, a_k = (v_k − v_{k−1})/T.

    Ports as of `TrackingObserver`. Discrete state, every ``sample_time_s``: y_{k−1}, v_{k−1};
    ``Simulator.Initialize()`` sets it to y at rest. No Context parameters.
    """

    def __init__(self, sample_time_s: float = _SAMPLE_TIME_S) -> None:
        self._sample_time = _checked(sample_time_s)
        self._position = self.DeclareVectorInputPort("measured_position", 1)
        self._estimate = self._declare_output(
            "estimated_state", 3, self._differences, self._position, self.xd_ticket()
        )
        self._declare_update(sample_time_s, 2, lambda c: self._estimate.Eval(c)[:2])
        self._declare_initialization(lambda c: [self._position.Eval(c)[0], 0.0])

    def _differences(self, context: Any) -> list[Any]:
        previous_y, previous_v = discrete_state(context)
        y = self._position.Eval(context)[0]
        v = (y - previous_y) / self._sample_time
        return [y, v, (v - previous_v) / self._sample_time]


BackwardDifference_ = leaf_template(BackwardDifference)
"""`BackwardDifference` by scalar type."""
