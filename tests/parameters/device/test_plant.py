"""The plant has the numbers that the paper prints, and areas and leakage that follow from them."""

import math

import pytest

from kneexo.parameters import BldcPumpParameters, CylinderParameters, RodPolynomialParameters


def test_the_polynomials_are_those_of_table_1() -> None:
    polynomial = RodPolynomialParameters()
    assert polynomial.p_mm_deg == (1.571e-8, -4.164e-6, 4.789e-4, -0.03192, -0.6195, 148.0)
    assert polynomial.q_deg_mm == (-1.807e-9, 5.788e-7, -7.285e-5, 0.004161, -0.6389, 91.73)
    angle = math.radians(60.0)
    rod = sum(p * angle ** (5 - n) for n, p in enumerate(polynomial.p_si))
    rod_mm = sum(p * 60.0 ** (5 - n) for n, p in enumerate(polynomial.p_mm_deg))
    assert 1e3 * rod == pytest.approx(rod_mm, rel=1e-13)
    back = sum(q * rod_mm ** (5 - n) for n, q in enumerate(polynomial.q_deg_mm))
    assert back == pytest.approx(60.0, abs=0.1)  # the printed maps are inverse to 0.1 deg


def test_areas_follow_from_table_3_and_are_those_of_table_2() -> None:
    cylinder = CylinderParameters()
    assert 1e6 * cylinder.cap_area_m2 == pytest.approx(100 * math.pi, rel=1e-14)
    assert 1e6 * cylinder.rod_side_area_m2 == pytest.approx(75 * math.pi, rel=1e-14)
    assert 1e6 * cylinder.mean_area_m2 == pytest.approx(274.8894, abs=5e-5)
    assert 1e9 * cylinder.mean_area_m2 * cylinder.stroke_m == pytest.approx(41_233.0, abs=0.5)


def test_the_load_flow_loses_half_of_the_external_leakage() -> None:
    pump = BldcPumpParameters(
        internal_leakage_m3_per_s_pa=3e-13, external_leakage_m3_per_s_pa=2e-13
    )
    assert pump.leakage_m3_per_s_pa == pytest.approx(4e-13, rel=1e-14, abs=0)  # C_im + C_em/2
