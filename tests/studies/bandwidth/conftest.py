"""Results of the bandwidth study that several test files read."""

import numpy as np
import pytest
from bandwidth_cases import (
    AMPLITUDES,
    BANDWIDTHS,
    FOLLOWER,
    FREQUENCIES,
    GAINS,
    LINEAR_GAINS,
    LINEAR_PHASES,
    PHASES,
    QUICK,
    SMALL_MAP,
    table,
)

from kneexo.parameters import Scenario
from kneexo.studies.bandwidth import BandwidthResult, BandwidthSettings, bandwidth_study
from kneexo.sweeps.checkpoint import Checkpoint


@pytest.fixture(scope="session")
def mapped(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "checkpoint.jsonl"
    return bandwidth_study(Scenario(), SMALL_MAP, checkpoint=Checkpoint(path)), path


@pytest.fixture(scope="session")
def by_hand():
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
