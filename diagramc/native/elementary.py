"""Emits elementary functions as instructions; scalars and lanes of vectors get the same bits.

For signed zeros, infinities, nan and subnormal numbers a function gives the same value as the C
function of the same name. Its error is below 2 units in the last place. If lanes require different
formulas, the code computes all formulas and selects a result in each lane. There is a branch only
for arguments that are passed to the C library: large angles of sine and cosine, and rare arguments
of powers.
``benchmarks/fit_elementary.py`` computes and prints the coefficients.

The methods are those of W. J. Cody and W. Waite, Software Manual for the Elementary Functions
(Prentice-Hall, 1980): reduce the argument with a constant in several parts, evaluate a polynomial,
scale back. Estrin's scheme evaluates the polynomials. `power` has its logarithm as a sum of two
doubles, as T. J. Dekker's arithmetic (1971, Numer. Math. 18) makes it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from .ir import Function, Operand, Value

SIN = (  # relative error 1.3e-17
    -0.16666666666666666,
    0.008333333333330967,
    -0.00019841269836758655,
    2.755731610255217e-06,
    -2.5051131845003737e-08,
    1.5918129294866835e-10,
)
"""Coefficients cᵢ of sin r = r + r³ (c₀ + c₁ r² + …), for an angle |r| ≤ π/4."""
COS = (  # relative error 6.0e-19
    0.041666666666666664,
    -0.0013888888888887378,
    2.480158729876558e-05,
    -2.7557317271730026e-07,
    2.087614626840273e-09,
    -1.1382632425522016e-11,
)
"""Coefficients cᵢ of cos r = 1 - r²/2 + r⁴ (c₀ + c₁ r² + …), for an angle |r| ≤ π/4."""
ATAN = (  # relative error 3.4e-17
    -0.33333333333333326,
    0.1999999999999753,
    -0.14285714285384132,
    0.11111111093490826,
    -0.09090908590891934,
    0.07692298971033217,
    -0.06666564699289104,
    0.058815068777936554,
    -0.052579733342841106,
    0.04737749579527779,
    -0.04260356632601652,
    0.03749486812535247,
    -0.031277189066996385,
    0.023696731580048622,
    -0.015535152475414177,
    0.008368931178450162,
    -0.0034958859739163102,
    0.001049603508496851,
    -0.00019996189377901387,
    1.8061954618612127e-05,
)
"""Coefficients cᵢ of arctan t = t + t³ (c₀ + c₁ t² + …), for |t| ≤ 1."""
ASIN = (  # relative error 3.4e-18
    0.16666666666666669,
    0.0749999999999843,
    0.04464285714635542,
    0.03038194413853124,
    0.022372172942149885,
    0.017352392720869962,
    0.013971212973552935,
    0.01147917741518491,
    0.010322814350185783,
    0.005457506718640357,
    0.01740087944269402,
    -0.014851887071247198,
    0.02875785136742157,
)
"""Coefficients cᵢ of arcsin s = s + s³ (c₀ + c₁ s² + …), for |s| ≤ ½."""
EXP = (  # relative error 1.5e-17
    0.5000000000000001,
    0.1666666666666667,
    0.0416666666666242,
    0.008333333333330058,
    0.0013888888917196734,
    0.00019841269863040545,
    2.4801521322368695e-05,
    2.755726848031006e-06,
    2.762007587998331e-07,
    2.5100375832561274e-08,
)
"""Coefficients cᵢ of eʳ = 1 + r + r² (c₀ + c₁ r + …), for |r| ≤ ½ ln 2."""
LOG = (  # relative error 4.3e-18
    0.666666666666667,
    0.39999999999899527,
    0.28571428625975426,
    0.22222211134795133,
    0.18182889125261753,
    0.15331721600556042,
    0.14616449685043353,
)
"""Coefficients cᵢ of 2 artanh s = 2 s + s³ (c₀ + c₁ s² + …), where `log` defines s."""
LOG_END = (  # relative error 1.7e-21
    0.4,
    0.2857142857142928,
    0.22222222221656115,
    0.18181818335314254,
    0.1538459497089529,
    0.13334804238225118,
    0.11706248540922265,
    0.11723051028097596,
)
"""Coefficients cᵢ of 2 artanh s = 2 s + ⅔ s³ + s⁵ (c₀ + c₁ s² + …), where `power` defines s."""
HALF_PI = (  # relative error 3.5e-50
    1.5707963267948966,
    6.123233995736766e-17,
    -1.4973849048591698e-33,
)
"""π/2 as a sum of three doubles, the largest double first."""
LN_2 = (  # relative error 8.2e-34
    0.6931471805599453,
    2.3190468138462996e-17,
)
"""The natural logarithm of 2 as a sum of two doubles, the larger double first."""
TWO_THIRDS = (  # relative error 3.1e-33
    0.6666666666666666,
    3.700743415417188e-17,
)
"""⅔ as a sum of two doubles, the larger double first."""

LARGE = 1e9
"""Largest |x| for which this module computes sin x and cos x. The C library does it beyond.

