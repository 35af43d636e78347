"""Parameters of the wearer: leg, cuff between leg and exoskeleton, and biological moment."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from kneexo.common.files.reading import file_error
from kneexo.common.files.table import read_table
from kneexo.common.result import Array
from kneexo.errors import ParameterError
from kneexo.parameters.fields.fields import Words
from kneexo.parameters.fields.quantity import Parameters, choice, quantities, quantity
from kneexo.parameters.task.gait import gait_moment_cycle, gait_start_percent
from kneexo.parameters.task.reference import (
    LONGEST_TIME_S,
    TIMES_IN_MS,
    CsvTable,
    GaitReference,
    gait_reference,
    object_of_kind,
    require_samples,
    shifted,
    table_mapping,
)

MAXWELL_BANK = (
    (0.06, 1.3939),
    (0.3, 0.9620),
    (1.4142, 0.9980),
    (6.6667, 0.9620),
    (33.333, 1.3939),
)
"""Corner frequency f_i in Hz and weight κ_i of each Maxwell element of `WearerKnee`.

Assumption: geometric frequencies, with weights that keep the loss modulus h Σ κ_i f f_i/(f² + f_i²)
within 0.8 % of h over 0.1…20 Hz. The real part of the bank is the stiffness, which must
grow with frequency for a causal leg.
"""

STIFFNESS_FREQUENCY_HZ = 1.0
"""Frequency in Hz at which ``stiffness_n_m_per_rad`` of the leg holds, about that of a stride."""

BANK_STIFFNESS = sum(
    weight * STIFFNESS_FREQUENCY_HZ**2 / (STIFFNESS_FREQUENCY_HZ**2 + corner**2)
    for corner, weight in MAXWELL_BANK
)
"""Stiffness of the bank at `STIFFNESS_FREQUENCY_HZ`, relative to the loss modulus h."""

LARGEST_LOSS = 0.38
"""Largest ratio of loss modulus h to stiffness k. At larger ratios the bare spring is negative."""

LARGEST_MOMENT_N_M = 1e3
"""Largest magnitude in N·m of a moment of the knee that a file may have."""

MOMENT_MASS_KG = 75.0
"""Assumption: mass in kg of the adult of `kneexo.parameters.task.gait.gait_knee_moment`.

The file has no mass.
"""

BODIES = {"light": (50.0, 1.55), "average": (75.0, 1.75), "heavy": (110.0, 1.90)}
"""Assumption: mass in kg and height in m of three wearers."""


class MomentTable(Parameters):
    """Biological moment of the knee over time, with straight lines between the samples.

    A positive moment flexes the knee.
    """

    times_s: tuple[float, ...] = quantities(
        (), "s", "given by the user; strictly increasing", ge=-LONGEST_TIME_S, le=LONGEST_TIME_S
    )
    moments_n_m: tuple[float, ...] = quantities(
        (), "N·m", "given by the user", ge=-LARGEST_MOMENT_N_M, le=LARGEST_MOMENT_N_M
    )

    @model_validator(mode="after")
    def _consistent(self) -> MomentTable:
        require_samples(self.times_s, "moments_n_m", self.moments_n_m, 2)
        return self


class GaitMoment(GaitReference):
    """The built-in knee moment of walking, in phase with `GaitReference`; see `gait_moment`."""

    body_mass_kg: float = quantity(
        MOMENT_MASS_KG, "kg", "assumption: an adult; the moment is proportional", ge=1, le=500
    )


class CsvMoment(CsvTable):
    """A file with the biological moment of the knee, such as one of OpenSim's inverse dynamics."""

    column: str = choice(
        "knee_moment_nm", "name of the column of moments in N·m; OpenSim's knee_angle_r_moment"
    )

    def moments(self, directory: str | os.PathLike[str] = ".") -> MomentTable:
        """Read the moments from the file. A relative file path starts at ``directory``.

        Raises `ScenarioError` for a faulty file, as `CsvReference.samples` does.
        """
        path, sign = Path(directory, self.file), -1.0 if self.flexion == "negative" else 1.0
        remedy = "; give its names: moment: {file: …, time: …, column: …}"
        table = read_table(path, (self.time, self.column), remedy).without_repeats()
        table.require(self.time, -LONGEST_TIME_S, LONGEST_TIME_S, "s", TIMES_IN_MS)
        table.require(self.column, -LARGEST_MOMENT_N_M, LARGEST_MOMENT_N_M, "N·m")
        try:
            return MomentTable(
                times_s=tuple(shifted(table.columns[self.time], self.shift_s or 0.0)),
                moments_n_m=tuple(sign * moment for moment in table.columns[self.column]),
            )
        except ParameterError as error:
            raise file_error(path, None, str(error).removeprefix("MomentTable: ")) from None


