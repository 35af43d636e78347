"""Estimators of rod position, velocity and acceleration from one measured position.

Lee et al. 2020 do not say how their law (Eq. 27) obtains velocity and acceleration, but the law
works only with a good estimator. `TrackingObserver` is the default. `BackwardDifference` is the
simplest estimator; the quantization of the encoder makes its estimates useless.
"""

from __future__ import annotations

import math
from typing import Any

import pydrake.math as drake_math

from kneexo.errors import ParameterError
from kneexo.parameters import ObserverParameters, SlidingModeParameters
from kneexo.systems._leaf import NamedLeaf, discrete_state, leaf_template, values_of

# 2 ms, the period of the paper. The oil's mode of 447 Hz lies above its Nyquist frequency, so
# samples show the mode at 53 Hz, which the observer filters out.
_SAMPLE_TIME_S = SlidingModeParameters().sample_time_s


def tracking_gains(time_constant: Any, sample_time: float) -> tuple[Any, Any, Any]:
    """Return the gains on x, v and a of the α-β-γ observer with three poles at z = e^(−T/T_f).

    The gains are 1 − z³, 1.5(1 − z²)(1 − z)/T and (1 − z)³/T². ``time_constant`` T_f and
    ``sample_time`` T are in s.
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

    In each sample the observer corrects its prediction by the innovation y − x̂⁻ times the gains of
    `tracking_gains`. The output is the corrected estimate. Then the observer predicts the next
    sample with constant acceleration.

    =================  ====  ===============  ============================================
    input port         size  unit
    =================  ====  ===============  ============================================
    measured_position  1     m                y
    **output port**
    estimated_state    3     m, m/s, m/s²     x̂, v̂, â, corrected by the present y
    =================  ====  ===============  ============================================

    The discrete state, updated every ``sample_time_s``, is the prediction x̂⁻, v̂⁻, â⁻.
    ``Simulator.Initialize()`` sets the prediction to the present y, at rest. Context parameter by
    name: ``time_constant_s`` (T_f). Raises `ParameterError` for a sample time that is not positive.
    """

    def __init__(
        self,
        parameters: ObserverParameters = ObserverParameters(),
        sample_time_s: float = _SAMPLE_TIME_S,
    ) -> None:
        self._declare_parameters(values_of(parameters, "time_constant_s"))
        self._sample_time = _checked(sample_time_s)
        self._position = self.DeclareVectorInputPort("measured_position", 1)
        # The output contains the present reading already. So the law, which reads it in the same
        # sample, adds no second delay.
        self._estimate = self._declare_output(
            "estimated_state", 3, self._correct, self._position, self.xd_ticket()
        )
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
"""Template of `TrackingObserver` classes by scalar type of Drake."""


class BackwardDifference(NamedLeaf):
    """Estimates velocity and acceleration by backward differences.

    v_k = (y_k − y_{k−1})/T, a_k = (v_k − v_{k−1})/T.

    The system has the ports of `TrackingObserver`. The discrete state, updated every
    ``sample_time_s``, is y_{k−1}, v_{k−1}. ``Simulator.Initialize()`` sets it to the present y, at
    rest. There are no Context parameters. Raises `ParameterError` for a sample time that is not
    positive.
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
"""Template of `BackwardDifference` classes by scalar type of Drake."""
