"""Four-bar knee: linkage mathematics as plain functions (Lee et al. 2020, Eq. 1–9).

All coordinates are in the frame of the ground link. Its origin is the nominal knee axis, y points
to the hip, and flexion is counter-clockwise. Angles are in rad, lengths in m. Every function takes
an array (or a scalar) and returns an array of the same shape, unless its docstring says otherwise.
Functions that the leaf systems use too have an argument ``xp``: the module of elementary functions,
numpy by default, `pydrake.math` for the scalars of Drake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kneexo.common.result import Array, Result
from kneexo.errors import LinkageError
from kneexo.parameters import LinkageParameters

FIT_RANGE_DEG = (-2.0, 91.0)
"""The lowest and the highest knee angle in deg at which the rod can be inverted."""

RodAndArm = Callable[[Array], tuple[Array, Array]]
"""A function that returns rod extension and moment arm in m for knee angles in rad."""


# ------------------------------------------------------------- encoder angle to knee angle


def wrap(angle: Any, xp: Any = np) -> Any:
    """Return the angle within (−π, π] that equals ``angle`` up to a multiple of 2π."""
    return xp.atan2(xp.sin(angle), xp.cos(angle))


def knee_angle_from_encoder(link: Any, encoder_angle: Any, eq6_sign: Any, xp: Any = np) -> Any:
    """Return the knee angle θ_p, within (−π, π], for the angle θ_4 of link 4 (Eq. 3–7).

    Eq. 6 is evaluated as θ_3 = atan2(A, B) ± acos(C/√(A² + B²)). The form in the paper divides by
    the sum B+C, which is zero at a knee angle within the range of motion of G1 and G2. The result
    is nan where the linkage cannot be assembled.

    Parameters
    ----------
    link
        The lengths in m and φ in rad, as in `LinkageParameters`.
    encoder_angle
        θ_4 in rad, a number or an array.
    eq6_sign
        1 or −1, the sign of the acos, as the function `eq6_sign` returns it.
    xp
        The module of the elementary functions, such as ``numpy`` or ``pydrake.math``.
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
    """The result of `pose`: angles and joints of the linkage at the knee angles ``knee_angle``.

    All arrays have the shape of ``knee_angle``. Angles θ_2 of link 2, θ_3 of the coupler and θ_4 of
    link 4 are in rad. Points are complex numbers x + jy in m. Joint A connects the coupler to link
    2, joint B connects the coupler to link 4, and ``rod_pin`` is the moving end of the rod. The rod
    extension is in m.
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
    """Moment arm of the rod, r = −dx/dθ_p in m, with the rod extension x and the knee angle θ_p."""
    encoder_sensitivity: Array
    """Derivative of the knee angle with respect to the angle of link 4, dθ_p/dθ_4."""


def _ground(link: LinkageParameters) -> tuple[complex, complex]:
    return complex(link.o_a_x_m, link.o_a_y_m), complex(link.o_b_x_m, link.o_b_y_m)


def rod_anchor(link: LinkageParameters) -> complex:
    """Return the fixed end of the rod, P_rod of Eq. 9, as x + jy in m."""
    return complex(link.rod_anchor_radius_m * np.exp(1j * link.rod_anchor_angle_rad))


def shank_is_ground(link: LinkageParameters) -> bool:
    """Return True if the ground link belongs to the shank, False if it belongs to the thigh.

    The cylinder's pin is fixed to the ground link. The pin lies below the knee if the shank is the
    ground (G1), and above the knee if the thigh is the ground.
    """
    return rod_anchor(link).imag < 0.0


def pose(link: LinkageParameters, knee_angle: ArrayLike) -> LinkagePose:
    """Assemble the linkage at given knee angles, in closed form.

    The knee angle sets the angle of the coupler, θ_3 = θ_p − φ. The vector D is O_B − O_A −
    a_3e^{jθ_3}, and θ_4 solves |D + a_4e^{jθ_4}| = a_2. The equation has two solutions.
    ``link.branch`` is the sign of sin(θ_4 − θ_2) in the chosen solution. Eq. 8 and 9 give the rod.
    θ_4 is unwrapped to within ±π of its value at 45°, so that it is continuous over the range of
    motion.

    Raises `LinkageError` where the links do not close.
    """
    theta_p = np.asarray(knee_angle, dtype=float)
    wrapped = _theta_4(link, theta_p)
    # 45° lies within every range of motion, so θ_4 is continuous over it.
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


def _diagonal(link: LinkageParameters, theta_p: Array) -> NDArray[np.complex128]:
    """Return D = O_B − O_A − a_3e^{jθ_3} in m, which links 2 and 4 must span."""
    o_a, o_b = _ground(link)
    return np.asarray(o_b - o_a - link.a_3_m * np.exp(1j * (theta_p - link.phi_rad)))


def _theta_4(link: LinkageParameters, theta_p: Array) -> Array:
    d = _diagonal(link, theta_p)
    cosine = (link.a_2_m**2 - link.a_4_m**2 - np.abs(d) ** 2) / (2.0 * link.a_4_m * np.abs(d))
    if np.any(bad := ~(np.abs(cosine) <= 1.0)):
        angle = np.degrees(np.broadcast_to(theta_p, bad.shape)[bad].flat[0])
        raise LinkageError(
            f"the linkage cannot be assembled at knee angle {angle:.4g} deg: links "
            f"a_2_m = {link.a_2_m:g} m and a_4_m = {link.a_4_m:g} m do not close"
            f"{_closing_change(link, theta_p)}"
        )
    # sin(θ_4 − θ_2) has the sign of sin(θ_4 − arg D), since a_2 e^{jθ_2} = D + a_4 e^{jθ_4}.
    return np.asarray(np.angle(d) + link.branch * np.arccos(cosine))


def _closing_change(link: LinkageParameters, theta_p: Array) -> str:
    """Return the remedy of a linkage that does not close, as the end of a message.

    The links close where |a_2 − a_4| ≤ |D| ≤ a_2 + a_4. The remedy is a range for the length of
    link 2 or link 4, whichever changes less. With a length in this range, 0.1 % away from the
    limits, the links close at the knee angles ``theta_p`` and over `FIT_RANGE_DEG`. If no change of
    one length suffices, the remedy has both lengths. The text is empty if the lengths are right,
    and a knee angle is not a number.
    """
    # Every 0.5°, as in `rod_table`.
    fit_range = np.radians(np.linspace(*FIT_RANGE_DEG, 187))
    distance = np.abs(_diagonal(link, np.append(theta_p[np.isfinite(theta_p)], fit_range)))
    farthest, nearest = distance.max(), distance.min()
    changes = []
    for name, other in (("a_2_m", link.a_4_m), ("a_4_m", link.a_2_m)):
        low, high = 1.001 * max(farthest - other, other - nearest), 0.999 * (nearest + other)
        change = max(low - getattr(link, name), getattr(link, name) - high)
        if low <= high:
            changes.append((change, f"; {name} must be {low:.4g} … {high:.4g} m"))
    if not changes:
        return f"; choose a_2_m = a_4_m, at least {0.501 * farthest:.4g} m"
    change, text = min(changes)
    return text if change > 0.0 else ""


@lru_cache(maxsize=64)
def eq6_sign(link: LinkageParameters) -> int:
    """Return −1 or 1, the sign of acos in Eq. 6 that gives the true knee angles.

    Raises `LinkageError` if the sign changes within knee angles of 0…90°. Two knee angles would
    then have the same encoder angle, and no controller could distinguish these knee angles.
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
    """Return the rod extension x(θ_p) in m (Eq. 8, 9). Raises `LinkageError` as `pose` does."""
    return pose(link, knee_angle).rod_extension