@cache
def gait_moment_stride_n_m() -> Array:
    """Return the moment of one stride of `gait_moment` in N·m, (n,), without the last sample."""
    return np.roll(gait_moment_cycle()[:-1], -round(gait_start_percent()))


def gait_moment(
    frequency_hz: float = 1.0, cycles: int = 3, *, body_mass_kg: float = MOMENT_MASS_KG
) -> MomentTable:
    """Return the measured knee moment of walking, in phase with `gait_reference`.

    Parameters
    ----------
    frequency_hz, cycles
        Stride frequency in Hz and number of strides, as given to `gait_reference`.
    body_mass_kg
        Mass of the wearer in kg, to which the moment is proportional.
    """
    times = gait_reference(frequency_hz, cycles).times_s
    moments = np.resize(gait_moment_stride_n_m(), len(times)) * body_mass_kg / MOMENT_MASS_KG
    return MomentTable(times_s=times, moments_n_m=tuple(moments.tolist()))


def leg_of_body(mass_kg: float, height_m: float) -> dict[str, float]:
    """Return mass, centre of mass and inertia of leg and foot of a body, as in `LegParameters`.

    Source: Winter 2009, Table 4.1 (mass 0.061 of the body; centre of mass at 0.606 and radius of
    gyration 0.735 of the length of the leg, from the knee) and Fig. 4.1 (length 0.246 of height).
    """
    mass, length = 0.061 * mass_kg, 0.246 * height_m
    return {
        "leg_mass_kg": mass,
        "centre_of_mass_m": 0.606 * length,
        "inertia_kg_m2": mass * (0.735 * length) ** 2,
    }


def read_moment(value: Any, directory: Any) -> Any:
    """Return the table of a moment of walking or of a file. Return other values unchanged.

    ``value`` is an object, a mapping, or the path of a file of `CsvMoment`. A relative path starts
    at ``directory``. Raises `ParameterError` for a faulty file or value.
    """
    value = object_of_kind(table_mapping(value), CsvMoment, GaitMoment)
    if isinstance(value, CsvMoment):
        return value.moments(directory)
    if isinstance(value, GaitMoment):
        mass_kg = value.body_mass_kg
        return gait_moment(value.frequency_hz, value.cycles, body_mass_kg=mass_kg)
    return value


class CuffParameters(Parameters):
    """Cuff that couples the wearer's leg to the shank of the exoskeleton."""

    stiffness_n_m_per_rad: float = quantity(
        1500.0,
        "N·m/rad",
        "assumption: straps and soft tissue of 16.7 kN/m, 0.30 m from the knee",
        ge=1,
        le=1e6,
    )
    damping_n_m_s_per_rad: float = quantity(
        5.0, "N·m·s/rad", "assumption: damping of soft tissue", ge=0, le=1e4
    )
    slip_torque_n_m: float | None = quantity(
        None,
        "N·m",
        "assumption: none, the strap does not slip; 40 N·m are 133 N, 0.30 m from the knee",
        ge=0.1,
        le=1e4,
    )
    slip_damping_n_m_s_per_rad: float = quantity(
        50.0, "N·m·s/rad", "assumption: torque above slip torque per rate of slip", ge=0.1, le=1e5
    )


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


class NoWearer(Parameters):
    """No wearer: the shank of the exoskeleton moves freely, as in the paper."""

    kind: Literal["none"] = "none"


