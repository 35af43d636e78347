"""Knee references: θ_d(t) and its three time derivatives.

Each system has one output port, ``knee_reference``: θ_d, dθ_d/dt, d²θ_d/dt², d³θ_d/dt³ in rad and
s. `make_knee_reference` makes the system for a parameter class. Samples become Drake's
`TrajectorySource`, whose port ``y0`` has the same output. A `TrajectorySource` has no Context
parameters and no value at a symbolic time. If a loop requires these,
``make_closed_loop(external_reference=True)`` replaces the reference by an input port.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pydrake.math as drake_math
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from kneexo.errors import ParameterError
from kneexo.geometry.linkage import polynomial, polynomial_derivative
from kneexo.parameters import (
    KneeParameters,
    RampReference,
    Reference,
    SampledReference,
    Scenario,
    SineReference,
    StepReference,
)
from kneexo.systems._leaf import NamedLeaf, clip, leaf_template, where_positive


class _KneeReference(NamedLeaf):
    """Base of the references: one output that depends on time and on Context parameters."""

    def _declare(
        self,
        parameters: SineReference | StepReference | RampReference,
        evaluate: Callable[[Any, Any], list[Any]],
    ) -> None:
        self._declare_parameters(context_values(parameters))
        self._declare_output(
            "knee_reference",
            4,
            lambda c: evaluate(c.get_time(), self.parameters(c)),
            self.time_ticket(),
        )


# Of degree seven, because the sliding-mode law needs three continuous derivatives of the reference.
_SMOOTHSTEP = (-20.0, 70.0, -84.0, 35.0, 0.0, 0.0, 0.0, 0.0)
"""Coefficients, highest power first, of a polynomial that rises from 0 at 0 to 1 at 1.

