"""Settings, numbers and helpers of the tests of the size study."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from kneexo.analysis.walking.walking import WALKING_METRICS, WalkingDemand
from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.studies.hardware import ACCELERATION_LIMIT, DISPLACEMENT, HARDWARE, scaled, with_piston
from kneexo.studies.size.result import Search, SizeResult, WalkingDesign
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


def demand(frequency, factor):
    """A stride whose peaks are ``factor`` times a number for each signal."""
    wave = factor * WAVE
    return WalkingDemand(
        frequency_hz=frequency,
        cycle_percent=CYCLE,
        knee_angle_deg=40.0 + 0.01 * WAVE,
        knee_rate_deg_s=301.0 * wave,
        rod_speed_m_s=0.62 * wave,
        rod_acceleration_m_s2=6.3 * wave,
        rod_force_n=64.0 * wave,
        load_pressure_pa=0.65e6 * wave,
        load_flow_m3_s=1.66e-4 * wave,
        motor_speed_rad_s=6700.0 * wave,
        motor_acceleration_rad_s2=68000.0 * wave,
        shaft_power_w=69.0 * factor * (WAVE + 0.25) / 1.25,
    )


def numbers(names, start, failure=""):
    """Numbers that no other row has."""
    values = {name: 0.017 * (start + n) for n, name in enumerate(names)}
    if "saturated_share" in values:
        values["saturated_share"] = start / 1000.0
    return values | {"failure": failure}


def failed(names):
    return dict.fromkeys(names, math.nan) | {"failure": "t = 1 s: left the range; too slow"}


def design(frequency, share, start):
    factors = {DISPLACEMENT: FLOW * share, ACCELERATION_LIMIT: ACCELERATION * share}
    halved = numbers(WALKING_METRICS, start + 40)
    checked = {k: v if isinstance(v, str) else v / 1.02 for k, v in halved.items()}
    checked["peak_shaft_power_w"] = halved["peak_shaft_power_w"] / 0.95
    reached = share == 1.0
    return WalkingDesign(
        frequency_hz=frequency,
        flow=Search(15.4 * share, 1.9, True, 1.0, 25.0),
        acceleration=Search(1.8e4 * share, 1.7 if reached else 2.6, reached, 1e3, 1e5),
        scenario=scaled(UNCERTAIN_KNEE, factors),
        carrying=with_piston(scaled(UNCERTAIN_KNEE, factors), PISTON),
        walking=numbers(WALKING_METRICS, start),
        checked=checked,
        halved=halved,
        carried=numbers(WALKING_METRICS, start + 60),
    )


@cache
def made_up():
    """A `SizeResult` that nothing was simulated for."""
    sweeps = {
        path: [numbers(AT_SINE, 100 + 30 * n + 7 * m) for m, _ in enumerate(SETTINGS.factors)]
        for n, path in enumerate(HARDWARE)
    }
    sweeps[DISPLACEMENT][0] = failed(AT_SINE) | {"expected_bandwidth_hz": 0.5}
    walking_sweeps = {
        path: [{"max_error_deg": error} for error in (9.0 + n, 1.0, 1.5, 3.0 - 0.4 * n)]
        for n, path in enumerate(HARDWARE)
    }
    gains = [
        {"lambda_per_s": lambda_, "slope_per_s": slope, "observer_s": observer}
        | {"max_error_deg": 1.0 + 10 * i + j, "disk_margin": 0.1 * i + 0.01 * j, "meets": j == 1}
        for observer in SETTINGS.observer_s
        for i, slope in enumerate(SETTINGS.slope_per_s)
        for j, lambda_ in enumerate(SETTINGS.lambda_per_s)
    ]
    time = 1.0 + np.arange(0.0, 2.0 + 1e-9, 0.02)
    trace = {
        "time_s": time,
        "knee_angle_rad": np.radians(30.0 + time),
        "knee_reference_rad": np.radians(30.0 + 3.0 * time),
        "motor_speed_rad_s": 100.0 * time,
        "load_pressure_pa": 2e6 * time,
        "shaft_power_w": 40.0 * time,
    }
    return SizeResult(
        scenario=UNCERTAIN_KNEE,
        settings=SETTINGS,
        nominal=numbers(AT_SINE, 1),
        sweeps=sweeps,
        bandwidth_map_hz=np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, np.nan, 0.9]]),
        demands=[demand(1.0, 1.0), demand(0.8, 0.7)],
        segment_demands=[demand(1.0, 1.1), demand(0.8, 0.9)],
        torque_demands={0.0: demand(1.0, 1.3), 10.0: demand(1.0, 1.7)},
        gains=gains,
        best_gains=gains[1] | {"phase_margin_deg": 44.0},
        steps={
            "as it is": [
                numbers(WALKING_METRICS, 400) | {"saturated_share": 0.87},
                numbers(WALKING_METRICS, 420),
            ],
            "ample": [failed(WALKING_METRICS), numbers(WALKING_METRICS, 440)],
        },
        designs=[design(1.0, 1.0, 500), design(0.8, 2.0, 600)],
        design_at_reference=numbers(AT_SINE, 51),
        variations={"reduced": numbers(WALKING_METRICS, 700), "full": failed(WALKING_METRICS)},
        walking_sweeps=walking_sweeps,
        walking_map_deg=1.0 + 0.1 * np.arange(16.0).reshape(4, 4),
        traces={"nominal": trace, "sized": {k: 1.0 * v for k, v in trace.items()}},
    )


SMALL_STUDY = {"scenario": UNCERTAIN_KNEE, "settings": SMALL}
"""Arguments of a study that takes about a second."""
