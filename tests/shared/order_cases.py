"""Settings, numbers and helpers of the tests of the order study."""

from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.parameters.paths import changed

FORCE, POSTURE = 300.0, 40.0
BRIEF = changed(
    UNCERTAIN_KNEE,
    {
        "reference": {"kind": "sine", "mean_deg": 40.0, "amplitude_deg": 10.0, "frequency_hz": 2.0},
        "simulation.duration_s": 3.198,
        # Under `FORCE` P_1 passes the relief pressure now and then; little flows back.
        "plant.full_order": {
            "reservoir_pressure_pa": 0.25e6,
            "relief_pressure_pa": 1.09e6,
            "relief_conductance_m3_per_s_pa": 1e-12,
        },
    },
)


def rows(part, **labels):
    return [row for row in part if all(getattr(row, k) == v for k, v in labels.items())]


NAMES = {
    "tracking": (
        *("max_error_deg", "rms_error_deg", "mean_command_change_rpm", "saturated_share"),
        *("load_pressure_min_mpa", "load_pressure_max_mpa", "cap_min_mpa", "cap_max_mpa"),
        *("rod_side_min_mpa", "rod_side_max_mpa"),
    ),
    "speeds": ("saturated_share", "rod_speed_mm_s"),
    "switching": (
        *("velocity_swing_mm_s", "velocity_rms_mm_s", "load_pressure_swing_mpa"),
        "max_error_deg",
    ),
    "frequency": (
        *("rod_force_n", "mode_hz", "mode_damping", "phase_margin_deg", "gain_margin"),
        *("delay_margin_ms", "disk_margin", "bandwidth_hz"),
        "complementary_sensitivity_bandwidth_hz",
    ),
    "bandwidth": ("bandwidth_hz",),
}
"""The numbers of a row in each part; no two of all rows are equal."""
