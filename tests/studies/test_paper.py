import math

import pytest

from kneexo.analysis.frequency.bandwidth import rod_amplitude_m, rod_limits
from kneexo.studies.paper import (
    EQ_27_DIFFERENCES,
    EQ_27_EXACT_STATES,
    FIG_13_SCALING,
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
