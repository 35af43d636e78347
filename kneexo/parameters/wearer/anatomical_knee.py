"""Motion of an anatomical knee in the sagittal plane: a knee of the literature, or of a file."""

from __future__ import annotations

import os
import re
import warnings
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, model_validator

from kneexo.common.files.reading import file_error, read_text
from kneexo.common.files.table import MOST_BYTES_OF_TABLE, SUFFIXES, read_table
from kneexo.common.result import Array
from kneexo.errors import ParameterError, shown
from kneexo.parameters.fields.fields import Words
from kneexo.parameters.fields.quantity import Parameters, quantities, quantity, require_increasing

_GAIT2392 = (
    "OpenSim model gait2392 by S. L. Delp et al., CC BY 3.0; planar knee of Yamaguchi and Zajac, "
    "J. Biomechanics 22, 1989"
)
_ANTERIOR = (
    *((-2.0944, -0.00525), (-1.52146, -0.005435), (-0.490178, -0.005574), (-0.337395, -0.005435)),
    *((-0.197344, -0.005227), (0.174533, -0.0031), (0.349066, -0.001), (0.698132, 0.00212)),
    *((1.0472, 0.0041), (1.39626, 0.00411), (1.74533, 0.00179), (2.0944, -0.0032)),
)
"""Nodes of gait2392's knee: flexion in rad, and place of the tibia's origin in m, forwards."""

_UP = (
    *((-2.0944, -0.396), (-0.159149, -0.395264), (0.174533, -0.3966), (0.349066, -0.3976)),
    *((0.523599, -0.399), (1.22173, -0.4082), (2.0944, -0.4226)),
)
"""Nodes of gait2392's knee: flexion in rad, and place of the tibia's origin in m, upwards."""


def _angles(nodes: tuple[tuple[float, float], ...]) -> Any:
    # 3.2 rad is just above half a turn. So angles in degrees are refused.
    angles = tuple(angle for angle, _ in nodes)
    return quantities(angles, "rad", _GAIT2392, ge=-3.2, le=3.2, min_length=3)


def _places(nodes: tuple[tuple[float, float], ...]) -> Any:
    places = tuple(place for _, place in nodes)
    return quantities(places, "m", _GAIT2392, ge=-1, le=1, min_length=3)


class AnatomicalKneeParameters(Parameters):
    """Position of the tibia's origin in the frame of the femur, over the flexion.

    Natural cubic splines join the nodes. Flexion is positive; the files of OpenSim have the other
    sign. The defaults are one knee of one model, gait2392. The instantaneous centres of other knees
    move about as far. Test a conclusion on several knees.
    """

    anterior_angles_rad: tuple[float, ...] = _angles(_ANTERIOR)
    anterior_m: tuple[float, ...] = _places(_ANTERIOR)
    """Position in front of the femur's origin, the hip joint's centre."""
    up_angles_rad: tuple[float, ...] = _angles(_UP)
    up_m: tuple[float, ...] = _places(_UP)
    """Position above the femur's origin, so that the values of a leg are negative."""
    size: float = quantity(
        1.0,
        "1",
        "assumption: size of the wearer's knee, relative to the knee of the nodes",
        ge=0.3,
        le=3,
    )

    @model_validator(mode="after")
    def _consistent(self) -> AnatomicalKneeParameters:
        for angles, values in (("anterior_angles_rad", "anterior_m"), ("up_angles_rad", "up_m")):
            nodes, count = getattr(self, angles), len(getattr(self, values))
            if len(nodes) != count:
                raise ValueError(f"{angles} has {len(nodes)} values and {values} has {count}")
            try:
                require_increasing(nodes)
            except ValueError as error:
                raise ValueError(f"{angles}: {error}") from None
            if not nodes[0] <= 0.0 < nodes[-1]:
                raise ValueError(
                    f"{angles} = {nodes[0]:g} … {nodes[-1]:g} rad: must have full extension, "
                    f"0 rad, and flexion, which is positive"
                )
        return self

    @property
    def range_rad(self) -> tuple[float, float]:
        """Least and largest flexion in rad at which both splines have nodes."""
        both = self.anterior_angles_rad, self.up_angles_rad
        return max(nodes[0] for nodes in both), min(nodes[-1] for nodes in both)


GAIT2392 = AnatomicalKneeParameters()
"""The planar knee of OpenSim's model gait2392."""

