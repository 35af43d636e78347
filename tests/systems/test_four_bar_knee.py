import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from table_1 import P_MM_DEG, THETA_4_DEG

from diagramc.testing import check_leaf
from kneexo.errors import LinkageError, SimulationError
from kneexo.geometry.linkage import rod_extension
from kneexo.parameters import (
    G1,
    G2,
    LINKAGES,
    TABLE_1_LINKAGES,
    KneeParameters,
    LinkageParameters,
    RodPolynomialParameters,
)
from kneexo.systems import FourBarKnee

INPUTS = {"rod_extension": [(0.01, 0.13)]}
OUTPUTS = {
    "knee_kinematics": 3, "knee_angle": 1, "encoder_angle": 1, "moment_arm": 1,
    "moment_arm_slope": 1, "icr": 2,
}  # fmt: skip

names = pytest.mark.parametrize("name", LINKAGES)


def outputs(system, extension):
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_extension").FixValue(context, extension)
    return {name: np.array(system.GetOutputPort(name).Eval(context)) for name in OUTPUTS}


def many_outputs(system, extensions):
    every = [outputs(system, x) for x in extensions]
    return {name: np.array([one[name] for one in every]) for name in OUTPUTS}


# ----------------------------------------------------------------------------- conversion


@pytest.mark.parametrize(  # coordinates of zero have no relative step
    "name", [n if n == "G1" else pytest.param(n, marks=pytest.mark.slow) for n in TABLE_1_LINKAGES]
)
def test_conversions_agree_and_keep_arguments_and_changes(name):
    check_leaf(FourBarKnee(LINKAGES[name]), INPUTS)


def test_conversions_keep_the_table_and_the_range_of_motion():
    knee = KneeParameters(flexion_max_deg=80.0)
    system = FourBarKnee(G1, knee, RodPolynomialParameters())
    check_leaf(system, INPUTS)
    converted = system.ToAutoDiffXd()
    largest_angle = converted.parameters(converted.CreateDefaultContext()).flexion_max_rad.value()
    assert largest_angle == pytest.approx(math.radians(80.0), rel=1e-15)


# -------------------------------------------------------------------------------- numbers


@names
def test_knee_and_encoder_angles_meet_the_compass_construction(name, compass):
    link = LINKAGES[name]
    walk = compass(link, np.radians(np.linspace(*THETA_4_DEG[name], 301)))
    values = many_outputs(FourBarKnee(link), walk.rod_extension)
    # The fit leaves 4e-13 m at arms of 0.03 m or more, and up to 4e-12 rad; ten times that on G4
    # and G5.
    limit = 1e-10 if name in ("G4", "G5") else 2e-11
    np.testing.assert_allclose(values["knee_angle"][:, 0], walk.knee_angle, rtol=0.0, atol=limit)
    np.testing.assert_allclose(values["encoder_angle"][:, 0], walk.theta_4, rtol=0.0, atol=limit)


@names
def test_moment_arm_and_centre_of_rotation_meet_differences_of_the_construction(name, compass):
    link, h = LINKAGES[name], 1e-5
    theta_4 = np.radians(np.linspace(*THETA_4_DEG[name], 61))
    start = np.radians(THETA_4_DEG[name][0])  # the walk needs to start at the extended knee
    at, ahead, behind = (
        compass(link, np.concatenate([[start], theta_4 + step])) for step in (0.0, h, -h)
    )
    turned = (ahead.knee_angle - behind.knee_angle)[1:]
    arm = -(ahead.rod_extension - behind.rod_extension)[1:] / turned
    # A point of the coupler at A moves at j(A − centre) per rad.
    centre = at.joint_a[1:] + 1j * (ahead.joint_a - behind.joint_a)[1:] / turned
    values = many_outputs(FourBarKnee(link), at.rod_extension[1:])
    # Truncation h² ~ 1e-10 times curvatures below 1e2 (m, rad); rounding 1e-16/1e-5.
    np.testing.assert_allclose(values["moment_arm"][:, 0], arm, rtol=0.0, atol=1e-8)
    own_centre = values["icr"] @ [1.0, 1.0j]
    np.testing.assert_allclose(own_centre, centre, rtol=0.0, atol=1e-8)
    # Virtual work: r is the clockwise moment of a unit force of the rod about its own centre. The
    # fit leaves 2e-11 of an arm of 0.03 m.
    anchor = link.rod_anchor_radius_m * np.exp(1j * link.rod_anchor_angle_rad)
    pin, rod = at.rod_pin[1:], at.rod_pin[1:] - anchor
    moment = -np.imag(np.conj(pin - own_centre) * rod) / np.abs(rod)
    np.testing.assert_allclose(values["moment_arm"][:, 0], moment, rtol=1e-9)


