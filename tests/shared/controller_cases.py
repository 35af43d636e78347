"""Settings, numbers and helpers of the tests of the controller study."""

from kneexo.parameters import (
    Scenario,
    SimulationParameters,
    SineReference,
)
from kneexo.studies.controller.settings import ControllerSettings

GRID = ControllerSettings(
    lambdas_per_s=(10.0, 20.0, 40.0),
    phis_m_s2=(0.32, 1.0, 3.2, 10.0, 32.0),
    etas_m_s3=(2.8e4, 2.8e5),
    map_time_constants_s=(0.01, 0.02),
    map_slopes_per_s=(1e4, 1e5),
)
SHAPE = (3, 5, 2)
BASE = Scenario(
    reference=SineReference(amplitude_deg=1.0, frequency_hz=4.0),
    simulation=SimulationParameters(duration_s=0.5),
)
SMALL = ControllerSettings(
    lambdas_per_s=(20.0, 40.0),
    phis_m_s2=(1.0, 3.2),
    etas_m_s3=(2.8e5,),
    step_duration_s=0.4,
    large_step_deg=5.0,
    fast_duration_s=0.2,
    fast_frequency_hz=10.0,
    fast_amplitude_deg=0.2,
    hold_duration_s=0.1,
    limit_cycle_lambdas_per_s=(20.0,),
    map_time_constants_s=(0.01, 0.02),
    map_slopes_per_s=(1e4, 1e5),
)
