from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from size_cases import (
    SPEED_MM_S,
)

from kneexo.studies.size.figures import figures, motions


@pytest.mark.slow
def test_a_map_in_which_every_run_fails_has_its_axes_all_the_same(by_hand):
    none = dataclasses.replace(by_hand, bandwidth_map_hz=np.full((3, 3), math.nan))
    ax = figures(none)["sizing_maps"].axes[0]
    assert [text.get_text() for text in ax.texts] == ["every run fails"]
    assert ax.get_xlim() == pytest.approx((0.5 * SPEED_MM_S, 2.0 * SPEED_MM_S))
    assert ax.get_ylim() == pytest.approx((5e3, 2e4))
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")


def test_the_view_shows_what_walks(by_hand):
    shown = motions(by_hand)
    assert list(shown) == ["hardware as it is", "sized hardware"]
    for (plant, columns), trace in zip(shown.values(), by_hand.traces.values(), strict=True):
        assert plant is by_hand.scenario.plant
        assert columns["time_s"][0] == 0.0
        np.testing.assert_allclose(np.diff(columns["time_s"]), np.diff(trace["time_s"]))
        assert columns["knee_angle_rad"] is trace["knee_angle_rad"]
    stopped = dataclasses.replace(by_hand, traces=by_hand.traces | {"nominal": {}})
    assert list(motions(stopped)) == ["sized hardware"]
