"""Linkage mathematics against Table 1, a compass construction, and differences."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from table_1 import P_MM_DEG, THETA_4_DEG, changed

from kneexo.errors import LinkageError
from kneexo.geometry.linkage import (
    encoder_angle,
    eq6_sign,
    icr,
    knee_angle_from_encoder,
    knee_angle_from_rod,
    moment_arm,
    polynomial,
    polynomial_derivative,
    pose,
    rod_anchor,
    rod_extension,
    wrap,
)
from kneexo.parameters import (
    G1,
    G2,
    G3,
    G4,
    G5,
    HINGE,
    LINKAGES,
    RodPolynomialParameters,
)

MM = 1e-3
RANGE = np.radians(np.linspace(0.0, 90.0, 901))

names = pytest.mark.parametrize("name", LINKAGES)
linkages = st.sampled_from([G1, G2, G3, G4, G5])
knee_angles = st.floats(0.0, np.pi / 2.0)


# ------------------------------------------------------------------------------- Table 1


def test_table_1_in_si_equals_the_printed_polynomial():
    x = polynomial(RodPolynomialParameters().p_si, RANGE)
    # Rounding only: six products of at most 3e2 mm.
    np.testing.assert_allclose(x, MM * np.polyval(P_MM_DEG, np.degrees(RANGE)), atol=1e-15)


def test_table_1_polynomials_are_inverse_only_away_from_the_extended_knee():
    table_1 = RodPolynomialParameters()

    def error_deg(low, high):
        knee = np.linspace(low, high, 2001)
        x_mm = polynomial(table_1.p_mm_deg, knee)
        return np.abs(polynomial(table_1.q_deg_mm, x_mm) - knee).max()

    # Figures known to 0.01 deg.
    assert error_deg(10.0, 70.0) == pytest.approx(0.10, abs=0.005)
    assert error_deg(5.0, 88.5) == pytest.approx(0.32, abs=0.005)
    assert error_deg(0.0, 0.0) == pytest.approx(1.54, abs=0.005)


def test_polynomial_derivatives_equal_numpy_for_every_order():
    for order in range(5):
        assert polynomial_derivative(P_MM_DEG, order) == pytest.approx(
            np.polyder(np.array(P_MM_DEG), order), rel=1e-15
        )


@pytest.mark.parametrize(
    ("name", "rmse", "largest"),
    [
        ("G1", 0.0295, 0.153),
        ("G2", 0.0294, 0.152),
        ("G3", 0.0161, 0.070),
        ("G4", 0.0453, 0.217),
        ("G5", 0.0276, 0.149),
    ],
)
def test_linkage_reproduces_table_1(name, rmse, largest):
    error = rod_extension(LINKAGES[name], RANGE) / MM - np.polyval(P_MM_DEG, np.degrees(RANGE))
    # The figures are known to one unit in their last digit.
    assert np.sqrt(np.mean(error**2)) == pytest.approx(rmse, abs=1e-4)
    assert np.abs(error).max() == pytest.approx(largest, abs=1e-3)


def test_a_hinge_obeys_the_cosine_law_and_misses_table_1_by_its_known_error():
    link = HINGE
    pin = pose(link, 0.0).rod_pin  # the axis is the origin
    a, b = link.rod_anchor_radius_m, abs(pin)
    gap = link.rod_anchor_angle_rad - np.angle(pin) - RANGE
    length = np.sqrt(a**2 + b**2 - 2.0 * a * b * np.cos(gap))
    # Rounding of lengths of 0.6 m, and the arm divides by 0.4 m.
    np.testing.assert_allclose(rod_extension(link, RANGE), length - link.rod_length_m, atol=1e-15)
    np.testing.assert_allclose(moment_arm(link, RANGE), a * b * np.sin(gap) / length, atol=1e-15)
    np.testing.assert_allclose(np.diff(encoder_angle(link, RANGE)), np.diff(RANGE), atol=1e-14)
    error = rod_extension(link, RANGE) / MM - np.polyval(P_MM_DEG, np.degrees(RANGE))
    # Another program, rounded to the last digit.
    assert np.sqrt(np.mean(error**2)) == pytest.approx(0.3404, abs=1e-4)
    assert np.abs(error).max() == pytest.approx(1.626, abs=1e-3)


# -------------------------------------------------------------------------- check values


@pytest.mark.parametrize(
    ("theta_4_deg", "knee_deg", "rod_mm"), [(82.524, 0.000, 148.044), (-4.705, 90.001, 2.223)]
)
def test_g1_meets_its_check_values(theta_4_deg, knee_deg, rod_mm):
    knee = knee_angle_from_encoder(G1, np.radians(theta_4_deg), -1)
    # Half a unit of the last printed digit.
    assert np.degrees(knee) == pytest.approx(knee_deg, abs=5e-4)
    assert rod_extension(G1, knee) == pytest.approx(rod_mm * MM, abs=5e-7)


@names
def test_encoder_angle_runs_between_its_known_ends_without_a_jump(name):
    theta_4 = np.degrees(encoder_angle(LINKAGES[name], RANGE))
    assert theta_4[[0, -1]] == pytest.approx(THETA_4_DEG[name], abs=5e-4)  # last printed digit
    # 0.1 deg of knee moves link 4 by at most 0.1/0.35 deg, on G5.
    assert np.abs(np.diff(theta_4)).max() < 0.3


# ---------------------------------------------------------------------- closure of the loop


@given(link=linkages, knee=st.floats(np.radians(-2.0), np.radians(91.0)))
def test_vector_loop_closes(link, knee):
    at = pose(link, knee)
    o_a = link.o_a_x_m + 1j * link.o_a_y_m
    o_b = link.o_b_x_m + 1j * link.o_b_y_m
    # Lee et al. 2020, Eq. 1: each bar keeps its length. Rounding of acos near ±1 gives 1e-15 m.
    assert abs(at.joint_a - o_a) == pytest.approx(link.a_2_m, abs=1e-14)
    assert abs(at.joint_b - at.joint_a) == pytest.approx(link.a_3_m, abs=1e-14)
    assert abs(at.joint_b - o_b) == pytest.approx(link.a_4_m, abs=1e-14)
    assert abs(at.rod_pin - at.joint_b) == pytest.approx(link.rod_pin_radius_m, abs=1e-14)
    rod = abs(at.rod_pin - rod_anchor(link))
    assert rod - link.rod_length_m == pytest.approx(at.rod_extension, abs=1e-14)
    coupler = at.joint_b - at.joint_a
    assert wrap(np.angle(coupler) + link.phi_rad - knee) == pytest.approx(0.0, abs=1e-12)


@names
def test_pose_equals_the_compass_construction(name, compass):
    link = LINKAGES[name]
    walk = compass(link, np.radians(np.linspace(*THETA_4_DEG[name], 2001)))
    at = pose(link, walk.knee_angle)
    # acos near the ends loses a few digits: 1e-12 rad, and times 0.3 m.
    np.testing.assert_allclose(at.theta_4, walk.theta_4, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(at.joint_a, walk.joint_a, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(at.joint_b, walk.joint_b, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(at.rod_pin, walk.rod_pin, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(at.rod_extension, walk.rod_extension, rtol=0.0, atol=1e-12)


@names
def test_eq_6_gives_the_compass_construction_back(name, compass):
    link = LINKAGES[name]
    walk = compass(link, np.radians(np.linspace(*THETA_4_DEG[name], 2001)))
    knee = knee_angle_from_encoder(link, walk.theta_4, -1)
    np.testing.assert_allclose(knee, walk.knee_angle, rtol=0.0, atol=1e-12)


@names
def test_eq_6_takes_the_minus_sign(name):
    assert eq6_sign(LINKAGES[name]) == -1
    wrong = knee_angle_from_encoder(LINKAGES[name], encoder_angle(LINKAGES[name], RANGE), 1)
    assert np.abs(np.degrees(wrong - RANGE)).min() > 1.0


def test_other_branch_swaps_the_sign_of_eq_6():
    assert eq6_sign(changed(G3, branch=-1)) == 1


@pytest.mark.parametrize("link", [G1, G2], ids=["G1", "G2"])
def test_safe_form_of_eq_6_passes_the_zero_of_b_plus_c(link, compass):
    theta_4 = np.linspace(*encoder_angle(link, np.radians([0.0, 90.0])), 200_001)
    c_1 = link.o_b_x_m - link.o_a_x_m + link.a_4_m * np.cos(theta_4)
    c_2 = link.o_b_y_m - link.o_a_y_m + link.a_4_m * np.sin(theta_4)
    b = -2.0 * c_1 * link.a_3_m
    c = link.a_2_m**2 - link.a_3_m**2 - c_1**2 - c_2**2
    crossing = np.flatnonzero(np.diff(np.sign(b + c)))
    assert crossing.size > 0
    near = np.concatenate([[theta_4[0]], theta_4[crossing[0] - 5 : crossing[0] + 6]])
    np.testing.assert_allclose(
        knee_angle_from_encoder(link, near, -1), compass(link, near).knee_angle, atol=1e-12
    )


def test_encoder_angle_out_of_reach_has_no_knee_angle():
    with np.errstate(invalid="ignore"):
        assert np.isnan(knee_angle_from_encoder(G1, np.radians(-30.0), -1))


@given(link=linkages, knee=knee_angles)
def test_knee_angle_survives_the_encoder_round_trip(link, knee):
    back = knee_angle_from_encoder(link, encoder_angle(link, knee), -1)
    assert back == pytest.approx(knee, abs=1e-12)  # 1e-15 rad, times the conditioning of acos


@given(angle=st.floats(-20.0, 20.0))
def test_wrapped_angle_lies_within_half_a_turn_and_differs_by_whole_turns(angle):
    wrapped = wrap(angle)
    assert -np.pi <= wrapped <= np.pi
    turns = (angle - wrapped) / (2.0 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-14)


# ----------------------------------------------------------------------- derivatives, ICR


@names
def test_moment_arm_is_minus_the_slope_of_the_rod(name):
    link, h = LINKAGES[name], 1e-5
    slope = (rod_extension(link, RANGE + h) - rod_extension(link, RANGE - h)) / (2.0 * h)
    # Truncation h²x‴/6 ~ 2e-12 m, rounding 2e-16 m/h ~ 2e-11 m, times 10.
    np.testing.assert_allclose(moment_arm(link, RANGE), -slope, rtol=0.0, atol=2e-10)


@names
def test_encoder_sensitivity_is_the_slope_of_the_knee_angle(name, compass):
    link, h = LINKAGES[name], 1e-5
    start, theta_4 = np.radians(THETA_4_DEG[name][0]), encoder_angle(link, RANGE)
    ahead, behind = (
        compass(link, np.concatenate([[start], theta_4 + step])).knee_angle[1:] for step in (h, -h)
    )
    # As above; third derivatives of the knee angle are larger, up to 1e2 rad.
    np.testing.assert_allclose(
        pose(link, RANGE).encoder_sensitivity, (ahead - behind) / (2.0 * h), rtol=0.0, atol=1e-8
    )


@names
def test_coupler_stands_still_at_the_instantaneous_centre(name):
    link, h = LINKAGES[name], 1e-5
    at, ahead, behind = (pose(link, RANGE + step) for step in (0.0, h, -h))
    x, y = icr(link, at.theta_3, at.theta_4)
    centre = x + 1j * y
    for joint in ("joint_a", "joint_b"):
        arm = (centre - getattr(at, joint)) * np.exp(-1j * at.theta_3)  # fixed in the coupler
        moved = [getattr(p, joint) + arm * np.exp(1j * p.theta_3) for p in (ahead, behind)]
        # m per rad; truncation and rounding as for the moment arm.
        assert np.abs((moved[0] - moved[1]) / (2.0 * h)).max() < 1e-9


# ------------------------------------------------------------------------------- inverses


@given(link=linkages, knee=st.floats(np.radians(-2.0), np.radians(91.0)))
def test_newton_inverse_undoes_the_rod(link, knee):
    # Newton stops at machine precision: 1e-15 rad, and 1e-16 m times the smallest arm of 0.03 m.
    assert knee_angle_from_rod(link, rod_extension(link, knee)) == pytest.approx(knee, abs=1e-13)


# ------------------------------------------------------------------------ scalars and arrays


@pytest.mark.parametrize(
    "function", [rod_extension, moment_arm, encoder_angle], ids=lambda f: f.__name__
)
@given(link=linkages, knees=st.lists(knee_angles, min_size=1, max_size=8))
@settings(max_examples=30)
def test_arrays_give_the_scalar_values_in_the_same_shape(function, link, knees):
    array = function(link, np.array([knees]))
    assert array.shape == (1, len(knees))
    # numpy's vectorized sine differs from its scalar one in the last digit.
    np.testing.assert_allclose(array[0], [function(link, k) for k in knees], rtol=0.0, atol=1e-14)


@given(link=linkages, knees=st.lists(knee_angles, min_size=1, max_size=8))
@settings(max_examples=30)
def test_inverse_of_an_array_gives_the_scalar_values(link, knees):
    x = rod_extension(link, np.array(knees))
    singly = [knee_angle_from_rod(link, value) for value in x]
    np.testing.assert_allclose(knee_angle_from_rod(link, x), singly, rtol=0.0, atol=1e-13)


# --------------------------------------------------------------------------------- errors


def message_of(error):
    text = str(error.value)
    assert "\n" not in text
    return text


def test_links_that_do_not_close_are_reported_with_angle_and_lengths():
    with pytest.raises(LinkageError) as error:
        pose(changed(G1, a_2_m=0.2), np.radians(45.0))
    assert message_of(error) == (
        "the linkage cannot be assembled at knee angle 45 deg: links a_2_m = 0.2 m and "
        "a_4_m = 0.0182289 m do not close; a_2_m must be 0.02406 … 0.03604 m"
    )


def test_first_angle_that_does_not_close_is_the_one_reported():
    with pytest.raises(LinkageError, match="cannot be assembled at knee angle -2 deg"):
        pose(changed(G1, a_4_m=0.015), np.radians([10.0, 0.0, -2.0, -5.0]))


def test_nan_knee_angle_is_refused():
    with pytest.raises(LinkageError, match=r"at knee angle nan deg: .* do not close$"):
        pose(G1, np.nan)


def test_encoder_that_reverses_is_reported_with_its_angle():
    link = changed(
        G1, o_a_x_m=0.0135, o_a_y_m=-0.0244, o_b_x_m=-0.0052, o_b_y_m=-0.0143,
        a_2_m=0.0268, a_3_m=0.0183, a_4_m=0.0268,
    )  # fmt: skip
    theta_4 = encoder_angle(link, RANGE)
    slopes = np.sign(np.diff(theta_4))
    turn = np.degrees(RANGE[np.flatnonzero(slopes != slopes[0])[0]])
    with pytest.raises(LinkageError) as error:
        eq6_sign(link)
    assert "the linkage is not one-to-one over 0…90 deg" in message_of(error)
    angle = float(str(error.value).split("knee angle ")[1].split(" deg")[0])
    assert angle == pytest.approx(turn, abs=0.6)  # the search steps by 0.5 deg


@pytest.mark.parametrize("extension", [0.2, -0.01, np.nan])
def test_extension_out_of_range_is_reported_with_the_range(extension):
    with pytest.raises(LinkageError) as error:
        knee_angle_from_rod(G1, [0.1, extension])
    assert message_of(error) == (
        f"rod_extension = {extension:g} m belongs to no knee angle: must be 0.0004591 … 0.1492 m"
    )


@pytest.mark.parametrize("anchor_deg", [180.0, 195.0, 150.0])
def test_dead_centre_inside_the_range_is_reported_with_its_angle(anchor_deg):
    link = changed(G1, rod_anchor_angle_rad=np.radians(anchor_deg))
    fine = np.radians(np.linspace(-2.0, 91.0, 9301))
    turn = np.degrees(fine[np.argmax(np.diff(rod_extension(link, fine)) >= 0.0)])
    with pytest.raises(LinkageError, match="the rod has a dead centre near") as error:
        knee_angle_from_rod(link, 0.1)
    angle = float(message_of(error).split("knee angle ")[1].split(" deg")[0])
    assert angle == pytest.approx(turn, abs=0.6)  # the search steps by 0.5 deg
