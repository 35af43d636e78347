import dataclasses
import math

import pytest
from contest_cases import (
    made_up,
    metrics_of,
)

from kneexo.studies.contest.figures import figures


@pytest.mark.slow
def test_a_contest_whose_every_run_failed_is_drawn():
    study = made_up()
    failed = {name: [metrics_of(math.nan)] * 4 for name in study.tested}
    figure = figures(dataclasses.replace(study, tested=failed, other_reference=failed))["contest"]
    figure.canvas.draw()
    assert [ax.get_xlim() for ax in figure.axes[:3]] == [(0.1, 10.0)] * 3
