"""Values of a scenario that are not known exactly."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import Field, model_validator

from kneexo.parameters.plant import KneeLoadParameters, PlantParameters
from kneexo.parameters.quantity import Parameters
from kneexo.parameters.scenario import Scenario


class Uncertainty(Parameters):
    """What one value of a scenario may be: an interval ``low`` … ``high``, or one of ``options``.

    ``scale`` log draws the logarithm uniformly (values known by their order of magnitude). With
    ``known`` the controller knows the value: its nominal plant changes too.
    """

    low: float | None = None
    high: float | None = None
    scale: Literal["linear", "log"] = "linear"
    options: tuple[Any, ...] = ()
    known: bool = False
    source: str = "given by the user"

    @model_validator(mode="after")
    def _one_kind(self) -> Uncertainty:
        interval = self.low is not None and self.high is not None
        if interval == bool(self.options) or (self.options and self.low != self.high):
            raise ValueError("must have either low and high, or options")
        if self.low is not None and self.high is not None:
            if not self.low < self.high:
                raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
            if self.scale == "log" and self.low <= 0.0:
                raise ValueError(f"low = {self.low:g} must be > 0 with scale: log")
        return self

    @property
    def levels(self) -> tuple[Any, ...]:
        """The ends of the interval, or the options."""
        return self.options or (self.low, self.high)

    def at(self, share: float) -> Any:
        """The value at ``share`` of the interval (0 … 1), or the option that holds that share."""
        if self.low is None or self.high is None:
            return self.options[min(int(share * len(self.options)), len(self.options) - 1)]
        if share in (0.0, 1.0):
            return (self.low, self.high)[int(share)]
        if self.scale == "log":
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)


class UncertaintySet(Parameters):
    """Uncertain values of a scenario, by dotted path (``plant.cylinder.mass_kg``)."""

    values: dict[str, Uncertainty] = Field(min_length=1)

    def __repr__(self) -> str:
        """How many values are uncertain."""
        return f"UncertaintySet({len(self.values)} values)"


UNCERTAINTY = UncertaintySet(
    values={
        "plant.cylinder.mass_kg": Uncertainty(low=1.4, high=1.8, source="Table 2"),
        "plant.cylinder.bulk_modulus_pa": Uncertainty(
            low=0.2e9, high=17_200e5, scale="log", source="assumption: entrained air; Table 2"
        ),
        "plant.pump.internal_leakage_m3_per_s_pa": Uncertainty(
            low=2e-14, high=2e-12, scale="log", source="assumption: a decade about the default"
        ),
        "plant.cylinder.damping_n_s_per_m": Uncertainty(
            low=0.05, high=1000.0, source="Table 2; assumption: 40 N of seal friction at 40 mm/s"
        ),
        "plant.cylinder.bore_m": Uncertainty(
            low=19.95e-3, high=20.05e-3, source="assumption: 0.5 % of the piston areas"
        ),
        "plant.load.segment_mass_kg": Uncertainty(
            low=0.0, high=3.2, source="assumption: from no weight to twice that of Table 3"
        ),
        "plant.load.knee_torque_n_m": Uncertainty(
            low=-5.0, high=5.0, source="assumption: a wearer who helps or resists a little"
        ),
        "plant.pump.lag_s": Uncertainty(
            low=0.005, high=0.020, scale="log", source="assumption: half and twice the default"
        ),
        "plant.pump.acceleration_limit_rad_s2": Uncertainty(
            low=2e3, high=1e4, scale="log", source="assumption: as in the trials of Fig. 13"
        ),
        "encoder.mounting_error_rad": Uncertainty(
            low=-2.0 * math.pi / 4096, high=2.0 * math.pi / 4096, source="assumption: one count"
        ),
        "can_delay_samples": Uncertainty(
            options=(0, 1, 2), source="assumption: latency of the CAN bus"
        ),
        "plant.linkage": Uncertainty(
            options=("G1", "G2", "G3"), known=True, source="three geometries reproduce Table 1"
        ),
        "plant.full_order": Uncertainty(
            options=(None, {}, {"coulomb_friction_n": 40.0}),
            source="the reduction of Eq. 14 to Eq. 15; assumption: 40 N of seal friction",
        ),
    }
)
"""Default uncertainty of ``kneexo robustness`` and ``kneexo study contest``."""

UNCERTAIN_KNEE = Scenario(plant=PlantParameters(load=KneeLoadParameters()))
"""The paper's setup under the weight of the shank: what `UNCERTAINTY` varies."""
