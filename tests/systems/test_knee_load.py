import math

import numpy as np
import pytest
from table_1 import P_MM_DEG

from diagramc.testing import check_leaf
from kneexo.parameters import KneeLoadParameters
from kneexo.systems import KneeLoad

PARAMETERS = KneeLoadParameters(
    segment_mass_kg=3.0,
    centre_of_mass_m=0.25,
    thigh_inclination_rad=0.4,
    knee_torque_n_m=2.0,
    disturbance_n=-7.0,
    disturbance_amplitude_n=5.0,
    disturbance_frequency_hz=0.7,
)
INPUTS = {
    "knee_angle": [(0.0, 1.5)],
    "moment_arm": [(0.03, 0.11)],
    "knee_torque": [(-10.0, 10.0)],
    "disturbance_force": [(-50.0, 50.0)],
}


# ----------------------------------------------------------------------------- conversion


def test_conversions_agree_and_keep_arguments_and_changes():
    check_leaf(KneeLoad(PARAMETERS), INPUTS)


# -------------------------------------------------------------------------------- numbers


def test_random_points_meet_the_written_out_equation(leaf):
    probe = leaf.Probe(KneeLoad(PARAMETERS), INPUTS)
    for z in probe.points(50):
        time, knee, arm, torque, disturbance = z[:5]
        weight = 3.0 * 9.81 * 0.25 * math.sin(0.4 - knee)
        sine = 5.0 * math.sin(2.0 * math.pi * 0.7 * time)
        expected = (weight + 2.0 + torque) / arm - 7.0 + sine + disturbance
        assert probe.results(z) == pytest.approx([expected], rel=1e-12, abs=1e-11)  # rounding


def test_work_of_the_weight_on_the_rod_is_its_loss_of_potential_energy():
    degrees = np.linspace(0.0, 90.0, 2001)
    x = 1e-3 * np.polyval(P_MM_DEG, degrees)
    arm = -1e-3 * np.polyval(np.polyder(np.array(P_MM_DEG)), degrees) * math.degrees(1.0)
    system = KneeLoad(KneeLoadParameters(segment_mass_kg=2.0, thigh_inclination_rad=0.9))
    context, forces = system.CreateDefaultContext(), []
    for angle, lever in zip(np.radians(degrees), arm, strict=True):
        system.GetInputPort("knee_angle").FixValue(context, angle)
        system.GetInputPort("moment_arm").FixValue(context, lever)
        forces.append(system.GetOutputPort("load_force").Eval(context)[0])
    # Height of the centre of mass below the knee: 0.2 m · cos(α − θ).
    sinks = 0.2 * (math.cos(0.9 - math.pi / 2.0) - math.cos(0.9))
    # The load drives the rod by −F_L dx; the trapezoidal rule over 2000 steps leaves 1e-6.
    assert -np.trapezoid(forces, x) == pytest.approx(2.0 * 9.81 * sinks, rel=1e-5)


def test_an_inertia_is_a_mass_at_the_rod_that_grows_as_the_arm_shortens():
    inputs = INPUTS | {"moment_arm_slope": [(-0.6, 0.6)]}
    system = KneeLoad(KneeLoadParameters(inertia_kg_m2=0.064))
    check_leaf(system, inputs)
    for arm, slope in ((0.1, 0.0), (0.04, -0.5), (0.08, 0.3)):
        context = system.CreateDefaultContext()
        system.GetInputPort("moment_arm").FixValue(context, arm)
        system.GetInputPort("moment_arm_slope").FixValue(context, slope)
        mass, mass_slope = system.GetOutputPort("moving_mass").Eval(context)
        assert mass == pytest.approx(0.064 / arm**2, rel=1e-14)
        h = 1e-6  # relative truncation h² r'²/r², some 1e-10
        ahead, behind = (0.064 / (arm + s * slope) ** 2 for s in (h, -h))
        assert mass_slope == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-8, abs=1e-9)
