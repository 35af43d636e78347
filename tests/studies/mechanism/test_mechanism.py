"""Study `mechanism`: its devices, its settings and its answer."""

import math

import numpy as np
import pytest
from design_cases import made_up as designed
from mechanism_cases import made_up

from kneexo.analysis import TradeOff, align, swing_clearance
from kneexo.geometry.linkage import rod_extension
from kneexo.geometry.shank_motion import anatomical_motion, linkage_motion
from kneexo.parameters import (
    G1,
    GAIT2392,
    AnatomicalKneeParameters,
    RodPolynomialParameters,
    Scenario,
)
from kneexo.parameters.paths import changed
from kneexo.studies.mechanism import MechanismSettings, mechanism, mechanism_study
from kneexo.studies.mechanism.figures import figures
from kneexo.studies.mechanism.report import report


def test_the_linkage_of_the_scenario_is_the_first_of_the_devices():
    assert list(made_up().devices) == ["G1", "hinge", "G2", "G3", "G4", "G5"]
    hinge = Scenario(plant={"linkage": "hinge"})
    assert list(mechanism_study(hinge).devices) == ["hinge", "G1", "G2", "G3", "G4", "G5"]
    longer = G1.model_copy(update={"rod_pin_radius_m": 0.27})
    own = mechanism_study(Scenario(plant={"linkage": longer}))
    assert next(iter(own.devices)) == "the scenario's"
    # The rod does not change the motion of the shank.
    assert own.devices["the scenario's"].results()["rms_mm"] == pytest.approx(
        own.devices["G1"].results()["rms_mm"], rel=1e-12
    )


def test_numbers_of_a_device_are_those_of_its_alignment():
    best, row = align(G1), made_up().devices["G1"].results()
    moved = align(G1, position=best.placement.position + 10e-3)
    assert row["rms_mm"] == best.rms_mm
    assert row["largest_mm"] == best.largest_mm
    assert row["backwards_mm"] == pytest.approx(20.7, abs=0.05)
    assert row["up_mm"] == pytest.approx(-10.5, abs=0.05)
    assert row["misplaced_rms_mm"] == pytest.approx(moved.rms_mm, rel=1e-12)
    assert row["turned_rms_mm"] == pytest.approx(2.956, abs=1e-3)
    assert row["turn_deg"] == pytest.approx(43.0, abs=0.5)
    assert row["largest_across_n"] == pytest.approx(16.67 * 7.79, rel=1e-2)  # k u
    tolerated = align(G1, position=best.placement.position - 1e-3j * row["placement_tolerance_mm"])
    assert tolerated.rms_mm == pytest.approx(5.0, rel=1e-9)


def test_links_and_leg_of_a_device_are_those_of_their_analyses():
    row = made_up().devices["G1"].results()
    assert (row["thigh_as_ground"], row["shank_as_ground"]) == ("double crank", "double rocker")
    assert row["grashof_margin_mm"] == pytest.approx(0.6, abs=1e-3)
    assert row["rod_dead_centres_deg"][0] == pytest.approx(-11.73, abs=0.01)
    assert row["encoder_reversals_deg"][0] == pytest.approx(-29.03, abs=0.01)
    assert row["least_transmission_angle_deg"] == pytest.approx(25.0, abs=0.1)
    # Another program: 16.3 mm at 60°.
    assert row["shortening_at_60_deg_mm"] == pytest.approx(16.3, abs=0.05)
    swing = swing_clearance(G1)
    assert row["toe_clearance_gain_mm"] == pytest.approx(1e3 * swing.least_clearance_gain_m)
    hinge = made_up().devices["hinge"].results()
    assert hinge["thigh_as_ground"] == "hinge"
    assert math.isnan(hinge["least_transmission_angle_deg"])


@pytest.mark.parametrize("flexion_max_deg", [40.0, 115.0])
def test_the_shortening_at_60_deg_is_that_at_60_deg_whatever_the_motion(flexion_max_deg):
    other = mechanism_study(settings=MechanismSettings(flexion_max_deg=flexion_max_deg))
    for name, device in other.devices.items():
        expected = made_up().devices[name].results()["shortening_at_60_deg_mm"]
        assert device.results()["shortening_at_60_deg_mm"] == pytest.approx(expected, rel=1e-12)


def test_the_leg_is_the_wearer_s_own():
    leg = made_up().leg
    assert 1e3 * leg.shortening_m[60] == pytest.approx(-6.5, abs=0.05)  # another program