class LegParameters(Parameters):
    """Leg of a wearer below the knee: inertia, weight, stiffness, damping, motion and cuff.

    ``plant.load`` gives inclination of the thigh and gravity.
    """

    kind: Literal["leg"] = "leg"
    motion: Literal["prescribed", "active", "passive"] = choice(
        "prescribed",
        "prescribed: the leg follows the reference; active: muscles move the leg along the "
        "reference, and it yields to the cuff; passive: relaxed, from the start of the reference",
    )
    inertia_kg_m2: float = quantity(
        0.458,
        "kg·m²",
        "Winter 2009, Table 4.1: leg and foot of 75 kg and 1.75 m, about the knee",
        ge=1e-3,
        le=10,
    )
    leg_mass_kg: float = quantity(4.575, "kg", "Winter 2009, Table 4.1: leg and foot", ge=0, le=50)
    centre_of_mass_m: float = quantity(
        0.261, "m", "Winter 2009, Table 4.1: knee to centre of mass of leg and foot", ge=0, le=1
    )
    stiffness_n_m_per_rad: float = quantity(
        2.0,
        "N·m/rad",
        "arXiv 2112.05564: 0…3.5 N·m/rad in swing; k at 1 Hz",
        ge=0,
        le=1e3,
    )
    loss_modulus_n_m_per_rad: float = quantity(
        0.5,
        "N·m/rad",
        "assumption: h of hysteretic damping, measured at the elbow only (arXiv 2009.12446)",
        ge=0,
        le=380,
    )
    damping_n_m_s_per_rad: float = quantity(
        0.08, "N·m·s/rad", "arXiv 2112.05564: 0.02…0.14 N·m·s/rad in swing", ge=0, le=100
    )
    neutral_angle_rad: float = quantity(
        0.35,
        "rad",
        "assumption: 20°, where the stiffness of a passive leg has no moment",
        ge=-2,
        le=3,
    )
    effort: float = quantity(
        1.0,
        "1",
        "assumption: share of the biological moment that the muscles of an active leg give",
        ge=0,
        le=2,
    )
    moment: Annotated[
        MomentTable | None,
        Words(models=(GaitMoment, CsvMoment), others=("the path of a .csv file",)),
    ] = choice(
        None, "given by the user: biological moment, a table, gait, or the path of a CSV file"
    )
    cuff: CuffParameters = CuffParameters()

    @property
    def bare_stiffness_n_m_per_rad(self) -> float:
        """Stiffness at frequency zero, k_0 = k − 2.627 h, in N·m/rad."""
        return self.stiffness_n_m_per_rad - BANK_STIFFNESS * self.loss_modulus_n_m_per_rad

    @field_validator("moment", mode="before")
    @classmethod
    def _read_moment(cls, moment: Any, info: ValidationInfo) -> Any:
        return read_moment(moment, (info.context or {}).get("directory", "."))

    @model_validator(mode="after")
    def _is_passive(self) -> LegParameters:
        largest = LARGEST_LOSS * self.stiffness_n_m_per_rad
        if self.loss_modulus_n_m_per_rad > largest:
            raise ValueError(
                f"loss_modulus_n_m_per_rad = {self.loss_modulus_n_m_per_rad:g} N·m/rad: must be at "
                f"most {LARGEST_LOSS:g} times stiffness_n_m_per_rad = "
                f"{self.stiffness_n_m_per_rad:g} N·m/rad, because the leg would create energy; "
                f"reduce it, or take damping_n_m_s_per_rad"
            )
        return self


Wearer = Annotated[NoWearer | LegParameters, Field(discriminator="kind")]
"""Type of a scenario's wearer. The field ``kind`` selects the class."""


WEARERS = {
    "relaxed": LegParameters(
        motion="active",
        stiffness_n_m_per_rad=0.0,
        loss_modulus_n_m_per_rad=0.0,
        damping_n_m_s_per_rad=0.02,
    ),
    "light": LegParameters(
        motion="active", inertia_kg_m2=0.15, leg_mass_kg=2.5, centre_of_mass_m=0.18
    ),
    "swing": LegParameters(motion="active"),
    "tense": LegParameters(
        motion="active",
        stiffness_n_m_per_rad=14.0,
        loss_modulus_n_m_per_rad=4.0,
        damping_n_m_s_per_rad=0.5,
    ),
    "stance": LegParameters(
        motion="active",
        stiffness_n_m_per_rad=286.0,
        loss_modulus_n_m_per_rad=60.0,
        damping_n_m_s_per_rad=5.0,
    ),
    "held": LegParameters(motion="prescribed"),
}
"""Legs from soft to stiff, as cases for the stability of a loop.

Sources: PMC2801882 reports 6…14 N·m/rad in swing and 143…286 N·m/rad in stance. arXiv 2112.05564
reports 0…3.5 N·m/rad in swing, the source of the default. Assumptions: the losses of a tense leg
and of a leg in stance, and a light leg with a third of an adult's inertia.
"""
