"""Shared by the tests of studies: what a row must hold, from runs and margins without a study."""

import math

import numpy as np
import pytest

from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.simulation.engines import simulate


def _in_numbers(scenario, period_s):
    run = simulate(
        scenario, signals=("knee_reference", "knee_angle", "motor_speed_command", "load_pressure")
    )
    late = run.time_s > period_s - 1e-6
    error = np.degrees(run["knee_reference_rad"] - run["knee_angle_rad"])[late]
    command = run["motor_speed_command_rad_s"][late]
    return {
        "max_error_deg": np.max(np.abs(error)),
        "rms_error_deg": np.sqrt(np.mean(error**2)),
        "mean_command_change_rpm": np.mean(np.abs(np.diff(command))) * 30.0 / math.pi,
        "saturated_share": np.mean(np.abs(command) > 523.598),  # of 5000 rpm
        "peak_pressure_mpa": np.max(np.abs(run["load_pressure_pa"])) / 1e6,
    }


def _margins(scenario, angle_deg):
    loop = linearize_loop(scenario, angle_deg)
    names = ("phase_margin_deg", "delay_margin_s", "gain_margin", "disk_margin")
    values = loop.margins() if loop.stable else None
    return {"stable": float(loop.stable)} | {
        name: getattr(values, name, math.nan) for name in names
    }


@pytest.fixture(scope="session")
def in_numbers():
    """The function ``in_numbers(scenario, period_s)``: a run after its first period, by NumPy."""
    return _in_numbers


@pytest.fixture(scope="session")
def margins():
    """The function ``margins(scenario, angle_deg)``: of the sampled loop; nan if unstable."""
    return _margins