The first three derivatives of the polynomial are zero at 0 and at 1.
"""


def _ramp(time: Any, ramp_s: Any) -> list[Any]:
    """Return a smooth rise from 0 to 1 over ``ramp_s`` and its three time derivatives.

    The rise is 1 at all times if ``ramp_s`` is zero.
    """
    scale = 1.0 / where_positive(ramp_s, ramp_s, 1.0)
    share = time * scale
    return [
        where_positive(
            ramp_s - time,
            scale**order * polynomial(polynomial_derivative(_SMOOTHSTEP, order), share),
            1.0 if order == 0 else 0.0,
        )
        for order in range(4)
    ]


def _product_derivatives(u: list[Any], v: list[Any]) -> list[Any]:
    """Return the product of two functions of time and its derivatives, by Leibniz's rule.

    ``u`` and ``v`` have the value of each function, and then its derivatives.
    """
    return [sum(math.comb(n, k) * u[k] * v[n - k] for k in range(n + 1)) for n in range(len(u))]


def sine(time: Any, p: Any) -> list[Any]:
    """Return θ_d = mean − w(t)·amplitude·cos(2πft) and its three time derivatives.

    w is the smooth rise from 0 to 1 over the ramp. ``p`` has the `context_values` as attributes.
    """
    omega = 2.0 * math.pi * p.frequency_hz
    cosine = p.amplitude_rad * drake_math.cos(omega * time)
    sine = p.amplitude_rad * drake_math.sin(omega * time)
    wave = [-cosine, omega * sine, omega * omega * cosine, -omega * omega * omega * sine]
    angle, *rates = _product_derivatives(_ramp(time, p.ramp_s), wave)
    return [p.mean_rad + angle, *rates]


def step(time: Any, p: Any) -> list[Any]:
    """Return a θ_d that jumps just after ``p.time_s``, and its three time derivatives.

    ``p`` has the `context_values` as attributes.
    """
    return [where_positive(time - p.time_s, p.end_rad, p.start_rad), 0.0, 0.0, 0.0]


def ramp(time: Any, p: Any) -> list[Any]:
    """Return a θ_d that moves from start to end at a constant rate, and its three derivatives.

    ``p`` has the `context_values` as attributes.
    """
    distance = p.end_rad - p.start_rad
    travel = drake_math.abs(distance)
    direction = where_positive(distance, 1.0, -1.0)
    covered = p.rate_rad_s * (time - p.time_s)
    inside = where_positive(covered, where_positive(travel - covered, 1.0, 0.0), 0.0)
    angle = p.start_rad + direction * clip(covered, 0.0, travel)
    return [angle, direction * p.rate_rad_s * inside, 0.0, 0.0]


def context_values(parameters: SineReference | StepReference | RampReference) -> dict[str, float]:
    """Return a dictionary of the Context parameters of a reference system, with angles in rad."""
    return {
        name.replace("_deg", "_rad"): math.radians(value) if "_deg" in name else value
        for name, value in parameters
        if name != "kind"
    }


class SineKneeReference(_KneeReference):
    """Reference θ_d = mean − w(t)·amplitude·cos(2πft), with three time derivatives.

    The factor w rises from 0 to 1 over the ramp, with three continuous derivatives. Without a ramp
    w is 1. Context parameters by name: ``mean_rad``, ``amplitude_rad``, ``frequency_hz`` and
    ``ramp_s``.
    """

    def __init__(self, parameters: SineReference = SineReference()) -> None:
        self._declare(parameters, sine)


SineKneeReference_ = leaf_template(SineKneeReference)
"""Template of `SineKneeReference` classes by scalar type of Drake."""


class StepKneeReference(_KneeReference):
    """Reference that jumps from start to end just after ``time_s``; its derivatives are zero.

    Context parameters by name: ``start_rad``, ``end_rad``, ``time_s``.
    """

    def __init__(self, parameters: StepReference = StepReference()) -> None:
        self._declare(parameters, step)


StepKneeReference_ = leaf_template(StepKneeReference)
"""Template of `StepKneeReference` classes by scalar type of Drake."""


class RampKneeReference(_KneeReference):
    """Reference that moves from start to end at a constant rate, from ``time_s`` on.

    Context parameters by name: ``start_rad``, ``end_rad``, ``time_s``, ``rate_rad_s`` (> 0).
    """

    def __init__(self, parameters: RampReference = RampReference()) -> None:
        self._declare(parameters, ramp)


RampKneeReference_ = leaf_template(RampKneeReference)
"""Template of `RampKneeReference` classes by scalar type of Drake."""


class IntervalReference(NamedLeaf):
    """Reference from polynomials in time, which an input port gives at each sample t_k.

    θ_d(t) = Σ a_n u^n up to the break t_b, and Σ b_n u^n later, with u = (t − t_k)/T.

    ==================  ====  =============  ===================================================
    input port          size  unit
    ==================  ====  =============  ===================================================
    interval            14    s, s, rad, …   t_k, t_b, a_0 … a_7, b_0 … b_3
    **output port**
    knee_reference      4     rad, rad/s, …  θ_d and derivatives to the third
    ==================  ====  =============  ===================================================

    No state and no Context parameters. A loop that gets inputs only at its samples uses this
    system, so that the leg of a wearer follows the reference between the samples too.

    Parameters
    ----------
    sample_time_s
        The time T between two samples, in s.
    """

    def __init__(self, sample_time_s: float = 0.002) -> None:
        self._declare_parameters({})
        self._sample_time = sample_time_s
        self._interval = self.DeclareVectorInputPort("interval", 14)
        self._declare_output("knee_reference", 4, self._calc, self._interval, self.time_ticket())

    def _calc(self, context: Any) -> list[Any]:
        start, at_break, *coefficients = self._interval.Eval(context)
        u = (context.get_time() - start) / self._sample_time
        before, after = coefficients[7::-1], coefficients[:7:-1]  # highest power first
        return [
            where_positive(
                context.get_time() - at_break,
                polynomial(polynomial_derivative(after, order), u),
                polynomial(polynomial_derivative(before, order), u),
            )
            / self._sample_time**order
            for order in range(4)
        ]


IntervalReference_ = leaf_template(IntervalReference)
"""Template of `IntervalReference` classes by scalar type of Drake."""


def make_knee_reference(parameters: Reference) -> Any:
    """Make the reference system for a parameter class.

    Samples become a `TrajectorySource`, which has no symbolic form. Between samples the curve
    follows ``interpolation``. Before the first and after the last sample the curve is constant.
    """
    if isinstance(parameters, SampledReference):
        spline = sampled_spline(parameters)
        return TrajectorySource(
            spline, output_derivative_order=3, zero_derivatives_beyond_limits=True
        )
    systems = {"sine": SineKneeReference, "step": StepKneeReference, "ramp": RampKneeReference}
    return systems[parameters.kind](parameters)


@lru_cache(maxsize=64)
def sampled_spline(parameters: SampledReference) -> Any:
    """Return Drake's piecewise polynomial θ_d(t) through the samples, in rad over s."""
    interpolate = {
        "cubic": PiecewisePolynomial.CubicWithContinuousSecondDerivatives,
        "pchip": PiecewisePolynomial.CubicShapePreserving,
        "linear": PiecewisePolynomial.FirstOrderHold,
    }[parameters.interpolation]
    return interpolate(np.array(parameters.times_s), np.radians([parameters.angles_deg]))


@lru_cache(maxsize=64)
def start_motion(parameters: Reference) -> tuple[float, float]:
    """Return θ_d in rad and dθ_d/dt in rad/s at t = 0."""
    return _motion(parameters, 0.0)


