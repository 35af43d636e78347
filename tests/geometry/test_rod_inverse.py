"""The fitted inverse of the rod against Newton's method and exact arithmetic."""

import os
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from mpmath import mp
from numpy.polynomial import Polynomial
from numpy.polynomial.chebyshev import cheb2poly
from table_1 import P_MM_DEG, changed

from kneexo.errors import LinkageError
from kneexo.geometry.linkage import (
    encoder_angle,
    knee_angle_from_rod,
    moment_arm,
    polynomial,
    rod_extension,
)
from kneexo.geometry.rod_inverse import fit_rod_inverse, rounded_rod_extension
from kneexo.parameters import (
    G1,
    G2,
    G3,
    G4,
    G5,
    HINGE,
    LINKAGES,
    TABLE_1_LINKAGES,
    RodPolynomialParameters,
)

MM = 1e-3
RANGE = np.radians(np.linspace(0.0, 90.0, 901))

names = pytest.mark.parametrize("name", LINKAGES)
linkages = st.sampled_from([G1, G2, G3, G4, G5])
knee_angles = st.floats(0.0, np.pi / 2.0)


def inverse(fit, extension):
    t = (np.sqrt(fit.dead_centre_m - extension) - fit.centre) / fit.half_width
    return tuple(polynomial(c, t) for c in (fit.knee_angle, fit.encoder_angle, fit.moment_arm))


@names
def test_fitted_inverse_equals_newton_over_the_range_of_motion(name):
    link = LINKAGES[name]
    x = np.linspace(*rod_extension(link, np.radians([90.0, 0.0])), 5001)
    knee, theta_4, arm = inverse(fit_rod_inverse(link), x)
    exact = knee_angle_from_rod(link, x)
    # The required 1e-11 m of rod; the arm is 0.03 … 0.11 m, so 1e-11 rad is no weaker. The dead
    # centre of G4 lies closer, and link 4 of G4 and G5 turns faster.
    limit = 5e-11 if name in ("G4", "G5") else 1e-11
    assert np.abs(rod_extension(link, knee) - x).max() <= 1e-11
    np.testing.assert_allclose(knee, exact, rtol=0.0, atol=limit)
    np.testing.assert_allclose(theta_4, encoder_angle(link, exact), rtol=0.0, atol=limit)
    np.testing.assert_allclose(arm, moment_arm(link, exact), rtol=0.0, atol=limit)


@given(link=linkages, knee=knee_angles)
def test_fitted_inverse_undoes_the_rod(link, knee):
    x = rod_extension(link, knee)
    back, _, _ = inverse(fit_rod_inverse(link), x)
    assert abs(rod_extension(link, back) - x) <= 1e-11


@pytest.mark.parametrize("name", TABLE_1_LINKAGES)
def test_fit_knows_the_dead_centre_of_the_rod(name):
    link = LINKAGES[name]
    angle = np.radians(np.linspace(-25.0, 0.0, 250_001))
    x = rod_extension(link, angle)
    # The grid misses the maximum by at most half a step: x″ (1e-6 rad)²/2 ~ 1e-13 m.
    assert fit_rod_inverse(link).dead_centre_m == pytest.approx(x.max(), abs=1e-12)
    assert -24.0 < np.degrees(angle[x.argmax()]) < -10.5


