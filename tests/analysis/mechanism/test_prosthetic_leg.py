"""Leg length, toe clearance and stance against compass constructions and statics by hand."""

import numpy as np
import pytest

from kneexo.analysis import leg_length, swing_clearance, voluntary_stability
from kneexo.analysis.mechanism.prosthetic_leg import voluntary_margin_n_m
from kneexo.errors import LinkageError, ParameterError
from kneexo.geometry.linkage import icr, pose
from kneexo.parameters import G1, G2, G3, G4, GAIT2392, WalkingLegParameters
from kneexo.parameters.task.gait import gait_knee_flexion

MM = 1e-3
AXIS = G3.changed(
    {
        **dict.fromkeys(("o_a_x_m", "o_a_y_m", "o_b_x_m", "o_b_y_m"), 0.0),
        **dict.fromkeys(("a_2_m", "a_3_m", "a_4_m"), 0.03),
    }
)  # a hinge at the origin
LEG = WalkingLegParameters()


# The figures were computed without kneexo. Half a unit of the last digit.
@pytest.mark.parametrize(
    ("knee", "shorter_mm"), [(G1, (8.0, 16.3, 18.9)), (GAIT2392, (-2.9, -6.5, -10.9))]
)
def test_leg_has_its_known_length(knee, shorter_mm):
    of = leg_length(knee, [30.0, 60.0, 90.0])
    assert of.shortening_m / MM == pytest.approx(shorter_mm, abs=0.05)
    assert of.knee_angle_deg == pytest.approx([30.0, 60.0, 90.0])
    # A straight leg; the tibia's origin of gait2392 is then 4 mm beside the line from the hip.
    assert leg_length(knee, 0.0).distance_m == pytest.approx([0.82], abs=5e-5)


def moved(link, point, angle):
    """Place of a coupler's point, which is ``point`` at full extension, by the joints alone."""
    now, straight = pose(link, angle), pose(link, 0.0)
    share = (point - straight.joint_a) / (straight.joint_b - straight.joint_a)
    return now.joint_a + share * (now.joint_b - now.joint_a)


def hip_and_foot(link, angle, forwards_m, down_m):
    """Hip, knee's origin on the thigh, and a point of the foot, with the direction forwards."""
    hip, origin, below = 0.42j, 0.0j, -1j * down_m
    if link == G1:  # the shank is the ground, and x points forwards
        return moved(link, hip, angle), moved(link, origin, angle), below + forwards_m, 1.0
    return hip, origin, moved(link, below - forwards_m, angle), -1.0


@pytest.mark.parametrize("link", [G1, G2, G3, G4], ids=["G1", "G2", "G3", "G4"])
def test_prosthetic_leg_is_that_of_its_joints(link):
    degrees = np.linspace(0.0, 90.0, 7)
    hip, _, ankle, _ = hip_and_foot(link, np.radians(degrees), 0.0, 0.40)
    of = leg_length(link, degrees)
    np.testing.assert_allclose(of.distance_m, np.abs(hip - ankle), atol=1e-14)
    # Law of cosines.
    hinge = np.sqrt(0.42**2 + 0.40**2 + 2.0 * 0.42 * 0.40 * np.cos(np.radians(degrees)))
    np.testing.assert_allclose(of.hinge_distance_m, hinge, atol=1e-14)


@pytest.mark.parametrize("link", [G1, G3], ids=["G1", "G3"])
def test_depth_of_the_toe_is_that_of_its_joints(link):
    of = swing_clearance(link)
    percent, flexion, _ = gait_knee_flexion()
    np.testing.assert_array_equal(of.knee_angle_deg, flexion[percent >= 62.0])
    np.testing.assert_array_equal(of.gait_percent, np.arange(62.0, 101.0))
    angle, thigh = np.radians(of.knee_angle_deg), np.radians(of.thigh_flexion_deg)
    hip, origin, toe, forwards = hip_and_foot(link, angle, 0.216, 0.468)
    axis = (hip - origin) / 0.42  # up along the thigh; its front is a quarter turn forwards
    front = forwards * -1j * axis
    vertical = axis * np.cos(thigh) + front * np.sin(thigh)
    depth = np.real(np.conj(vertical) * (hip - toe))
    np.testing.assert_allclose(of.toe_depth_m, depth, atol=1e-14)
    # A chain of two bars: thigh, then shank and foot.
    hinge = 0.42 * np.cos(thigh) + 0.468 * np.cos(angle - thigh) + 0.216 * np.sin(angle - thigh)
    np.testing.assert_allclose(of.hinge_toe_depth_m, hinge, atol=1e-14)
    assert of.thigh_flexion_deg[[0, 13, 25, 38]] == pytest.approx([-10.0, 15.0, 25.0, 20.0])
    assert of.least_clearance_gain_m == pytest.approx(hinge.max() - depth.max(), abs=1e-14)
    np.testing.assert_allclose(of.clearance_gain_m, hinge - depth, atol=1e-14)