@names
def test_slope_of_the_moment_arm_meets_differences(name):
    system, h = FourBarKnee(LINKAGES[name]), 1e-6
    x = np.linspace(0.01, 0.14, 14)
    ahead, behind = (many_outputs(system, x + s)["moment_arm"] for s in (h, -h))
    # Rounding 1e-17/1e-6 of the arm, truncation h² times a third derivative of some 1e3 1/m².
    slope = many_outputs(system, x)["moment_arm_slope"]
    np.testing.assert_allclose(slope, (ahead - behind) / (2.0 * h), rtol=0.0, atol=1e-8)


def test_knee_of_table_1_follows_eq_10_and_keeps_the_encoder_of_the_linkage(compass):
    knee_deg = np.linspace(0.0, 90.0, 91)
    x = 1e-3 * np.polyval(P_MM_DEG, knee_deg)
    values = many_outputs(FourBarKnee(G1, rod_polynomial=RodPolynomialParameters()), x)
    # Degree 25 leaves 2.4e-10 rad for the polynomial.
    np.testing.assert_allclose(values["knee_angle"][:, 0], np.radians(knee_deg), atol=1e-9)
    walk = compass(G1, np.radians(np.linspace(82.6, -5.0, 20_001)))
    theta_4 = np.interp(np.radians(knee_deg), walk.knee_angle, walk.theta_4)
    # Linear interpolation over 8e-5 rad: its square over 8, times curvature.
    np.testing.assert_allclose(values["encoder_angle"][:, 0], theta_4, rtol=0.0, atol=1e-8)


# ------------------------------------------------------------------------------ bad input


def test_linkage_that_does_not_close_is_refused_on_construction():
    with pytest.raises(LinkageError, match="cannot be assembled at knee angle -2 deg"):
        FourBarKnee(LinkageParameters(**(G1.model_dump() | {"a_4_m": 0.015})))


@pytest.mark.parametrize(("angle_deg", "rest_deg"), [(15.0, 5.0), (65.0, 5.0), (71.0, -1.0)])
def test_the_margin_is_the_way_to_the_nearer_end_and_its_overshoot(angle_deg, rest_deg):
    system = FourBarKnee(G1, KneeParameters(flexion_min_deg=10.0, flexion_max_deg=70.0))
    overshoot = KneeParameters().overshoot_deg
    extension = float(rod_extension(G1, math.radians(angle_deg)))
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_extension").FixValue(context, extension)
    assert math.degrees(system.margin(context)) == pytest.approx(rest_deg + overshoot, abs=1e-6)


@pytest.mark.parametrize(
    ("extension", "words"),
    [
        (-0.02, "knee_angle outside -2 … 91 deg left"),
        (0.17, "knee_angle outside -2 … 91"),
        (
            0.1483,
            "= -0.4.* deg left the range of motion 0 … 90 deg; reduce the motion, the load, the "
            "push, the fault or the step",
        ),
    ],
)
def test_no_angle_is_named_where_the_polynomials_give_none(extension, words):
    # At −20 mm the polynomial of θ_p gives 103 deg, and at −1 m 4e14 deg.
    system = FourBarKnee(G1, KneeParameters(overshoot_deg=0.1))
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_extension").FixValue(context, extension)
    with pytest.raises(SimulationError, match=words):
        Simulator(system, context).Initialize()


def test_range_of_motion_is_a_context_parameter():
    system = FourBarKnee()
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_extension").FixValue(context, 0.075)
    Simulator(system, context.Clone()).Initialize()  # 47 deg are inside 0 … 90 deg
    system.set_parameter(context, "flexion_max_rad", math.radians(45.0))
    with pytest.raises(SimulationError, match="left the range of motion 0 … 45 deg"):
        Simulator(system, context).Initialize()


@pytest.mark.parametrize("extension", [math.nan, 1.0, -1.0])
def test_extension_without_a_knee_angle_raises_instead_of_hanging(extension):
    system = FourBarKnee(G2)
    system.set_name("knee")
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_extension").FixValue(context, extension)
    with pytest.raises(
        SimulationError, match=r"^t = 0 s: knee: knee_angle (=|outside) [^\n]* left the range"
    ):
        Simulator(system, context).AdvanceTo(0.1)
