from __future__ import annotations

import pytest

from kneexo.errors import ParameterError
from kneexo.studies.size.settings import SizeSettings


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"factors": (1.0, 1.0)}, "factors: must increase"),
        ({"walking_factors": (2.0, 1.0)}, "walking_factors: must increase"),
        ({"factors": ()}, "factors has 0 values: must have at least 1"),
        (
            {"acceleration_limit_min_rad_s2": 1e5},
            "acceleration_limit_min_rad_s2 = 100000 rad/s² must be below",
        ),
        ({"cycles": 1}, "cycles = 1 is out of range: must be finite and >= 2 and <= 1000"),
    ],
)
def test_settings_that_contradict_themselves_are_refused(values, message):
    with pytest.raises(ParameterError) as caught:
        SizeSettings(**values)
    assert message in str(caught.value)
