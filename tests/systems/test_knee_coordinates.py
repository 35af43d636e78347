import math

import numpy as np
import pytest
from numpy import poly1d
from table_1 import P_MM_DEG, THETA_4_DEG

from diagramc.testing import check_leaf
from kneexo.errors import LinkageError
from kneexo.parameters import G1, TABLE_1_LINKAGES, LinkageParameters, RodPolynomialParameters
from kneexo.systems import KneeCoordinates, RodReference

OTHER_TABLE = RodPolynomialParameters(p_mm_deg=(2e-8, -4e-6, 0.0005, -0.03, -0.6, 140.0))
COUNT = 2.0 * math.pi / 4096

names = pytest.mark.parametrize("name", TABLE_1_LINKAGES)


def reading_range(name):
    """Encoder angles well inside the range of motion, ascending."""
    return [tuple(sorted(np.radians(THETA_4_DEG[name]) * 0.98))]


def coordinates(system, reading):
    context = system.CreateDefaultContext()
    system.GetInputPort("encoder_reading").FixValue(context, reading)
    return [system.GetOutputPort(n).Eval(context)[0] for n in ("knee_angle", "rod_extension")]


def rod(system, knee):
    context = system.CreateDefaultContext()
    system.GetInputPort("knee_reference").FixValue(context, knee)
    return system.GetOutputPort("rod_reference").Eval(context)


# ----------------------------------------------------------------------------- conversion


@names
def test_conversions_of_coordinates_agree_and_keep_arguments_and_changes(name):
    system = KneeCoordinates(TABLE_1_LINKAGES[name], OTHER_TABLE, 0.01)
    check_leaf(system, {"encoder_reading": reading_range(name)})


def test_conversions_of_the_rod_reference_agree_and_keep_the_table():
    ranges = [(0.1, 1.4), (-1.0, 1.0), (-2.0, 2.0), (-5.0, 5.0)]
    check_leaf(RodReference(OTHER_TABLE), {"knee_reference": ranges})


# -------------------------------------------------------------------------------- numbers


@names
def test_coordinates_meet_the_compass_construction_and_table_1(name, compass):
    link = TABLE_1_LINKAGES[name]
    walk = compass(link, np.radians(np.linspace(*THETA_4_DEG[name], 201)))
    system = KneeCoordinates(link)
    knee_and_rod = np.array([coordinates(system, theta_4) for theta_4 in walk.theta_4])
    x = 1e-3 * np.polyval(P_MM_DEG, np.degrees(walk.knee_angle))
    # Rounding of acos near the stretched positions: 1e-12 rad.
    np.testing.assert_allclose(knee_and_rod[:, 0], walk.knee_angle, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(knee_and_rod[:, 1], x, rtol=0.0, atol=1e-12)


def test_measured_angle_is_the_same_for_every_full_turn_of_the_encoder():
    system = KneeCoordinates()
    here, turned = coordinates(system, 0.5), coordinates(system, 0.5 - 2.0 * math.pi)
    assert turned == pytest.approx(here, abs=1e-13)


def test_half_a_count_of_offset_centres_the_error_of_an_encoder_that_rounds_down(compass):
    walk = compass(G1, np.radians(np.linspace(82.5, -4.7, 997)))
    readings = COUNT * np.floor(walk.theta_4 / COUNT)

    def errors_in_counts(offset):
        system = KneeCoordinates(offset_rad=offset)
        knee = [coordinates(system, reading)[0] for reading in readings]
        ahead = compass(G1, np.concatenate([[walk.theta_4[0]], walk.theta_4 + COUNT]))
        per_count = ahead.knee_angle[1:] - walk.knee_angle
        return (np.array(knee) - walk.knee_angle) / per_count

    # Uniform over one count: mean 0 or 0.5, each to 3 standard errors 0.29/√997 = 0.009.
    assert errors_in_counts(0.0).mean() == pytest.approx(-0.5, abs=0.03)
    assert errors_in_counts(0.5 * COUNT).mean() == pytest.approx(0.0, abs=0.03)
    # The sensitivity changes by 2 % within a count.
    assert np.abs(errors_in_counts(0.5 * COUNT)).max() < 0.52


def test_rod_reference_equals_the_derivatives_of_a_composed_polynomial():
    rng = np.random.default_rng(5)
    system = RodReference()
    p_rad = poly1d([1e-3 * c * math.degrees(1.0) ** (5 - n) for n, c in enumerate(P_MM_DEG)])
    for _ in range(20):
        angle, rate, acceleration, jerk = rng.uniform([0, -1, -3, -9], [1.5, 1, 3, 9])
        knee = poly1d([jerk / 6.0, acceleration / 2.0, rate, angle])  # of time, at t = 0
        x = p_rad(knee)  # numpy composes polynomials
        expected = [x(0.0), x.deriv(1)(0.0), x.deriv(2)(0.0), x.deriv(3)(0.0)]
        derivatives = rod(system, [angle, rate, acceleration, jerk])
        # Rounding of a dozen products of order one.
        np.testing.assert_allclose(derivatives, expected, rtol=1e-11, atol=1e-13)


# ------------------------------------------------------------------------------ bad input


def test_linkage_whose_encoder_reverses_is_refused_on_construction():
    values = {
        "o_a_x_m": 0.0135, "o_a_y_m": -0.0244, "o_b_x_m": -0.0052, "o_b_y_m": -0.0143,
        "a_2_m": 0.0268, "a_3_m": 0.0183, "a_4_m": 0.0268,
    }  # fmt: skip
    with pytest.raises(LinkageError, match="the encoder angle reverses near knee angle 4"):
        KneeCoordinates(LinkageParameters(**(G1.model_dump() | values)))


def test_reading_out_of_reach_gives_nan_and_never_a_plausible_angle():
    assert np.isnan(coordinates(KneeCoordinates(), math.radians(-30.0))).all()
    assert np.isnan(coordinates(KneeCoordinates(), math.nan)).all()
