"""The wearer's leg, cuff and biological moment."""

import math

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import (
    BODIES,
    CsvMoment,
    GaitMoment,
    LegParameters,
    MomentTable,
    gait_moment,
    gait_reference,
    leg_of_body,
)
from kneexo.parameters.task.gait import gait_knee_flexion, gait_moment_cycle


def test_the_leg_is_that_of_winters_table() -> None:
    # Winter 2009, Table 4.1, leg and foot: 0.061 of the mass; centre of mass at 0.606 and radius of
    # gyration about the knee 0.735 of the length of the shank, 0.246 of the height.
    leg, length = LegParameters(), 0.246 * 1.75
    assert leg.leg_mass_kg == pytest.approx(0.061 * 75.0, rel=1e-3)
    assert leg.centre_of_mass_m == pytest.approx(0.606 * length, rel=2e-3)
    assert leg.inertia_kg_m2 == pytest.approx(leg.leg_mass_kg * (0.735 * length) ** 2, rel=2e-3)


def test_the_leg_of_the_average_body_is_the_default_leg() -> None:
    leg = LegParameters()
    for name, value in leg_of_body(*BODIES["average"]).items():
        assert value == pytest.approx(getattr(leg, name), rel=2e-3)  # three printed digits
    # Mass ∝ M, centre of mass ∝ H, inertia ∝ M H².
    double = leg_of_body(150.0, 3.5)
    assert double["leg_mass_kg"] == pytest.approx(2.0 * 4.575)
    assert double["centre_of_mass_m"] == pytest.approx(2.0 * leg.centre_of_mass_m, rel=2e-3)
    assert double["inertia_kg_m2"] == pytest.approx(8.0 * leg.inertia_kg_m2, rel=2e-3)


def test_the_moment_of_walking_is_in_phase_with_the_reference() -> None:
    moment, reference = gait_moment(0.5, 2, body_mass_kg=150.0), gait_reference(0.5, 2)
    assert moment.times_s == reference.times_s
    assert moment.times_s[-1] == pytest.approx(4.0)
    cycle, flexion = gait_moment_cycle(), gait_knee_flexion()[1]
    # The reference starts in mid-stance, at 41 % of the gait cycle.
    for percent in (0, 15, 71, 100):
        for stride in (0, 1):
            index = (percent - 41) % 100 + 100 * stride
            assert moment.moments_n_m[index] == pytest.approx(2.0 * cycle[percent % 100])
            assert reference.angles_deg[index] == pytest.approx(flexion[percent % 100], abs=0.03)


def test_the_bare_spring_lacks_what_the_bank_adds_at_1_hz() -> None:
    leg = LegParameters(stiffness_n_m_per_rad=4.0, loss_modulus_n_m_per_rad=1.0)
    assert leg.bare_stiffness_n_m_per_rad == pytest.approx(4.0 - 2.627, abs=5e-4)  # printed digits


def test_a_leg_that_would_create_energy_is_refused() -> None:
    limit = {"stiffness_n_m_per_rad": 2.0, "loss_modulus_n_m_per_rad": 0.76}
    assert LegParameters(**limit).bare_stiffness_n_m_per_rad > 0.0
    with pytest.raises(
        ParameterError,
        match=r"^LegParameters: loss_modulus_n_m_per_rad = 0.77 N·m/rad: must be at most 0.38 "
        r"times stiffness_n_m_per_rad = 2 N·m/rad, .*\Z",
    ):
        LegParameters(**(limit | {"loss_modulus_n_m_per_rad": 0.77}))


@pytest.mark.parametrize(
    ("times", "moments", "line"),
    [
        ([0.0, 1.0], [1.0], r"times_s has 2 values and moments_n_m has 1: must be as many, .*"),
        ([0.0], [1.0], r".* has 1 values .* at least 2"),
        ([0.0, 0.0], [1.0, 2.0], r"times_s must increase by at least 1e-6 s .*"),
        ([0.0, 1.0], [1.0, math.nan], r"moments_n_m\.?\[?1.* must be finite.*N·m"),
        ([0.0, 1.0], [1.0, 2e3], r"moments_n_m.*1.* = 2000 N·m is out of range: .*1000 N·m"),
    ],
)
def test_a_faulty_table_is_refused_in_one_line(times, moments, line) -> None:
    with pytest.raises(ParameterError, match=rf"^MomentTable: {line}\Z"):
        MomentTable(times_s=times, moments_n_m=moments)


@pytest.mark.parametrize(
    ("given", "moment"),
    [
        ("gait", gait_moment(1.0, 30)),
        (GaitMoment(cycles=2), gait_moment(1.0, 2)),
        (
            {"kind": "gait", "frequency_hz": 0.5, "cycles": 3, "body_mass_kg": 150.0},
            gait_moment(0.5, 3, body_mass_kg=150.0),
        ),
    ],
)
def test_the_moment_of_walking_has_a_name(given, moment) -> None:
    assert LegParameters(moment=given).moment == moment


def test_a_faulty_moment_of_walking_is_refused_in_one_line() -> None:
    line = r"^LegParameters: moment: body_mass_kg = 0 kg is out of range: .*>= 1 and <= 500 kg\Z"
    with pytest.raises(ParameterError, match=line):
        LegParameters(moment={"kind": "gait", "body_mass_kg": 0})


def test_a_moment_can_be_a_csv_file(tmp_path) -> None:
    file = tmp_path / "my moment.csv"
    file.write_text("time_s,knee_angle_deg,knee_moment_nm\n0,5,-1\n0.5,6,-60.5\n", encoding="utf-8")
    moment = LegParameters(moment=str(file)).moment
    assert moment == MomentTable(times_s=(0.0, 0.5), moments_n_m=(-1.0, -60.5))


def test_a_moment_can_be_a_file_of_opensim(tmp_path) -> None:
    file = tmp_path / "id.sto"
    text = "inDegrees=no\nendheader\ntime\tknee_moment_nm\n0\t-1\n0.5\t-60.5\n"
    file.write_text(text, encoding="utf-8")
    moment = LegParameters(moment=str(file)).moment
    assert moment == MomentTable(times_s=(0.0, 0.5), moments_n_m=(-1.0, -60.5))
    file.write_text(text.replace("knee_moment_nm", "knee_angle_r_moment"), encoding="utf-8")
    line = (
        r"has no column 'knee_moment_nm'; it has .*knee_angle_r_moment.*; give its names: moment: "
    )
    with pytest.raises(ParameterError, match=line):
        LegParameters(moment=str(file))
    named = {"file": str(file), "column": "knee_angle_r_moment"}
    for given, sign in ((named, 1.0), (CsvMoment(**named, flexion="negative"), -1.0)):
        moment = LegParameters(moment=given).moment
        assert moment.moments_n_m == (-sign, -60.5 * sign)
        assert moment.times_s == (0.0, 0.5)
    shifted = LegParameters(moment=named | {"shift_s": 0.2, "kind": "csv"}).moment
    assert shifted.times_s == (-0.2, 0.3)
    with pytest.raises(ParameterError, match=r"moment: file: is missing; must be given by the"):
        LegParameters(moment="csv")


def test_a_faulty_csv_file_is_named_with_its_line(tmp_path) -> None:
    file = tmp_path / "moment.csv"
    file.write_text("time_s,knee_moment_nm\n0,1\n1,2000\n", encoding="utf-8")
    with pytest.raises(
        ParameterError, match=r"moment\.csv:3: knee_moment_nm = 2000 N·m is out of range: .*\Z"
    ):
        LegParameters(moment=str(file))
