"""Synthesis of a four-bar knee that follows a knee's motion and obeys a rod map, within limits.

The linkage is six points with the knee extended: the joints O_A, O_B, A and B, the cylinder's pin
on the thigh and the rod's pin on the shank. The strap's place on the shank and the rod's length L_0
appear linearly in the errors, so that their best values are means. The other twelve numbers are
searched, from random starts. Damped least squares with penalties improve all starts together, and
sequential quadratic programming improves the best results (Nocedal and Wright, Numerical
Optimization, 2006, ch. 10 and 18). The parameters of the result are rounded to 1 nm and 1 nrad.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from kneexo.common.plotting import BLUE, GOLD, axes_or_new
from kneexo.common.result import Array, Result, data_frame
from kneexo.errors import ParameterError
from kneexo.geometry.linkage import pose, rod_anchor, rod_extension, shank_is_ground
from kneexo.geometry.shank_motion import Points, ShankMotion, anatomical_motion, linkage_motion
from kneexo.parameters import (
    GAIT2392,
    AnatomicalKneeParameters,
    DesignLimits,
    LinkageParameters,
    RodPolynomialParameters,
)

RodTarget = RodPolynomialParameters | tuple[ArrayLike, ArrayLike]
"""The rod map to obey: Eq. 10 of a polynomial over 0…90°, or knee angles in deg and x in mm."""

# With 160 drawn and 120 improved linkages all of 20 random linkages are found again from their
# motion, to 7e-8 of it. A search takes 2.5 s of processor time.
_DRAWN = 160  # random linkages for each start
_IMPROVED = 120
_FINISHED = 8
_STEPS = (40, 80, 160)  # of damped least squares, of all starts, a third, and a ninth of them
_REFINED = 4
_COARSE_DEG, _FINE_DEG = 5.0, 1.0  # steps of the knee angle, the second for the refined starts
_MINOR = 1e-3
"""Weight of an error that is not to be minimized, which decides between equally good linkages."""

_PENALTY_M = 3e-3  # error in m that weighs as much as one scaled unit of violation
# Forward differences guide all starts at half the cost; the few that are finished get central ones.
_FORWARD_M, _STEP_M = 1e-8, 1e-6  # of forward and of central differences
_VIOLATION = 1e-7  # largest scaled violation of a result
_NEARLY = 1e-3  # largest scaled violation of a start that is refined
_BINDING = 1e-6  # scaled distance below which a limit counts as reached
_CHECKED_DEG = (-5.0, 95.0)  # knee angles at which the links must close
_LARGEST_EXTENSION_MM, _LEAST_TRAVEL_MM = 1000.0, 1.0  # beyond these the unit is wrong
_LEAST_SPAN_DEG = 10.0  # less is a range in the wrong unit
_SAME = 1e-6  # relative difference of the costs of two linkages that count as equally good
_DIGITS = 9  # decimals of lengths in m and angles in rad
_SHORTEST = {
    "any": (None,),
    "grashof": (0, 1, 2, 3),
    "drag link": (0,),
    "crank rocker": (1, 3),
    "double rocker": (2,),
}
"""Indices of the links 1…4 that may be the shortest, for each value of `DesignLimits.grashof`."""


# -------------------------------------------------------------------------------- results


@dataclass(frozen=True, repr=False)
class LinkageDesign(Result):
    """A linkage found by `design_linkage`, and its errors.

    The frame of the linkage is the frame of the knee, because the device is placed on the thigh
    without offset and turn. The strap is put on where the migration of the strap is least.
    """

    linkage: LinkageParameters
    limits: DesignLimits
    knee_angle_deg: Array
    """Knee angles (n,) of the motion in deg."""
    migration_mm: Points
    """Place of the strap minus place of the cuff in the frame of the tibia (n,), in mm."""
    rod_angle_deg: Array
    """Knee angles (m,) of the rod map in deg."""
    rod_error_mm: Array
    """Rod extension minus its target (m,), in mm."""
    binding: tuple[str, ...]
    """Names of the limits that the linkage reaches."""
    finished_mm: Array
    """Rms migration and rms rod error of all finished starts within the limits (k, 2), in mm.

    The rows are sorted by what the search minimizes, the best first. Small differences between the
    first rows show that several starts have ended with equally good linkages.
    """

    @property
    def rms_mm(self) -> float:
        """Root of the mean square of the strap's migration in mm."""
        return _rms(self.migration_mm)

    @property
    def largest_mm(self) -> float:
        """Largest migration of the strap in mm."""
        return float(np.max(np.abs(self.migration_mm)))

    @property
    def rod_rms_mm(self) -> float:
        """Root of the mean square of the rod's error in mm."""
        return _rms(self.rod_error_mm)

    @property
    def rod_largest_mm(self) -> float:
        """Largest error of the rod in mm."""
        return float(np.max(np.abs(self.rod_error_mm)))

    def plot(self, ax: Any = None) -> Any:
        """Plot the migration of the strap and the error of the rod; return the axes."""
        caption = "Migration of the strap, and error of the rod extension, over the knee angle."
        ax = axes_or_new(ax, caption=caption)
        ax.plot(self.knee_angle_deg, self.migration_mm.real, BLUE, label="across the shank")
        ax.plot(self.knee_angle_deg, self.migration_mm.imag, BLUE, ls="--", label="along it")
        ax.plot(self.rod_angle_deg, self.rod_error_mm, GOLD, label="rod extension")
        ax.set(xlabel="knee angle (deg)", ylabel="error (mm)")
        ax.legend()
        return ax


