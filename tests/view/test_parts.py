import numpy as np
import pytest

from kneexo.parameters.linkages import LINKAGES
from kneexo.view.mechanism import BARS, GHOST, PINS, points
from kneexo.view.parts import Placement, icr_path, placements, shapes


@pytest.fixture(params=sorted(LINKAGES))
def link(request):
    return LINKAGES[request.param]


def test_the_path_of_the_centre_is_that_of_its_pin(link):
    path = icr_path(link, 0.2)
    assert path.shape == (3, 91)
    for degrees in (0, 37, 90):
        (centre,) = points(link, np.radians(float(degrees)))["icr"]
        np.testing.assert_allclose(path[:, degrees], [centre.real, 0.2, centre.imag], atol=1e-15)


def test_each_part_with_a_shape_has_a_placement(link):
    names = {*BARS, *(f"reference_{bar}" for bar in GHOST), *(f"pin_{pin}" for pin in PINS)}
    assert set(shapes(link)) == set(placements(link, 0.3, 0.4)) == names | {"pin_icr"}


def test_the_ghost_is_placed_at_the_reference_and_all_else_at_the_knee_angle(link):
    at_first, at_second = placements(link, 0.3, 0.3), placements(link, 0.9, 0.9)
    for name, part in placements(link, 0.3, 0.9).items():
        expected = (at_second if name.startswith("reference_") else at_first)[name]
        np.testing.assert_array_equal(part.middle, expected.middle)


def test_a_bar_lies_between_its_points():
    start, end = 0.1 + 0.2j, 0.4 + 0.6j
    middle, direction = np.array([0.5 * (start + end)]), np.array([(end - start) / 0.5])
    (pose,) = Placement(middle, direction, 0.3).poses()
    for sign, point in ((-1.0, start), (1.0, end)):
        tip = pose.multiply(np.array([0.0, 0.0, sign * 0.25]))
        np.testing.assert_allclose(tip, [point.real, 0.3, point.imag], atol=1e-12)


def test_a_pin_lies_across_the_plane():
    (pose,) = Placement(np.array([0.1 + 0.2j])).poses()
    np.testing.assert_allclose(pose.multiply(np.zeros(3)), [0.1, 0.0, 0.2], atol=1e-15)
    end = pose.multiply(np.array([0.0, 0.0, 1.0]))
    assert abs(end[1]) == pytest.approx(1.0)


def test_a_placement_in_a_frame_has_the_pose_that_it_has_in_the_world():
    part = Placement(np.array([0.1 + 0.2j]), np.array([np.exp(0.3j)]), 0.02)
    frame = Placement(np.array([0.5 - 0.1j]), np.array([np.exp(-1.1j)]))
    (world,), (local,), (base,) = part.poses(), part.seen_from(frame).poses(), frame.frames()
    np.testing.assert_allclose((base @ local).GetAsMatrix4(), world.GetAsMatrix4(), atol=1e-14)


def test_only_a_placement_that_neither_moves_nor_turns_is_constant():
    still, moving = np.full(3, 0.1j), np.array([0.1j, 0.1j, 0.2j])
    assert Placement(still, still / 0.1).is_constant
    assert not Placement(moving, still / 0.1).is_constant
    assert not Placement(still, np.exp(moving)).is_constant
    assert not Placement(moving).is_constant
