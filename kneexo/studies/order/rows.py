"""Rows of the tables of a `kneexo.studies.order.study.OrderResult`, a class for each table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class TrackingTrace:
    """Signals of a tracking run at up to about 800 samples."""

    time_s: tuple[float, ...]
    """Times of the samples in s."""
    error_deg: tuple[float, ...]
    """Tracking error of the knee angle in deg."""
    pressures_mpa: Mapping[str, tuple[float, ...]]
    """Pressures in MPa: ``load_pressure`` in reduced order, ``cap`` and ``rod_side`` in full."""


@dataclass(frozen=True, kw_only=True)
class TrackingRow:
    """Metrics and trace of a tracking run. A number that the order does not have is None.

    Errors, command and saturation leave out the first period of the reference. They are nan if the
    run ends within this period.
    """

    order: str
    """The model of the cylinder, ``reduced`` or ``full``."""
    disturbance_n: float
    """Force in N that is added to the scenario's load."""
    max_error_deg: float
    """Largest tracking error in deg."""
    rms_error_deg: float
    """Root mean square of the tracking error in deg."""
    mean_command_change_rpm: float
    """Mean change of the motor speed command from sample to sample in rpm."""
    saturated_share: float
    """Share (0 … 1) of the samples at which the command is at its limit."""
    load_pressure_min_mpa: float | None = None
    """Smallest load pressure P_L in MPa; None in full order."""
    load_pressure_max_mpa: float | None = None
    """Largest load pressure P_L in MPa; None in full order."""
    cap_min_mpa: float | None = None
    """Smallest pressure P_1 of the cap side in MPa; None in reduced order."""
    cap_max_mpa: float | None = None
    """Largest pressure P_1 of the cap side in MPa; None in reduced order."""
    rod_side_min_mpa: float | None = None
    """Smallest pressure P_2 of the rod side in MPa; None in reduced order."""
    rod_side_max_mpa: float | None = None
    """Largest pressure P_2 of the rod side in MPa; None in reduced order."""
    relief_share: float | None = None
    """Share (0 … 1) of the time with flow through a relief valve; None in reduced order."""
    peak_makeup_cm3_s: float | None = None
    """Largest flow through both make-up valves together in cm³/s; None in reduced order."""
    trace: TrackingTrace
    """Error and pressures over time."""


@dataclass(frozen=True, kw_only=True)
class SpeedRow:
    """Speed of the rod in a ramp that requires more than the motor's speed limit.

    The start of the ramp is left out.
    """

    order: str
    """The model of the cylinder, ``reduced`` or ``full``."""
    force_n: float
    """Constant force on the rod in N, the only load."""
    direction: str
    """``in`` if the rod retracts (flexion), ``out`` if the rod extends."""
    saturated_share: float
    """Share (0 … 1) of the samples at which the command is at its limit."""
    rod_speed_mm_s: float
    """Mean speed of the rod in mm/s."""


@dataclass(frozen=True, kw_only=True)
class SwitchingRow:
    """Oscillation of the rod about a slow ramp, with the full-order cylinder.

    The start of the ramp is left out.
    """

    force_n: float
    """Constant force on the rod in N, the only load."""
    direction: str
    """``in`` if the rod retracts (flexion), ``out`` if the rod extends."""
    velocity_swing_mm_s: float
    """Rod velocity about its reference in mm/s, peak to peak."""
    velocity_rms_mm_s: float
    """Rod velocity about its reference in mm/s, root mean square about its own mean."""
    load_pressure_swing_mpa: float
    """Pressure P_1 − P_2 in MPa, peak to peak."""
    max_error_deg: float
    """Largest tracking error in deg."""
    oscillates: bool
    """Whether ``velocity_swing_mm_s`` exceeds the limit in the settings."""


@dataclass(frozen=True)
class FrequencyTrace:
    """Gain of the linear plant over frequency."""

    frequencies_hz: tuple[float, ...]
    """Frequencies in Hz."""
    plant_gain_m: tuple[float, ...]
    """Gain from motor speed command (rad/s) to rod velocity (m/s), in m."""


@dataclass(frozen=True, kw_only=True)
class FrequencyRow:
    """Mode of the oil and margins of the loop at one posture.

    Numbers that follow from a linearization are nan if this linearization fails.
    """

    order: str
    """The model of the cylinder, ``reduced`` or ``full``."""
    disturbance_n: float
    """Force in N that is added to the scenario's load."""
    posture_deg: float
    """Knee angle in deg."""
    mode_hz: float = math.nan
    """Natural frequency of the oil's mode in Hz; nan also if the plant has no such mode."""
    mode_damping: float = math.nan
    """Damping ratio of this mode; nan where ``mode_hz`` is nan."""
    rod_force_n: float = math.nan
    """Force on the rod at rest in N."""
    phase_margin_deg: float = math.nan
    """Phase margin of the sampled loop in deg; nan, as all margins, also in an unstable loop."""
    gain_margin: float = math.nan
    """Gain margin as a factor."""
    delay_margin_ms: float = math.nan
    """Delay margin in ms."""
    disk_margin: float = math.nan
    """Balanced disk margin."""
    bandwidth_hz: float = math.nan
    """Small-signal −3 dB frequency in Hz with feedforward; nan also if unstable or if the gain
    stays above −3 dB up to the Nyquist frequency."""
    complementary_sensitivity_bandwidth_hz: float = math.nan
    """−3 dB frequency of the feedback alone in Hz; nan as for ``bandwidth_hz``."""
    stable: bool | None = None
    """Whether the sampled loop is stable; None if a linearization fails."""
    failure: str = ""
    """Reason why a linearization failed; empty if none failed."""
    trace: FrequencyTrace | None = None
    """Gain of the plant; None if the linearization of the plant fails."""


@dataclass(frozen=True, kw_only=True)
class BandwidthRow:
    """Large-signal bandwidth under one load."""

    order: str
    """The model of the cylinder, ``reduced`` or ``full``."""
    disturbance_n: float
    """Force in N that is added to the scenario's load."""
    bandwidth_hz: float
    """Large-signal −3 dB frequency in Hz; nan if the search fails."""
    failure: str
    """Reason why the search failed; empty if it succeeded."""