@dataclass(frozen=True, repr=False)
class TradeOff(Result):
    """Designs with falling error of the rod, each with the least migration found for its error.

    `trade_off` makes them.
    """

    designs: tuple[LinkageDesign, ...]

    def to_dataframe(self) -> Any:
        """Return the errors in mm as a `pandas.DataFrame` with the index ``rod_rms_mm``.

        Raises `PackageError` without pandas.
        """
        names = ("rod_rms_mm", "rod_largest_mm", "rms_mm", "largest_mm")
        return data_frame(
            {name: [getattr(design, name) for design in self.designs] for name in names},
            "rod_rms_mm",
        )

    def plot(self, ax: Any = None) -> Any:
        """Plot the rms migration over the rms error of the rod; return the axes."""
        ax = axes_or_new(ax, caption="Migration of the strap against the error of the rod map.")
        rod = [design.rod_rms_mm for design in self.designs]
        ax.plot(rod, [design.rms_mm for design in self.designs], "o-", color=BLUE)
        ax.set(xlabel="rod extension, rms error (mm)", ylabel="migration of the strap, rms (mm)")
        return ax


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


# -------------------------------------------------------------------- errors and constraints


@dataclass(frozen=True)
class _Problem:
    """Errors and constraints of a linkage, given by its six points (..., 12) as x, y in m."""

    motion: ShankMotion
    rod_angle: Array
    rod_target: Array
    limits: DesignLimits
    weights: tuple[float, float]
    """Weights of the migration and of the rod's error."""
    step_deg: float
    """Step of the knee angles at which the limits are checked."""
    shortest: int | None = None
    """Index of the shortest link if a class of Grashof is required."""

    @cached_property
    def _checked(self) -> Array:
        low, high = _CHECKED_DEG
        return np.radians(np.arange(low, high + self.step_deg / 2, self.step_deg))

    @cached_property
    def _angles(self) -> tuple[Points, Any, Any, Any]:
        """Rotations e^{jθ} of all knee angles that are used, each angle once.

        The other three values are the indices in this array for the motion, the rod map and the
        checks of the limits.
        """
        parts = [self.motion.knee_angle, self.rod_angle, self._checked]
        angle, index = np.unique(np.concatenate(parts).round(12), return_inverse=True)
        motion, rod, check = np.split(index, np.cumsum([part.size for part in parts[:2]]))
        return np.exp(1j * angle), motion, rod, check

    @cached_property
    def thinned(self) -> _Problem:
        """The same problem with fewer knee angles of motion and rod map, for a fast search."""
        motion = self.motion
        some, few = (
            slice(None, None, max(1, n.size // 18)) for n in (motion.knee_angle, self.rod_angle)
        )
        return replace(
            self,
            motion=ShankMotion(
                motion.knee_angle[some], motion.translation[some], motion.rate[some]
            ),
            rod_angle=self.rod_angle[few],
            rod_target=self.rod_target[few],
        )

    def errors(self, x: Array) -> tuple[Points, Array, dict[str, Array]]:
        """Return migration (..., n), rod error (..., m) and constraints of linkages, in m.

        A constraint is met if all its values are >= 0. The values are scaled so that −1 is a gross
        violation of any limit.
        """
        points = x[..., 0::2] + 1j * x[..., 1::2]
        o_a, o_b, a, b, cylinder, pin = (points[..., i, None] for i in range(6))
        turn, motion, rod, check = self._angles
        ground, link_2, coupler, link_4 = o_b - o_a, a - o_a, b - a, b - o_b
        # As in `kneexo.geometry.linkage.pose`, but where the links do not close they stay in line.
        d = ground - coupler * turn
        cosine = (abs(link_2) ** 2 - abs(link_4) ** 2 - abs(d) ** 2) / (2 * abs(link_4) * abs(d))
        sine = np.sqrt(np.maximum(1.0 - cosine**2, 1e-12))
        branch = np.where(_cross(link_2, link_4) < 0.0, -1.0, 1.0)
        now_4 = abs(link_4) * d / abs(d) * (np.clip(cosine, -1.0, 1.0) + 1j * branch * sine)
        now_2 = now_4 + d
        migration = (o_b + now_4[..., motion] - self.motion.translation) / turn[motion]
        lever = (pin - b) * turn
        cylinder_to_pin = o_b + now_4 + lever - cylinder
        length = abs(cylinder_to_pin)
        rod_error = length[..., rod] - self.rod_target
        rod_length = rod_error.mean(-1, keepdims=True)
        rod_error = rod_error - rod_length

        limits, d, now_2, now_4 = self.limits, d[..., check], now_2[..., check], now_4[..., check]
        now_3 = coupler * turn[check]
        # Cosine of the angle between links 2 and 4; beyond ±1 where they do not close.
        folded = (abs(link_2) ** 2 + abs(link_4) ** 2 - abs(d) ** 2) / 2 / abs(link_2 * link_4)
        least = np.cos(np.radians(limits.link_angle_deg))
        encoder = _cross(now_2, now_3) / abs(link_2 * coupler)
        encoder = encoder * np.where(encoder.mean(-1, keepdims=True) < 0.0, -1.0, 1.0)
        joint_b_rate = 1j * now_4 * _cross(now_2, now_3) / _cross(now_2, now_4)
        arm = (
            -np.real(np.conj(cylinder_to_pin[..., check]) * (joint_b_rate + 1j * lever[..., check]))
            / length[..., check]
        )
        lengths = np.concatenate([abs(ground), abs(link_2), abs(coupler), abs(link_4)], -1)
        joints, pins = x[..., :8], points[..., 4:]
        first = round(-_CHECKED_DEG[0] / self.step_deg)  # index of 0°, as far from 95° as 90°
        travel = length[..., check[[first]]] - length[..., check[[-1 - first]]]
        met = {
            "link_angle_deg": 10.0 * np.concatenate([least - folded, least + folded], -1),
            "encoder_angle_deg": 3.0 * (encoder - np.sin(np.radians(limits.encoder_angle_deg))),
            "least_link_m": 100.0 * (lengths - limits.least_link_m),
            "joint_box_m": 100.0 * (limits.joint_box_m - np.concatenate([joints, -joints], -1)),
            "pin_radius_m": 10.0 * (limits.pin_radius_m - abs(pins)),
            "pin_offset_m": 10.0 * (limits.pin_offset_m - abs(pins.real)),
            "cylinder_height_m": 10.0 * (cylinder.imag - limits.cylinder_height_m),
            "least_arm_m": 20.0 * (arm - limits.least_arm_m),
            "largest_arm_m": 20.0 * (limits.largest_arm_m - arm),
            "stroke_m": 20.0 * (limits.stroke_m - travel),
            "rod_length_m": 10.0 * (rod_length - limits.rod_length_m),
        }
        if self.shortest is not None:
            others = np.delete(lengths, self.shortest, -1)
            pair = lengths[..., [self.shortest]] + others
            margin = lengths.sum(-1, keepdims=True) - 2.0 * pair
            met["grashof"] = 100.0 * (margin - limits.grashof_margin_m)
        if limits.rod_error_mm is not None:
            mean_square = np.mean(rod_error**2, -1, keepdims=True)
            met["rod_error_mm"] = 1.0 - mean_square / (1e-3 * limits.rod_error_mm) ** 2
        return migration - migration.mean(-1, keepdims=True), rod_error, met

    def residuals(self, x: Array) -> Array:
        """Return errors and violations (..., r) in m; the sum of their squares guides a start.

        The limit of the rod's error acts by its weight, since it depends on a sum of squares.
        """
        migration, rod, met = self.errors(x)
        limit = self.limits.rod_error_mm
        rod_weight = self.weights[1] if limit is None else self.weights[0] / limit
        migration = self.weights[0] / np.sqrt(migration.shape[-1]) * migration
        rod = rod_weight / np.sqrt(rod.shape[-1]) * rod
        met.pop("rod_error_mm", None)
        violation = np.maximum(0.0, -np.concatenate(list(met.values()), -1))
        parts = [migration.real, migration.imag, rod, _PENALTY_M * violation]
        return np.concatenate(parts, -1)

    def cost_and_constraints(self, x: Array) -> Array:
        """Return what sequential quadratic programming minimizes and observes, (..., 1 + c).

        The first number is the cost in mm². The others are the constraints, which must be >= 0.
        """
        migration, rod, met = self.errors(x)
        rod_weight = self.weights[1] if self.limits.rod_error_mm is None else _MINOR
        cost = (self.weights[0] * 1e3) ** 2 * np.mean(abs(migration) ** 2, -1, keepdims=True)
        cost = cost + (rod_weight * 1e3) ** 2 * np.mean(rod**2, -1, keepdims=True)
        return np.concatenate([cost, *met.values()], -1)

    def guide(self, x: Array) -> Array:
        """Return the sum of the squares of the residuals (...) in m², which ranks the starts."""
        return np.asarray(np.sum(self.residuals(x) ** 2, -1))

    def cost(self, x: Array, allowed: float) -> float:
        """Return the cost of a linkage in mm², or inf if a limit is violated by > ``allowed``."""
        cost, *constraints = self.cost_and_constraints(x)
        return float(cost) if min(constraints) >= -allowed else math.inf


def _cross(a: Any, b: Any) -> Any:
    return np.imag(np.conj(a) * b)


def _slopes(function: Callable[[Array], Array], x: Array) -> Array:
    """Return the Jacobian (r, n) of a function at x (n,), by central differences."""
    steps = _STEP_M * np.eye(x.size)
    values = function(np.concatenate([x + steps, x - steps]))
    return np.asarray((values[: x.size] - values[x.size :]).T / (2.0 * _STEP_M))


# ---------------------------------------------------------------------------------- search


_Start = tuple[_Problem, Array]


def _drawn(problem: _Problem, seed: int, count: int) -> list[_Start]:
    """Return the ``count`` random linkages with the least sums of squares, to start from.

    ``_DRAWN`` linkages are drawn at random for each start.
    """
    limits = problem.limits
    radius, height = 0.9 * limits.pin_radius_m, limits.cylinder_height_m
    offset = min(limits.pin_offset_m, radius)
    high = np.array([0.6 * limits.joint_box_m] * 8 + [offset, radius, offset, radius])
    low = -high
    low[9] = min(height, radius)
    x = np.random.default_rng(seed).uniform(low, high, (_DRAWN * count, 12))
    parts = np.array_split(x, 1 + len(x) // 500)
    guide = np.concatenate([problem.thinned.guide(part) for part in parts])
    return [(problem, x[i]) for i in np.sort(np.argsort(guide)[:count])]


def _best(starts: list[_Start], count: int, rank: Callable[[_Problem, Array], Any]) -> list[_Start]:
    """Return the ``count`` starts of least rank, in the order of ``starts``."""
    ranks = [float(rank(problem, x)) for problem, x in starts]
    return [starts[i] for i in np.sort(np.argsort(ranks, kind="stable")[:count])]


def _selected(starts: list[_Start]) -> list[_Start]:
    """Improve the starts by damped least squares, and return the best of them.

    All starts get some steps, the better third more steps, and the best ninth most.
    """
    for steps in _STEPS:
        problems = {id(problem): problem for problem, _ in starts}.values()
        moved = [
            _improved(problem.thinned, np.array([x for p, x in starts if p is problem]), steps)
            for problem in problems
        ]
        starts = [(p, x) for p, points in zip(problems, moved, strict=True) for x in points]
        starts = _best(starts, max(_FINISHED, len(starts) // 3), lambda p, x: p.thinned.guide(x))
    return starts


def _improved(problem: _Problem, x: Array, steps: int) -> Array:
    """Return the points (s, 12) of s linkages after some steps of damped least squares from ``x``.

    The damping follows Nielsen's rule (Madsen, Nielsen and Tingleff, Methods for Non-Linear Least
    Squares Problems, 2004, algorithm 3.16). The largest slope of a variable is its scale.
    """
    # All starts as one array: five times as fast as a call of MINPACK for each.
    damping, scale, square = np.full(len(x), 0.1), np.zeros_like(x), problem.guide(x)
    forward = np.vstack([np.zeros(12), _FORWARD_M * np.eye(12)])
    for _ in range(steps):
        residuals = problem.residuals(x[:, np.newaxis] + forward)
        slopes = (residuals[:, 1:] - residuals[:, :1]) / _FORWARD_M  # (s, 12, r)
        hessian = slopes @ np.swapaxes(slopes, -1, -2)
        gradient = np.einsum("snr,sr->sn", slopes, residuals[:, 0])
        scale = np.maximum(scale, np.diagonal(hessian, axis1=-2, axis2=-1))
        damped = damping[:, np.newaxis] * scale + 1e-14  # a variable can have no effect
        hessian += damped[..., np.newaxis] * np.eye(12)
        step = -np.linalg.solve(hessian, gradient[..., np.newaxis])[..., 0]
        reached = problem.guide(x + step)
        better = reached < square
        foreseen = np.sum(step * (damped * step - gradient), axis=-1)
        ratio = np.where(better, square - reached, 0.0) / np.maximum(foreseen, 1e-300)
        factor = np.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        damping *= np.where(better, factor, 4.0)
        x = np.where(better[:, np.newaxis], x + step, x)
        square = np.where(better, reached, square)
    return x


def _finished(problem: _Problem, x: Array, rounds: int) -> Array:
    """Return the points (12,) of the linkage near ``x`` with the least cost within the limits.

    The variables are scaled so that the Gauss-Newton Hessian of the residuals is the identity, from
    which sequential quadratic programming starts. Each round renews the scale.
    """
    # Sequential quadratic programming takes the limits as they are, where penalties end a little
    # beside them.
    for _ in range(rounds):
        if problem.cost(x, allowed=_VIOLATION) < _SAME**2:
            break  # The motion is followed exactly. Slopes of zero give no scale.
        slopes = _slopes(problem.residuals, x)
        hessian = slopes.T @ slopes
        hessian += 1e-6 * np.diag(np.diag(hessian))
        scale = 1e-3 * np.linalg.inv(np.linalg.cholesky(hessian)).T
        moved = x + scale @ _minimum(problem, x, scale)
        if not np.all(np.isfinite(moved)) or np.max(np.abs(moved - x)) < 1e-9:
            break
        x = moved
    return x


def _minimum(problem: _Problem, x: Array, scale: Array) -> Array:
    """Return the step y (12,) for which the points x + scale y have the least cost."""

    @lru_cache(maxsize=1)
    def values(key: bytes) -> Array:
        return problem.cost_and_constraints(x + scale @ np.frombuffer(key))

    @lru_cache(maxsize=1)
    def slopes(key: bytes) -> Array:
        return _slopes(problem.cost_and_constraints, x + scale @ np.frombuffer(key)) @ scale

    found = scipy.optimize.minimize(
        lambda y: values(y.tobytes())[0],
        np.zeros(x.size),
        method="SLSQP",
        jac=lambda y: slopes(y.tobytes())[0],
        constraints={
            "type": "ineq",
            "fun": lambda y: values(y.tobytes())[1:],
            "jac": lambda y: slopes(y.tobytes())[1:],
        },
        options={"maxiter": 80, "ftol": 1e-16},
    )
    return np.asarray(found.x)


def _points_of(link: LinkageParameters) -> Array:
    """Return the six points (12,) of a linkage with the knee extended, in m."""
    at = pose(link, 0.0)
    o_a, o_b = complex(link.o_a_x_m, link.o_a_y_m), complex(link.o_b_x_m, link.o_b_y_m)
    points = [o_a, o_b, at.joint_a, at.joint_b, rod_anchor(link), at.rod_pin]
    return np.asarray(points, dtype=complex).view(float)


def _linkage_of(problem: _Problem, x: Array) -> LinkageParameters:
    """Return the linkage that has six points (12,), with L_0 for the least error of the rod."""
    o_a, o_b, a, b, cylinder, pin = x[0::2] + 1j * x[1::2]
    values = {
        "o_a_x_m": o_a.real,
        "o_a_y_m": o_a.imag,
        "o_b_x_m": o_b.real,
        "o_b_y_m": o_b.imag,
        "a_2_m": abs(a - o_a),
        "a_3_m": abs(b - a),
        "a_4_m": abs(b - o_b),
        "phi_rad": -np.angle(b - a),
        "rod_pin_radius_m": abs(pin - b),
        "rod_pin_angle_rad": np.angle((pin - b) / (b - a)),
        "rod_anchor_radius_m": abs(cylinder),
        "rod_anchor_angle_rad": np.angle(cylinder),
        "rod_length_m": 1.0,
    }
    rounded = {name: round(float(value), _DIGITS) for name, value in values.items()}
    link = LinkageParameters(**rounded, branch=-1 if _cross(a - o_a, b - o_b) < 0.0 else 1)
    error = rod_extension(link, problem.rod_angle) - problem.rod_target
    length = round(1.0 + float(np.mean(error)), _DIGITS)
    return link.changed({"rod_length_m": length})


def _design(problem: _Problem, x: Array, finished: list[_Start]) -> LinkageDesign:
    """Return the design of the linkage with the six points ``x`` (12,), and its errors.

    ``x`` has x and y in m of the joints O_A, O_B, A and B and of the two pins, with the knee
    extended. Lengths in m and angles in rad of the linkage are rounded to ``_DIGITS`` decimals. The
    errors are computed with the rounded linkage. ``finished`` has all finished starts, whose errors
    are part of the design.
    """
    link, motion = _linkage_of(problem, x), problem.motion
    strap = (linkage_motion(link, motion.knee_angle).translation - motion.translation) / motion.turn
    met = problem.errors(x)[2]
    ranked = sorted((p.cost(y, allowed=_NEARLY), i) for i, (p, y) in enumerate(finished))
    errors = [problem.errors(finished[i][1])[:2] for cost, i in ranked if math.isfinite(cost)]
    return LinkageDesign(
        linkage=link,
        limits=problem.limits,
        knee_angle_deg=np.degrees(motion.knee_angle),
        migration_mm=1e3 * (strap - strap.mean()),
        rod_angle_deg=np.degrees(problem.rod_angle),
        rod_error_mm=1e3 * (rod_extension(link, problem.rod_angle) - problem.rod_target),
        binding=tuple(name for name, values in met.items() if np.min(values) < _BINDING),
        finished_mm=np.array([[1e3 * _rms(error) for error in pair] for pair in errors]),
    )


def _excluding(improved: list[_Start]) -> str:
    """Return the message for a search without result: limits that no linkage meets together.

    The violations alone are made least, whatever the errors of the linkage. The limits that are
    still violated then are in conflict.
    """
    near = _best(improved, _REFINED, lambda p, x: p.thinned.guide(x))
    free = [(replace(problem, weights=(0.0, 0.0)), x) for problem, x in near]
    nearest = [(problem, _improved(problem, x[np.newaxis], 80)[0]) for problem, x in free]
    problem, x = _best(nearest, 1, lambda p, x: p.guide(x))[0]
    met = problem.errors(x)[2]
    limits = problem.limits
    names = [n for n, values in met.items() if n != "rod_error_mm" and np.min(values) < -_NEARLY]
    if not names and limits.rod_error_mm is None:
        return "limits: the search ended before a linkage met all limits; increase starts"
    if not names:
        names = ["rod_error_mm"]
    shown = ", ".join(f"{name} = {getattr(limits, name)}" for name in names)
    return f"limits: no linkage was found that meets {shown}; change one of them"


def _target(rod: RodTarget) -> tuple[Array, Array]:
    """Return knee angles in rad and rod extensions in m of the rod map that the user gives.

    Raises `ParameterError` for a rod map with wrong numbers.
    """
    if isinstance(rod, RodPolynomialParameters):
        angle_deg = np.arange(91.0)
        return np.radians(angle_deg), 1e-3 * np.polyval(rod.p_mm_deg, angle_deg)
    angle_deg, extension_mm = (np.asarray(values, dtype=float) for values in rod)
    if angle_deg.shape != extension_mm.shape or angle_deg.ndim != 1 or angle_deg.size < 3:
        raise ParameterError(
            f"rod: has {angle_deg.size} knee angles and {extension_mm.size} extensions, must have "
            f"equally many of both, at least 3"
        )
    # Written so that nan is wrong too.
    if np.any(wrong := ~(np.abs(extension_mm) <= _LARGEST_EXTENSION_MM)):
        raise ParameterError(
            f"rod: extension {extension_mm[wrong][0]:.4g} mm must be finite and within "
            f"±{_LARGEST_EXTENSION_MM:g} mm; leave its pair out"
        )
    if not np.ptp(extension_mm) >= _LEAST_TRAVEL_MM:
        raise ParameterError(
            f"rod: extensions span {np.ptp(extension_mm):.3g} mm, must span at least "
            f"{_LEAST_TRAVEL_MM:g} mm; extensions are in mm"
        )
    return np.radians(angle_deg), 1e-3 * extension_mm


def _require_range(name: str, angle: Array) -> None:
    low, high = _CHECKED_DEG
    degrees = np.degrees(angle)
    if np.any(bad := ~((degrees >= low) & (degrees <= high))):
        raise ParameterError(
            f"{name}: knee angle {degrees[bad][0]:.4g} deg must be {low:g} … {high:g} deg, flexion "
            f"positive; a motion has angles in rad, pairs of a rod map in deg"
        )
    if not np.ptp(degrees) >= _LEAST_SPAN_DEG:
        raise ParameterError(
            f"{name}: spans {np.ptp(degrees):.3g} deg of knee angle, must span at least "
            f"{_LEAST_SPAN_DEG:g} deg; a motion has angles in rad, pairs of a rod map in deg"
        )


def design_linkage(
    motion: AnatomicalKneeParameters | ShankMotion | None = GAIT2392,
    rod: RodTarget | None = RodPolynomialParameters(),
    limits: DesignLimits = DesignLimits(),
    *,
    seed: int = 0,
    starts: int = _IMPROVED,
    first: LinkageParameters | None = None,
) -> LinkageDesign:
    """Return the four-bar linkage that follows a motion and obeys a rod map best, within limits.

    The sum of the mean squares of the strap's migration and of the rod's error is least. With
    ``limits.rod_error_mm`` the migration alone is least. Two starts whose costs agree to 1e-6 are
    equally good. The first of them is the result, so that the result does not depend on the last
    digits of a processor.

    >>> import kneexo as kx
    >>> design = kx.design_linkage(rod=None)  # a search of 3 s
    >>> f"{design.rms_mm:.2f} mm of migration, {design.rod_rms_mm:.2f} mm off Table 1"
    '0.08 mm of migration, 0.32 mm off Table 1'
    >>> scenario = kx.Scenario(plant={"linkage": design.linkage})

    Parameters
    ----------
    motion
        An anatomical knee, which is followed over 0…90°, or the motion of a shank. If None, only
        the rod map counts, and of equal linkages the one that follows `GAIT2392` best is chosen.
    rod
        The rod map: a polynomial, or knee angles in deg and rod extensions in mm. If None, only the
        motion counts, and the pins of the rod are those that obey Table 1 best.
    limits
        Class, angles, lengths and places that the linkage must obey.
    seed
        Seed of the random linkages.
    starts
        Number of random linkages that are improved.
    first
        One more start, a linkage with the thigh as ground.

    Raises
    ------
    ParameterError
        A knee angle is outside −5…95°, all knee angles span less than 10°, or no start meets all
        limits. Then the message names the limits that exclude each other.
    """
    followed = GAIT2392 if motion is None else motion
    if isinstance(followed, AnatomicalKneeParameters):
        followed = anatomical_motion(followed, np.radians(np.arange(91.0)))
    rod_angle, rod_target = _target(RodPolynomialParameters() if rod is None else rod)
    _require_range("motion", followed.knee_angle)
    _require_range("rod", rod_angle)
    if first is not None and shank_is_ground(first):
        raise ParameterError("first: has the shank as ground; must have the thigh as ground")
    if starts < (0 if first else 1):
        raise ParameterError(f"starts = {starts}: must be >= 1, or >= 0 with a linkage as first")
    weights = _MINOR if motion is None else 1.0, _MINOR if rod is None else 1.0
    problems = [
        _Problem(followed, rod_angle, rod_target, limits, weights, _COARSE_DEG, shortest)
        for shortest in _SHORTEST[limits.grashof]
    ]
    count = -(-starts // len(problems))
    begun = [start for problem in problems for start in _drawn(problem, seed, count)]
    if first is not None:
        begun += [(problem, _points_of(first)) for problem in problems]
    improved = _selected(begun)
    finished = [(problem, _finished(problem, x, rounds=1)) for problem, x in improved]
    refined = [
        (fine := replace(problem, step_deg=_FINE_DEG), _finished(fine, x, rounds=6))
        for problem, x in _best(finished, _REFINED, lambda p, x: p.cost(x, allowed=_NEARLY))
    ]
    costs = np.array([problem.cost(x, allowed=_VIOLATION) for problem, x in refined])
    least = float(np.min(costs))
    if math.isinf(least):
        raise ParameterError(_excluding(improved))
    problem, x = refined[int(np.argmax(costs <= (1.0 + _SAME) * least + _SAME**2))]
    return _design(problem, x, [(p, x) for p, x in (*refined, *finished)])


def trade_off(
    rod_errors_mm: Iterable[float] = (0.03, 0.06, 0.12, 0.2, 0.3),
    motion: AnatomicalKneeParameters | ShankMotion | None = GAIT2392,
    rod: RodTarget = RodPolynomialParameters(),
    limits: DesignLimits = DesignLimits(),
    *,
    seed: int = 0,
    starts: int = _IMPROVED,
) -> TradeOff:
    """Return the designs with the least migration for limits of the rod's rms error, in mm.

    Each design is one of the starts of the next, which has less error of the rod. A design with
    less error that also migrates less takes the place of a design.

    Parameters
    ----------
    rod_errors_mm
        Limits of the rod's rms error in mm.
    motion, rod, limits, seed, starts
        As in `design_linkage`.

    Raises
    ------
    ParameterError
        As `design_linkage`.
    """
    designs: list[LinkageDesign] = []
    for limit_mm in sorted(rod_errors_mm, reverse=True):
        designs.append(
            design_linkage(
                motion,
                rod,
                limits.changed({"rod_error_mm": float(limit_mm)}),
                seed=seed,
                starts=starts,
                # From loose to tight: so the search finds a linkage with 0.31 mm of migration at
                # 0.12 mm off Table 1, which random starts missed.
                first=designs[-1].linkage if designs else None,
            )
        )
    falling = [designs.pop()]
    while designs:
        looser = designs.pop()
        falling.append(looser if looser.rms_mm < falling[-1].rms_mm else falling[-1])
    return TradeOff(tuple(falling))
