"""Equilibria of sampled loops against closed forms, and the loops that have none."""

import math

import numpy as np
import pytest
import scipy
from linear_cases import (
    AREA,
    DISPLACEMENT,
    LEAKY,
    PAPER,
    SCENARIOS,
    SOFT,
    WEIGHT,
    Matrices,
    plant_parameters,
    raises_one_line,
    slope_of_table_1,
    total_leakage,
)

from kneexo.analysis.linear import loop_equilibrium
from kneexo.analysis.linear.loop_equilibrium import find_equilibrium
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.errors import LinearizationError
from kneexo.parameters import (
    BldcPumpParameters,
    CuffParameters,
    DifferenceParameters,
    ExactParameters,
    KneeLoadParameters,
    LegParameters,
    MomentTable,
    ObserverParameters,
    PidParameters,
    PlantParameters,
    RodPolynomialParameters,
    Scenario,
    SlidingModeParameters,
    TorqueParameters,
)
from kneexo.simulation.compiled import Recent
from kneexo.studies.paper import IDEAL_SMC

EQ_27_GAIN = (
    4.0 * PAPER["bulk"] * AREA * DISPLACEMENT / (6.0 * math.sqrt(1.4 * 1.8) * PAPER["volume"])
)
"""b̂ of Eq. 27 in m/s³ per rad/s."""


def test_a_loop_rests_where_leakage_and_slope_of_the_boundary_layer_meet():
    # Eq. 27 at rest: u = −(k/Φ) λ² e/b̂ must feed the leakage under a constant force.
    force, n = 300.0, PAPER | {"c_im": 2e-12}
    load = KneeLoadParameters(segment_mass_kg=0.0, disturbance_n=force)
    loop = linearize_loop(Scenario(plant=plant_parameters(n, load=load)))
    speed = n["gear"] / DISPLACEMENT * total_leakage(n) * force / AREA
    slope = math.sqrt(1.8 / 1.4) * 2.8e5 / 3.2
    error = -speed * EQ_27_GAIN / (slope * 20.0**2)
    p = RodPolynomialParameters().p_mm_deg
    rod = np.polyval(p, math.degrees(loop.knee_angle_rad))
    assert 1e-3 * (rod - np.polyval(p, 40.0)) == pytest.approx(error, rel=1e-8)


@pytest.mark.parametrize("estimator", [ObserverParameters(), DifferenceParameters()])
@pytest.mark.parametrize("force", [0.0, 300.0, 800.0])
def test_the_kink_of_eq_27_at_rest_leaves_no_trace(force, estimator):
    # |x⃛_d − 2λë − λ²ė| multiplies s, which is not zero under a load: its slope there is the mean
    # of both sides, 0, and the jerk of the reference acts through b̂⁻¹ alone.
    n = PAPER | {"c_im": 2e-12}
    load = KneeLoadParameters(segment_mass_kg=0.0, disturbance_n=force)
    controller = SlidingModeParameters(
        stiffness_uncertainty_n_per_m=1e4, damping_uncertainty_n_s_per_m=1e3
    )
    plant = plant_parameters(n, load=load)
    loop = linearize_loop(Scenario(plant=plant, controller=controller, estimator=estimator))
    m = Matrices(loop)
    command = m.c_u @ m.g_r
    assert command[0, 3] == pytest.approx(slope_of_table_1(40.0) / EQ_27_GAIN, rel=1e-7)
    # û has λ² and 2λ on the velocity and the acceleration, k/Φ times sat's slope 2λ and 1.
    slope = math.sqrt(1.8 / 1.4) * 2.8e5 / 3.2
    expected = (
        slope_of_table_1(40.0)
        / EQ_27_GAIN
        * np.array([20.0**2 * slope, 20.0**2 + 40.0 * slope, 40.0 + slope])
    )
    assert command[0, :3] == pytest.approx(expected, rel=1e-7)


@pytest.fixture
def nothing_read(monkeypatch):
    """Function that forgets the equations that were read before."""

    def forget():
        recent = Recent()
        monkeypatch.setattr(loop_equilibrium, "recent_equations", recent)
        return recent

    return forget


RARE = ("other_plant", "weight", "exact", "pid", "pid_tuned", "can_2")


@pytest.mark.parametrize("name", ["smc", *(pytest.param(n, marks=pytest.mark.slow) for n in RARE)])
def test_one_diagram_serves_all_loops_of_a_structure(nothing_read, name):
    nothing_read()
    for scenario in (Scenario(plant=plant_parameters(LEAKY, load=WEIGHT)), SCENARIOS[name]):
        linear_loop = linearize_loop(scenario, knee_angle_deg=52.0)
    nothing_read()
    fresh = linearize_loop(SCENARIOS[name], knee_angle_deg=52.0)
    for matrix in ("a", "b", "c", "d"):
        ours, theirs = (getattr(loop.model, matrix) for loop in (linear_loop, fresh))
        assert np.array_equal(ours, theirs), matrix


def test_loops_that_differ_in_numbers_share_a_diagram(nothing_read):
    recent = nothing_read()
    for n in (PAPER, LEAKY, SOFT):
        linearize_loop(Scenario(plant=plant_parameters(n), nominal=PlantParameters()))
    assert len(recent) == 1


def test_there_is_no_linear_loop_without_samples_or_slope():
    with raises_one_line(LinearizationError, "controller.continuous = true"):
        linearize_loop(IDEAL_SMC)
    with raises_one_line(LinearizationError, "controller.switching = signum"):
        linearize_loop(Scenario(controller=SlidingModeParameters(switching="signum")))


