"""Motion of an anatomical knee in the sagittal plane, as numbers of the literature."""

from __future__ import annotations

from typing import Any

from pydantic import model_validator

from kneexo.parameters.quantity import Parameters, quantities, quantity, require_increasing

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
    angles = tuple(angle for angle, _ in nodes)
    return quantities(angles, "rad", _GAIT2392, ge=-3.2, le=3.2, min_length=3)


def _places(nodes: tuple[tuple[float, float], ...]) -> Any:
    places = tuple(place for _, place in nodes)
    return quantities(places, "m", _GAIT2392, ge=-1, le=1, min_length=3)


class AnatomicalKneeParameters(Parameters):
    """Position of the tibia's origin in the frame of the femur, over the flexion.

    Natural cubic splines join the nodes. Flexion is positive; the files of OpenSim have the other
    sign. The defaults are one knee of one model, gait2392. Other knees move their instantaneous
    centres by as much as this knee does, so that a conclusion needs more than one knee.
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
