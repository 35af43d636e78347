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
PAPER = {
    ("table1", "x_at_10deg_mm"): 139.05,
    ("table1", "x_at_70deg_mm"): 38.98,
    ("table1", "strokes_per_period_mm"): 200.14,
    ("table1", "linkage_max_mm"): None,
    ("table1", "refit_p_sse_mm2"): 0.1781,
    ("table1", "refit_q_sse_deg2"): 1.241,
    ("table1", "linkage_rmse_mm"): 0.03,
    ("table1", "refit_q_rmse_deg"): 0.0792,
    ("table1_g4", "refit_p_sse_mm2"): 0.1781,
    ("table1_g4", "refit_q_sse_deg2"): 1.241,
    ("table1_g4", "refit_p_rmse_mm"): 0.03,
    ("table1_g4", "refit_q_rmse_deg"): 0.0792,
    ("fig9", "error_after_1s_mm"): None,
    ("fig9", "final_error_mm"): 0.0,
    ("fig12", "smc", "max_error_deg"): 2.0,
    ("fig12", "pid", "max_error_deg"): 4.0,
    ("fig12", "pid_tuned", "max_error_deg"): None,
    ("fig12", "pid_feedforward", "max_error_deg"): None,
    ("speed_limit", "peak_speed_demand_at_0.1hz_rpm"): 5000.0,
    ("fig13", "bandwidth_hz"): 0.21,
    ("fig13", "phase_at_bandwidth_deg"): None,
    ("scaling", "gear_3", "ratio"): None,
    ("scaling", "half_amplitude", "ratio"): None,
}
"""Where the results have a number, and what Lee et al. 2020 print in its place."""
