"""Parameters of the strap that holds the wearer's shank, for the forces of misalignment."""

from __future__ import annotations

from kneexo.parameters.fields.quantity import Parameters, quantity
from kneexo.parameters.wearer.wearer import CuffParameters


class StrapParameters(Parameters):
    """Place of the cuff on the shank, and stiffness and friction of its strap.

    `CuffParameters` has the rotational stiffness about the knee, with which a run is simulated.
    """

    distance_m: float = quantity(
        0.20, "m", "assumption: the cuff is on the calf, below the tibia's origin", ge=0.01, le=1
    )
    normal_stiffness_n_per_m: float = quantity(
        CuffParameters().stiffness_n_m_per_rad / 0.30**2,
        "N/m",
        "assumption: stiffness of CuffParameters, whose strap is 0.30 m from the knee",
        ge=1,
        le=1e7,
    )
    shear_stiffness_n_per_m: float = quantity(
        5000.0,
        "N/m",
        "assumption: soft tissue is softer in shear; no source was found",
        ge=1,
        le=1e7,
    )
    friction: float = quantity(
        0.5, "1", "assumption: textile on skin; no source was found", ge=0, le=5
    )
    preload_n: float = quantity(
        60.0, "N", "assumption: sum of a strap's pressure on the calf", ge=0, le=5000
    )
