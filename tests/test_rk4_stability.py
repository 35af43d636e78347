"""RK4 on random full-order plants, in small; `benchmarks/rk4_stability.py` has 200 plants.

Drake's implicit integrator is the oracle of the oracle: see `test_the_oracle_agrees_with_drake`.
"""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from kneexo.errors import UnstableStepError
from kneexo.simulation.engines import simulate

PATH = Path(__file__).parents[1] / "benchmarks" / "rk4_stability.py"
spec = importlib.util.spec_from_file_location("rk4_stability", PATH)
campaign = importlib.util.module_from_spec(spec)
spec.loader.exec_module(campaign)

FAST = 1  # a seed with a wearer's leg


def test_right_with_short_steps_refused_with_long_ones():
    plant = campaign.oracle(campaign.random_scenario(FAST))
    outcomes = [campaign.outcome(plant, angle)[0] for angle in (0.5, 4.0)]
    assert outcomes == ["right", "refused"]


@pytest.mark.slow
def test_right_where_accurate_refused_where_unstable_never_wrong_in_silence():
    for seed in range(20):
        plant = campaign.oracle(campaign.random_scenario(seed))
        assert campaign.outcome(plant, 0.2)[0] == "right", seed
        for angle in (4.0, 15.0):
            word, text = campaign.outcome(plant, angle)
            assert word in ("refused", "refused twice", "no such step"), (seed, text)