def _motion(parameters: Reference, time_s: float) -> tuple[float, float]:
    """Return θ_d in rad and dθ_d/dt in rad/s at a time."""
    if isinstance(parameters, SampledReference):
        spline = sampled_spline(parameters)
        return float(spline.value(time_s)[0, 0]), float(spline.EvalDerivative(time_s, 1)[0, 0])
    evaluate = {"sine": sine, "step": step, "ramp": ramp}[parameters.kind]
    angle, rate, *_ = evaluate(time_s, SimpleNamespace(**context_values(parameters)))
    return float(angle), float(rate)


def start_angle_rad(parameters: Reference) -> float:
    """Return θ_d at t = 0 in rad."""
    return start_motion(parameters)[0]


@lru_cache(maxsize=64)
def reference_range_deg(parameters: Reference) -> tuple[float, float]:
    """Return the smallest and the largest knee angle of a reference in deg.

    The range of a sampled reference includes the curve between the samples.
    """
    if not isinstance(parameters, SampledReference):
        return parameters.range_deg
    spline = sampled_spline(parameters)
    samples = np.array(parameters.times_s)
    start, length = samples[:-1], np.diff(samples)
    # The rate is a parabola between two samples: rate + slope t + curvature t²/2.
    rate, slope, curvature = (spline.derivative(n).vector_values(start)[0] for n in (1, 2, 3))
    with np.errstate(all="ignore"):  # nan without a real root, and infinity without a parabola
        q = -0.5 * (slope + np.copysign(np.sqrt(slope**2 - 2.0 * curvature * rate), slope))
        roots = np.stack([2.0 * q / curvature, rate / q])
    times = np.concatenate([samples, (start + roots)[(roots > 0.0) & (roots < length)]])
    angles = np.degrees(spline.vector_values(times)[0])
    return float(angles.min()), float(angles.max())


def run_range_deg(scenario: Scenario) -> tuple[float, float]:
    """Return the smallest and the largest knee angle in deg of the reference within a run.

    The run lasts from 0 to ``scenario.duration_s``. Steps, angles and samples beyond the end of the
    run do not count. A sampled reference counts with its samples within the run, and with its curve
    at both ends of the run.
    """
    return _range_within(scenario.reference, scenario.duration_s)


def run_middle_deg(scenario: Scenario) -> float:
    """Return the middle in deg of `run_range_deg`. Analyses linearize the loop at this angle."""
    return 0.5 * sum(run_range_deg(scenario))


@lru_cache(maxsize=64)
def _range_within(reference: Reference, duration_s: float) -> tuple[float, float]:
    times, samples = [0.0, duration_s], np.empty(0)
    if isinstance(reference, SineReference):  # its amplitude never falls, so the last period counts
        period_s = 1.0 / reference.frequency_hz
        turns = math.floor(2.0 * duration_s / period_s)
        times += [0.5 * period_s * turn for turn in (turns - 1, turns) if turn >= 0]
        if duration_s < reference.ramp_s + period_s:  # it turns later while the amplitude grows
            # 100 steps a period miss the turn by at most 5e-4 of the amplitude.
            times += np.linspace(max(0.0, duration_s - period_s), duration_s, 101).tolist()
    if isinstance(reference, SampledReference):
        samples_s = np.array(reference.times_s)
        within = (samples_s >= 0.0) & (samples_s <= duration_s)
        samples = np.array(reference.angles_deg)[within]
    # The way through radians must not turn 70° into 69.99999999999999°.
    ends = [round(math.degrees(_motion(reference, time)[0]), 9) for time in times]
    return float(min(*ends, *samples)), float(max(*ends, *samples))


def require_reference_in_range(parameters: Reference, knee: KneeParameters) -> None:
    """Raise `ParameterError` when a reference leaves the range of motion.

    All samples must lie within the range. The curve between samples can exceed it by
    at most ``knee.overshoot_deg``.
    """
    knee.require_in_range(*parameters.range_deg)
    if not isinstance(parameters, SampledReference):
        return
    low, high = reference_range_deg(parameters)
    slack = knee.overshoot_deg + 1e-9
    if low < knee.flexion_min_deg - slack or high > knee.flexion_max_deg + slack:
        raise ParameterError(
            f"reference = {low:.4g} … {high:.4g} deg between its samples: the interpolation "
            f"{parameters.interpolation} passes the range of motion {knee.flexion_min_deg:g} … "
            f"{knee.flexion_max_deg:g} deg by more than overshoot_deg = {knee.overshoot_deg:g} "
            f"deg; take interpolation: pchip, or reduce the reference"
        )
