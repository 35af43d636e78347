"""Presets: scenarios by name, from the idealized knee of the paper to a knee with a wearer.

A preset consists of the values that differ from the defaults of `kneexo.parameters.Scenario`. It
names only the kind of a part. The numbers of the part are its defaults, with their provenance. A
scenario file can choose another kind. The only number in a preset is `SEAL_FRICTION_N`.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from kneexo.errors import ParameterError, close_names, question, shortened
from kneexo.parameters.device.plant import SEAL_FRICTION_N


@dataclass(frozen=True)
class Preset:
    """A scenario that has a name."""

    summary: str
    """What the scenario has, in one phrase."""
    values: Mapping[str, Any]
    """The values that differ from the defaults, as in a scenario file."""


_WEIGHT = {"kind": "knee"}
_DRIVE = {"kind": "cia402"}
_LEG_PLANT = {"load": _WEIGHT, "full_order": {"coulomb_friction_n": SEAL_FRICTION_N}}
_LEG = {"plant": _LEG_PLANT, "bus": _DRIVE}
_SOUND_TORQUE = {
    "kind": "torque",
    "proportional_rad_s_per_n": 3.0,
    "integral_rad_s2_per_n": 10.0,
    "speed_feedforward": 0.3,
}
"""Torque control with lower gains than the default, because the bus delays the loop.

From 5 to 70° the disk margin is at least 0.5, which is sound. With the default gains it is 0.27.
"""

PRESETS: Mapping[str, Preset] = {
    "paper": Preset(
        "the paper's simulation: reduced order of the cylinder, no gravity, no bus",
        {},
    ),
    "bench": Preset(
        "the paper's knee with the weight of the shank, and its drive on the CAN bus",
        {"plant": {"load": _WEIGHT}, "bus": _DRIVE},
    ),
    "leg": Preset(
        "bench, and the full order of the cylinder: chambers, valves, friction of the seals",
        _LEG,
    ),
    "wearer": Preset(
        "leg, and the leg of a wearer in a cuff; torque control that keeps the rod free of force",
        {**_LEG, "wearer": {"kind": "leg"}, "controller": _SOUND_TORQUE},
    ),
    "protected": Preset(
        "leg, limits of motor torque and supply, end stops, and protection against faults",
        {
            **_LEG,
            "plant": {**_LEG_PLANT, "motor": {}, "end_stops": {}},
            "protection": {"safe_state": "dynamic_brake"},
        },
    ),
}
"""The presets by name. Each one contains the one before it, but ``protected`` has no wearer."""


def with_preset(name: Any, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a preset, overridden by ``data``, as in a scenario file.

    A mapping in ``data`` changes only the values that it contains, and leaves the others to the
    preset. Raises `ParameterError` if there is no preset of this name.
    """
    if not isinstance(name, str) or name not in PRESETS:
        hint = question(close_names(str(name), PRESETS, most=1))
        *others, last = PRESETS
        raise ParameterError(
            f"preset = {shortened(str(name))!r}: must be {', '.join(others)} or {last}{hint}"
        )
    return _overridden(PRESETS[name].values, data)


def _overridden(base: Mapping[str, Any], data: Mapping[str, Any]) -> dict[str, Any]:
    result = deepcopy(dict(base))
    for name, value in data.items():
        below = result.get(name)
        if isinstance(value, dict) and isinstance(below, dict):
            result[name] = _overridden(below, value)
        elif isinstance(below, dict) and (
            value is True or (isinstance(value, str) and value == below.get("kind"))
        ):
            continue  # the word for what the preset has
        else:
            result[name] = value
    return result
