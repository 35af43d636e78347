"""Finds the unit at the end of a name, such as rad/s for ``motor_speed_rad_s``."""

from __future__ import annotations

import math
from dataclasses import dataclass

BASE_UNITS = ("kg", "m", "s", "rad")
"""Base units of all units in this module, in the order of the field ``exponents`` of `Unit`."""


@dataclass(frozen=True)
class Unit:
    """A unit: its name in the notation of Modelica, exponents of `BASE_UNITS`, and factor to SI."""

    name: str
    exponents: tuple[int, int, int, int]
    factor: float = 1.0


_BY_ENDING = {
    "s": Unit("s", (0, 0, 1, 0)),
    "per_s": Unit("1/s", (0, 0, -1, 0)),
    "per_s2": Unit("1/s2", (0, 0, -2, 0)),
    "hz": Unit("Hz", (0, 0, -1, 0)),
    "rad": Unit("rad", (0, 0, 0, 1)),
    "rad_s": Unit("rad/s", (0, 0, -1, 1)),
    "rad_s2": Unit("rad/s2", (0, 0, -2, 1)),
    "rad_s3": Unit("rad/s3", (0, 0, -3, 1)),
    "rad_s_per_n": Unit("rad/(s.N)", (-1, -1, 1, 1)),
    "rad_s2_per_n": Unit("rad/(s2.N)", (-1, -1, 0, 1)),
    "deg": Unit("deg", (0, 0, 0, 1), math.pi / 180.0),
    "deg_s": Unit("deg/s", (0, 0, -1, 1), math.pi / 180.0),
    "m": Unit("m", (0, 1, 0, 0)),
    "m2": Unit("m2", (0, 2, 0, 0)),
    "m3": Unit("m3", (0, 3, 0, 0)),
    "m_s": Unit("m/s", (0, 1, -1, 0)),
    "m_s2": Unit("m/s2", (0, 1, -2, 0)),
    "m_s3": Unit("m/s3", (0, 1, -3, 0)),
    "m3_s": Unit("m3/s", (0, 3, -1, 0)),
    "m3_per_rad": Unit("m3/rad", (0, 3, 0, -1)),
    "m3_per_s_pa": Unit("m3/(s.Pa)", (-1, 4, 1, 0)),
    "kg": Unit("kg", (1, 0, 0, 0)),
    "kg_m2": Unit("kg.m2", (1, 2, 0, 0)),
    "n": Unit("N", (1, 1, -2, 0)),
    "n_m": Unit("N.m", (1, 2, -2, 0)),
    "n_m_per_rad": Unit("N.m/rad", (1, 2, -2, -1)),
    "n_m_s_per_rad": Unit("N.m.s/rad", (1, 2, -1, -1)),
    "n_per_m": Unit("N/m", (1, 0, -2, 0)),
    "n_per_s": Unit("N/s", (1, 1, -3, 0)),
    "n_s_per_m": Unit("N.s/m", (1, 0, -1, 0)),
    "pa": Unit("Pa", (1, -1, -2, 0)),
    "w": Unit("W", (1, 2, -3, 0)),
}


def unit_of_name(name: str) -> Unit | None:
    """Return the longest unit with which a name ends, or None if the name ends with no unit."""
    # The longest ending: by the last word alone, a stiffness in N·m/rad would be in rad.
    words = name.rpartition(".")[2].split("_")
    endings = ("_".join(words[first:]) for first in range(1, len(words)))
    return next((_BY_ENDING[ending] for ending in endings if ending in _BY_ENDING), None)
