"""Settings of the study `controller`."""

from __future__ import annotations

from pydantic import field_validator, model_validator

from kneexo.parameters.criteria import SOUND_DISK_MARGIN
from kneexo.parameters.fields.quantity import (
    Parameters,
    positive_values,
    quantity,
    require_increasing,
)


class ControllerSettings(Parameters):
    """Settings of ``kneexo study controller``: the grid over λ, Φ and η, and the simulated runs."""

    lambdas_per_s: tuple[float, ...] = positive_values(
        (5.0, 7.1, 10.0, 14.1, 20.0, 28.3, 40.0, 56.6, 80.0),
        "1/s",
        "assumption: the default times powers of √2",
    )
    phis_m_s2: tuple[float, ...] = positive_values(
        (0.32, 0.57, 1.0, 1.8, 3.2, 5.7, 10.0, 18.0, 32.0, 57.0, 100.0),
        "m/s²",
        "assumption: the default times powers of 10^(1/4)",
    )
    etas_m_s3: tuple[float, ...] = positive_values(
        (8.9e3, 2.8e4, 8.9e4, 2.8e5, 8.9e5, 2.8e6),
        "m/s³",
        "assumption: the default times powers of √10",
    )
    step_deg: float = quantity(
        2.0,
        "deg",
        "assumption: twenty counts of the encoder, and within the speed limit up to λ = 60 1/s",
        ge=1e-3,
        le=45,
    )
    large_step_deg: float = quantity(
        20.0, "deg", "assumption: one that the speed limit governs", ge=1e-3, le=45
    )
    step_duration_s: float = quantity(
        4.0, "s", "assumption: four times what the large step takes", ge=0.01, le=1e3
    )
    settling_band_deg: float = quantity(
        0.2,
        "deg",
        "assumption: a step has settled when its error stays within ± this; a tenth of the small "
        "step, a hundredth of the large one, two counts of the encoder",
        ge=1e-3,
        le=45,
    )
    fast_amplitude_deg: float = quantity(
        2.5, "deg", "assumption: at 1 Hz it stays below the speed limit", ge=1e-3, le=45
    )
    fast_frequency_hz: float = quantity(
        1.0, "Hz", "assumption: ten times the reference of Section 5", ge=1e-3, le=250
    )
    fast_duration_s: float = quantity(4.0, "s", "assumption: four periods", ge=0.01, le=1e4)
    chattering_factor: float = quantity(
        2.0,
        "1",
        "assumption: a value chatters whose command changes by so much more than at the best one",
        gt=1,
        le=100,
    )
    wrong_factor: float = quantity(
        3.0, "1", "assumption: a value is wrong that is so much too large or small", gt=1, le=100
    )
    sound_disk_margin: float = quantity(
        SOUND_DISK_MARGIN,
        "1",
        "assumption: 28° of phase or a gain of 0.6…1.67, each alone; a loop below it is "
        "counted apart",
        ge=1e-3,
        le=2,
    )
    limit_cycle_time_constant_s: float = quantity(
        0.008,
        "s",
        "assumption: T_f of a loop that is linearly stable and errs by degrees",
        ge=1e-5,
        le=1,
    )
    limit_cycle_slope_per_s: float = quantity(
        1e4, "1/s", "assumption: k/Φ of the same", ge=1e-3, le=1e12
    )
    limit_cycle_lambdas_per_s: tuple[float, ...] = positive_values(
        (20.0, 10.0), "1/s", "assumption: λ of the same"
    )
    hold_duration_s: float = quantity(
        20.0, "s", "assumption: long enough for an oscillation at rest to settle", ge=0.01, le=1e4
    )
    unlimited_acceleration_rad_s2: float = quantity(
        1e7, "rad/s²", "assumption: a thousand times the default limit", ge=1, le=1e7
    )
    map_time_constants_s: tuple[float, ...] = positive_values(
        (0.003, 0.004, 0.006, 0.008, 0.012, 0.016, 0.020, 0.028, 0.040),
        "s",
        "assumption: T_f about its default",
    )
    map_slopes_per_s: tuple[float, ...] = positive_values(
        (5.6e3, 1e4, 1.8e4, 3.2e4, 5.6e4, 1e5, 1.8e5, 3.2e5, 5.6e5, 1e6),
        "1/s",
        "assumption: k/Φ about its default",
    )

    _increasing = field_validator(
        "lambdas_per_s", "phis_m_s2", "etas_m_s3", "map_time_constants_s", "map_slopes_per_s"
    )(require_increasing)

    @model_validator(mode="after")
    def _band_within_the_steps(self) -> ControllerSettings:
        smallest = min(self.step_deg, self.large_step_deg)
        if self.settling_band_deg >= smallest:
            raise ValueError(
                f"settling_band_deg = {self.settling_band_deg:g} deg: must be less than the "
                f"smaller step, {smallest:g} deg"
            )
        return self
