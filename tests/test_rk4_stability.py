"""RK4 on random full-order plants, in small; `benchmarks/rk4_stability.py` has 200 plants."""

from pathlib import Path

import pytest
from elsewhere import module_of

PATH = Path(__file__).parents[1] / "benchmarks" / "rk4_stability.py"
campaign = module_of("rk4_stability", PATH)


def test_right_with_short_steps_refused_with_long_ones():
    plant = campaign.oracle(campaign.random_scenario(1))
    outcomes = [campaign.outcome(plant, angle)[0] for angle in (0.5, 4.0)]
    assert outcomes == ["right", "refused"]


@pytest.mark.slow
def test_right_where_accurate_refused_where_unstable_never_wrong_in_silence():
    for seed in range(10):
        plant = campaign.oracle(campaign.random_scenario(seed))
        assert campaign.outcome(plant, 0.2)[0] in ("right", "no such step"), seed
        for angle in (4.0, 15.0):
            word, text = campaign.outcome(plant, angle)
            assert word in ("refused", "refused twice", "no such step"), (seed, text)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 8, 14])
def test_the_oracle_agrees_with_drake(seed):
    assert campaign.drake_error(campaign.random_scenario(seed)) < 2e-5
