"""Bars and points of the view: rigid, and where the linkage is."""

import numpy as np
import pytest

from kneexo.linkage import rod_extension
from kneexo.parameters.linkages import LINKAGES
from kneexo.view.mechanism import (
    BARS,
    HEAD,
    PINS,
    SHANK_M,
    THIGH_M,
    bar_pose,
    icr_path,
    pin_pose,
    points,
    pressure_colours,
)

ANGLES = np.radians(np.linspace(0.0, 90.0, 181))


@pytest.fixture(params=sorted(LINKAGES))
def link(request):
    return LINKAGES[request.param]


def test_bars_do_not_change_their_length(link):
    at = points(link, ANGLES)
    for name, bar in BARS.items():
        length = np.abs(at[bar.end] - at[bar.start])
        np.testing.assert_allclose(length, length[0], rtol=0, atol=1e-12, err_msg=name)
        assert length[0] > 0.0
    assert {*PINS, "icr"} <= set(at)


def test_the_thigh_stands_still_and_the_shank_turns_back_by_the_knee_angle(link):
    at = points(link, ANGLES)
    for name, bar in BARS.items():
        moves = max(np.abs(np.diff(at[point])).max() for point in (bar.start, bar.end))
        assert (moves < 1e-12) == name.startswith("thigh"), name
    assert at["hip"][0] == pytest.approx(1j * THIGH_M, abs=1e-12)
    shank = at["ankle"] - at["shank_start"]
    np.testing.assert_allclose(shank, -1j * SHANK_M * np.exp(-1j * ANGLES), atol=1e-12)
    assert at["toe"][0].real > at["ankle"][0].real  # the foot points forward


def test_cylinder_and_rod_slide_by_the_rod_extension(link):
    at = points(link, ANGLES)
    length = np.abs(at["rod_pin"] - at["cylinder_pin"])
    np.testing.assert_allclose(length, link.rod_length_m + rod_extension(link, ANGLES), rtol=1e-12)
    direction = (at["rod_pin"] - at["cylinder_pin"]) / length
    for start, end, share in (
        ("cylinder_pin", "cylinder_end", HEAD),
        ("rod_start", "rod_pin", 1.0),
    ):
        along = (at[end] - at[start]) / link.rod_length_m
        np.testing.assert_allclose(along, share * direction, atol=1e-12)
    assert (np.abs(at["rod_pin"] - at["cylinder_end"]) > 0.01).all()  # some of the rod is seen
    inside = np.abs(at["cylinder_end"] - at["cylinder_pin"]) - np.abs(
        at["rod_start"] - at["cylinder_pin"]
    )
    assert (inside > 0.05).all()  # and its other end is held


def test_cylinder_and_rod_stand_clear_of_the_thigh_and_graze_the_shank_only_at_their_pin(link):
    """Distances of the axes against the sum of the radii, at every degree."""

    def distance(at, first, second):
        """Of two bars: the ends of one from the other, which do not cross."""
        lengths = []
        for bar, other in ((first, second), (second, first)):
            start, way = at[BARS[bar].start], at[BARS[bar].end] - at[BARS[bar].start]
            for point in (at[BARS[other].start], at[BARS[other].end]):
                share = np.clip(np.real((point - start) / way), 0.0, 1.0)
                lengths.append(np.abs(start + share * way - point))
        return np.min(lengths, axis=0)

    at = points(link, ANGLES)
    for part in ("cylinder", "rod"):
        for bone in ("thigh", "shank", "foot"):
            gap = distance(at, part, bone) - BARS[part].radius_m - BARS[bone].radius_m
            assert gap.min() > (-0.01 if bone == "shank" else 0.005), (part, bone)


def test_links_have_their_lengths(link):
    at = points(link, ANGLES)
    for (start, end), length in {
        ("o_a", "a"): link.a_2_m,
        ("a", "b"): link.a_3_m,
        ("o_b", "b"): link.a_4_m,
    }.items():
        np.testing.assert_allclose(np.abs(at[end] - at[start]), length, rtol=1e-12)


def test_the_shank_turns_about_the_instantaneous_centre(link):
    """Its point at the centre does not move: by central differences of the shank's pose."""
    angle, step = np.radians(40.0), 1e-5
    before, now, after = (points(link, angle + s) for s in (-step, 0.0, step))

    def carried(at):
        """Where the point of the shank that is at the centre now is in another pose."""
        axis = (at["ankle"] - at["shank_start"]) / (now["ankle"] - now["shank_start"])
        return at["shank_start"] + axis * (now["icr"] - now["shank_start"])

    moved = abs(carried(after) - carried(before))[0]
    of_ankle = abs(after["ankle"] - before["ankle"])[0]
    assert moved < 1e-6 * of_ankle


def test_the_path_of_the_centre_is_that_of_its_pin(link):
    path = icr_path(link, 0.2)
    assert path.shape == (3, 91)
    for degrees in (0, 37, 90):
        (centre,) = points(link, np.radians(float(degrees)))["icr"]
        np.testing.assert_allclose(path[:, degrees], [centre.real, 0.2, centre.imag], atol=1e-15)


def test_a_bar_lies_between_its_points():
    pose = bar_pose(0.1 + 0.2j, 0.4 + 0.6j, 0.3)
    half = 0.25
    for sign, point in ((-1.0, 0.1 + 0.2j), (1.0, 0.4 + 0.6j)):
        end = pose.multiply(np.array([0.0, 0.0, sign * half]))
        np.testing.assert_allclose(end, [point.real, 0.3, point.imag], atol=1e-12)


def test_a_pin_lies_across_the_plane():
    pose = pin_pose(0.1 + 0.2j, 0.3)
    np.testing.assert_allclose(pose.multiply(np.zeros(3)), [0.1, 0.3, 0.2], atol=1e-15)
    end = pose.multiply(np.array([0.0, 0.0, 1.0]))
    assert abs(end[1] - 0.3) == pytest.approx(1.0)


def test_the_cylinder_is_blue_at_negative_and_red_at_positive_pressure():
    colours = pressure_colours(np.array([-2e6, -1e6, 0.0, 1e6, 2e6]), 2e6)
    low, half_low, none, half_high, high = colours
    assert low[2] == max(low) > 0.8
    assert high[0] == max(high) > 0.8
    assert np.ptp(none) == 0.0
    np.testing.assert_allclose(half_low, 0.5 * (low + none))
    np.testing.assert_allclose(half_high, 0.5 * (high + none))
    assert ((colours >= 0.0) & (colours <= 1.0)).all()
    np.testing.assert_array_equal(pressure_colours(np.array([9e6]), 2e6)[0], high)
    assert np.isfinite(pressure_colours(np.zeros(2), 0.0)).all()
