import math

import pytest

from kneexo.analysis.frequency.bandwidth import rod_amplitude_m, rod_limits
from kneexo.studies.paper import (
    EQ_27_DIFFERENCES,
    EQ_27_EXACT_STATES,
    FIG_12,
    FIG_13_SCALING,
    IDEAL_SMC,
)


@pytest.mark.parametrize("name", ["gear_3", "half_amplitude"])
def test_each_change_of_fig_13_doubles_the_speed_limit_per_stroke(name):
    def speed_per_stroke(scenario):
        return rod_limits(scenario)[0] / rod_amplitude_m(scenario)

    (nominal, settings), (changed, other_settings) = FIG_13_SCALING["nominal"], FIG_13_SCALING[name]
    # About 40° a degree moves the rod by 3.3 % more than the mean of 10…70° (Table 1).
    assert speed_per_stroke(changed) == pytest.approx(2.0 * speed_per_stroke(nominal), rel=0.04)
    doubled = [2.0 * hertz for hertz in settings.frequencies_hz]
    assert other_settings.frequencies_hz == pytest.approx(doubled)


@pytest.mark.parametrize("cases", [EQ_27_EXACT_STATES, EQ_27_DIFFERENCES], ids=["exact", "counts"])
def test_the_cases_of_eq_27_have_the_slopes_of_their_names(cases):
    for name, scenario in cases.items():
        law = scenario.controller
        # k = β η with β = √(1.8 kg/1.4 kg), Table 3.
        slope = math.sqrt(1.8 / 1.4) * law.eta_m_s3 / law.phi_m_s2
        assert slope == pytest.approx(float(name), rel=1e-9)
        assert law.sample_time_s == 0.002


def test_fig_9_starts_89_mm_off_with_the_continuous_law_and_no_leakage():
    assert IDEAL_SMC.initial_offset_m == -0.089
    assert IDEAL_SMC.controller.continuous
    assert IDEAL_SMC.plant.pump.internal_leakage_m3_per_s_pa == 0.0


def test_the_controllers_of_fig_12_follow_the_same_sine_with_the_same_plant():
    smc = FIG_12["smc"]
    assert smc.reference.range_deg == (10.0, 70.0)
    for scenario in FIG_12.values():
        assert (scenario.reference, scenario.plant) == (smc.reference, smc.plant)
    laws = [scenario.controller for scenario in FIG_12.values()]
    assert [law.kind for law in laws] == ["smc", "pid", "pid", "pid"]
    assert [law.velocity_feedforward for law in laws[1:]] == [0.0, 0.0, 1.0]