def pushed(force, **more):
    """A leaky plant whose motor must turn at ``speed`` to hold a constant force on the rod."""
    n = PAPER | {"c_im": 5e-12}
    load = KneeLoadParameters(segment_mass_kg=0.0, disturbance_n=force)
    speed = n["gear"] / DISPLACEMENT * total_leakage(n) * force / AREA
    return plant_parameters(n, load=load, **more), speed


def test_a_proportional_controller_rests_beside_its_reference_by_what_feeds_the_leakage():
    # u = −G r_0 K_p (θ_d − θ): the error is small, and the unused integral takes no part in it.
    plant, speed = pushed(200.0)
    loop = linearize_loop(Scenario(plant=plant, controller=PidParameters()))
    gain = 5.0 * 0.1 * 6.0 * AREA / DISPLACEMENT
    resting_rad = math.radians(40.0) + speed / gain
    # The linkage and the controller's polynomial differ by 0.04 mm, or 4e-4 rad.
    assert loop.knee_angle_rad == pytest.approx(resting_rad, abs=5e-4)
    assert speed / gain > 3e-3


def test_a_search_that_leaves_the_linkage_says_so():
    plant = PlantParameters(
        load=KneeLoadParameters(disturbance_n=1e4),
        pump=BldcPumpParameters(internal_leakage_m3_per_s_pa=2e-11),
    )
    where = r"where the search ends, d\(plant/cylinder.x\[0\]\)/dt = .* per s; reduce the load"
    with raises_one_line(LinearizationError, f"does not rest at knee angle 45 deg: {where}"):
        linearize_loop(Scenario(plant=plant, controller=PidParameters()), knee_angle_deg=45.0)


@pytest.mark.parametrize("share", [1.0 + 1e-10, 0.99, 0.5])
@pytest.mark.parametrize("kind", [SlidingModeParameters, PidParameters])
def test_a_rest_that_needs_the_speed_limit_or_more_is_refused(share, kind):
    plant, speed = pushed(200.0)
    controller = kind(command_limit_rad_s=share * speed)
    needed = rf"motor_speed_command = {speed:.4g} rad/s is at or above its limit of .* rad/s"
    with raises_one_line(LinearizationError, needed):
        linearize_loop(Scenario(plant=plant, controller=controller))


@pytest.mark.parametrize("moment", [-64.0, 20.0, 60.0])
def test_a_knee_that_assists_rests_where_the_cuff_carries_the_desired_torque(moment):
    # Without mass and leak the cuff carries a M, which is k (θ − θ_leg), and θ_leg is 40°. Each
    # moment is that at t = 0, and the search starts where the command is far above its limit.
    wearer = LegParameters(
        moment=MomentTable(times_s=(0.0, 30.0), moments_n_m=(moment, 0.0)),
        cuff=CuffParameters(stiffness_n_m_per_rad=1500.0),
    )
    scenario = Scenario(
        plant={"load": {"kind": "knee", "segment_mass_kg": 0.0}, "rod_map": "polynomial"},
        wearer=wearer,
        controller=TorqueParameters(mode="assist", assistance=0.4, leak_per_s=0.0),
    )
    rest = find_equilibrium(scenario, knee_angle_deg=40.0).knee_angle_rad
    assert rest - math.radians(40.0) == pytest.approx(0.4 * moment / 1500.0, rel=1e-6)


@pytest.mark.parametrize("eta", [3e3, 5e3, 8e3])
def test_a_boundary_layer_too_weak_for_the_leakage_leaves_no_rest(eta):
    plant, speed = pushed(800.0)
    controller = SlidingModeParameters(eta_m_s3=eta)
    assert speed > 100.0
    with raises_one_line(LinearizationError, "does not rest at knee angle 40 deg"):
        linearize_loop(Scenario(plant=plant, controller=controller))


@pytest.mark.parametrize("full_order", [None, {}])
def test_a_passive_leg_rests_where_its_weight_is_whatever_the_reference(full_order):
    """W(θ) + k_0 (θ_n − θ) = 0 of leg and shank together, with zero torque of the actuator."""
    leg = Scenario.preset("wearer").changed(
        {"wearer.motion": "passive", "plant.full_order": full_order}
    )
    rests = [
        find_equilibrium(leg, knee_angle_deg=angle).knee_angle_rad for angle in (5.0, 40.0, 80.0)
    ]
    assert rests == pytest.approx([rests[0]] * 3, abs=1e-6)
    wearer, load = leg.wearer, leg.plant.load
    weight = 9.81 * (
        wearer.leg_mass_kg * wearer.centre_of_mass_m + load.segment_mass_kg * load.centre_of_mass_m
    )
    spring = wearer.bare_stiffness_n_m_per_rad
    by_hand = scipy.optimize.brentq(
        lambda x: -weight * math.sin(x) - spring * (x - wearer.neutral_angle_rad), 0.0, 1.0
    )
    assert rests[0] == pytest.approx(by_hand, rel=0.05)


def test_a_rest_outside_the_boundary_layer_is_refused():
    # Without η nothing pulls s to zero; Table 1 and the linkage differ by λ²·0.03 mm.
    controller = SlidingModeParameters(eta_m_s3=0.0, phi_m_s2=1e-6)
    with raises_one_line(LinearizationError, "outside the boundary layer"):
        linearize_loop(Scenario(estimator=ExactParameters(), controller=controller))