The error bound in `sincos` and the tests hold up to this number.
"""

ROUNDING = 1.5 * 2.0**52
"""A number whose unit in the last place is 1.

Adding x to this number rounds x to a whole number, which is then in the lowest bits of the sum.
"""


def _bits(value: float) -> int:
    (bits,) = struct.unpack("<q", struct.pack("<d", value))
    return bits


SIGN = _bits(-0.0)
"""Bit pattern in which only the sign bit of a double is set."""
ROOT_HALF = _bits(math.sqrt(0.5))
"""Bit pattern of the double √½."""
EXPONENT = 52
"""Position of the exponent's lowest bit in the bit pattern of a double; bit 0 is the lowest."""
BIAS = 1023
"""The whole number in the exponent's bits of the double 1.0 = 2⁰."""


def estrin(f: Function, coefficients: Sequence[float], x: Value) -> Value:
    """Emit the value of the polynomial c₀ + c₁ x + c₂ x² + … with the ``coefficients`` c₀, c₁, ….

    The code uses Estrin's scheme, which is fast because its products do not wait for each other.
    """
    terms = [f.coerce(c, x.type) for c in coefficients]
    power = x
    while len(terms) > 1:
        pairs = zip(terms[::2], terms[1::2], strict=False)
        alone = terms[-1:] if len(terms) % 2 else []
        terms = [f.fma(power, high, low) for low, high in pairs] + alone
        power = power * power
    return terms[0]


def sincos(f: Function, x: Value) -> tuple[Value, Value]:
    """Emit the sine and the cosine of x in rad; return the two values.

    The code first subtracts a multiple of π/2 from x. The remainder keeps its relative precision
    even if x is next to the multiple: the first subtraction is exact, and the second is rounded
    once. The sum of three doubles for π/2 causes an error of 1e-40. A double up to `LARGE` is at
    least 6e-19 away from every multiple, which is far more.
    """
    sine, cosine = _of_large(f, ("sin", "cos"), x, _sincos(f, x))
    return sine, cosine


def _sincos(f: Function, x: Value) -> tuple[Value, Value]:
    magnitude = f.absolute(x)
    shifted = f.fma(magnitude, 2.0 / math.pi, ROUNDING)
    quarters = shifted - ROUNDING
    r = magnitude
    for part in HALF_PI:
        r = f.fma(quarters, -part, r)
    z = r * r
    sine = f.fma(r * z, estrin(f, SIN, z), r)
    cosine = f.fma(z * z, estrin(f, COS, z), f.fma(z, -0.5, 1.0))
    quadrant = f.bits(shifted)
    odd = (quadrant & 1).differs(0)
    sign = ((quadrant << 62) ^ f.bits(x)) & SIGN  # bit 1 of the quadrant
    cosine_sign = ((quadrant + 1) << 62) & SIGN
    return (
        f.from_bits(f.bits(f.select(odd, cosine, sine)) ^ sign),
        f.from_bits(f.bits(f.select(odd, sine, cosine)) ^ cosine_sign),
    )


def _of_large(f: Function, names: Sequence[str], x: Value, values: Sequence[Value]) -> list[Value]:
    """Emit a choice: the C library's values at x in lanes with |x| > `LARGE`, else ``values``.

    ``names``: names of the C library's functions, one name for each value.
    """
    results = [f.variable(value) for value in values]
    large = f.absolute(x) > LARGE
    with f.when(f.any_lane(large)):
        for name, value, result in zip(names, values, results, strict=True):
            result.set(_library_where(f, name, large, value, x))
    return [result.get() for result in results]


def _library_where(f: Function, name: str, where: Value, value: Value, *arguments: Value) -> Value:
    """Emit a choice: the C library's function ``name`` in lanes of ``where``, else ``value``.

    The code calls an emitted function, which keeps the rare calls of the C library from slowing
    down other code.
    """
    types = {"where": where.type, "value": value.type}
    types |= {f"x{i}": argument.type for i, argument in enumerate(arguments)}
    full = f"{name}_where_{value.type.lanes}"

    def make() -> Function:
        new = f.module.function(full, types, value.type, attributes="cold noinline")
        where, value_, *operands = new.arguments.values()
        new.return_(new.select(where, new.library(name, *operands), value_))
        return new

    return f.call(f.module.shared(full, make), where, value, *arguments)


