"""Settings, numbers and helpers of the tests of the size study."""

from __future__ import annotations

import math

import numpy as np

from kneexo.studies.size.settings import SizeSettings

SMALL = SizeSettings(
    factors=(0.5, 1.0, 2.0),
    walking_factors=(0.5, 1.0, 1.5),
    stride_frequencies_hz=(1.0,),
    lambda_per_s=(20.0, 80.0),
    slope_per_s=(5e4,),
    observer_s=(0.02,),
    search_tolerance=0.02,
    wearer_torques_n_m=(0.0, 10.0),
)
# Lee et al. 2020, Tables 2 and 3: bore 20 mm, rod 10 mm, 0.8 cm³/rev behind a gear of 6:1.
AREA_MM2 = math.pi / 4.0 * (20.0**2 - 0.5 * 10.0**2)
SPEED_MM_S = 0.8e3 * 5000.0 / 60.0 / 6.0 / AREA_MM2
SETTINGS = SizeSettings(
    factors=(0.5, 1.0, 2.0),
    walking_factors=(0.5, 1.0, 1.25, 1.5),
    stride_frequencies_hz=(1.0, 0.8),
    lambda_per_s=(20.0, 80.0, 100.0),
    slope_per_s=(5e4, 7e4),
    observer_s=(0.02,),
    wearer_torques_n_m=(0.0, 10.0),
)
FLOW, ACCELERATION = 17.0, 2.0
"""Of the first design, as factors on the paper's hardware; the second has twice as much."""
PISTON = 1.21
"""Factor on the area of the piston that carries the moment of the stride."""
CYCLE = np.linspace(0.0, 100.0, 101)
WAVE = np.sin(2.0 * np.pi * CYCLE / 100.0)  # its largest value is 1
AT_SINE = (
    "expected_bandwidth_hz",
    "bandwidth_hz",
    "small_signal_bandwidth_hz",
    "max_error_deg",
    "rms_error_deg",
    "mean_command_change_rpm",
)
