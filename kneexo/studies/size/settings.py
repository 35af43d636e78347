"""Settings of the study `size`."""

from __future__ import annotations

from pydantic import field_validator

from kneexo.parameters import SEAL_FRICTION_N
from kneexo.parameters.fields.quantity import (
    Parameters,
    ordered_limits,
    positive_values,
    quantities,
    quantity,
    require_increasing,
)
from kneexo.parameters.task.gait import GAIT_STRIDE_S


class SizeSettings(Parameters):
    """Settings of the study `size`: hardware and gains to try, and the largest allowed error."""

    factors: tuple[float, ...] = positive_values(
        (0.125, 0.25, 0.5, 0.707, 1.0, 1.414, 2.0, 4.0, 8.0),
        "1",
        "assumption: what each value of the scenario's hardware is multiplied by",
    )
    walking_factors: tuple[float, ...] = positive_values(
        (0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0),
        "1",
        "assumption: the same for the hardware that was sized for walking",
    )
    stride_frequencies_hz: tuple[float, ...] = quantities(
        (1.0, 1.0 / GAIT_STRIDE_S),
        "Hz",
        "assumption: walking at 1 Hz; the measured stride",
        ge=1e-5,
        le=10,
    )
    cycles: int = quantity(3, "1", "assumption: strides; the first is discarded", ge=2, le=1000)
    error_bound_deg: float = quantity(
        2.0, "deg", "Section 5: the error was less than 2° with the SMC", ge=1e-3, le=90
    )
    largest_flow_factor: float = quantity(
        25.0,
        "1",
        "assumption: the search for the smallest flow begins here, 40 % above what the measured "
        "stride asks for",
        gt=1,
        le=100,
    )
    acceleration_limit_min_rad_s2: float = quantity(
        1e3, "rad/s²", "assumption: a tenth of the default", ge=1, le=1e7
    )
    acceleration_limit_max_rad_s2: float = quantity(
        1e5, "rad/s²", "assumption: ten times the default, without effect on walking", ge=1, le=1e7
    )
    search_tolerance: float = quantity(
        0.005, "1", "assumption: relative accuracy of the smallest values", ge=1e-4, le=0.5
    )
    margin: float = quantity(
        1.1, "1", "assumption: sized flow, acceleration and piston over the smallest", ge=1, le=10
    )
    moment_share: float = quantity(
        1.0, "1", "assumption: share of the measured knee moment for the piston", ge=0, le=1
    )
    lambda_per_s: tuple[float, ...] = positive_values(
        (20.0, 40.0, 60.0, 80.0, 100.0, 120.0), "1/s", "assumption: λ to try"
    )
    slope_per_s: tuple[float, ...] = positive_values(
        (2.5e4, 3.5e4, 5e4, 7e4, 1e5, 1.4e5), "1/s", "assumption: k/Φ to try, with k = β·η"
    )
    observer_s: tuple[float, ...] = positive_values((0.010, 0.020), "s", "assumption: T_f to try")
    disk_margin_min: float = quantity(
        0.5, "1", "assumption: 28° of phase or a gain of 0.6…1.67, each alone", ge=1e-3, le=2
    )
    command_change_ratio_max: float = quantity(
        1.5,
        "1",
        "assumption: mean change of the command over what the motion itself asks for; beyond it "
        "is chattering",
        gt=1,
        le=1000,
    )
    check_step_s: float = quantity(
        1e-4,
        "s",
        "assumption: step of RK4 for pressure and power; half of it too",
        ge=1e-6,
        le=2e-3,
    )
    seal_friction_n: float = quantity(
        SEAL_FRICTION_N,
        "N",
        "assumption: as in UNCERTAINTY; a sized design must bear it",
        ge=0,
        le=1e5,
    )
    wearer_torques_n_m: tuple[float, ...] = quantities(
        (-20.0, -10.0, 0.0, 10.0, 20.0),
        "N·m",
        "assumption: constant torques of a wearer",
        ge=-500,
        le=500,
    )

    _increasing = field_validator("factors", "walking_factors")(require_increasing)
    _ordered = ordered_limits(strict=True)