def atan2(f: Function, y: Operand, x: Operand) -> Value:
    """Emit the angle in rad from the positive x axis to the point (x, y), like C's ``atan2``.

    The code first computes the angle between the direction to the point and the nearer axis. The
    result is ± b ± this angle, where b is 0, π/2 or π.
    """
    y, x = f.alike(y, x)
    across, up = f.absolute(x), f.absolute(y)
    steep, behind = across < up, f.bits(x) < 0
    small, large = f.select(steep, across, up), f.select(steep, up, across)
    large = f.select(large.equals(0.0), 1.0, large)
    t = f.select(small.equals(large), 1.0, small / large)  # both may be infinite
    high, low = (f.select(steep, part, f.select(behind, 2.0 * part, 0.0)) for part in HALF_PI[:2])
    z, t = t * t, f.select(steep ^ behind, -t, t)
    return f.copysign((high + t) + f.fma(t * z, estrin(f, ATAN, z), low), y)


def atan(f: Function, x: Value) -> Value:
    """Emit the arc tangent of x in rad."""
    return atan2(f, x, 1.0)


def asin(f: Function, x: Value) -> Value:
    """Emit the arc sine of x in rad; nan if |x| > 1."""
    s, rest, far = _arc(f, f.absolute(x))
    factor = f.select(far, -2.0, 1.0)
    high, low = (f.select(far, part, 0.0) for part in HALF_PI[:2])
    total = f.fma(factor, s, high)
    lost = f.fma(factor, s, high - total)
    return f.copysign(total + (f.fma(factor, rest, low) + lost), x)


def acos(f: Function, x: Value) -> Value:
    """Emit the arc cosine of x in rad; nan if |x| > 1."""
    s, rest, far = _arc(f, f.absolute(x))
    behind = x < 0.0
    factor = f.select(far, 2.0, -1.0)
    factor = f.select(behind, -factor, factor)
    high, low = (f.select(far, f.select(behind, 2.0 * part, 0.0), part) for part in HALF_PI[:2])
    return f.fma(factor, s, high) + f.fma(factor, rest, low)


def _arc(f: Function, magnitude: Value) -> tuple[Value, Value, Value]:
    """Emit an auxiliary angle, from which `asin` and `acos` get their values at x = ``magnitude``.

    If x ≤ ½, the angle is arcsin x, and its sine is s = x. If x > ½, the angle is half of arccos x,
    and its sine is s = √((1 - x) / 2). Returns s, the angle minus s, and the condition x > ½.
    """
    far = magnitude > 0.5
    z = f.select(far, f.fma(magnitude, -0.5, 0.5), magnitude * magnitude)
    s = f.select(far, f.sqrt(z), magnitude)
    return s, s * z * estrin(f, ASIN, z), far


def exp(f: Function, x: Value) -> Value:
    """Emit the exponential eˣ = eʳ 2ᵏ, with x = k ln 2 + r and |r| ≤ ½ ln 2.

    The code multiplies by 2ᵏ in two factors, because 2ᵏ alone can overflow.
    """
    x = f.maximum(f.minimum(x, 720.0), -760.0)  # ∞ and 0 from there on
    r, exponent = _reduced(f, x)
    power = _exp_of_reduced(f, r)
    half = ((exponent + 2 * BIAS) >> 1) - BIAS
    for share in (half, exponent - half):
        power = power * f.from_bits((share + BIAS) << EXPONENT)
    return power


def _reduced(f: Function, x: Value) -> tuple[Value, Value]:
    """Emit r and the whole number k of x = k ln 2 + r, with |r| ≤ ½ ln 2."""
    shifted = f.fma(x, 1.0 / math.log(2.0), ROUNDING)
    doublings = shifted - ROUNDING
    r = x
    for part in LN_2:
        r = f.fma(doublings, -part, r)
    return r, f.bits(shifted) - _bits(ROUNDING)


def _exp_of_reduced(f: Function, r: Value) -> Value:
    """Emit eʳ for |r| ≤ ½ ln 2."""
    total = 1.0 + r
    lost = (1.0 - total) + r
    return total + f.fma(r * r, estrin(f, EXP, r), lost)