def moment_arm(link: LinkageParameters, knee_angle: ArrayLike) -> Array:
    """Return the rod's moment arm r(θ_p) = −dx/dθ_p in m. Raises `LinkageError` as `pose` does."""
    return pose(link, knee_angle).moment_arm


def encoder_angle(link: LinkageParameters, knee_angle: ArrayLike) -> Array:
    """Return the angle θ_4 of link 4 in rad, continuous over the range of motion.

    Raises `LinkageError` as `pose` does.
    """
    return pose(link, knee_angle).theta_4


def knee_angle_from_rod(link: LinkageParameters, extension: ArrayLike) -> Array:
    """Return the knee angle θ_p(x) in rad, the inverse of `rod_extension`; see `invert_rod`."""
    return invert_rod(lambda angle: exact_rod_and_arm(link, angle), extension)


def exact_rod_and_arm(link: LinkageParameters, angle: Array) -> tuple[Array, Array]:
    """Return rod extension and moment arm in m. Raises `LinkageError` as `pose` does."""
    at = pose(link, angle)
    return at.rod_extension, at.moment_arm


def rod_table(rod_and_arm: RodAndArm) -> tuple[Array, Array]:
    """Return knee angles in rad, one every 0.5° of `FIT_RANGE_DEG`, and their rod extensions in m.

    Raises `LinkageError` unless the extension falls as the knee flexes.
    """
    grid = np.radians(np.linspace(*FIT_RANGE_DEG, 187))
    extension, _ = rod_and_arm(grid)
    if np.any(rising := np.diff(extension) >= 0.0):
        angle = np.degrees(grid[np.argmax(rising)])
        raise LinkageError(
            f"the rod has a dead centre near knee angle {angle:.4g} deg: its extension must fall "
            f"as the knee flexes over {FIT_RANGE_DEG[0]:g}…{FIT_RANGE_DEG[1]:g} deg"
        )
    return grid, extension


