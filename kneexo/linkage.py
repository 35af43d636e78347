"""Four-bar knee: linkage mathematics as plain functions (Lee et al. 2020, Eq. 1–9).

Frame: that of the ground link; origin at the nominal knee axis, y proximal, flexion
counter-clockwise. Angles in rad, lengths in m. Every function takes an array (or a scalar) and
returns an array of the same shape, unless its text says otherwise. The functions that the
LeafSystems share take ``xp``, the module of elementary functions: numpy by default,
`pydrake.math` for the scalars of Drake.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from functools import lru_cache
from itertools import zip_longest
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kneexo.errors import LinkageError
from kneexo.parameters import LinkageParameters, RodPolynomialParameters
from kneexo.result import Array, Result

FIT_RANGE_DEG = (-2.0, 91.0)
"""Knee angles that the inverse `RodInverse` covers: the range of motion and a margin."""

FIT_DEGREE = 25
"""Chebyshev degree of `RodInverse`: below 5e-12 rad for G1, G2 and G3, 5e-11 rad for G4."""

_FIT_TOLERANCE_RAD = 1e-8

_DECIMAL = Context(prec=50)
_PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")


# ------------------------------------------------------------- encoder angle to knee angle


def wrap(angle: Any, xp: Any = np) -> Any:
    """The angle in (−π, π], as atan2(sin, cos)."""
    return xp.atan2(xp.sin(angle), xp.cos(angle))


def knee_angle_from_encoder(link: Any, encoder_angle: Any, eq6_sign: Any, xp: Any = np) -> Any:
    """Knee angle θ_p of the angle θ_4 of link 4 (Eq. 3–7), wrapped to (−π, π].

    Eq. 6 in the form θ_3 = atan2(A, B) ± acos(C/√(A² + B²)), because B + C may pass through zero
    inside the range of motion, as for G1 and G2. ``link`` has the lengths and φ of
    `LinkageParameters`; ``eq6_sign`` comes from `eq6_sign`. Where the linkage cannot be assembled
    the result is nan.
    """
    c_1 = link.o_b_x_m - link.o_a_x_m + link.a_4_m * xp.cos(encoder_angle)
    c_2 = link.o_b_y_m - link.o_a_y_m + link.a_4_m * xp.sin(encoder_angle)
    a = -2.0 * c_2 * link.a_3_m
    b = -2.0 * c_1 * link.a_3_m
    c = link.a_2_m**2 - link.a_3_m**2 - c_1**2 - c_2**2
    theta_3 = xp.atan2(a, b) + eq6_sign * xp.acos(c / xp.sqrt(a * a + b * b))
    return wrap(theta_3 + link.phi_rad, xp)


# --------------------------------------------------------- knee angle to everything (exact)


@dataclass(frozen=True, repr=False)
class LinkagePose(Result):
    """All joints of the linkage at the knee angles ``knee_angle`` (n,); see `pose`.

    Points are complex numbers x + jy in m; angles in rad.
    """

    knee_angle: Array
    theta_2: Array
    theta_3: Array
    theta_4: Array
    joint_a: NDArray[np.complex128]
    joint_b: NDArray[np.complex128]
    rod_pin: NDArray[np.complex128]
    rod_extension: Array
    moment_arm: Array
    """r = −dx/dθ_p in m."""
    encoder_sensitivity: Array
    """dθ_p/dθ_4."""


def _ground(link: LinkageParameters) -> tuple[complex, complex]:
    return complex(link.o_a_x_m, link.o_a_y_m), complex(link.o_b_x_m, link.o_b_y_m)


def rod_anchor(link: LinkageParameters) -> complex:
    """P_rod of Eq. 9 as x + jy, in m."""
    return complex(link.rod_anchor_radius_m * np.exp(1j * link.rod_anchor_angle_rad))


def pose(link: LinkageParameters, knee_angle: ArrayLike) -> LinkagePose:
    """Assemble the linkage at given knee angles: closed form, driven by the coupler.

    With θ_3 = θ_p − φ the dyad of links 2 and 4 closes on D = O_B − O_A − a_3 e^{jθ_3}, so
    |D + a_4 e^{jθ_4}| = a_2 gives θ_4 (``link.branch`` is the sign of sin(θ_4 − θ_2)); Eq. 8 and
    9 give the rod. θ_4 is continuous over the range of motion: it is wrapped around its own value
    at mid-range, not at ±π.

    Raises `LinkageError` where the links do not close.
    """
    theta_p = np.asarray(knee_angle, dtype=float)
    wrapped = _theta_4(link, theta_p)
    middle = _theta_4(link, np.asarray(np.pi / 4.0))
    theta_4 = middle + wrap(wrapped - middle)
    o_a, o_b = _ground(link)
    theta_3 = theta_p - link.phi_rad
    joint_b = o_b + link.a_4_m * np.exp(1j * theta_4)
    joint_a = joint_b - link.a_3_m * np.exp(1j * theta_3)
    theta_2 = np.angle(joint_a - o_a)
    with np.errstate(divide="ignore"):
        sensitivity = (link.a_4_m * np.sin(theta_4 - theta_2)) / (
            link.a_3_m * np.sin(theta_3 - theta_2)
        )
        rod_pin = joint_b + link.rod_pin_radius_m * np.exp(1j * (theta_3 + link.rod_pin_angle_rad))
        rod = rod_pin - rod_anchor(link)
        length = np.abs(rod)
        pin_velocity = 1j * ((joint_b - o_b) / sensitivity + (rod_pin - joint_b))
    return LinkagePose(
        knee_angle=theta_p,
        theta_2=theta_2,
        theta_3=theta_3,
        theta_4=theta_4,
        joint_a=joint_a,
        joint_b=joint_b,
        rod_pin=rod_pin,
        rod_extension=length - link.rod_length_m,
        moment_arm=-np.real(np.conj(rod) * pin_velocity) / length,
        encoder_sensitivity=sensitivity,
    )


def _theta_4(link: LinkageParameters, theta_p: Array) -> Array:
    o_a, o_b = _ground(link)
    d = o_b - o_a - link.a_3_m * np.exp(1j * (theta_p - link.phi_rad))
    cosine = (link.a_2_m**2 - link.a_4_m**2 - np.abs(d) ** 2) / (2.0 * link.a_4_m * np.abs(d))
    if np.any(bad := ~(np.abs(cosine) <= 1.0)):
        angle = np.degrees(np.broadcast_to(theta_p, bad.shape)[bad].flat[0])
        raise LinkageError(
            f"the linkage cannot be assembled at knee angle {angle:.4g} deg: links "
            f"a_2_m = {link.a_2_m:g} m and a_4_m = {link.a_4_m:g} m do not close; change the "
            f"lengths or the ground joints"
        )
    # sin(θ_4 − θ_2) has the sign of sin(θ_4 − arg D), since a_2 e^{jθ_2} = D + a_4 e^{jθ_4}.
    return np.asarray(np.angle(d) + link.branch * np.arccos(cosine))


@lru_cache(maxsize=64)
def eq6_sign(link: LinkageParameters) -> int:
    """The sign in Eq. 6 that belongs to the linkage's assembly: −1 or 1.

    Raises `LinkageError` when the sign changes within 0…90°: then one encoder angle has two knee
    angles and no controller can tell them apart.
    """
    at = pose(link, np.radians(np.linspace(0.0, 90.0, 181)))
    signs = -np.sign(np.sin(at.theta_3 - at.theta_2))
    if np.any(signs != signs[0]):
        angle = np.degrees(at.knee_angle[np.argmax(signs != signs[0])])
        raise LinkageError(
            f"the encoder angle reverses near knee angle {angle:.4g} deg: the linkage is not "
            f"one-to-one over 0…90 deg; change the lengths or the ground joints"
        )
    return int(signs[0])


def rod_extension(link: LinkageParameters, knee_angle: ArrayLike) -> Array:
    """Rod extension x(θ_p) in m (Eq. 8, 9)."""
    return pose(link, knee_angle).rod_extension


def moment_arm(link: LinkageParameters, knee_angle: ArrayLike) -> Array:
    """Moment arm of the rod r(θ_p) = −dx/dθ_p in m."""
    return pose(link, knee_angle).moment_arm


def encoder_angle(link: LinkageParameters, knee_angle: ArrayLike) -> Array:
    """Angle θ_4 of link 4 in rad, continuous over the range of motion."""
    return pose(link, knee_angle).theta_4


def knee_angle_from_rod(link: LinkageParameters, extension: ArrayLike) -> Array:
    """Knee angle θ_p(x) in rad: the inverse of `rod_extension`, by Newton's method.

    Starts from an interpolated table; stops when no step exceeds 1e-15 rad or after 20 steps.
    Raises `LinkageError` when the extension belongs to no knee angle of −2…91°.
    """
    return _invert(lambda angle: _rod_and_arm(link, angle), extension)


def _rod_and_arm(link: LinkageParameters, angle: Array) -> tuple[Array, Array]:
    at = pose(link, angle)
    return at.rod_extension, at.moment_arm


def _table(rod_and_arm: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, Array]:
    """Knee angles every 0.5° and their rod extensions, which must fall; else `LinkageError`."""
    grid = np.radians(np.linspace(*FIT_RANGE_DEG, 187))
    extension, _ = rod_and_arm(grid)
    if np.any(rising := np.diff(extension) >= 0.0):
        angle = np.degrees(grid[np.argmax(rising)])
        raise LinkageError(
            f"the rod has a dead centre near knee angle {angle:.4g} deg: its extension must fall "
            f"as the knee flexes over {FIT_RANGE_DEG[0]:g}…{FIT_RANGE_DEG[1]:g} deg"
        )
    return grid, extension


def _invert(
    rod_and_arm: Callable[[Array], tuple[Array, Array]],
    extension: ArrayLike,
) -> Array:
    x = np.asarray(extension, dtype=float)
    grid, table = _table(rod_and_arm)
    slack = 1e-9
    if np.any(bad := ~((x >= table[-1] - slack) & (x <= table[0] + slack))):
        raise LinkageError(
            f"rod_extension = {x[bad].flat[0]:g} m belongs to no knee angle: must be "
            f"{table[-1]:.4g} … {table[0]:.4g} m"
        )
    angle = np.interp(x, table[::-1], grid[::-1])
    for _ in range(20):
        value, arm = rod_and_arm(angle)
        step = (value - x) / arm
        angle = angle + step
        if np.all(np.abs(step) < 1e-15):
            break
    return np.asarray(angle)


# ------------------------------------------------------------------------------ properties


def icr(link: Any, theta_3: Any, theta_4: Any, xp: Any = np) -> tuple[Any, Any]:
    """Instantaneous centre of rotation of the coupler, (x, y) in m.

    It is where the lines O_A A and O_B B meet: O_B + t e^{jθ_4} with t from the cross product
    with A − O_A.
    """
    cos_4, sin_4 = xp.cos(theta_4), xp.sin(theta_4)
    d_x = link.o_b_x_m - link.o_a_x_m
    d_y = link.o_b_y_m - link.o_a_y_m
    link_2_x = d_x + link.a_4_m * cos_4 - link.a_3_m * xp.cos(theta_3)
    link_2_y = d_y + link.a_4_m * sin_4 - link.a_3_m * xp.sin(theta_3)
    t = (d_y * link_2_x - d_x * link_2_y) / (cos_4 * link_2_y - sin_4 * link_2_x)
    return link.o_b_x_m + t * cos_4, link.o_b_y_m + t * sin_4


# -------------------------------------------------------------------- Table 1 (Eq. 10, 11)


def polynomial(coefficients: Any, argument: Any) -> Any:
    """Horner's rule, highest power first; for arrays and for all scalars of Drake."""
    value = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * argument + coefficient
    return value


