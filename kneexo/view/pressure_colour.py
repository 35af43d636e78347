"""Colour of a part in Meshcat by a pressure."""

from __future__ import annotations

import math
from typing import Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import EventStatus, LeafSystem

from kneexo.errors import ParameterError
from kneexo.view.mechanism import pressure_colours


class PressureColour(LeafSystem):
    """Colour of a part in Meshcat by a pressure: blue at −p_max, grey at 0, red at p_max.

    Beyond p_max the colour stays (`pressure_colours`).

    ===============  ====  ====  ===============================
    input port       size  unit
    ===============  ====  ====  ===============================
    load_pressure    1     Pa    P_L, positive pushes the rod out
    ===============  ====  ====  ===============================

    Stateless. Publishes every ``period_s`` from 0 s on, in a recording too. SceneGraph's geometry
    has one colour only, so this writes the property of Meshcat. The part must have its geometry
    first: add this system behind the `MeshcatVisualizer`.

    It has no scalar conversion, and needs none: nothing depends on a picture.

    Parameters
    ----------
    meshcat
        Where the part is.
    path
        Of the part's geometry in Meshcat.
    largest_pressure_pa
        p_max in Pa.
    period_s
        Period in s.

    Raises `ParameterError` unless pressure and period are finite and positive.
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