LARGEST_PLACE_MM = 1000.0
"""Largest distance in mm of a place in the file of a knee from the origin, along each axis."""


SHORTEST_PATH_MM = 5.0
"""Assumption: change in mm of a place or centre below which a file may have another unit.

That of gait2392 is 28 mm.
"""


def read_anatomical_knee(path: str | os.PathLike[str]) -> AnatomicalKneeParameters:
    """Read a knee from a file with a row for each flexion.

    The file is read by `kneexo.common.files.table.read_table`.

    The columns are ``knee_flexion_deg`` and either ``anterior_mm`` and ``up_mm``, the place of the
    tibia's origin, or ``icr_anterior_mm`` and ``icr_up_mm``, the instantaneous centre of rotation.
    A centre is relative to the tibia's origin at full extension.

    Raises `ScenarioError` for a faulty file, for angles that do not increase, have the sign of
    OpenSim or are in rad, and for places more than 1 m away.
    """
    text = read_text(path, MOST_BYTES_OF_TABLE)
    centres = "icr_anterior_mm" in text
    if centres and re.search(r"\b(anterior|up)_mm", text):
        message = "has places and centres of rotation: must have one of both; remove two columns"
        raise file_error(path, None, message)
    names = ("icr_anterior_mm", "icr_up_mm") if centres else ("anterior_mm", "up_mm")
    table = read_table(path, ("knee_flexion_deg", *names), "; rename its columns")
    table.require("knee_flexion_deg", -60.0, 180.0, "deg")
    table.require_increase("knee_flexion_deg", 0.01, "deg")
    for name in names:
        table.require(name, -LARGEST_PLACE_MM, LARGEST_PLACE_MM, "mm")
    angles_deg = table.columns["knee_flexion_deg"]
    if len(angles_deg) < 3:
        raise file_error(path, None, f"has {len(angles_deg)} rows of numbers: must have at least 3")
    if not angles_deg[-1] >= 10.0:
        message = (
            f"knee_flexion_deg ends at {angles_deg[-1]:g} deg: must reach 10 deg; flexion is "
            f"positive and in deg"
        )
        raise file_error(path, table.lines[-1], message)
    span_mm = max(np.ptp(table.columns[name]) for name in names)
    if 0.0 < span_mm < SHORTEST_PATH_MM:  # the place of a hinge may not move at all
        warnings.warn(
            f"{shown(os.fspath(path))}: {' and '.join(names)} change by {span_mm:.2g} mm at most; "
            f"are they in cm?",
            stacklevel=2,
        )
    angles = np.radians(angles_deg)
    forwards, up = (1e-3 * np.array(table.columns[name]) for name in names)
    if centres:
        forwards, up = _place_of_centres(angles, forwards, up)
    nodes = tuple(angles.tolist())
    try:
        return AnatomicalKneeParameters(
            anterior_angles_rad=nodes,
            anterior_m=tuple(forwards.tolist()),
            up_angles_rad=nodes,
            up_m=tuple(up.tolist()),
        )
    except ParameterError as error:
        message = str(error).removeprefix("AnatomicalKneeParameters: ")
        raise file_error(path, None, message) from None


def _place_of_centres(angles: Array, forwards: Array, up: Array) -> tuple[Array, Array]:
    """Return the place of the tibia's origin, forwards and up in m, for the centres of rotation.

    With x backwards the place t follows from the centre c by dt/dθ = j(t − c), see
    `kneexo.geometry.shank_motion`. The solution is t = −j e^{jθ} ∫ c e^{−jθ} dθ, and t is 0 at
    θ = 0.
    """
    from scipy.interpolate import CubicSpline

    turn = np.exp(1j * angles)
    integral = CubicSpline(angles, (up * 1j - forwards) / turn).antiderivative()
    place = -1j * turn * (integral(angles) - integral(0.0))
    return -place.real, place.imag


def _read(value: Any) -> Any:
    """Return the knee of a file. Return a value that is no path of a table unchanged."""
    is_path = isinstance(value, str) and value.endswith(SUFFIXES)
    return read_anatomical_knee(value) if is_path else value


KneeChoice = Annotated[
    AnatomicalKneeParameters,
    BeforeValidator(_read),
    Words({"gait2392": GAIT2392}, others=("the path of a .csv file",)),
]
"""Type of the knee in the settings of a study, which can be a word or the path of a file."""
