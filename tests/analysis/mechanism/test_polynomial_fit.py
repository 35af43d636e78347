import math

import numpy as np
import pytest

from kneexo.analysis import fit_polynomials
from kneexo.analysis.signals import rms
from kneexo.errors import LinkageError
from kneexo.geometry import linkage
from kneexo.parameters import G2, G4, LinkageParameters, RodPolynomialParameters


def test_the_linkage_agrees_with_table_1():
    fit = fit_polynomials()
    assert fit.angle_deg.size == 901
    assert rms(fit.table_p_error_mm) <= 0.0296
    assert np.max(np.abs(fit.table_p_error_mm)) <= 0.154


@pytest.mark.parametrize("link", [LinkageParameters(), G2])
def test_the_fit_is_the_least_squares_one(link):
    fit = fit_polynomials(link)
    # The residual of a least-squares fit is orthogonal to every power that it fits.
    for residual, argument in (
        (fit.p_error_mm, fit.angle_deg / 90.0),
        (fit.q_error_deg, fit.extension_mm / 150.0),
    ):
        powers = np.vander(argument, 6)
        # Evaluation of a degree-5 polynomial at 90 in doubles leaves about 1e-11 a point.
        assert np.abs(powers.T @ residual).max() < 1e-6
    assert rms(fit.p_error_mm) <= rms(fit.table_p_error_mm)
    assert rms(fit.q_error_deg) <= rms(fit.table_q_error_deg)


def test_a_linkage_that_cannot_be_assembled_is_refused():
    with pytest.raises(LinkageError, match="cannot be assembled"):
        fit_polynomials(LinkageParameters(a_2_m=0.2))


def test_errors_are_linkage_minus_polynomial():
    fit, table = fit_polynomials(samples=91), RodPolynomialParameters()
    rod = 1e3 * linkage.rod_extension(LinkageParameters(), np.radians(np.arange(91.0)))
    assert fit.angle_deg == pytest.approx(np.arange(91.0))
    assert fit.extension_mm == pytest.approx(rod)
    for error, argument, value, coefficients in (
        (fit.p_error_mm, fit.angle_deg, rod, fit.p_mm_deg),
        (fit.q_error_deg, rod, fit.angle_deg, fit.q_deg_mm),
        (fit.table_p_error_mm, fit.angle_deg, rod, table.p_mm_deg),
        (fit.table_q_error_deg, rod, fit.angle_deg, table.q_deg_mm),
    ):
        assert error == pytest.approx(value - np.polyval(coefficients, argument), abs=1e-9)
    assert fit.p_sse_mm2 == pytest.approx(fit.p_error_mm @ fit.p_error_mm)
    assert fit.q_sse_deg2 == pytest.approx(fit.q_error_deg @ fit.q_error_deg)


def test_the_plot_has_the_two_maps_of_fig_5_and_their_residuals(curves):
    fit, table = fit_polynomials(samples=91), RodPolynomialParameters()
    angle, rod = r"knee angle $\theta_p$ (deg)", "rod extension $x$ (mm)"
    axes = fit.plot()
    upper, lower = axes
    assert [ax.get_ylabel() for ax in upper] == [rod, angle]
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in lower] == [
        (angle, "residual of $x$ (mm)"),
        (rod, r"residual of $\theta_p$ (deg)"),
    ]
    for maps, errors, x, y, own, printed in (
        (upper[0], lower[0], fit.angle_deg, fit.extension_mm, fit.p_mm_deg, table.p_mm_deg),
        (upper[1], lower[1], fit.extension_mm, fit.angle_deg, fit.q_deg_mm, table.q_deg_mm),
    ):
        lines, residuals = curves(maps), curves(errors)
        assert lines["linkage (Eq. 1–9)"][0] == pytest.approx(x[::30])
        assert lines["linkage (Eq. 1–9)"][1] == pytest.approx(y[::30])
        for label, polynomial in (("quintic fit", own), ("Table 1", printed)):
            assert lines[label][0] == pytest.approx(x)
            assert lines[label][1] == pytest.approx(np.polyval(polynomial, x))
            assert residuals[label][0] == pytest.approx(x)
            # Of values up to 150 the difference keeps 13 digits.
            assert residuals[label][1] == pytest.approx(y - np.polyval(polynomial, x), abs=1e-9)
    assert "the linkage minus each polynomial" in upper[0].figure.get_label()


def test_quintics_fitted_to_g4_leave_the_printed_errors_of_fig_5():
    fit = fit_polynomials(G4, start_deg=5.0, samples=204)
    assert fit.angle_deg[[0, -1]].tolist() == [5.0, 90.0]
    assert fit.degrees_of_freedom == 198
    assert fit.p_sse_mm2 == pytest.approx(0.1740, abs=5e-5)
    assert fit.q_sse_deg2 == pytest.approx(1.2533, abs=5e-5)
    # Fig. 5 prints 0.1781 mm² and 1.241 deg².
    assert fit.p_sse_mm2 == pytest.approx(0.1781, rel=0.03)
    assert fit.q_sse_deg2 == pytest.approx(1.241, rel=0.02)
    assert math.sqrt(fit.p_sse_mm2 / 198) == pytest.approx(0.03, abs=5e-4)
    assert math.sqrt(fit.q_sse_deg2 / 198) == pytest.approx(0.0792, abs=5e-4)
