"""Names and units of the continuous states of the leaf systems."""

from __future__ import annotations

from typing import NamedTuple


class StateVariable(NamedTuple):
    """A continuous state of a leaf system: its column in a run and its unit in the Context."""

    column: str
    """Name of the quantity with its unit, such as ``motor_speed_rad_s``."""
    factor: float = 1.0
    """Value in the unit of the column, divided by the value in the Context."""
