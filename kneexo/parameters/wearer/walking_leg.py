"""Lengths, load and swing of a leg that walks, for a linkage that would be its knee."""

from __future__ import annotations

from pydantic import field_validator

from kneexo.parameters.fields.quantity import Parameters, quantities, quantity, require_increasing

_CONTACT = "assumption: along the foot, which is at a right angle to the shank"
_THIGH = (
    "assumption: flexion of the thigh from the vertical at the ends of the phases of swing, about "
    "as in Perry and Burnfield, Gait Analysis, 2010; straight lines between"
)

_STRENGTH = (
    "Anderson et al., J. Biomechanics 40, 2007, Table 3, men of 18-25 years: share of weight times "
    "height, 736 N by 1.75 m, in the hip's flexion θ in rad;"
)


class WalkingLegParameters(Parameters):
    """Leg from the hip to the foot, whose ankle does not move, and the load on it in stance."""

    thigh_m: float = quantity(
        0.42,
        "m",
        "assumption: hip above the knee's origin; Winter 2009, Fig. 4.1, has 0.245 of the height, "
        "0.429 m of 1.75 m",
        ge=0.1,
        le=1,
    )
    shank_m: float = quantity(
        0.40,
        "m",
        "assumption: ankle below the knee's origin; Winter 2009, Fig. 4.1, has 0.246 of the "
        "height, 0.431 m of 1.75 m",
        ge=0.1,
        le=1,
    )
    ankle_height_m: float = quantity(
        0.068, "m", "Winter 2009, Fig. 4.1: 0.039 of the height, of 1.75 m", ge=0, le=0.3
    )
    heel_m: float = quantity(0.05, "m", f"{_CONTACT}: heel behind the ankle", ge=0, le=0.3)
    forefoot_m: float = quantity(
        0.14, "m", f"{_CONTACT}: ball of the foot in front of the ankle", ge=0, le=0.4
    )
    toe_m: float = quantity(
        0.216,
        "m",
        f"{_CONTACT}: in front of the ankle, 0.152 of 1.75 m (Winter 2009, Fig. 4.1) less heel",
        ge=0,
        le=0.5,
    )
    load_n: float = quantity(
        736.0,
        "N",
        "assumption: weight of 75 kg, force of the ground along the line from contact to hip",
        ge=0,
        le=1e4,
    )
    knee_moment_n_m: float = quantity(
        0.0,
        "N·m",
        "assumption: knee muscles are absent; positive extends the knee",
        ge=-1e3,
        le=1e3,
    )
    hip_extension_n_m: float = quantity(
        176.0,
        "N·m",
        f"{_STRENGTH} 0.161 cos(0.958 (θ - 0.932)) at θ = 20°, as at heel contact",
        ge=0,
        le=1e3,
    )
    """Largest extension moment of the hip at heel contact."""
    hip_flexion_n_m: float = quantity(
        145.0,
        "N·m",
        f"{_STRENGTH} 0.113 cos(0.738 (θ + 0.214)) at θ = -10°, as at push-off",
        ge=0,
        le=1e3,
    )
    """Largest flexion moment of the hip at push-off."""
    swing_percent: tuple[float, float, float, float] = quantities(
        (62.0, 75.0, 87.0, 100.0), "%", _THIGH, ge=0, le=100, min_length=None
    )
    """Times of the thigh's angles after heel contact, from toe-off to the next heel contact."""
    thigh_flexion_deg: tuple[float, float, float, float] = quantities(
        (-10.0, 15.0, 25.0, 20.0), "deg", _THIGH, ge=-90, le=120, min_length=None
    )

    _increasing = field_validator("swing_percent")(require_increasing)