def invert_rod(
    rod_and_arm: RodAndArm,
    extension: ArrayLike,
) -> Array:
    """Return the knee angles in rad at which the rod has these extensions in m.

    Newton's method starts from angles interpolated in a table, and stops when no step exceeds 1e-15
    rad, or after 20 steps. Raises `LinkageError` if no knee angle within −2…91° has one of the
    extensions.
    """
    x = np.asarray(extension, dtype=float)
    grid, table = rod_table(rod_and_arm)
    slack = 1e-9
    if np.any(bad := ~((x >= table[-1] - slack) & (x <= table[0] + slack))):
        raise LinkageError(
            f"rod_extension = {x[bad].flat[0]:g} m belongs to no knee angle: must be "
            f"{table[-1]:.4g} … {table[0]:.4g} m"
        )
    # Three steps from the table reach rounding, 4e-15 rad for the linkages by name. So the test
    # below may never hold, and 20 steps are the bound.
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
    """Return the instantaneous centre of rotation of the coupler, (x, y) in m.

    The centre is where the line through O_A and A (link 2) meets the line through O_B and B (link
    4). So the centre is O_B + te^{jθ_4}. The length t follows from the cross product with the
    vector from O_A to A.

    Parameters
    ----------
    link
        The lengths in m and φ in rad, as in `LinkageParameters`.
    theta_3, theta_4
        Angles of links 3 and 4 in rad, numbers or arrays.
    xp
        The module of the elementary functions, such as ``numpy`` or ``pydrake.math``.
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
    """Return the value of a polynomial at ``argument``, by Horner's rule.

    ``coefficients`` begin with the highest power. ``argument`` can be an array, a decimal number or
    a scalar of Drake.
    """
    # Clenshaw's recursion of a Chebyshev series would give symbolic expressions of exponential
    # size.
    value = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * argument + coefficient
    return value


def polynomial_derivative(coefficients: Any, order: int = 1) -> list[Any]:
    """Differentiate a polynomial ``order`` times; return coefficients, highest power first."""
    result = list(coefficients)
    for _ in range(order):
        degree = len(result) - 1
        result = [c * (degree - n) for n, c in enumerate(result[:-1])]
    return result
