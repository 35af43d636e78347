"""Results of the controller study that several test files read."""

import math
from itertools import product

import numpy as np
import pytest
from controller_cases import (
    BASE,
    GRID,
    SHAPE,
    SMALL,
)

from kneexo.parameters import (
    Scenario,
)
from kneexo.studies.controller.result import (
    MAP_METRICS,
    METRICS,
    ControllerResult,
    LimitCycleCase,
)
from kneexo.studies.controller.study import (
    LIMIT_CYCLE_VARIANTS,
    controller_study,
)
from kneexo.sweeps.checkpoint import Checkpoint


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    checkpoint = Checkpoint(tmp_path_factory.mktemp("study") / "checkpoint.jsonl")
    return controller_study(BASE, SMALL, checkpoint=checkpoint), checkpoint


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


@pytest.fixture(scope="session")
def by_hand():
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
        for n, (lambda_, variant) in enumerate(
            product(GRID.limit_cycle_lambdas_per_s, LIMIT_CYCLE_VARIANTS)
        )
    ]
    failures = {(10.0, 0.32, 2.8e4): "left the range"}
    return ControllerResult(Scenario(), GRID, values, failures, tuple(limit_cycle), mapped)