def test_a_device_that_exceeds_the_tolerance_has_no_tolerated_place():
    strict = mechanism_study(settings=MechanismSettings(tolerance_mm=1.0))
    assert math.isnan(strict.devices["G1"].placement_tolerance_mm)
    assert strict.devices["hinge"].placement_tolerance_mm > 0.0
    assert "| – |" in report(strict)


def test_the_stride_is_the_measured_one():
    # Of data/gait_knee_flexion.csv, read by eye: a stride neither hyperextends nor exceeds 90°.
    stride = made_up().results()["stride"]
    assert stride == {
        "least_deg": pytest.approx(2.3, abs=0.05),
        "largest_deg": pytest.approx(59.2, abs=0.05),
        "share_0_to_90": 1.0,
        "share_0_to_135": 1.0,
        "share_hyperextended": 0.0,
    }


@pytest.mark.parametrize(
    ("flexion_deg", "shares"), [([-5.0, 0.0, 90.0, 91.0], (0.5, 0.75, 0.25)), ([136.0], (0, 0, 0))]
)
def test_shares_of_a_stride_count_its_angles_in_each_range(monkeypatch, flexion_deg, shares):
    monkeypatch.setattr(mechanism, "gait_knee_flexion", lambda: (None, np.array(flexion_deg), None))
    assert tuple(mechanism._stride().values()) == (min(flexion_deg), max(flexion_deg), *shares)


def test_the_trade_off_is_searched_if_asked_for(monkeypatch):
    assert made_up().trade_off is None
    assert made_up().results()["trade_off"] == []
    assert "trade_off" not in figures(made_up())
    searched = []

    def search(motion):
        searched.append(motion)
        return TradeOff((designed().design,))

    monkeypatch.setattr(mechanism, "trade_off", search)
    result = mechanism_study(settings=MechanismSettings(trade_off=True))
    assert searched == [GAIT2392]
    assert "| 0.0173 | 0.0695 | 9.03 | 19.5 |" in report(result)
    (ax,) = figures(result)["trade_off"].axes
    curve, *marks = ax.lines
    np.testing.assert_allclose(curve.get_xydata(), [[0.0173, 9.03]], rtol=1e-2)
    assert [line.get_label() for line in marks] == list(result.devices)
    degrees = np.arange(91.0)
    table_mm = np.polyval(RodPolynomialParameters().p_mm_deg, degrees)
    error_mm = 1e3 * rod_extension(G1, np.radians(degrees)) - table_mm
    expected = np.sqrt(np.mean(error_mm**2)), align(G1).rms_mm
    np.testing.assert_allclose(marks[0].get_xydata(), [expected], rtol=1e-9)


def test_the_centres_are_those_of_the_wearer_s_knee_in_mm():
    knee = made_up().results()["knee"]
    centre = anatomical_motion(AnatomicalKneeParameters(), np.pi / 4.0).fixed_centrode[0]
    assert knee["knee_angle_deg"][45] == 45.0
    assert knee["centre_backwards_mm"][45] == pytest.approx(1e3 * centre.real, rel=1e-12)
    assert knee["centre_up_mm"][45] == pytest.approx(1e3 * centre.imag, rel=1e-12)


def test_the_first_sentence_says_which_device_follows_the_knee_better():
    def first(result):
        return report(result).splitlines()[2]

    assert first(made_up()).startswith("A hinge at its best place follows this knee better than G1")
    hinge = mechanism_study(Scenario(plant={"linkage": "hinge"}))
    assert first(hinge).startswith("The hinge at its best place leaves 0.383 mm")
    # A wearer whose shank moves as G1 moves it.
    motion = made_up().devices["G1"].alignment
    angles = np.radians(np.arange(0.0, 91.0))
    place = linkage_motion(motion.linkage, angles).translation
    knee = AnatomicalKneeParameters(
        anterior_angles_rad=tuple(angles),
        anterior_m=tuple(-place.real),
        up_angles_rad=tuple(angles),
        up_m=tuple(place.imag),
    )
    like_g1 = mechanism_study(settings=MechanismSettings(knee=knee))
    assert first(like_g1).startswith("G1 at its best place follows this knee better than a hinge")


def test_the_knee_of_a_file_is_a_setting(tmp_path):
    path = tmp_path / "knee of Ada.csv"
    path.write_text("knee_flexion_deg,anterior_mm,up_mm\n0,0,0\n50,1,-5\n100,2,-9\n")
    settings = changed(MechanismSettings(), {"knee": str(path), "flexion_max_deg": 80.0})
    assert settings.knee.up_m == pytest.approx((0.0, -5e-3, -9e-3))
    assert mechanism_study(settings=settings).knee_angle_deg[-1] == 80.0
