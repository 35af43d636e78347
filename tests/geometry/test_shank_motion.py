"""Motion of the shank against a construction with circles, and against differences."""

import numpy as np
import pytest

from kneexo.errors import ParameterError
from kneexo.geometry.shank_motion import anatomical_motion, linkage_motion
from kneexo.parameters import GAIT2392, HINGE, LINKAGES, AnatomicalKneeParameters

RANGE = np.radians(np.linspace(0.0, 90.0, 91))
MM = 1e-3
names = pytest.mark.parametrize("name", LINKAGES)


def crank_crossing(link, angle):
    """Return where the lines O_A–A and O_B–B of a linkage cross, in the frame of its ground.

    A is on circles about O_A and about B, and B is on a circle about O_B: the joints follow from a
    search over the angle of link 4, without the equations of the package.
    """
    o_a, o_b = complex(link.o_a_x_m, link.o_a_y_m), complex(link.o_b_x_m, link.o_b_y_m)

    def joints(theta_4):
        b = o_b + link.a_4_m * np.exp(1j * theta_4)
        return b - link.a_3_m * np.exp(1j * (angle - link.phi_rad)), b

    theta_4 = np.linspace(-np.pi, np.pi, 40001)
    a, b = joints(theta_4)
    gap = np.abs(a - o_a) - link.a_2_m
    found = []
    for at in np.flatnonzero(np.diff(np.sign(gap))):
        low, high = theta_4[at], theta_4[at + 1]
        for _ in range(60):
            middle = 0.5 * (low + high)
            value = np.abs(joints(middle)[0] - o_a) - link.a_2_m
            low, high = (middle, high) if (value > 0.0) == (gap[at] > 0.0) else (low, middle)
        a, b = joints(low)
        if np.sign(np.imag(np.conj(a - o_a) * (b - o_b))) == link.branch:
            along = np.array([[(a - o_a).real, (o_b - b).real], [(a - o_a).imag, (o_b - b).imag]])
            offset = o_b - o_a
            share = np.linalg.solve(along, [offset.real, offset.imag])[0]
            found.append((o_a + share * (a - o_a), a, b))
    ((centre, a, b),) = found
    return centre, a, b


@pytest.mark.parametrize("name", ["G1", "G2", "G3", "G4"])
def test_the_centre_is_where_the_cranks_cross(name):
    link = LINKAGES[name]
    angles = np.radians([5.0, 40.0, 85.0])
    motion = linkage_motion(link, angles)
    start_a, start_b = crank_crossing(link, 0.0)[1:]
    for angle, centre in zip(angles, motion.fixed_centrode, strict=True):
        expected, _, b = crank_crossing(link, angle)
        if name == "G1":  # the shank is the ground: to the frame of the thigh, mirrored
            expected = -np.conj((expected - b) * np.exp(-1j * angle) + start_b)
        # The two lines cross at 8.5° at least, so the bisection's 1e-15 stays below 1e-12.
        assert centre == pytest.approx(expected, abs=1e-11)
    assert abs(abs(start_a - start_b) - link.a_3_m) < 1e-12


@names
def test_the_shank_starts_at_its_origin_and_its_rate_is_a_difference(name):
    step = 1e-5
    before, now, after = (linkage_motion(LINKAGES[name], RANGE + n * step) for n in (-1, 0, 1))
    assert linkage_motion(LINKAGES[name], 0.0).translation == pytest.approx(0.0, abs=1e-16)
    # The error of a central difference is h²/6 of the third derivative, which is below 10 m.
    difference = (after.translation - before.translation) / (2.0 * step)
    np.testing.assert_allclose(now.rate, difference, atol=1e-8)


@names
def test_the_moving_centrode_rolls_on_the_fixed_one(name):
    motion = linkage_motion(LINKAGES[name], RANGE)
    rolled = motion.translation + motion.moving_centrode * motion.turn
    np.testing.assert_allclose(rolled, motion.fixed_centrode, atol=1e-15)


def test_a_hinge_turns_about_its_axis():
    motion = linkage_motion(HINGE, RANGE)
    np.testing.assert_allclose(motion.translation, 0.0, atol=1e-16)
    np.testing.assert_allclose(motion.fixed_centrode, 0.0, atol=1e-15)


def test_the_centres_of_gait2392_are_the_known_ones():
    centres = anatomical_motion(GAIT2392, np.radians(np.arange(0.0, 91.0, 15.0))).fixed_centrode
    # From another program, rounded to 0.1 mm.
    backwards = np.array([8.5, 7.7, 8.6, 9.9, 10.7, 11.6, 13.2])
    up = np.array([-5.6, -13.7, -11.8, -12.8, -12.9, -12.2, -11.5])
    np.testing.assert_allclose(centres / MM, backwards + 1j * up, atol=0.08)


def test_the_rate_of_the_anatomical_knee_is_a_difference():
    angles, step = np.radians([1.0, 33.0, 88.0]), 1e-5
    after, before = (anatomical_motion(GAIT2392, angles + s * step) for s in (1, -1))
    difference = (after.translation - before.translation) / (2.0 * step)
    np.testing.assert_allclose(anatomical_motion(GAIT2392, angles).rate, difference, atol=1e-9)


def test_a_larger_knee_moves_in_proportion():
    small = anatomical_motion(GAIT2392, RANGE)
    large = anatomical_motion(AnatomicalKneeParameters(size=1.25), RANGE)
    np.testing.assert_allclose(large.translation, 1.25 * small.translation, rtol=1e-14)
    np.testing.assert_allclose(large.rate, 1.25 * small.rate, rtol=1e-14)


def test_an_angle_without_nodes_is_refused_with_the_range():
    with pytest.raises(
        ParameterError, match="over -120 … 120 deg of flexion, must have them at 130 deg"
    ):
        anatomical_motion(GAIT2392, np.radians([20.0, 130.0]))
