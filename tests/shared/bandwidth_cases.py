"""Settings, numbers and helpers of the tests of the bandwidth study."""

from functools import cache

import numpy as np

from kneexo.analysis.frequency.sine_estimate import SineEstimateSettings
from kneexo.parameters import Scenario
from kneexo.studies.bandwidth import BandwidthResult, BandwidthSettings

QUICK = SineEstimateSettings(averaged_cycles=2, largest_cycles=3)
SMALL_MAP = BandwidthSettings(
    amplitudes_deg=(0.3, 3.0), frequencies_hz=(2.5, 5.0, 12.5), estimate=QUICK
)
GAINS = np.array([[0.99, 0.8, 0.5], [0.95, 0.6, 0.2]])
PHASES = np.array([[-5.0, -20.0, -50.0], [-15.0, -70.0, -190.0]])
LINEAR_GAINS, LINEAR_PHASES = np.array([1.0, 0.91, 0.52]), np.array([-4.0, -19.0, -45.0])
FOLLOWER = np.array([[1.0, 1.0, 0.8], [0.97, 0.65, 0.25]])
BANDWIDTHS = {
    "measured_hz": [0.3, 0.16],
    "linear_loop_hz": [0.31, 0.31],
    "acceleration_bound_hz": [3.3, 0.5],
    "follower_hz": [6.7, 0.17],
    "rate_limit_hz": [6.9, 0.18],
    "speed_limit_reached_hz": [4.0, 0.12],
}
AMPLITUDES, FREQUENCIES = (1.0, 30.0), (0.1, 0.2, 0.4)


def table(start):
    return start + 0.01 * np.arange(6.0).reshape(2, 3)


@cache
def made_up():
    """A map that nothing was simulated for: its numbers tell each other apart."""
    return BandwidthResult(
        amplitudes_deg=np.array(AMPLITUDES),
        frequencies_hz=np.array(FREQUENCIES),
        response=GAINS * np.exp(1j * np.radians(PHASES)),
        cells={
            "uncertainty": 0.1 * table(0.1),
            "settled": np.array([[True, True, False], [True, False, True]]),
            "cycles": np.arange(6).reshape(2, 3),
            "mean_deg": table(40.0),
            "speed_limited_share": table(0.3),
            "acceleration_limited_share": table(0.6),
        },
        bandwidths={name: np.array(values) for name, values in BANDWIDTHS.items()},
        linear=LINEAR_GAINS * np.exp(1j * np.radians(LINEAR_PHASES)),
        linear_failure="",
        follower=FOLLOWER * np.exp(0.2j),
        unquantized=LINEAR_GAINS * np.exp(1j * np.radians(LINEAR_PHASES)) * [1.003, 0.905, 5.0],
        unlimited=np.array([True, True, False]),
        failures=("30 deg, 9 Hz: left the range",),
        scenario=Scenario(),
        settings=BandwidthSettings(
            amplitudes_deg=AMPLITUDES, frequencies_hz=FREQUENCIES, estimate=QUICK
        ),
    )


SMALL_STUDY = {"scenario": Scenario(), "settings": SMALL_MAP}
"""Arguments of a study that takes about a second."""
