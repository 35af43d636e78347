"""Settings, numbers and helpers of the tests of the reproduce study."""

import numpy as np

METRICS = {
    "max_error_deg": 0.11,
    "rms_error_deg": 0.12,
    "max_error_overall_deg": 0.13,
    "rms_error_overall_deg": 0.14,
    "mean_command_change_rpm": 15.0,
    "saturated_share": 0.16,
    "peak_command_rpm": 1700.0,
    "peak_pressure_mpa": 0.18,
    "pressure_over_rating_share": 0.19,
    "peak_shaft_power_w": 20.0,
    "power_over_rating_share": 0.21,
    "shaft_energy_j": 22.0,
    "shaft_energy_delivered_j": 23.0,
    "hydraulic_energy_j": 24.0,
}
"""Numbers that tell each other apart; those of the n-th run are n + 1 times as large."""
TIME = np.array([0.0, 0.5, 1.0, 1.5])
ANGLES = np.linspace(0.0, 90.0, 91)
GAINS = np.array([[0.9, 0.8, 0.5], [1.0, 0.7, 0.6]])
PHASES = np.array([[-10.0, -20.0, -40.0], [-12.0, -24.0, -48.0]])
