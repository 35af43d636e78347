import numpy as np
import pytest
from pydrake.math import RigidTransform

from kneexo.parameters.device.linkages import LINKAGES
from kneexo.view.mechanism import BARS, FRAMES, PINS, points
from kneexo.view.parts import Placement, icr_path, parts, placements


@pytest.fixture(params=sorted(LINKAGES))
def link(request):
    return LINKAGES[request.param]


def poses_of(link, *angles):
    """Poses of all parts; ``angles``: knee angle, reference and perhaps the angle of the wearer."""
    frames = {name: next(p.poses()) for name, p in placements(link, *angles).items()}
    return {name: frames[part.frame] @ part.pose for name, part in parts(link).items()}


def test_the_path_of_the_centre_is_that_of_its_pin(link):
    path = icr_path(link, 0.2)
    assert path.shape == (3, 91)
    for degrees in (0, 37, 90):
        (centre,) = points(link, np.radians(float(degrees)))["icr"]
        np.testing.assert_allclose(path[:, degrees], [centre.real, 0.2, centre.imag], atol=1e-15)


def test_each_part_has_a_frame_with_a_placement(link):
    leg, frames = parts(link), placements(link, 0.3, 0.4)
    assert (
        set(frames)
        == {*FRAMES, "icr", "reference", "wearer"}
        == {part.frame for part in leg.values()}
    )
    assert {*BARS, *(f"pin_{pin}" for pin in (*PINS, "icr"))} < set(leg)


@pytest.mark.parametrize("degrees", [0.0, 33.0, 90.0])
def test_bars_and_pins_are_at_their_points_at_each_angle(link, degrees):
    at, poses = points(link, np.radians(degrees)), poses_of(link, np.radians(degrees), 0.2)
    leg = parts(link)
    for name, bar in BARS.items():
        shape = leg[name].shape
        half = 0.5 * (shape.height() if bar.is_flat else shape.length())
        for sign, point in ((-1.0, at[bar.start][0]), (1.0, at[bar.end][0])):
            tip = poses[name].multiply(np.array([0.0, 0.0, sign * half]))
            expected = [point.real, bar.layer_m, point.imag]
            np.testing.assert_allclose(tip, expected, atol=1e-12, err_msg=name)
    for name in (*PINS, "icr"):
        pose, point = poses[f"pin_{name}"], at[name][0]
        np.testing.assert_allclose(pose.translation(), [point.real, 0.0, point.imag], atol=1e-12)
        assert abs(pose.rotation().matrix()[1, 2]) == pytest.approx(1.0)  # across the plane


def test_the_ghost_is_placed_at_the_reference_and_all_else_at_the_knee_angle(link):
    at_first, at_second = poses_of(link, 0.3, 0.3), poses_of(link, 0.9, 0.9)
    for name, pose in poses_of(link, 0.3, 0.9).items():
        expected = (at_second if name.startswith("reference_") else at_first)[name]
        assert pose.IsExactlyEqualTo(expected)
        if name.startswith("reference_"):
            other = at_second[name.removeprefix("reference_")]
            assert pose.IsExactlyEqualTo(other)


def test_the_limb_moves_with_the_wearer_and_the_brace_with_the_exoskeleton(link):
    at_knee, at_wearer = poses_of(link, 0.3, 0.3), poses_of(link, 0.9, 0.9)
    limb = {"shank", "foot", "calf", "shin", "heel", "toes"}
    for name, pose in poses_of(link, 0.3, 0.3, 0.9).items():
        expected = (at_wearer if name in limb else at_knee)[name]
        assert pose.IsExactlyEqualTo(expected)


def test_the_thigh_stands_still_and_the_foot_swings_over_the_ground(link):
    leg, straight, ground = parts(link), poses_of(link, 0.0, 0.0), -0.438
    half = 0.5 * leg["sole"].shape.size()
    for angle in np.radians([5.0, 20.0, 35.0, 60.0]):
        bent = poses_of(link, angle, angle)
        for name, part in leg.items():
            if part.frame == "thigh":
                assert straight[name].IsNearlyEqualTo(bent[name], 1e-12)
        corners = bent["sole"].multiply((np.array([[1, 1, -1], [-1, 1, -1]]) * half).T)
        assert ground < corners[2].min() < ground + 0.4


def test_a_frame_has_its_x_axis_along_its_direction():
    (pose,) = Placement(np.array([0.1 + 0.2j]), np.array([0.6 + 0.8j])).poses()
    np.testing.assert_allclose(pose.multiply(np.zeros(3)), [0.1, 0.0, 0.2], atol=1e-15)
    np.testing.assert_allclose(pose.multiply(np.array([1.0, 0.0, 0.0])), [0.7, 0.0, 1.0])
    np.testing.assert_allclose(pose.rotation().matrix()[:, 1], [0.0, 1.0, 0.0], atol=1e-15)
    assert isinstance(pose, RigidTransform)
