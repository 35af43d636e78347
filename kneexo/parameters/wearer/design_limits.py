"""Limits that a designed four-bar knee must obey."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import model_validator

from kneexo.parameters.device.plant import CylinderParameters
from kneexo.parameters.fields.quantity import Parameters, choice, quantity

_ENVELOPE = "assumption: a device beside thigh and shank"


def _angle(default: float, source: str) -> Any:
    return quantity(default, "deg", source, ge=0, le=85)


def _length(default: float, source: str) -> Any:
    return quantity(default, "m", source, ge=1e-3, le=2)


class DesignLimits(Parameters):
    """Limits of the linkage that `kneexo.analysis.design_linkage` searches.

    The ground link belongs to the thigh. Places are those with the knee extended, in the frame of
    the thigh: x points backwards, y points to the hip, and the origin is that of the knee which the
    linkage follows.
    """

    grashof: Literal["any", "grashof", "double rocker", "drag link", "crank rocker"] = choice(
        "any", "assumption: no link needs to turn fully, because the knee turns by 90°"
    )
    """Class of the four-bar linkage: any, any of Grashof's, or the one of the shortest link.

    The shortest link is the coupler of a double rocker, the ground link of a drag link, and link 2
    or 4 of a crank rocker.
    """
    grashof_margin_m: float = quantity(
        0.5e-3, "m", "least margin of G1…G4, of G2 and G3", ge=0, le=1
    )
    """Least sum of the two links of middle length, minus the shortest and the longest link."""
    link_angle_deg: float = _angle(
        30.0, "assumption: sin 30° = 1/2, so that the forces in the links are at most doubled"
    )
    """Least angle between links 2 and 4 over −5…95°. The coupler is driven."""
    encoder_angle_deg: float = _angle(
        5.0, "assumption: far enough from 0°, where the encoder angle reverses"
    )
    """Least angle between the coupler and link 2 over −5…95°. The encoder measures link 4."""
    least_link_m: float = _length(5e-3, "assumption: room for two bearings")
    """Least length of a link, also of the ground link."""
    joint_box_m: float = _length(0.06, _ENVELOPE)
    """Largest |x| and |y| of the four joints between the links."""
    pin_radius_m: float = _length(0.45, _ENVELOPE)
    """Largest distance of the pins of cylinder and rod from the origin."""
    pin_offset_m: float = _length(0.15, _ENVELOPE)
    """Largest |x| of the pins of cylinder and rod."""
    cylinder_height_m: float = _length(0.02, "assumption: the cylinder is on the thigh")
    """Least y of the cylinder's pin."""
    least_arm_m: float = _length(5e-3, "assumption: far enough from the rod's dead centre")
    """Least moment arm of the rod over −5…95°."""
    largest_arm_m: float = _length(0.2, "assumption: twice the largest arm of Table 1")
    """Largest moment arm of the rod over −5…95°."""
    stroke_m: float = _length(CylinderParameters().stroke_m, "stroke of CylinderParameters")
    """Largest travel of the rod over 0…90°."""
    rod_length_m: float = _length(
        0.15, "assumption: the cylinder with the rod retracted is longer than its stroke"
    )
    """Least distance of the pins of cylinder and rod at x = 0, L_0."""
    rod_error_mm: float | None = quantity(
        None, "mm", "chosen by the user; None: the error is weighed", ge=1e-3, le=100
    )
    """Largest rms error of the rod extension over its target."""

    @model_validator(mode="after")
    def _in_order(self) -> DesignLimits:
        for low, high in (
            ("least_arm_m", "largest_arm_m"),
            ("cylinder_height_m", "pin_radius_m"),
        ):
            if not getattr(self, low) < getattr(self, high):
                raise ValueError(
                    f"{low} = {getattr(self, low):g} m must be < {high} = {getattr(self, high):g} m"
                )
        return self
