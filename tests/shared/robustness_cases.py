"""Settings, numbers and helpers of the tests of the robustness study."""

import math

import numpy as np

from kneexo.parameters import (
    UNCERTAIN_KNEE,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.paths import changed
from kneexo.studies.robustness.study import (
    MERITS,
    Assessment,
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
    values = {
        "plant.cylinder.mass_kg": mass,
        "plant.pump.lag_s": lag,
        "bus.latency_samples": delay,
    }
    present = {path: value for path, value in values.items() if value is not None}
    numbers = {name: round(number * size, 6) for name, size in UNITS.items()}
    return Assessment(present, merits(**numbers, bandwidth_failure="") | changes)


SAMPLED = np.array([1.5, 0.9, 1.9, 1.2, 1.1])
LINEAR = {  # by slope: over 0.4 kg; over a factor of four, by the logarithm, at 10 ms
    "rms_error_deg": [0.3 * 0.4, 0.05 * 0.010 * math.log(4.0)],
    "disk_margin": [-0.2 * 0.4, -0.07 * 0.010 * math.log(4.0)],
}


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
