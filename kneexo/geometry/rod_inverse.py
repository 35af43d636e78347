"""The inverse of the rod's kinematics as polynomials, fitted with decimal numbers.

The state of the plant is the rod extension, so the plant needs knee angle, encoder angle and moment
arm as functions of the rod extension. The fit uses decimal numbers because sines and sums of
doubles can differ between processors. So the fit, and every run, gives the same bits everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation, localcontext
from functools import lru_cache
from itertools import product, zip_longest
from types import SimpleNamespace

import numpy as np

from kneexo.common.result import Array
from kneexo.errors import KneexoError, LinkageError
from kneexo.geometry.linkage import (
    FIT_RANGE_DEG,
    RodAndArm,
    encoder_angle,
    eq6_sign,
    exact_rod_and_arm,
    invert_rod,
    polynomial,
    polynomial_derivative,
    rod_extension,
    rod_table,
)
from kneexo.parameters import LinkageParameters, RodPolynomialParameters
from kneexo.parameters.paths import changed

_PLACES = (
    *("rod_anchor_radius_m", "rod_pin_radius_m", "rod_anchor_angle_rad", "rod_pin_angle_rad"),
    *("a_2_m", "a_3_m", "a_4_m", "o_a_x_m", "o_a_y_m", "o_b_x_m", "o_b_y_m"),
)
"""Names of the values of a linkage that place its joints and the pins of the rod."""

FIT_DEGREE = 25
"""Degree of the polynomials of `RodInverse`.

