import numpy as np
import pytest

from kneexo.geometry.linkage import rod_extension
from kneexo.parameters.device.linkages import G5, HINGE, LINKAGES
from kneexo.view.mechanism import BARS, HEAD, PINS, SHANK_M, THIGH_M, points

ANGLES = np.radians(np.linspace(0.0, 90.0, 181))


@pytest.fixture(params=sorted(LINKAGES))
def link(request):
    return LINKAGES[request.param]


def test_bars_do_not_change_their_length(link):
    at = points(link, ANGLES)
    for name, bar in BARS.items():
        length = np.abs(at[bar.end] - at[bar.start])
        np.testing.assert_allclose(length, length[0], rtol=0, atol=1e-12, err_msg=name)
        assert (length[0] > 0.0) == (link != HINGE or name != "thigh_plate")
    assert {*PINS, "icr"} <= set(at)
    assert BARS["link_2"].layer_m == -BARS["link_4"].layer_m != 0.0  # on either side


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


@pytest.mark.parametrize("link", [link for link in LINKAGES.values() if link != G5])
def test_cylinder_and_rod_stand_clear_of_the_thigh_and_graze_the_shank_only_at_their_pin(link):
    """Distances of the axes against the sum of the radii, at every degree.

    The cylinder of G5 crosses the thigh, beside which the linkage lies.
    """

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
