"""Settings, numbers and helpers of the tests of the robustness study."""

import math
from functools import cache

import numpy as np

from kneexo.parameters import UNCERTAIN_KNEE, Uncertainty, UncertaintySet
from kneexo.parameters.paths import changed
from kneexo.studies.robustness.robustness import (
    MERITS,
    Assessment,
    RobustnessResult,
    RobustnessSettings,
)

FEW = RobustnessSettings(
    samples=40, corners_max=200, bandwidth=False, sensitivity_duration_s=0.0, nyquist_loops=3
)


def uncertain(**values):
    """An uncertainty set; names with __ for the dots."""
    return UncertaintySet(
        values={
            path.replace("__", "."): Uncertainty(**keywords) for path, keywords in values.items()
        }
    )


SMALL = uncertain(
    plant__cylinder__mass_kg={"low": 1.4, "high": 1.8},
    plant__pump__lag_s={"low": 0.005, "high": 0.02, "scale": "log"},
    bus__latency_samples={"options": (0, 1, 2)},
)


POSITION = [name for name in MERITS if "torque" not in name]
"""The figures of merit of a knee without a wearer."""


def merits(**changes):
    """What `assess` returns, all well unless said otherwise."""
    return {
        **{name: 1.0 for name in POSITION if name != "bandwidth_hz"},
        "stable": True,
        "tracking_failure": "",
        "margins_failure": "",
        **changes,
    }


REAL = changed(
    UNCERTAIN_KNEE,
    {
        "reference": {"kind": "sine", "amplitude_deg": 2.0, "frequency_hz": 4.0},
        "simulation.duration_s": 0.3,
    },
)
UNITS = dict(zip(POSITION, (1.0, 0.5, 20.0, 0.3, 60.0, 0.2, 0.7), strict=True))
"""Size of each figure of merit; an assessment has a number of its own times it."""


def assessment(number, mass, lag, delay, **changes):
    values = {"plant.cylinder.mass_kg": mass, "plant.pump.lag_s": lag, "bus.latency_samples": delay}
    present = {path: value for path, value in values.items() if value is not None}
    numbers = {name: round(number * size, 6) for name, size in UNITS.items()}
    return Assessment(present, merits(**numbers, bandwidth_failure="") | changes)


SAMPLED = np.array([1.5, 0.9, 1.9, 1.2, 1.1])


def expected_summary(merit):
    """Nominal, median, 5 %, 95 %, worst sample, worst corner; inf where it fails."""
    size, values = UNITS[merit], SAMPLED.copy()
    if merit == "max_error_deg":
        values[3] = math.inf
    ordered = np.sort(values)
    more_is_worse = merit in ("max_error_deg", "rms_error_deg", "mean_command_change_rpm")
    numbers = [1.0, ordered[2], ordered[0], ordered[4]]
    numbers += [ordered[4] if more_is_worse else ordered[0], 2.3 if more_is_worse else 0.6]
    return [size * value for value in numbers]


@cache
def made_up():
    """Visits out of order, one of which fails; its corners have other numbers than its samples."""
    stopped = {"max_error_deg": math.nan, "tracking_failure": "t = 1 s: out of range"}
    return RobustnessResult(
        scenario=UNCERTAIN_KNEE,
        uncertainty=SMALL,
        left_out=("plant.load.knee_torque_n_m",),
        settings=FEW,
        nominal=assessment(1.0, None, None, None),
        one_at_a_time=(
            assessment(1.1, 1.4, None, None),
            assessment(0.8, 1.8, None, None),
            assessment(0.7, None, 0.005, None),
            assessment(1.6, None, 0.02, None),
            assessment(1.0, None, None, 0),
            assessment(1.2, None, None, 1),
            assessment(1.25, None, None, 2),
        ),
        samples=(
            assessment(1.5, 1.50, 0.012, 1),
            assessment(0.9, 1.45, 0.007, 2),
            assessment(1.9, 1.60, 0.019, 0),
            assessment(1.2, 1.75, 0.011, 2, **stopped),
            assessment(1.1, 1.65, 0.009, 1),
        ),
        corners=(
            assessment(2.3, 1.4, 0.005, 0),
            assessment(0.6, 1.8, 0.02, 1),
            assessment(2.1, 1.4, 0.02, 2),
        ),
        corners_possible=12,
        corners_settled=True,
        local={
            "rms_error_deg": {"plant.cylinder.mass_kg": 0.3, "plant.pump.lag_s": 0.05},
            "disk_margin": {"plant.cylinder.mass_kg": -0.2, "plant.pump.lag_s": -0.07},
        },
        local_failures=("tracking: too long",),
    )


SMALL_STUDY = {
    "scenario": REAL,
    "uncertainty": uncertain(
        plant__cylinder__mass_kg={"low": 1.4, "high": 1.8},
        plant__pump__lag_s={"low": 0.0099, "high": 0.0101, "scale": "log"},
    ),
    "settings": FEW.model_copy(
        update={"samples": 4, "corners_max": 4, "sensitivity_duration_s": 0.1}
    ),
}
"""Arguments of a study that takes about a second."""
