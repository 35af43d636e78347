"""The wearer's leg, cuff and biological moment."""

import math

import pytest

from kneexo.errors import ParameterError
from kneexo.parameters import LegParameters, MomentTable


def test_the_leg_is_that_of_winters_table() -> None:
    # Winter 2009, Table 4.1, leg and foot: 0.061 of the mass; centre of mass at 0.606 and radius of
    # gyration about the knee 0.735 of the length of the shank, 0.246 of the height.
    leg, length = LegParameters(), 0.246 * 1.75
    assert leg.leg_mass_kg == pytest.approx(0.061 * 75.0, rel=1e-3)
    assert leg.centre_of_mass_m == pytest.approx(0.606 * length, rel=2e-3)
    assert leg.inertia_kg_m2 == pytest.approx(leg.leg_mass_kg * (0.735 * length) ** 2, rel=2e-3)


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


def test_a_leg_without_inertia_is_refused() -> None:
    with pytest.raises(
        ParameterError, match=r"inertia_kg_m2 = 0 kg·m² is out of range: .*>= 0.001 .*\Z"
    ):
        LegParameters(inertia_kg_m2=0.0)


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


def test_a_moment_can_be_a_csv_file(tmp_path) -> None:
    file = tmp_path / "my moment.csv"
    file.write_text("time_s,knee_angle_deg,knee_moment_nm\n0,5,-1\n0.5,6,-60.5\n", encoding="utf-8")
    moment = LegParameters(moment=str(file)).moment
    assert moment == MomentTable(times_s=(0.0, 0.5), moments_n_m=(-1.0, -60.5))


def test_a_faulty_csv_file_is_named_with_its_line(tmp_path) -> None:
    file = tmp_path / "moment.csv"
    file.write_text("time_s,knee_moment_nm\n0,1\n1,2000\n", encoding="utf-8")
    with pytest.raises(
        ParameterError, match=r"moment\.csv:3: knee_moment_nm = 2000 N·m is out of range: .*\Z"
    ):
        LegParameters(moment=str(file))