def tanh(f: Function, x: Value) -> Value:
    """Emit the hyperbolic tangent of x.

    With E = e^(-2|x|) and t = E - 1, the magnitude is -t/(2 + t) up to |x| = 0.55. For larger |x|
    the magnitude is 1 - 2 E/(1 + E), because the first quotient would lose two bits.
    """
    magnitude = f.minimum(f.absolute(x), 20.0)  # 1 from there on
    r, exponent = _reduced(f, -2.0 * magnitude)
    scale = f.from_bits((exponent + BIAS) << EXPONENT)
    far = magnitude > 0.55
    start = f.select(far, scale, scale - 1.0)
    most = f.fma(scale, r, start)
    lost = f.fma(scale, r, start - most)
    value = most + f.fma(scale * (r * r), estrin(f, EXP, r), lost)  # E or t
    quotient = f.select(far, 2.0 * value, -value) / (value + f.select(far, 1.0, 2.0))
    return f.copysign(f.select(far, 1.0 - quotient, quotient), x)


def power(f: Function, x: Operand, y: Operand) -> Value:
    """Emit xʸ, the exponential of y ln x.

    With x = 2ᵏ (1 + u), as in `log`, ln x = k ln 2 + 2 artanh s, where s = u/(2 + u). An error of
    y ln x is a relative error of the power, so ln x is a sum of two doubles, ``high`` + ``low``.
    The C library serves all x ≤ 0, infinite and nan arguments, and powers that are not between
    e⁻⁷⁰⁰ and e⁷⁰⁰.
    """
    x, y = f.alike(x, y)
    bits = f.bits(x) - ROOT_HALF
    doublings = f.to_double(((bits + (BIAS << EXPONENT)) >> EXPONENT) - BIAS)
    u = f.from_bits((bits & ((1 << EXPONENT) - 1)) + ROOT_HALF) - 1.0
    divisor = u + 2.0
    inverse = 1.0 / divisor
    s = u * inverse
    s_low = f.fma(-s, u - (divisor - 2.0), f.fma(-s, divisor, u)) * inverse
    z = s * s
    z_low = f.fma(2.0 * s, s_low, f.fma(s, s, -z))
    cube = s * z
    cube_low = f.fma(s, z_low, f.fma(s_low, z, f.fma(s, z, -cube)))
    third = TWO_THIRDS[0] * cube
    third_low = f.fma(
        TWO_THIRDS[0], cube_low, f.fma(TWO_THIRDS[1], cube, f.fma(TWO_THIRDS[0], cube, -third))
    )
    whole = doublings * LN_2[0]
    whole_low = f.fma(doublings, LN_2[1], f.fma(doublings, LN_2[0], -whole))
    total = f.fma(s, 2.0, whole)
    low = f.fma(s_low, 2.0, third_low) + f.fma(s, 2.0, whole - total) + whole_low
    fifth, series = cube * z, estrin(f, LOG_END, z)
    rest = f.fma(fifth, series, third)
    high = total + rest
    low = low + f.fma(fifth, series, third - rest) + ((total - high) + rest)
    exponent = y * high
    usual = (x >= 2.0**-1022) & (x < math.inf) & (f.absolute(exponent) < 700.0)
    r, doublings = _reduced(f, f.select(usual, exponent, 0.0))
    r = r + f.fma(y, low, f.fma(y, high, -exponent))
    value = _exp_of_reduced(f, r) * f.from_bits((doublings + BIAS) << EXPONENT)
    result = f.variable(value)
    with f.when(f.any_lane(~usual)):
        result.set(_library_where(f, "pow", ~usual, value, x, y))
    return result.get()


def log(f: Function, x: Value) -> Value:
    """Emit the natural logarithm of x = 2ᵏ (1 + u), with √½ ≤ 1 + u < √2.

    A polynomial gives log(1 + u) = 2 artanh s, where s = u/(2 + u). The code adds the part u - u²/2
    of this logarithm last, as Sun's fdlibm does. The rest of the logarithm is small, so the
    rounding error of the rest is small too.
    """
    tiny = x < 2.0**-1022
    bits = f.bits(f.select(tiny, x * 2.0**54, x)) - ROOT_HALF
    doublings = f.to_double(((bits + (BIAS << EXPONENT)) >> EXPONENT) - BIAS)
    doublings = f.select(tiny, doublings - 54.0, doublings)
    u = f.from_bits((bits & ((1 << EXPONENT) - 1)) + ROOT_HALF) - 1.0
    s = u / (u + 2.0)
    z = s * s
    half_square = 0.5 * u * u
    rest = f.fma(s, f.fma(z, estrin(f, LOG, z), half_square), doublings * LN_2[1])
    value = f.fma(doublings, LN_2[0], u - (half_square - rest))
    value = f.select(x < math.inf, value, x)  # ∞ and nan
    value = f.select(x.equals(0.0), -math.inf, value)
    return f.select(x < 0.0, math.nan, value)
