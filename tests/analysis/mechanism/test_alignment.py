"""Alignment against numbers of another program, closed forms and virtual work."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from table_1 import changed

from kneexo.analysis import align
from kneexo.errors import LinkageError, ParameterError
from kneexo.geometry.shank_motion import anatomical_motion, linkage_motion
from kneexo.parameters import (
    G1,
    GAIT2392,
    HINGE,
    LINKAGES,
    AnatomicalKneeParameters,
    StrapParameters,
)

TURN = np.exp(1j * np.radians(np.arange(91)))
MEAN_TURN = abs(TURN.mean())
names = pytest.mark.parametrize("name", LINKAGES)


@pytest.mark.parametrize(
    ("link", "turn_rad", "rms_mm", "largest_mm", "along_mm", "across_mm"),
    [
        (HINGE, 0.0, 0.383, 0.966, 0.80, 1.16),
        (G1, 0.0, 3.065, 7.824, 2.9, 11.1),
        (G1, None, 2.956, 7.638, 7.3, 8.1),
    ],
)
def test_migration_at_the_best_place(link, turn_rad, rms_mm, largest_mm, along_mm, across_mm):
    at = align(link, turn_rad=turn_rad)
    # Another program, rounded to the last digit; the best turn is found to 0.1°.
    assert at.rms_mm == pytest.approx(rms_mm, abs=1e-3)
    assert at.largest_mm == pytest.approx(largest_mm, abs=2e-3)
    assert np.ptp(at.along_mm) == pytest.approx(along_mm, abs=0.06)
    assert np.ptp(at.across_mm) == pytest.approx(across_mm, abs=0.06)


def test_the_best_place_of_a_hinge_is_behind_and_below_the_knee():
    place = align(HINGE).placement
    assert place.position == pytest.approx(9.7e-3 - 12.8e-3j, abs=0.05e-3)
    assert place.strap == pytest.approx(-4.4e-3 - 0.2j + 13.3e-3j, abs=0.05e-3)


@names
@pytest.mark.parametrize("turn_rad", [0.0, -0.6])
def test_no_place_near_the_best_one_is_better(name, turn_rad):
    best = align(LINKAGES[name], turn_rad=turn_rad)
    for step in (1e-3, -1e-3, 1e-3j, -1e-3j):
        place = best.placement
        for moved in (
            replace(place, position=place.position + step),
            replace(place, strap=place.strap + step),
        ):
            assert align(LINKAGES[name], placement=moved).rms_mm > best.rms_mm


def test_the_best_turn_is_no_worse_than_its_neighbours():
    best = align(G1, turn_rad=None)
    assert math.degrees(best.placement.turn_rad) == pytest.approx(43.0, abs=0.5)
    for step in (-1e-2, 1e-2):
        assert align(G1, turn_rad=best.placement.turn_rad + step).rms_mm > best.rms_mm
    assert align(HINGE, turn_rad=None).placement.turn_rad == 0.0


def test_the_best_turn_at_a_given_place_is_no_worse_than_its_neighbours():
    position = 0.02 - 0.03j
    best = align(G1, position=position, turn_rad=None)
    for step in (-1e-2, 1e-2):
        turn_rad = best.placement.turn_rad + step
        assert align(G1, position=position, turn_rad=turn_rad).rms_mm > best.rms_mm


@pytest.mark.parametrize("direction_deg", [0.0, 77.0, 200.0])
@pytest.mark.parametrize("name", ["hinge", "G1"])
def test_a_place_10_mm_off_adds_its_closed_form(name, direction_deg):
    best = align(LINKAGES[name])
    off = 10e-3 * cmath.exp(1j * math.radians(direction_deg))
    moved = align(LINKAGES[name], position=best.placement.position + off)
    added = 10.0 * math.sqrt(1.0 - MEAN_TURN**2)
    # The errors of place and linkage are orthogonal at the best place; rounding only.
    assert moved.rms_mm == pytest.approx(math.hypot(best.rms_mm, added), abs=1e-9)
    assert best.misplaced_rms_mm([0.0, 10.0]) == pytest.approx([best.rms_mm, moved.rms_mm])


def test_a_device_that_fits_exactly_has_the_error_of_its_place_alone():
    fixed = AnatomicalKneeParameters(anterior_m=(0.0,) * 12, up_m=(-0.4,) * 7)  # turns as a hinge
    assert align(HINGE, fixed).rms_mm == pytest.approx(0.0, abs=1e-12)
    off = align(HINGE, fixed, position=8e-3 - 6e-3j)
    assert off.rms_mm == pytest.approx(10.0 * math.sqrt(1.0 - MEAN_TURN**2), abs=1e-9)


def test_position_errors_on_the_rim_of_the_tolerance_reach_the_limit():
    best = align(HINGE)
    radius, other = best.placement_tolerance_mm(5.0)
    assert radius == pytest.approx(other, rel=1e-9)  # a circle
    moved = align(HINGE, position=best.placement.position + 1e-3j * radius)
    assert moved.rms_mm == pytest.approx(5.0, abs=1e-9)


def test_a_slotted_cuff_counts_the_migration_across_alone():
    best = align(HINGE, counts="across")
    np.testing.assert_array_equal(best.distance_mm, np.abs(best.across_mm))
    assert best.rms_mm < math.sqrt(np.mean(align(HINGE).across_mm ** 2))
    long, short = best.placement_tolerance_mm(5.0)
    assert long > short
    rim_mm = best.tolerated_errors_mm(5.0)
    places = best.placement.position + 1e-3 * rim_mm[::80]
    reached = [align(HINGE, position=complex(at), counts="across").rms_mm for at in places]
    assert reached == pytest.approx([5.0] * 10, rel=1e-9)
    # 0.25° beside the long axis the rim is (0.25° in rad)²/2 · (long/short)² nearer, 0.04 %.
    assert [max(abs(rim_mm)), min(abs(rim_mm))] == pytest.approx([long, short], rel=1e-3)
    assert best.misplaced_rms_mm(short) == pytest.approx(5.0, rel=1e-9)


@pytest.mark.parametrize("given", ["position", "placement"])
def test_the_effect_of_a_wrong_place_is_known_at_the_best_place_alone(given):
    best = align(G1)
    at = align(G1, **{given: best.placement if given == "placement" else best.placement.position})
    for call in (at.placement_tolerance_mm, lambda: at.misplaced_rms_mm(1.0)):
        with pytest.raises(ParameterError, match=r"placement: is not the best one, .*; call align"):
            call()


def test_the_frame_of_a_linkage_may_be_far_from_its_knee():
    at = align(changed(HINGE, o_a_x_m=0.9, o_b_x_m=0.9))
    assert at.rms_mm == pytest.approx(align(HINGE).rms_mm, abs=1e-9)
    assert at.placement.position == pytest.approx(align(HINGE).placement.position - 0.9)


def test_a_limit_below_the_best_placement_is_refused():
    with pytest.raises(ParameterError, match=r"limit_mm = 3 mm: must exceed 3.065 mm"):
        align(G1).placement_tolerance_mm(3.0)


# ------------------------------------------------------------------------ strap in a slot


@pytest.mark.parametrize(
    ("name", "difference_deg", "least", "largest"),
    [
        ("hinge", 0.36, 0.98, 1.04),
        ("G1", 3.0, 0.87, 1.08),
        ("G2", 7.0, 0.94, 1.46),
        ("G4", 2.4, 0.89, 1.04),
    ],
)
def test_angle_and_torque_of_a_strap_in_a_slot(name, difference_deg, least, largest):
    strap = align(LINKAGES[name]).slotted_strap()
    # Another program, rounded to the last digit.
    assert np.ptp(strap.angle_difference_deg) == pytest.approx(difference_deg, abs=0.05)
    assert strap.torque_ratio.min() == pytest.approx(least, abs=0.006)
    assert strap.torque_ratio.max() == pytest.approx(largest, abs=0.006)


@names
def test_the_torque_ratio_is_the_slope_of_the_device_s_angle(name):
    at, step = align(LINKAGES[name]), 1e-3
    knee_deg = np.array([3.0, 30.0, 88.0])

    def device_deg(angles):
        return align(LINKAGES[name], knee_angle_deg=angles, placement=at.placement)

    slope = (
        device_deg(knee_deg + step).slotted_strap().device_angle_deg
        - device_deg(knee_deg - step).slotted_strap().device_angle_deg
    ) / (2.0 * step)
    # Newton's method leaves 1e-13 deg, the step divides it by 2e-3.
    np.testing.assert_allclose(device_deg(knee_deg).slotted_strap().torque_ratio, slope, atol=1e-8)


# ------------------------------------------------------------------------- forces of the cuff

STICKS = StrapParameters(friction=5.0, preload_n=5000.0)


@names
def test_moments_and_energy_of_the_cuff_balance(name):
    link, step = LINKAGES[name], 1e-3
    at = align(link, cuff=STICKS, turn_rad=0.2)
    knee_deg = np.array([2.0, 41.0, 87.0])

    def energy_j(angles_deg):
        near = align(link, knee_angle_deg=angles_deg, placement=at.placement, cuff=STICKS)
        across_m, along_m = 1e-3 * near.across_mm, 1e-3 * near.along_mm
        return 0.5 * (
            STICKS.normal_stiffness_n_per_m * across_m**2
            + STICKS.shear_stiffness_n_per_m * along_m**2
        )

    one, two = (energy_j(knee_deg + n * step) - energy_j(knee_deg - n * step) for n in (1, 2))
    rate = (8.0 * one - two) / (12.0 * math.radians(step))
    near = align(link, knee_angle_deg=knee_deg, placement=at.placement, cuff=STICKS)
    forces = near.cuff_forces()
    # The difference divides the rounding of up to 2 J, 4e-16 J, by 2e-5 rad.
    np.testing.assert_allclose(
        forces.knee_moment_n_m + forces.device_moment_n_m + rate, 0.0, atol=1e-9
    )


def test_forces_are_springs_and_the_moment_is_force_times_lever_about_the_centre():
    at = align(G1, cuff=STICKS)
    forces = at.cuff_forces()
    np.testing.assert_allclose(forces.across_n, 1500.0 / 0.09 * 1e-3 * at.across_mm, rtol=1e-12)
    np.testing.assert_allclose(forces.along_n, 5000.0 * 1e-3 * at.along_mm, rtol=1e-12)
    motion = anatomical_motion(GAIT2392, np.radians(at.knee_angle_deg))
    u = 1e-3 * (at.across_mm + 1j * at.along_mm)
    lever = -0.2j + u - motion.moving_centrode  # in the frame of the tibia
    moment = lever.real * forces.along_n - lever.imag * forces.across_n
    np.testing.assert_allclose(forces.knee_moment_n_m, moment, atol=1e-12)


def test_the_strap_slips_at_the_friction_of_its_preload():
    cuff = StrapParameters(friction=0.1, preload_n=20.0)
    forces = align(G1, cuff=cuff).cuff_forces()
    assert np.abs(forces.along_n).max() == pytest.approx(2.0, rel=1e-15)
    np.testing.assert_array_equal(forces.slips, np.abs(forces.along_n) == 2.0)
    assert 0.1 < forces.slips.mean() < 0.9


# --------------------------------------------------------------------------- other motions


@settings(max_examples=20)
@given(st.sampled_from(sorted(LINKAGES)), st.floats(-1.0, 1.0), st.floats(0.5, 1.6))
def test_a_wearer_who_moves_as_the_device_does_has_no_migration(name, turn_rad, high):
    device = linkage_motion(LINKAGES[name], np.linspace(0.0, high, 400)).translation
    angles = tuple(np.linspace(0.0, high, 400))
    knee = AnatomicalKneeParameters(
        anterior_angles_rad=angles,
        anterior_m=tuple(-(device * np.exp(1j * turn_rad)).real),
        up_angles_rad=angles,
        up_m=tuple((device * np.exp(1j * turn_rad)).imag),
    )
    at = align(
        LINKAGES[name],
        knee,
        turn_rad=turn_rad,
        knee_angle_deg=np.degrees(np.linspace(0.1, high - 0.1, 31)),
    )
    # A spline of 400 nodes: (2e-3 … 4e-3 rad)⁴ of the fourth derivative, below 1e3 m.
    assert at.rms_mm < 1e-4


def test_a_stride_weighs_its_own_angles():
    # Two angles would be met exactly by place and strap; the third one leaves an error.
    stride = align(G1, knee_angle_deg=[5.0] * 50 + [30.0, 60.0])
    assert stride.distance_mm[0] < 0.5 * stride.distance_mm[-1]
    rare = align(G1, knee_angle_deg=[5.0] + [60.0] * 50 + [30.0])
    assert rare.distance_mm[0] > 2.0 * rare.distance_mm[1]


def test_plot_and_table_have_the_migration_in_mm():
    pandas = pytest.importorskip("pandas")
    at = align(G1)
    across, along = at.plot().lines[:2]
    np.testing.assert_array_equal(across.get_ydata(), at.across_mm)
    np.testing.assert_array_equal(along.get_ydata(), at.along_mm)
    frame = at.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == ["across_mm", "along_mm"]


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("link", "options", "message"),
    [
        (HINGE, {"position": 2.0 - 0.1j}, "position = 2-0.1j m: must be at most 0.5 m"),
        (HINGE, {"position": 0.45 + 0.2j}, "no angle of the device puts the strap into the slot"),
        (HINGE, {"knee_angle_deg": []}, "knee_angle_deg: has no knee angle"),
        (HINGE, {"knee_angle_deg": [0.0, 121.0]}, "must have them at 121 deg; add nodes"),
        (changed(G1, a_2_m=40e-3), {}, "cannot be assembled at knee angle"),
    ],
)
def test_what_cannot_be_aligned_is_refused(link, options, message):
    with pytest.raises((ParameterError, LinkageError), match=message):
        align(link, **options).slotted_strap()
