"""Knee references: θ_d(t) with derivatives to the third order.

Each system has one output port, ``knee_reference``: θ_d, dθ_d/dt, d²θ_d/dt², d³θ_d/dt³ in rad and
s. `make_knee_reference` picks the system for a parameter class. Samples become Drake's
`TrajectorySource` (same output, port ``y0``), which has no Context parameters and no value at a
symbolic time: where that matters, take ``make_closed_loop(external_reference=True)`` and feed the
samples in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pydrake.math as drake_math
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from kneexo.errors import ParameterError
from kneexo.linkage import polynomial, polynomial_derivative
from kneexo.parameters import (
    KneeParameters,
    RampReference,
    Reference,
    SampledReference,
    SineReference,
    StepReference,
)
from kneexo.systems._leaf import NamedLeaf, clip, leaf_template, where_positive


class _KneeReference(NamedLeaf):
    """One output that depends on time and on the named Context parameters."""

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
            self.all_parameters_ticket(),
        )


_SMOOTHSTEP = (-20.0, 70.0, -84.0, 35.0, 0.0, 0.0, 0.0, 0.0)
"""From 0 to 1 over 0…1 with three derivatives that vanish at both ends; highest power first."""


def _ramp(time: Any, ramp_s: Any) -> list[Any]:
    """Rise from 0 to 1 over ``ramp_s``, with three derivatives; 1 at once when that is zero."""
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
    """Product u·v and its derivatives, from those of u and v (Leibniz)."""
    return [sum(math.comb(n, k) * u[k] * v[n - k] for k in range(n + 1)) for n in range(len(u))]


def sine(time: Any, p: Any) -> list[Any]:
    """θ_d = mean − w(t)·amplitude·cos(2πft) and three derivatives; ``p`` as `context_values`."""
    omega = 2.0 * math.pi * p.frequency_hz
    cosine = p.amplitude_rad * drake_math.cos(omega * time)
    sine = p.amplitude_rad * drake_math.sin(omega * time)
    wave = [-cosine, omega * sine, omega * omega * cosine, -omega * omega * omega * sine]
    angle, *rates = _product_derivatives(_ramp(time, p.ramp_s), wave)
    return [p.mean_rad + angle, *rates]


def step(time: Any, p: Any) -> list[Any]:
    """θ_d that jumps just after its time, and three derivatives; ``p`` as `context_values`."""
    return [where_positive(time - p.time_s, p.end_rad, p.start_rad), 0.0, 0.0, 0.0]


def ramp(time: Any, p: Any) -> list[Any]:
    """θ_d at a constant rate from start to end, and derivatives; ``p`` as `context_values`."""
    distance = p.end_rad - p.start_rad
    travel = drake_math.abs(distance)
    direction = where_positive(distance, 1.0, -1.0)
    covered = p.rate_rad_s * (time - p.time_s)
    inside = where_positive(covered, where_positive(travel - covered, 1.0, 0.0), 0.0)
    angle = p.start_rad + direction * clip(covered, 0.0, travel)
    return [angle, direction * p.rate_rad_s * inside, 0.0, 0.0]


def context_values(parameters: SineReference | StepReference | RampReference) -> dict[str, float]:
    """Context parameters of a reference system: the values of its parameters, angles in rad."""
    return {
        name.replace("_deg", "_rad"): math.radians(value) if "_deg" in name else value
        for name, value in parameters
        if name != "kind"
    }


class SineKneeReference(_KneeReference):
    """θ_d = mean − w(t)·amplitude·cos(2πft), with three derivatives.

    w rises from 0 to 1 over the ramp, with three continuous derivatives; without ramp it is 1.
    Context parameters by name: ``mean_rad``, ``amplitude_rad``, ``frequency_hz``, ``ramp_s``.
    """

    def __init__(self, parameters: SineReference = SineReference()) -> None:
        self._declare(parameters, sine)


SineKneeReference_ = leaf_template(SineKneeReference)
"""`SineKneeReference` by scalar type."""


class StepKneeReference(_KneeReference):
    """θ_d jumps from start to end just after a given time; its derivatives are zero.

    Context parameters by name: ``start_rad``, ``end_rad``, ``time_s``.
    """

    def __init__(self, parameters: StepReference = StepReference()) -> None:
        self._declare(parameters, step)


StepKneeReference_ = leaf_template(StepKneeReference)
"""`StepKneeReference` by scalar type."""


class RampKneeReference(_KneeReference):
    """θ_d moves from start to end at a constant rate, from a given time on.

    Context parameters by name: ``start_rad``, ``end_rad``, ``time_s``, ``rate_rad_s`` (> 0).
    """

    def __init__(self, parameters: RampReference = RampReference()) -> None:
        self._declare(parameters, ramp)


RampKneeReference_ = leaf_template(RampKneeReference)
"""`RampKneeReference` by scalar type."""


def make_knee_reference(parameters: Reference) -> Any:
    """The reference system of a parameter class.

    Samples become a `TrajectorySource`, which has no symbolic form: they are joined as their
    ``interpolation`` says, and the first and last angle hold outside.
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
    """Drake's piecewise polynomial through the samples, in rad."""
    interpolate = {
        "cubic": PiecewisePolynomial.CubicWithContinuousSecondDerivatives,
        "pchip": PiecewisePolynomial.CubicShapePreserving,
        "linear": PiecewisePolynomial.FirstOrderHold,
    }[parameters.interpolation]
    return interpolate(np.array(parameters.times_s), np.radians([parameters.angles_deg]))


@lru_cache(maxsize=64)
def start_angle_rad(parameters: Reference) -> float:
    """θ_d at t = 0."""
    if isinstance(parameters, SampledReference):
        return float(sampled_spline(parameters).value(0.0)[0, 0])
    evaluate = {"sine": sine, "step": step, "ramp": ramp}[parameters.kind]
    return float(evaluate(0.0, SimpleNamespace(**context_values(parameters)))[0])


@lru_cache(maxsize=64)
def reference_range_deg(parameters: Reference) -> tuple[float, float]:
    """Smallest and largest knee angle of a reference in deg; for a spline, between samples too."""
    if not isinstance(parameters, SampledReference):
        return parameters.range_deg
    spline = sampled_spline(parameters)
    samples = parameters.times_s
    times = [*samples]
    for start, end in pairwise(samples):  # the rate is a parabola in between
        rate, slope, curvature = (spline.EvalDerivative(start, n)[0, 0] for n in (1, 2, 3))
        roots = np.roots([0.5 * curvature, slope, rate])
        times += [start + t.real for t in roots if t.imag == 0.0 and 0.0 < t.real < end - start]
    angles = np.degrees(spline.vector_values(times)[0])
    return float(angles.min()), float(angles.max())


def require_reference_in_range(parameters: Reference, knee: KneeParameters) -> None:
    """`ParameterError` when a reference leaves the range of motion.

    Samples must lie within it; the curve between them may pass it by ``knee.overshoot_deg``.
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