def test_a_hinge_at_the_origin_gains_nothing_and_the_wearers_own_knee_loses():
    assert np.abs(swing_clearance(AXIS).clearance_gain_m).max() < 1e-15
    assert swing_clearance(G1).least_clearance_gain_m > 0.01
    assert swing_clearance(GAIT2392).least_clearance_gain_m < 0.0


def cross(arm, force):
    return (np.conj(arm) * force).imag


def hip_extension_by_statics(centre, contact, leg):
    """Moment of the hip's muscles, from the equilibria of shank and leg.

    The force of the ground has the given part along the line to the hip. Its transverse part
    follows from the shank, whose knee turns about ``centre``.
    """
    hip = 0.42j
    line = (hip - contact) / abs(hip - contact)
    arms = [cross(contact - centre, leg.load_n * line), cross(contact - centre, 1j * line)]
    transverse = (leg.knee_moment_n_m - arms[0]) / arms[1]
    return -cross(contact - hip, leg.load_n * line + transverse * 1j * line)


@pytest.mark.parametrize("knee_moment_n_m", [0.0, 12.0])
@pytest.mark.parametrize("knee_angle_deg", [0.0, 8.0])
def test_hip_moments_hold_the_leg_in_equilibrium(knee_angle_deg, knee_moment_n_m):
    leg = LEG.changed({"knee_moment_n_m": knee_moment_n_m})
    at = pose(G3, np.radians(knee_angle_deg))
    centre = complex(*icr(G3, at.theta_3, at.theta_4))
    heel, ball = (moved(G3, x - 0.468j, np.radians(knee_angle_deg)) for x in (0.05, -0.14))
    of = voluntary_stability(G3, knee_angle_deg, leg)
    assert of.centre == pytest.approx(centre, abs=1e-12)
    extension = hip_extension_by_statics(centre, heel, leg)
    assert of.hip_extension_n_m == pytest.approx(extension, rel=1e-9)
    flexion = -hip_extension_by_statics(centre, ball, leg)
    assert of.hip_flexion_n_m == pytest.approx(flexion, rel=1e-9)


def test_the_margin_of_the_zone_is_the_strength_of_the_hip_less_the_moment_that_it_needs():
    for knee, needed in {"hip_extension_n_m": 100.0, "hip_flexion_n_m": 50.0}.items():
        leg = LEG.changed({"hip_extension_n_m": 1e3, "hip_flexion_n_m": 1e3, knee: needed})
        for linkage in (G2, G3):
            stance = voluntary_stability(linkage, 0.0, leg)
            margin = voluntary_margin_n_m(np.array([stance.centre]), leg)
            assert margin == pytest.approx([needed - getattr(stance, knee)], rel=1e-12)


def test_a_knee_on_the_load_line_needs_no_hip_moment_and_one_behind_it_is_stable():
    # The line from the heel to the hip passes 23.6 mm behind the origin.
    behind = 0.05 * 0.42 / 0.888
    on, off = (
        voluntary_stability(AXIS.changed(dict.fromkeys(("o_a_x_m", "o_b_x_m"), x)))
        for x in (behind, behind + 0.01)
    )
    assert on.hip_extension_n_m == pytest.approx(0.0, abs=1e-9)
    assert off.hip_extension_n_m < 0.0 < off.hip_flexion_n_m


def test_a_linkage_that_breaks_and_a_knee_without_nodes_are_refused():
    with pytest.raises(LinkageError, match="a_2_m must be"):
        leg_length(G1.changed({"a_2_m": 0.2}))
    with pytest.raises(ParameterError, match="must have them at 150 deg"):
        leg_length(GAIT2392, 150.0)
