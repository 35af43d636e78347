import pytest

from kneexo.errors import ParameterError
from kneexo.studies.controller.settings import ControllerSettings


def test_the_band_of_settling_is_smaller_than_the_steps():
    with pytest.raises(ParameterError, match=r"settling_band_deg = 0\.2 deg: must be less than"):
        ControllerSettings(step_deg=0.2)


def test_a_grid_must_increase():
    with pytest.raises(ParameterError, match=r"etas_m_s3: must increase"):
        ControllerSettings(etas_m_s3=(2.0, 1.0))
    with pytest.raises(ParameterError, match=r"lambdas_per_s"):
        ControllerSettings(lambdas_per_s=(-1.0, 1.0))