def test_fit_to_table_1_follows_the_polynomial_and_keeps_the_encoder_of_the_linkage():
    table_1 = RodPolynomialParameters()
    x = MM * np.polyval(P_MM_DEG, np.degrees(RANGE))
    knee, theta_4, arm = inverse(fit_rod_inverse(G1, table_1), x)
    # Degree 25 leaves 2.4e-10 rad here: the polynomial's dead centres lie closer than G1's.
    np.testing.assert_allclose(knee, RANGE, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(theta_4, encoder_angle(G1, RANGE), rtol=0.0, atol=3e-9)
    slope = np.polyval(np.polyder(np.array(P_MM_DEG)), np.degrees(RANGE))
    np.testing.assert_allclose(arm, -MM * slope * np.degrees(1.0), rtol=0.0, atol=1e-9)


def exact_pose(link, knee_angle):
    """Rod extension and θ_4 by complex numbers of mpmath, from Eq. 1, 8 and 9."""
    o_a, o_b = mp.mpc(link.o_a_x_m, link.o_a_y_m), mp.mpc(link.o_b_x_m, link.o_b_y_m)
    theta_3 = knee_angle - link.phi_rad
    d = o_b - o_a - link.a_3_m * mp.expj(theta_3)
    a_2, a_4 = mp.mpf(link.a_2_m), mp.mpf(link.a_4_m)
    theta_4 = mp.arg(d) + link.branch * mp.acos(
        (a_2**2 - a_4**2 - abs(d) ** 2) / (2 * a_4 * abs(d))
    )
    pin = o_b + a_4 * mp.expj(theta_4)
    pin += link.rod_pin_radius_m * mp.expj(theta_3 + link.rod_pin_angle_rad)
    anchor = link.rod_anchor_radius_m * mp.expj(link.rod_anchor_angle_rad)
    return abs(pin - anchor) - link.rod_length_m, theta_4


def test_coefficients_of_the_fit_are_those_of_exact_arithmetic_rounded_once():
    # A processor's own sines or sums would change the last bits of most of the 78 coefficients.
    fit = fit_rod_inverse(G1)
    size, degree = 32, 25
    with mp.workdps(45):
        nodes = [mp.cos(mp.pi * (2 * k + 1) / (2 * size)) for k in range(size)]
        knee, theta_4, arm = [], [], []
        start = inverse(fit, np.array([
            float(fit.dead_centre_m - (fit.centre + fit.half_width * t) ** 2) for t in nodes
        ]))[0]  # fmt: skip
        for t, near in zip(nodes, start, strict=True):
            x = fit.dead_centre_m - (mp.mpf(fit.centre) + fit.half_width * t) ** 2
            angle = mp.findroot(lambda a, x=x: exact_pose(G1, a)[0] - x, (near, near + 1e-9))
            knee.append(angle)
            theta_4.append(exact_pose(G1, angle)[1])
            arm.append(-mp.diff(lambda a: exact_pose(G1, a)[0], angle))
        cosines = [mp.cos(mp.pi * k / (2 * size)) for k in range(4 * size)]
        for coefficients, values in zip(
            (fit.knee_angle, fit.encoder_angle, fit.moment_arm), (knee, theta_4, arm), strict=True
        ):
            series = [
                mp.fsum(v * cosines[n * (2 * k + 1) % (4 * size)] for k, v in enumerate(values))
                * (2 if n else 1) / size
                for n in range(degree + 1)
            ]  # fmt: skip
            exact = sum(
                (c * Polynomial(cheb2poly([0] * n + [1])) for n, c in enumerate(series)),
                Polynomial([mp.mpf(0)]),
            )
            np.testing.assert_array_equal(coefficients[::-1], [float(c) for c in exact.coef])


def test_links_in_line_have_no_rounded_rod_extension():
    """a_2 + a_3 = a_4 in doubles, while the exact sum of the doubles is below a_4."""
    link = HINGE.changed({"a_2_m": 0.03, "a_3_m": 0.03, "a_4_m": 0.06})
    with pytest.raises(
        LinkageError, match=r"a_2_m = 0.03 m and a_4_m = 0.06 m are in line at .*90"
    ):
        rounded_rod_extension(link, np.pi / 2.0)


@names
def test_rounded_rod_extension_is_the_closest_double(name):
    link = LINKAGES[name]
    for angle in np.radians([0.0, 12.3, 40.0, 90.0]):
        with mp.workdps(40):
            exact = float(exact_pose(link, mp.mpf(angle))[0])
        assert rounded_rod_extension(link, float(angle)) == exact


OTHER_KERNELS = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4" if np.lib.NumpyVersion(np.__version__) >= "2.4.0"
    else "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4",
}  # fmt: skip


@pytest.mark.slow
def test_numbers_of_a_run_have_the_same_bits_with_the_kernels_of_another_processor():
    code = (
        "from kneexo.parameters import LINKAGES, PlantParameters, Scenario\n"
        "from kneexo.simulation.compiled import scenario_start, scenario_values\n"
        "for link in LINKAGES.values():\n"
        "    for rod_map in ('linkage', 'polynomial'):\n"
        "        plant = PlantParameters(linkage=link, rod_map=rod_map)\n"
        "        scenario = Scenario(plant=plant)\n"
        "        values = scenario_values(scenario) | scenario_start(scenario)\n"
        "        print(*(f'{k} {float(v).hex()}' for k, v in values.items()), sep='\\n')\n"
    )
    here, there = (
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", code],
            env=os.environ | kernels,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for kernels in ({}, OTHER_KERNELS)
    )
    assert len(here.splitlines()) > 8 * 78
    assert there == here


def test_fit_needs_no_dead_centre_nearby():
    # This anchor leaves the rod without a dead centre within 60 deg of the extended knee.
    link = changed(G1, rod_anchor_angle_rad=np.radians(-135.0), rod_anchor_radius_m=0.4,
                   rod_length_m=0.2)  # fmt: skip
    x = rod_extension(link, RANGE)
    knee, _, _ = inverse(fit_rod_inverse(link), x)
    assert np.abs(rod_extension(link, knee) - x).max() < 1e-9  # degree 25 leaves 5e-11 m here


@pytest.mark.parametrize(
    "anchor_deg",
    [
        pytest.param(180.0, marks=pytest.mark.slow),
        pytest.param(150.0, marks=pytest.mark.slow),
        60.0,
    ],
)
def test_fit_refuses_a_rod_with_a_dead_centre_inside_the_range(anchor_deg):
    with pytest.raises(LinkageError, match="the rod has a dead centre near"):
        fit_rod_inverse(changed(G1, rod_anchor_angle_rad=np.radians(anchor_deg)))


@pytest.mark.parametrize(
    ("base", "name", "factor", "reason"),
    [
        (G1, "a_2_m", 1.1, "cannot be assembled"),
        (G3, "rod_anchor_angle_rad", 1.3, "has a dead centre near knee angle -2 deg"),
        pytest.param(
            *(G1, "rod_anchor_angle_rad", -1.5, "has a dead centre"), marks=pytest.mark.slow
        ),
    ],
)
def test_a_refused_linkage_is_accepted_after_the_change_that_its_message_names(
    base, name, factor, reason
):
    link = changed(base, **{name: factor * getattr(base, name)})
    with pytest.raises(LinkageError, match=reason) as error:
        fit_rod_inverse(link)
    named = re.search(r"; for example, change (\w+) from (\S+) to (\S+) (m|rad)$", str(error.value))
    assert float(named[2]) == pytest.approx(getattr(link, named[1]), rel=1e-3)
    fit_rod_inverse(changed(link, **{named[1]: float(named[3])}))
    assert str(pickle.loads(pickle.dumps(error.value))) == str(error.value)  # from a worker
