import dataclasses
import math

import pytest
from contest_cases import (
    made_up,
    metrics_of,
)

from kneexo.studies.contest.figures import figures, outcome


def test_a_box_has_the_middle_half_of_the_plants_and_lines_have_90_percent():
    study = made_up()
    plants = [metrics_of(0.01 * k, margin=1.0 - 0.001 * k) for k in range(1, 101)]
    plants.append(metrics_of(math.nan, margin=0.3))
    tested = study.tested | {"SMC": plants}
    ax = outcome(dataclasses.replace(study, tested=tested)).axes[2]
    across, along, median = ax.lines[:3]
    assert across.get_xdata() == pytest.approx([0.05, 0.95])
    assert along.get_ydata() == pytest.approx([0.904, 0.994])
    assert median.get_xydata()[0] == pytest.approx([0.5, 0.949])
    corners = ax.patches[0].get_xy()
    assert corners.min(axis=0) == pytest.approx([0.25, 0.924])
    assert corners.max(axis=0) == pytest.approx([0.75, 0.974])


@pytest.mark.slow
def test_a_contest_whose_every_run_failed_is_drawn():
    study = made_up()
    failed = {name: [metrics_of(math.nan)] * 4 for name in study.tested}
    figure = figures(dataclasses.replace(study, tested=failed, other_reference=failed))["contest"]
    figure.canvas.draw()
    assert [ax.get_xlim() for ax in figure.axes[:3]] == [(0.1, 10.0)] * 3