def polynomial_derivative(coefficients: Any, order: int = 1) -> list[Any]:
    """Coefficients of a derivative, highest power first."""
    result = list(coefficients)
    for _ in range(order):
        degree = len(result) - 1
        result = [c * (degree - n) for n, c in enumerate(result[:-1])]
    return result


# ------------------------------------------- inverse in closed form, for the plant's knee


@dataclass(frozen=True)
class RodInverse:
    """θ_p, θ_4 and r as polynomials of t = (√(x_dc − x) − centre)/half_width.

    The rod's dead centre (θ_dc, x_dc) lies outside the range of motion, and in √(x_dc − x) the
    inverse is analytic, so a Chebyshev fit of degree 25 is exact to rounding (to 3e-10 rad for
    Table 1, whose dead centre is nearer). It is kept in powers of t, highest first, because
    Horner's rule stays small in symbolic form where Clenshaw's unfolds.
    """

    dead_centre_m: float
    centre: float
    half_width: float
    knee_angle: tuple[float, ...]
    encoder_angle: tuple[float, ...]
    moment_arm: tuple[float, ...]


@lru_cache(maxsize=64)
def fit_rod_inverse(
    link: LinkageParameters, table_1: RodPolynomialParameters | None = None
) -> RodInverse:
    """Fit `RodInverse` to the exact linkage, or to Eq. 10 where ``table_1`` is given.

    The fit is computed with 50 decimal digits and rounded once, so every processor and every
    numerical library gives the same bits.

    Raises `LinkageError` when the linkage cannot be assembled, the rod extension does not fall as
    the knee flexes over −2…91°, or the error of the fit is above 1e-8 rad.
    """
    if table_1 is None:

        def rod_and_arm(angle: Array) -> tuple[Array, Array]:
            return _rod_and_arm(link, angle)

        def decimal_rod_and_arm(angle: Decimal) -> tuple[Decimal, Decimal]:
            return _decimal_pose(link, angle)[:2]
    else:
        p = table_1.p_si
        decimal_p = [Decimal(c) for c in p]

        def rod_and_arm(angle: Array) -> tuple[Array, Array]:
            return polynomial(p, angle), -polynomial(polynomial_derivative(p), angle)

        def decimal_rod_and_arm(angle: Decimal) -> tuple[Decimal, Decimal]:
            slope = polynomial(polynomial_derivative(decimal_p), angle)
            return polynomial(decimal_p, angle), -slope

    angles, _ = _table(rod_and_arm)
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
    rod_and_arm: Callable[[Array], tuple[Array, Array]],
    decimal_rod_and_arm: Callable[[Decimal], tuple[Decimal, Decimal]],
) -> RodInverse:
    """Fit `RodInverse` by discrete orthogonality of Chebyshev polynomials, in decimal numbers.

    ``dead_centre_angle``: see `_dead_centre_angle`.
    """
    first, last = Decimal(float(angles[0])), Decimal(float(angles[-1]))
    extension, arm = decimal_rod_and_arm(first)
    if dead_centre_angle is None:
        dead_centre = float(extension + arm / 4)
    else:  # x is stationary there, so an error of 1e-15 rad does not matter
        dead_centre = float(decimal_rod_and_arm(Decimal(dead_centre_angle))[0])
    w_low = (Decimal(dead_centre) - extension).sqrt()
    w_high = (Decimal(dead_centre) - decimal_rod_and_arm(last)[0]).sqrt()
    centre, half_width = float((w_low + w_high) / 2), float((w_high - w_low) / 2)

    size = FIT_DEGREE + 7  # the first neglected degree that aliases is 2 · size − 25 = 39
    nodes = [_cos_sin(_PI * (2 * k + 1) / (2 * size))[0] for k in range(size)]
    extensions = [
        Decimal(dead_centre) - (Decimal(centre) + Decimal(half_width) * t) ** 2 for t in nodes
    ]
    start = _invert(rod_and_arm, np.array([float(x) for x in extensions]))
    knee_angles, encoder_angles, arms = [], [], []
    for x, near, near_4 in zip(extensions, start, encoder_angle(link, start), strict=True):
        angle = Decimal(float(near))
        for _ in range(2):  # Newton's method: 15 correct digits at the start, then 30, then all
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
    """Return the Chebyshev series of degree `FIT_DEGREE` as coefficients of powers, highest first.

    ``values`` are the function's values at ``nodes``, the zeros of a Chebyshev polynomial.
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
    """Return the rod extension x(θ_p) in m, rounded once, so with the same bits on every processor.

    Raises `LinkageError` where the links do not close.
    """
    rod_extension(link, knee_angle_rad)  # raises the error
    with localcontext(_DECIMAL):
        return float(_decimal_pose(link, Decimal(knee_angle_rad))[0])


def _decimal_pose(
    link: LinkageParameters, knee_angle: Decimal
) -> tuple[Decimal, Decimal, tuple[Decimal, Decimal]]:
    """Rod extension x, moment arm r and the vector a_4 e^{jθ_4} of `pose`, as decimal numbers.

    Only the trigonometry of θ_3 is needed: with D of `pose`, a_4 e^{jθ_4} has the scalar product
    (a_2² − a_4² − |D|²)/2 with D.
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
    """Return cosine and sine from their power series."""
    sums, term, n = [Decimal(0), Decimal(0)], Decimal(1), 0
    while abs(term) > Decimal("1e-55"):
        sums[n % 2] += -term if n % 4 > 1 else term
        n += 1
        term *= angle / n
    return sums[0], sums[1]


def _angle(vector: tuple[Decimal, Decimal], near: Decimal) -> Decimal:
    """Return the angle of a vector. ``near`` is this angle but for the rounding of doubles."""
    x, y = vector
    cos, sin = _cos_sin(near)
    return near + (y * cos - x * sin) / (x * x + y * y).sqrt()  # arcsin(y) = y for 1e-15


def _dead_centre_angle(
    rod_and_arm: Callable[[Array], tuple[Array, Array]], start: float
) -> float | None:
    """Return the knee angle below ``start`` where r = 0, the dead centre.

    Returns None for a linkage that has no dead centre within 60°, or that cannot be assembled so
    far. `_fit` then takes a fictitious dead centre well outside, because the fit only requires a
    square root that is analytic in its range.
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