The error of the knee angle is below 5e-12 rad for the linkages G1, G2 and G3, and below 5e-11 rad
for the linkages G4 and G5.
"""

_FIT_TOLERANCE_RAD = 1e-8

# The coefficients of T_25 reach 5e8, so the change to powers costs nine digits. 50 digits leave far
# more than the 17 of a double.
_DECIMAL = Context(prec=50)
_PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")


@dataclass(frozen=True)
class RodInverse:
    """Knee angle θ_p, encoder angle θ_4 and moment arm r as polynomials, for a rod extension x.

    The argument of the polynomials is t = (√(x_dc − x) − centre)/half_width, where x_dc is the rod
    extension at the rod's dead centre (r = 0). The dead centre lies outside the range of motion, so
    θ_p, θ_4 and r are analytic functions of √(x_dc − x), and polynomials of degree 25 represent
    them to rounding. For the rod of the paper's Table 1 the error is 3e-10 rad, because its dead
    centre is closer to the range of motion. The coefficients are those of the powers of t, highest
    power first. Powers of t give small symbolic expressions by Horner's rule. A Chebyshev series
    would give large expressions by Clenshaw's rule.
    """

    dead_centre_m: float
    centre: float
    half_width: float
    knee_angle: tuple[float, ...]
    encoder_angle: tuple[float, ...]
    moment_arm: tuple[float, ...]


@lru_cache(maxsize=64)
def fit_rod_inverse(
    link: LinkageParameters, rod_polynomial: RodPolynomialParameters | None = None
) -> RodInverse:
    """Fit `RodInverse` to the exact linkage, or to ``rod_polynomial`` (Eq. 10) if it is not None.

    The fit is computed with 50 decimal digits and then rounded once. So the fit has the same bits
    on every processor and with every numerical library.

    Raises `LinkageError` when the linkage cannot be assembled, the rod extension does not fall as
    the knee flexes over −2…91°, or the error of the fit is above 1e-8 rad. Without
    ``rod_polynomial`` the error is a `RodInverseError`, whose text names a change of the linkage
    that helps.
    """
    try:
        return _fitted(link, rod_polynomial)
    except LinkageError as error:
        if rod_polynomial is not None:
            raise
        inverse_error = RodInverseError(str(error))
        inverse_error.link = link
        raise inverse_error from error


class RodInverseError(LinkageError):
    """The rod of the linkage ``link`` cannot be inverted. The text names a change that helps.

    The search for the change takes up to 1 s, so it begins when the text is first read. Most errors
    of a search over linkages are never read.
    """

    link: LinkageParameters | None = None

    def __str__(self) -> str:
        """Return the reason and, if the linkage is known, a change of the linkage that helps."""
        return super().__str__() + (_helping_change(self.link) if self.link else "")


@lru_cache(maxsize=64)
def _helping_change(link: LinkageParameters) -> str:
    """Return, as text, the smallest change of one value with which the rod can be inverted.

    The change of an angle counts as the arc in m that the pin moves. The text is empty if no change
    up to 0.3 m helps.
    """
    grid = np.radians(np.arange(*FIT_RANGE_DEG))
    # The smallest change first, over all values, because the message names the first one that
    # helps. Of 60 random refused linkages the named change repairs all.
    for change_m in np.geomspace(1e-3, 0.3, 15):
        for name, sign in product(_PLACES, (1.0, -1.0)):
            angle = name.endswith("_rad")
            arm_m = getattr(link, name.replace("angle_rad", "radius_m")) if angle else 1.0
            value = float(f"{getattr(link, name) + sign * change_m / arm_m:.4g}")
            try:
                other = changed(link, {name: value})
                if np.any(np.diff(rod_extension(other, grid)) >= 0.0):
                    continue  # before the fit, which takes much longer
                eq6_sign(other)
                _fitted(other, None)
            except KneexoError:
                continue
            old, unit = getattr(link, name), "rad" if angle else "m"
            return f"; for example, change {name} from {old:.4g} to {value:.4g} {unit}"
    return ""


def _fitted(link: LinkageParameters, rod_polynomial: RodPolynomialParameters | None) -> RodInverse:
    """Fit `RodInverse`, as `fit_rod_inverse` describes it.

    Raises `LinkageError` with the reason alone, for the search for a linkage that can be inverted.
    """
    if rod_polynomial is None:

        def rod_and_arm(angle: Array) -> tuple[Array, Array]:
            return exact_rod_and_arm(link, angle)

        def decimal_rod_and_arm(angle: Decimal) -> tuple[Decimal, Decimal]:
            return _decimal_pose(link, angle)[:2]
    else:
        p = rod_polynomial.p_si
        decimal_p = [Decimal(c) for c in p]

        def rod_and_arm(angle: Array) -> tuple[Array, Array]:
            return polynomial(p, angle), -polynomial(polynomial_derivative(p), angle)

        def decimal_rod_and_arm(angle: Decimal) -> tuple[Decimal, Decimal]:
            slope = polynomial(polynomial_derivative(decimal_p), angle)
            return polynomial(decimal_p, angle), -slope

    angles, _ = rod_table(rod_and_arm)
    dead_centre_angle = _dead_centre_angle(rod_and_arm, float(angles[0]))
    try:
        with localcontext(_DECIMAL):
            return _fit(link, angles, dead_centre_angle, rod_and_arm, decimal_rod_and_arm)
    except ArithmeticError as error:
        raise LinkageError(
            "the inverse of the rod cannot be fitted: the linkage is at the limit of assembly "
            "within the range of motion; change the lengths or the ground joints"
        ) from error


def _fit(
    link: LinkageParameters,
    angles: Array,
    dead_centre_angle: float | None,
    rod_and_arm: RodAndArm,
    decimal_rod_and_arm: Callable[[Decimal], tuple[Decimal, Decimal]],
) -> RodInverse:
    """Fit `RodInverse` by discrete orthogonality of Chebyshev polynomials, in decimal numbers.

    The first and the last of ``angles`` are the knee angles in rad at the ends of the fit's range.
    ``dead_centre_angle`` is the value of `_dead_centre_angle`.
    """
    first, last = Decimal(float(angles[0])), Decimal(float(angles[-1]))
    extension, arm = decimal_rod_and_arm(first)
    if dead_centre_angle is None:
        dead_centre = float(extension + arm / 4)
    else:  # x is stationary at the dead centre, so an error of 1e-15 rad does not matter
        dead_centre = float(decimal_rod_and_arm(Decimal(dead_centre_angle))[0])
    w_low = (Decimal(dead_centre) - extension).sqrt()
    w_high = (Decimal(dead_centre) - decimal_rod_and_arm(last)[0]).sqrt()
    centre, half_width = float((w_low + w_high) / 2), float((w_high - w_low) / 2)

    size = FIT_DEGREE + 7  # with 32 nodes, degrees below 39 do not disturb these coefficients
    nodes = [_cos_sin(_PI * (2 * k + 1) / (2 * size))[0] for k in range(size)]
    extensions = [
        Decimal(dead_centre) - (Decimal(centre) + Decimal(half_width) * t) ** 2 for t in nodes
    ]
    start = invert_rod(rod_and_arm, np.array([float(x) for x in extensions]))
    knee_angles, encoder_angles, arms = [], [], []
    for x, near, near_4 in zip(extensions, start, encoder_angle(link, start), strict=True):
        angle = Decimal(float(near))
        for _ in range(2):  # Newton's method doubles the 15 correct digits of the start twice
            extension, arm = decimal_rod_and_arm(angle)
            angle += (extension - x) / arm
        knee_angles.append(angle)
        arms.append(decimal_rod_and_arm(angle)[1])
        encoder_angles.append(_angle(_decimal_pose(link, angle)[2], Decimal(float(near_4))))

    knee_angle = _in_powers(nodes, knee_angles)
    t = np.array([float(node) for node in nodes])
    error = float(np.max(np.abs(polynomial(knee_angle, t) - start)))
    if not error <= _FIT_TOLERANCE_RAD:
        raise LinkageError(
            f"the inverse of the rod cannot be fitted: off by {error:.1g} rad, must be below "
            f"{_FIT_TOLERANCE_RAD:g} rad; move the rod's dead centre away from the range of motion"
        )
    return RodInverse(
        dead_centre_m=dead_centre,
        centre=centre,
        half_width=half_width,
        knee_angle=knee_angle,
        encoder_angle=_in_powers(nodes, encoder_angles),
        moment_arm=_in_powers(nodes, arms),
    )


def _in_powers(nodes: Sequence[Decimal], values: Sequence[Decimal]) -> tuple[float, ...]:
    """Fit a Chebyshev series of degree `FIT_DEGREE`; return coefficients of powers, highest first.

    ``values`` are the values of the fitted function at ``nodes``, the zeros of a Chebyshev
    polynomial.
    """
    total = [Decimal(0)] * (FIT_DEGREE + 1)
    # T_n and T_{n+1}: values at the nodes, and coefficients of powers (integers), lowest first.
    at_nodes, next_at_nodes = [Decimal(1)] * len(nodes), list(nodes)
    powers, next_powers = [1], [0, 1]
    for n in range(FIT_DEGREE + 1):
        products = (a * b for a, b in zip(at_nodes, values, strict=True))
        coefficient = sum(products, Decimal(0)) * (2 if n else 1) / len(nodes)
        for i, power in enumerate(powers):
            total[i] += coefficient * power
        triples = zip(nodes, next_at_nodes, at_nodes, strict=True)
        at_nodes, next_at_nodes = next_at_nodes, [2 * t * b - a for t, b, a in triples]
        pairs = zip_longest([0, *next_powers], powers, fillvalue=0)
        powers, next_powers = next_powers, [2 * b - a for b, a in pairs]
    return tuple(float(value) for value in reversed(total))


def rounded_rod_extension(link: LinkageParameters, knee_angle_rad: float) -> float:
    """Return the rod extension x(θ_p) in m, with the same bits on every processor.

    The extension is computed with 50 decimal digits and rounded once. Raises `LinkageError` where
    the links do not close, or are in line.
    """
    rod_extension(link, knee_angle_rad)  # raises the error; the decimal numbers need no check
    with localcontext(_DECIMAL):
        try:
            return float(_decimal_pose(link, Decimal(knee_angle_rad))[0])
        except InvalidOperation:  # in line, the links close as doubles but not with 50 digits
            raise LinkageError(
                f"links a_2_m = {link.a_2_m:g} m and a_4_m = {link.a_4_m:g} m are in line at knee "
                f"angle {math.degrees(knee_angle_rad):.4g} deg; change a length"
            ) from None


def _decimal_pose(
    link: LinkageParameters, knee_angle: Decimal
) -> tuple[Decimal, Decimal, tuple[Decimal, Decimal]]:
    """Return rod extension x, moment arm r and the vector a_4 e^{jθ_4}, as decimal numbers.

    The equations are the equations of `pose`, solved for vectors instead of angles. The square of
    |D + a_4e^{jθ_4}| = a_2 gives the scalar product of D and a_4e^{jθ_4}, which is (a_2² − a_4² −
    |D|²)/2. So only θ_3 requires a cosine and a sine, which are slow in decimal numbers.
    """
    p = SimpleNamespace(**{k: Decimal(v) for k, v in link.model_dump().items()})
    theta_3 = knee_angle - p.phi_rad
    cos_3, sin_3 = _cos_sin(theta_3)
    d_x = p.o_b_x_m - p.o_a_x_m - p.a_3_m * cos_3
    d_y = p.o_b_y_m - p.o_a_y_m - p.a_3_m * sin_3
    square = d_x * d_x + d_y * d_y
    dot = (p.a_2_m**2 - p.a_4_m**2 - square) / 2
    cross = p.branch * (p.a_4_m**2 * square - dot * dot).sqrt()
    x_4, y_4 = (dot * d_x - cross * d_y) / square, (dot * d_y + cross * d_x) / square
    x_2, y_2 = d_x + x_4, d_y + y_4
    link_4_per_knee = p.a_3_m * (x_2 * sin_3 - y_2 * cos_3) / (x_2 * y_4 - y_2 * x_4)

    cos_pin, sin_pin = _cos_sin(p.rod_pin_angle_rad)
    pin_x = p.rod_pin_radius_m * (cos_3 * cos_pin - sin_3 * sin_pin)
    pin_y = p.rod_pin_radius_m * (sin_3 * cos_pin + cos_3 * sin_pin)
    cos_anchor, sin_anchor = _cos_sin(p.rod_anchor_angle_rad)
    rod_x = p.o_b_x_m + x_4 + pin_x - p.rod_anchor_radius_m * cos_anchor
    rod_y = p.o_b_y_m + y_4 + pin_y - p.rod_anchor_radius_m * sin_anchor
    length = (rod_x * rod_x + rod_y * rod_y).sqrt()
    velocity_x, velocity_y = -(link_4_per_knee * y_4 + pin_y), link_4_per_knee * x_4 + pin_x
    arm = -(rod_x * velocity_x + rod_y * velocity_y) / length
    return length - p.rod_length_m, arm, (x_4, y_4)


@lru_cache(maxsize=256)
def _cos_sin(angle: Decimal) -> tuple[Decimal, Decimal]:
    """Return cosine and sine of an angle in rad, from their power series."""
    sums, term, n = [Decimal(0), Decimal(0)], Decimal(1), 0
    while abs(term) > Decimal("1e-55"):
        sums[n % 2] += -term if n % 4 > 1 else term
        n += 1
        term *= angle / n
    return sums[0], sums[1]


def _angle(vector: tuple[Decimal, Decimal], near: Decimal) -> Decimal:
    """Return the angle of a vector in rad. ``near`` is an approximation in double precision."""
    x, y = vector
    cos, sin = _cos_sin(near)
    # The sine of the remaining angle of 1e-15 rad is this angle.
    return near + (y * cos - x * sin) / (x * x + y * y).sqrt()


def _dead_centre_angle(rod_and_arm: RodAndArm, start: float) -> float | None:
    """Return the knee angle of the dead centre (r = 0) below ``start``, in rad.

    Returns None if there is no dead centre within 60° below ``start``, or if the linkage cannot be
    assembled before the dead centre. Without a dead centre `_fit` chooses x_dc well outside its
    range. That is enough, because the square root only has to be analytic within the range.
    """
    angles = np.linspace(start, start - np.radians(60.0), 241)
    previous = angles[0]
    for angle in angles[1:]:
        try:
            _, arm = rod_and_arm(np.array(angle))
        except LinkageError:
            break
        if arm <= 0.0:
            for _ in range(40):  # bisection: SciPy's root finder takes 0.2 s to import
                middle = np.array(0.5 * (angle + previous))
                _, arm = rod_and_arm(middle)
                angle, previous = (angle, middle) if arm > 0.0 else (middle, previous)
            return float(angle)
        previous = angle
    return None
