"""Settings, numbers and helpers of the tests of the controller study."""

import math
from functools import cache
from itertools import product

import numpy as np

from kneexo.parameters import Scenario, SimulationParameters, SineReference
from kneexo.studies.controller.result import MAP_METRICS, METRICS, ControllerResult, LimitCycleCase
from kneexo.studies.controller.settings import ControllerSettings

GRID = ControllerSettings(
    lambdas_per_s=(10.0, 20.0, 40.0),
    phis_m_s2=(0.32, 1.0, 3.2, 10.0, 32.0),
    etas_m_s3=(2.8e4, 2.8e5),
    map_time_constants_s=(0.01, 0.02),
    map_slopes_per_s=(1e4, 1e5),
)
SHAPE = (3, 5, 2)
VARIANTS = ("as built", "exact encoder", "unlimited acceleration")
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


def limit_cycle_case(number, lambda_, variant):
    return LimitCycleCase(
        lambda_per_s=lambda_,
        variant=variant,
        stable=number != 2,
        disk_margin=0.11 + 0.01 * number,
        max_error_deg=1.1 + number,
        mean_command_change_rpm=31.0 + number,
        oscillation_at_rest_deg=0.21 + 0.1 * number,
        time_s=np.array([0.0, 1.0, 2.0]),
        error_deg=np.array([0.1, 0.2, 0.3]) + number,
        failure="",
    )


@cache
def made_up():
    """A study in which no two numbers are equal."""
    grid = np.arange(30.0).reshape(SHAPE)
    values = {name: 0.05 + 0.001 * grid + 0.04 * n for n, name in enumerate(METRICS)}
    values["stable"] = np.where(grid % 7 == 3, 0.0, 1.0)
    values["settling_s"][0, 0, 0] = math.inf
    values["disk_margin"][2, 4, 0] = math.nan
    mapped = {
        name: 0.3 + 0.1 * n + np.array([[0.01, 0.02], [0.03, 0.04]])
        for n, name in enumerate(MAP_METRICS)
    }
    mapped["stable"] = np.array([[1.0, 1.0], [1.0, 0.0]])
    limit_cycle = [
        limit_cycle_case(n, lambda_, variant)
        for n, (lambda_, variant) in enumerate(product(GRID.limit_cycle_lambdas_per_s, VARIANTS))
    ]
    failures = {(10.0, 0.32, 2.8e4): "left the range"}
    return ControllerResult(Scenario(), GRID, values, failures, tuple(limit_cycle), mapped)


SMALL_STUDY = {"scenario": BASE, "settings": SMALL}
"""Arguments of a study that takes about a second."""
