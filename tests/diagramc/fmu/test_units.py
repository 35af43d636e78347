"""Units by names, against an own reading of the units' symbols."""

import math
import re

import numpy as np
import pytest

from diagramc.fmu.units import BASE_UNITS, unit_of_name

ENDINGS = (
    *("s", "per_s", "per_s2", "hz", "rad", "rad_s", "rad_s2", "rad_s3", "deg", "m", "m2", "m3"),
    *("m_s", "m_s2", "m_s3", "m3_s", "m3_per_rad", "m3_per_s_pa", "kg", "n", "n_m", "n_per_m"),
    *("n_per_s", "n_s_per_m", "pa", "w", "deg_s", "kg_m2", "n_m_per_rad", "n_m_s_per_rad"),
)
GAINS = ("rad_s_per_n", "rad_s2_per_n")  # a speed or an acceleration per force

_SYMBOLS = {
    "kg": (1, 0, 0, 0),
    "m": (0, 1, 0, 0),
    "s": (0, 0, 1, 0),
    "rad": (0, 0, 0, 1),
    "deg": (0, 0, 0, 1),
    "Hz": (0, 0, -1, 0),
    "N": (1, 1, -2, 0),
    "Pa": (1, -1, -2, 0),
    "W": (1, 2, -3, 0),
    "1": (0, 0, 0, 0),
}


def _product(text):
    factors = re.findall(r"([A-Za-z]+|1)(\d*)", text)
    return sum(np.array(_SYMBOLS[symbol]) * int(power or 1) for symbol, power in factors)


def exponents(symbol):
    """Of a unit such as m3/(s.Pa)."""
    above, _, below = symbol.partition("/")
    return tuple(_product(above) - (_product(below) if below else 0))


def test_each_unit_has_the_dimension_of_its_symbol():
    assert BASE_UNITS == ("kg", "m", "s", "rad")
    for ending in (*ENDINGS, *GAINS):
        unit = unit_of_name(f"x_{ending}")
        assert unit.exponents == exponents(unit.name), ending
        assert unit.factor == (math.pi / 180.0 if unit.name.startswith("deg") else 1.0)


@pytest.mark.parametrize("ending", ENDINGS)
def test_each_ending_spells_its_symbol(ending):
    """``n_s_per_m`` is N.s/m; without "per" only seconds divide, but those that stand alone."""
    above, per, below = ending.partition("per_")
    words = [word for word in above.split("_") if word]
    if not per and len(words) > 1:
        words, below = words[:-1] if re.match(r"s\d?$", words[-1]) else words, ""
        if re.match(r"s\d?$", ending.split("_")[-1]):
            below = ending.split("_")[-1]
    symbol = {"n": "N", "pa": "Pa", "w": "W", "hz": "Hz"}

    def spelt(parts):
        texts = []
        for word in parts:
            base, power = re.fullmatch(r"([a-z]+)(\d?)", word).groups()
            texts.append(symbol.get(base, base) + power)
        return ".".join(texts)

    under = [word for word in below.split("_") if word]
    expected = spelt(words) or "1"
    if under:
        expected += f"/({spelt(under)})" if len(under) > 1 else f"/{spelt(under)}"
    assert unit_of_name(f"x_{ending}").name == expected


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("knee.a_3_m", "m"),
        ("controller.proportional_rad_s_per_n", "rad/(s.N)"),
        ("controller.integral_rad_s2_per_n", "rad/(s2.N)"),
    ],
)
def test_longest_ending_counts(name, unit):
    assert unit_of_name(name).name == unit


@pytest.mark.parametrize("name", ["plant.pump.gear_ratio", "knee.group_1[3]", "law.p_1", "m", "s"])
def test_names_without_unit(name):
    assert unit_of_name(name) is None
