"""Leg of a linkage that would be its knee: units, provenance and faulty values."""

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import WalkingLegParameters
from kneexo.parameters.fields.fields import unit_of


def test_defaults_are_those_of_a_body_of_1_75_m_where_winter_has_the_length():
    leg = WalkingLegParameters()
    # Winter 2009, Fig. 4.1: height of the ankle 0.039, and length of the foot 0.152, of the height.
    assert leg.ankle_height_m == pytest.approx(0.039 * 1.75, abs=5e-4)
    assert leg.heel_m + leg.toe_m == pytest.approx(0.152 * 1.75, abs=5e-4)
    assert unit_of(WalkingLegParameters.model_fields["load_n"]) == "N"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"swing_percent": (62.0, 75.0)}, "swing_percent has 2 values: must have 4"),
        ({"swing_percent": (62.0, 61.0, 87.0, 100.0)}, "swing_percent: must increase"),
    ],
)
def test_faulty_values_are_refused_in_one_line(values, message):
    with pytest.raises(ParameterError, match=message) as error:
        WalkingLegParameters(**values)
    assert "\n" not in str(error.value)
