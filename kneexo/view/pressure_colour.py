"""The leaf system that colours a part in Meshcat by a pressure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import EventStatus, LeafSystem

from kneexo.common.result import Array
from kneexo.errors import ParameterError

BLUE, GREY, RED = np.array([0.1, 0.3, 0.9]), np.array([0.85] * 3), np.array([0.9, 0.15, 0.1])
"""Red, green and blue from 0 to 1 at the largest negative pressure, at none, at the largest."""


def pressure_colours(pressure_pa: Array, largest_pa: float) -> Array:
    """Return red, green and blue from 0 to 1, (n, 3), for pressures (n,) in Pa.

    The colour is blue at −``largest_pa`` and below, grey at 0, and red at ``largest_pa`` and above.
    Between these pressures the colour is interpolated linearly.
    """
    share = np.clip(pressure_pa / (largest_pa or 1.0), -1.0, 1.0)[:, None]
    return np.asarray(GREY + np.abs(share) * (np.where(share > 0.0, RED, BLUE) - GREY))


class PressureColour(LeafSystem):
    """Colours a part in Meshcat by a pressure, from blue at −p_max to red (`pressure_colours`).

    ===============  ====  ====  ===============================
    input port       size  unit
    ===============  ====  ====  ===============================
    load_pressure    1     Pa    P_L, positive pushes the rod out
    ===============  ====  ====  ===============================

    No state and no scalar conversion. A geometry of SceneGraph has a constant colour, so the system
    sets the colour in Meshcat. The first update is at 0 s, and each later update follows after
    ``period_s``. Recordings have the colour too. Add the system after the `MeshcatVisualizer`,
    which creates the geometry in Meshcat.

    Parameters
    ----------
    meshcat
        The Meshcat that shows the part.
    path
        Path of the part's geometry in Meshcat.
    largest_pressure_pa
        p_max in Pa, the pressure at which the part is red.
    period_s
        Time in s between two updates of the colour.

    Raises `ParameterError` if ``largest_pressure_pa`` or ``period_s`` is not finite and positive.
    """

    def __init__(
        self, meshcat: Meshcat, path: str, largest_pressure_pa: float, period_s: float
    ) -> None:
        super().__init__()
        for name, value, unit in (
            ("largest_pressure_pa", largest_pressure_pa, "Pa"),
            ("period_s", period_s, "s"),
        ):
            if not (math.isfinite(value) and value > 0.0):
                raise ParameterError(f"{name} = {value:g} {unit}: must be finite and positive")
        self._meshcat, self._path = meshcat, f"{path}/<object>"
        self._largest_pa = float(largest_pressure_pa)
        self._pressure = self.DeclareVectorInputPort("load_pressure", 1)
        self.DeclarePeriodicPublishEvent(period_s, 0.0, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _publish(self, context: Any) -> EventStatus:
        (colour,) = pressure_colours(self._pressure.Eval(context), self._largest_pa).tolist()
        for channel, value in zip("rgb", colour, strict=True):
            # Meshcat's own property "color" does not move in a recording.
            name = f"material.color[{channel}]"
            self._meshcat.SetProperty(self._path, name, value, context.get_time())
        return EventStatus.Succeeded()
