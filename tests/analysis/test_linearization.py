"""The linear analysis against hand-written formulas, Drake's Simulator and python-control."""

import dataclasses
import itertools
import math
import re

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest
from pydrake.symbolic import Variable, exp
from pydrake.systems.analysis import InitializeParams, ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, SymbolicVectorSystem
from scipy.interpolate import CubicSpline
from scipy.optimize import linear_sum_assignment

from kneexo.analysis import loop_equilibrium
from kneexo.analysis.error_model import error_model
from kneexo.analysis.plant_linearization import find_operating_point, linearize_plant
from kneexo.analysis.sampled_loop import SampledLoop, linearize_loop
from kneexo.diagrams import make_closed_loop, make_plant
from kneexo.errors import KneexoError, LinearizationError, LinkageError, ParameterError
from kneexo.parameters import (
    G1,
    BldcPumpParameters,
    CylinderParameters,
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    LinkageParameters,
    ObserverParameters,
    PidParameters,
    PlantParameters,
    RodPolynomialParameters,
    Scenario,
    SineReference,
    SlidingModeParameters,
    StepReference,
)
from kneexo.parameters.paths import changed
from kneexo.studies.paper import EQ_27_EXACT_STATES, IDEAL_SMC

T = 0.002
AREA = math.pi / 4.0 * (0.020**2 - 0.5 * 0.010**2)
DISPLACEMENT = 0.8e-6 / (2.0 * math.pi)
GRAVITY = 9.81

# Lee et al. 2020, Tables 2 and 3; lag and leakage are this project's assumptions.
PAPER = {
    "lag": 0.010,
    "gear": 6.0,
    "c_im": 2e-13,
    "c_em": 0.0,
    "c_l": 0.0,
    "volume": 41_233e-9,
    "bulk": 1.72e9,
    "mass": 1.6,
    "damping": 0.05,
    "stiffness": 0.0,
}
LEAKY = PAPER | {"c_im": 3e-12, "c_em": 8e-12, "c_l": 5e-12, "damping": 40.0, "lag": 0.003}
# Soft oil, a spring and every leakage, so that no term of Eq. 13, 15, 16 can hide.
SOFT = LEAKY | {"gear": 4.0, "bulk": 5e7, "mass": 1.4, "stiffness": 1500.0, "lag": 0.020}
SPRING = PAPER | {"stiffness": 2e4, "c_em": 1e-12, "damping": 300.0}
SETS = {"paper": PAPER, "leaky": LEAKY, "soft": SOFT, "spring": SPRING}


def plant_parameters(n, **more):
    return PlantParameters(
        pump=BldcPumpParameters(
            lag_s=n["lag"],
            gear_ratio=n["gear"],
            displacement_m3_per_rad=DISPLACEMENT,
            internal_leakage_m3_per_s_pa=n["c_im"],
            external_leakage_m3_per_s_pa=n["c_em"],
        ),
        cylinder=CylinderParameters(
            total_volume_m3=n["volume"],
            bulk_modulus_pa=n["bulk"],
            mass_kg=n["mass"],
            damping_n_s_per_m=n["damping"],
            stiffness_n_per_m=n["stiffness"],
            leakage_m3_per_s_pa=n["c_l"],
        ),
        **more,
    )


def total_leakage(n):
    return n["c_l"] + n["c_im"] + 0.5 * n["c_em"]


def cubic(n, load_stiffness=0.0):
    """Characteristic polynomial of [x, v, P] (Eq. 13, 15, 16), highest power first.

    dP/dt = h(q − Āv − C_t P), m dv/dt = ĀP − Bv − Kx, h = 4β_e/V_t.
    """
    h, c_t = 4.0 * n["bulk"] / n["volume"], total_leakage(n)
    k = n["stiffness"] + load_stiffness
    return [
        n["mass"],
        n["damping"] + n["mass"] * h * c_t,
        k + n["damping"] * h * c_t + h * AREA**2,
        k * h * c_t,
    ]


def polished(polynomial, root):
    """Root of a polynomial nearest to ``root``, by Newton's method on its own coefficients."""
    slope = np.polyder(polynomial)
    for _ in range(20):
        root = root - np.polyval(polynomial, root) / np.polyval(slope, root)
    return root


def roots(polynomial):
    """All roots to full relative precision, also a slow one next to fast ones; 0 if it is one."""
    if polynomial[-1] == 0.0:
        return np.append(roots(polynomial[:-1]), 0.0)
    return np.array([polished(polynomial, root + 0j) for root in np.roots(polynomial)])


def distance(found, expected):
    """Largest distance of two sets of complex numbers, paired as well as can be."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.size == expected.size
    cost = np.abs(found[:, None] - expected[None, :])
    return cost[linear_sum_assignment(cost)].max()


def nearest(values, value):
    return values[np.argmin(np.abs(values - value))]


def raises_one_line(kind, match):
    return pytest.raises(kind, match=rf"\A(?=.*{match})[^\n]*\Z")


@pytest.fixture(scope="module")
def rod_of_knee(compass):
    """Rod extension of G1 as a function of the knee angle, by compass and ruler."""
    walk = compass(G1, np.radians(np.linspace(82.6, -4.8, 4001)))
    return CubicSpline(walk.knee_angle, walk.rod_extension)


# -------------------------------------------------------------------------- operating point

WEIGHT = KneeLoadParameters(thigh_inclination_rad=0.4)
POSTURES = {
    "none": (plant_parameters(PAPER), {}),
    "weight": (plant_parameters(LEAKY, load=WEIGHT), {}),
    "torque": (plant_parameters(LEAKY, load=WEIGHT), {"knee_torque_n_m": -14.0}),
    "disturbed": (plant_parameters(SOFT), {"disturbance_n": 90.0}),
    "spring": (
        plant_parameters(SOFT, load=WEIGHT, rod_map="polynomial"),
        {"knee_torque_n_m": 3.0, "disturbance_n": -25.0},
    ),
    "ideal": (plant_parameters(LEAKY, load=WEIGHT, ideal_motor=True), {}),
}


@pytest.mark.parametrize("name", POSTURES)
@pytest.mark.parametrize("angle", [12.0, 67.0])
def test_an_operating_point_is_an_equilibrium_of_the_plant(name, angle):
    parameters, forces = POSTURES[name]
    point = find_operating_point(parameters, angle, **forces)
    plant = make_plant(parameters)
    context = plant.CreateDefaultContext()
    context.SetContinuousState(point.state)
    plant.GetInputPort("motor_speed_command").FixValue(context, [point.motor_speed_rad_s])
    if "knee_torque_n_m" in forces:
        plant.GetInputPort("knee_torque").FixValue(context, [forces["knee_torque_n_m"]])
    plant.GetInputPort("disturbance_force").FixValue(context, [forces.get("disturbance_n", 0.0)])
    # Rounding: the pressure's rate in MPa/s is the difference of terms below 1e3.
    rates = plant.EvalTimeDerivatives(context).CopyToVector()
    assert np.abs(rates).max() < 1e-9
    assert math.degrees(point.knee_angle_rad) == pytest.approx(angle, abs=1e-9)
    for port, value in (
        ("knee_angle", point.knee_angle_rad),
        ("load_pressure", point.load_pressure_pa),
        ("rod_force", point.rod_force_n),
        ("motor_speed", point.motor_speed_rad_s),
    ):
        assert plant.GetOutputPort(port).Eval(context)[0] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("name", POSTURES)
def test_the_motor_makes_up_for_the_leakage(name, rod_of_knee):
    parameters, forces = POSTURES[name]
    knee = math.radians(33.0)
    if parameters.rod_map == "polynomial":
        p = RodPolynomialParameters().p_mm_deg
        x, arm = 1e-3 * np.polyval(p, 33.0), -0.18 / math.pi * np.polyval(np.polyder(p), 33.0)
    else:
        x, arm = float(rod_of_knee(knee)), -float(rod_of_knee(knee, 1))
    n = {"none": PAPER, "disturbed": SOFT, "spring": SOFT}.get(name, LEAKY)
    force = forces.get("disturbance_n", 0.0)
    if parameters.load.kind == "knee":
        weight = 1.6 * GRAVITY * 0.20 * math.sin(0.4 - knee)
        force += (weight + forces.get("knee_torque_n_m", 0.0)) / arm
    pressure = (force + n["stiffness"] * x) / AREA
    speed = n["gear"] / DISPLACEMENT * total_leakage(n) * pressure
    point = find_operating_point(parameters, 33.0, **forces)
    # The spline of the linkage is exact to 1e-9.
    assert point.load_pressure_pa == pytest.approx(pressure, rel=1e-8, abs=1e-6)
    assert point.rod_force_n == pytest.approx(force, rel=1e-8, abs=1e-7)
    assert point.motor_speed_rad_s == pytest.approx(speed, rel=1e-8, abs=1e-12)


def test_an_operating_point_prints_in_the_papers_units():
    point = find_operating_point(plant_parameters(PAPER), 40.0, disturbance_n=1e7 * AREA)
    rpm = 6.0 / DISPLACEMENT * 2e-13 * 1e7 * 30.0 / math.pi
    assert str(point) == (
        f"knee at 40 deg: motor {rpm:.4g} rpm, load pressure 10 MPa, rod force 2749 N"
    )


@pytest.mark.parametrize("torque", [3e3, 1e5, 1e9, -1e6])
def test_a_load_that_the_motor_cannot_hold_has_no_equilibrium(torque):
    load = rf"knee_torque = {torque:g} N·m and disturbance = 7 N".replace("+", r"\+")
    with raises_one_line(LinearizationError, f"no equilibrium at knee angle 40 deg with {load}"):
        find_operating_point(
            plant_parameters(PAPER, load=KneeLoadParameters()),
            40.0,
            knee_torque_n_m=torque,
            disturbance_n=7.0,
        )


@pytest.mark.parametrize("angle", [-30.0, 95.0, 400.0, math.nan, math.inf])
def test_a_posture_beyond_the_knee_is_refused(angle):
    with raises_one_line(KneexoError, "") as caught:
        find_operating_point(PlantParameters(), angle)
    assert isinstance(caught.value, ParameterError | LinkageError)


def test_a_linkage_that_does_not_close_is_refused():
    with raises_one_line(LinkageError, "cannot be assembled"):
        linearize_plant(PlantParameters(linkage=LinkageParameters(a_3_m=0.5)))


# ---------------------------------------------------------------------------------- plant


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("angle", [5.0, 40.0])
def test_poles_are_those_of_the_closed_form(name, angle):
    n = SETS[name]
    expected = np.append(roots(cubic(n)), -1.0 / n["lag"])
    found = linearize_plant(plant_parameters(n), angle).poles
    assert np.all(np.diff(np.abs(found)) > -1e-6 * np.abs(found[1:]))
    for pole in expected:
        # 1e-9 of each pole, and rounding of the largest for one that is zero or slow.
        floor = 1e-15 * np.abs(expected).max()
        assert abs(nearest(found, pole) - pole) <= 1e-9 * abs(pole) + floor
    assert distance(found, expected) <= 1e-9 * np.abs(expected).max()


def test_an_ideal_motor_has_no_pole():
    found = linearize_plant(plant_parameters(SOFT, ideal_motor=True)).poles
    assert distance(found, roots(cubic(SOFT))) <= 1e-9 * np.abs(found).max()


@pytest.mark.parametrize("name", SETS)
def test_damping_is_that_of_the_closed_form(name):
    n = SETS[name]
    frequency, ratio = linearize_plant(plant_parameters(n)).damping
    m, c_2, c_1, c_0 = cubic(n)
    oscillating = np.flatnonzero(ratio < 1.0 - 1e-6)
    assert oscillating.size == 2
    omega, zeta = frequency[oscillating[0]], ratio[oscillating[0]]
    slow = 0.0 if c_0 == 0.0 else max(roots([m, c_2, c_1, c_0]).real)
    # The pair and the slow root −σ: c_2/m = σ + 2ζω, c_1/m = ω² + 2ζωσ.
    assert 2.0 * zeta * omega - slow == pytest.approx(c_2 / m, rel=1e-8)
    assert omega**2 - 2.0 * zeta * omega * slow == pytest.approx(c_1 / m, rel=1e-9)
    real = np.setdiff1d(np.arange(4), oscillating)
    assert ratio[real] == pytest.approx([1.0, 1.0])


def test_the_papers_hydraulic_mode_lies_at_447_hz_and_is_nearly_undamped():
    frequency, ratio = linearize_plant().damping
    assert frequency[-1] / (2.0 * math.pi) == pytest.approx(446.8, abs=0.1)
    assert ratio[-1] == pytest.approx(0.0059, abs=1e-4)


def slope_of_table_1(angle_deg):
    """dx/dθ_p of Eq. 10 in m/rad."""
    return 0.18 / math.pi * np.polyval(np.polyder(RodPolynomialParameters().p_mm_deg), angle_deg)


@pytest.mark.parametrize("name", SETS)
def test_the_response_is_that_of_the_closed_form(name):
    n = SETS[name]
    plant = linearize_plant(
        plant_parameters(n, rod_map="polynomial"), 52.0, outputs=("knee_angle", "rod_extension")
    )
    f = np.array([0.02, 1.0, 30.0, 447.0, 2e3])
    s = 2j * math.pi * f
    h = 4.0 * n["bulk"] / n["volume"]
    rod = h * AREA * DISPLACEMENT / n["gear"] / (1.0 + n["lag"] * s) / np.polyval(cubic(n), s)
    # 3e-10 rad in the inverse of Table 1 become 1e-7 in its slope.
    assert plant.response(f) == pytest.approx(rod / slope_of_table_1(52.0), rel=1e-6)
    assert plant.to_control()(s)[1, 0] == pytest.approx(rod, rel=1e-8)


def test_knee_and_load_give_the_row_of_the_output(rod_of_knee):
    plant = linearize_plant(outputs=("knee_angle", "moment_arm", "rod_state"))
    knee = math.radians(40.0)
    x_1, x_2 = float(rod_of_knee(knee, 1)), float(rod_of_knee(knee, 2))
    assert plant.c.shape == (5, 4)
    assert plant.d == pytest.approx(np.zeros((5, 1)), abs=1e-15)
    assert plant.c[0] == pytest.approx([0.0, 1.0 / x_1, 0.0, 0.0], rel=1e-7)
    assert plant.c[1] == pytest.approx([0.0, -x_2 / x_1, 0.0, 0.0], rel=1e-5)
    assert plant.c[4] == pytest.approx([0.0, 0.0, -0.05 / 1.6, 1e6 * AREA / 1.6])


def test_the_knee_angle_has_no_zeros_and_the_pressure_those_of_the_mass():
    assert linearize_plant(plant_parameters(SOFT)).zeros.size == 0
    pressure = linearize_plant(plant_parameters(SOFT), outputs=("load_pressure",)).zeros
    assert distance(pressure, np.roots([1.4, 40.0, 1500.0])) < 1e-6
    velocity = linearize_plant(plant_parameters(SOFT), outputs=("rod_velocity",)).zeros
    assert distance(velocity, [0.0]) < 1e-6


@pytest.mark.parametrize("name", ["paper", "leaky"])
def test_velocity_gain_is_displacement_over_area_less_leakage(name):
    # Steady: ĀP = Bv and Dω/gear = Āv + C_t P, so v/ω = (D/gear)Ā/(Ā² + C_t B).
    n = SETS[name]
    gain = DISPLACEMENT / n["gear"] * AREA / (AREA**2 + total_leakage(n) * n["damping"])
    plant = plant_parameters(n, rod_map="polynomial")
    rod = linearize_plant(plant, 25.0, outputs=("rod_extension",)).velocity_gain
    assert rod == pytest.approx(gain, rel=1e-9)
    knee = linearize_plant(plant, 25.0).velocity_gain
    assert knee == pytest.approx(gain / slope_of_table_1(25.0), rel=1e-6)


def test_velocity_gain_of_the_full_order_is_the_limit_of_its_response():
    plant = linearize_plant(PlantParameters(full_order=FullCylinderParameters()))
    frequency_hz = 1e-3
    # The next pole is 1e5 times faster. Its phase is small, its effect on the magnitude smaller.
    limit = (2j * np.pi * frequency_hz * plant.response(frequency_hz)[0]).real
    assert plant.velocity_gain == pytest.approx(limit, rel=1e-8)


def test_pairs_of_eigenvalues_begin_with_the_positive_imaginary_part():
    # A sort that is not stable orders equal magnitudes by the processor's vector width.
    plants = [PlantParameters(), PlantParameters(full_order=FullCylinderParameters())]
    for values in (
        *(linearize_plant(plant).poles for plant in plants),
        linearize_loop(Scenario(encoder=EncoderParameters(quantized=False))).eigenvalues,
    ):
        imaginary = values.imag[values.imag != 0.0]
        assert len(imaginary) >= 2
        assert np.all(imaginary[::2] > 0.0)


def test_a_strong_spring_leaves_no_velocity_gain():
    # Its pole, −K C_t/Ā² = −1.4 1/s, is no integrator next to the motor's −100 1/s.
    plant = linearize_plant(plant_parameters(SPRING | {"c_em": 1e-11}), 85.0)
    assert plant.velocity_gain == 0.0


def test_the_plant_goes_to_control_and_back():
    plant = linearize_plant(plant_parameters(SOFT), outputs=("knee_angle", "load_pressure"))
    system = plant.to_control()
    assert system.dt == 0
    for name in ("a", "b", "c", "d"):
        assert np.array_equal(getattr(system, name.upper()), getattr(plant, name))
    f = np.array([0.1, 3.0, 60.0])
    assert system(2j * math.pi * f)[0, 0] == pytest.approx(plant.response(f), rel=1e-9)


@pytest.mark.parametrize("angle", [15.0, 40.0, 75.0])
@pytest.mark.parametrize("torque", [0.0, 6.0])
def test_the_weight_acts_as_a_spring_in_the_slow_pole(angle, torque, rod_of_knee):
    # F_L = τ(θ)/r(θ), dθ/dx = −1/r: dF_L/dx = −τ'/r² + τ r'/r³.
    knee = math.radians(angle)
    x_1, x_2 = float(rod_of_knee(knee, 1)), float(rod_of_knee(knee, 2))
    arm, arm_1 = -x_1, -x_2
    moment = 1.6 * GRAVITY * 0.20
    tau, tau_1 = moment * math.sin(0.4 - knee) + torque, -moment * math.cos(0.4 - knee)
    stiffness = -tau_1 / arm**2 + tau * arm_1 / arm**3
    n = LEAKY | {"c_im": 1e-11}  # so that the slow pole stands out of the rounding
    plant = linearize_plant(plant_parameters(n, load=WEIGHT), angle, knee_torque_n_m=torque)
    expected = roots(cubic(n, stiffness))
    slow = expected[np.argmin(np.abs(expected))]
    assert abs(slow) > 0.01
    # The second derivative of the spline is exact to 1e-6.
    assert plant.poles[0] == pytest.approx(slow, rel=1e-5)


def test_a_diagram_may_take_the_place_of_the_parameters():
    parameters = plant_parameters(LEAKY, load=WEIGHT)
    ours = linearize_plant(make_plant(parameters), 55.0, knee_torque_n_m=2.0, disturbance_n=9.0)
    theirs = linearize_plant(parameters, 55.0, knee_torque_n_m=2.0, disturbance_n=9.0)
    for name in ("a", "b", "c", "d"):
        scale = np.abs(getattr(theirs, name)).max() + 1e-300
        assert np.abs(getattr(ours, name) - getattr(theirs, name)).max() <= 1e-9 * scale


def test_a_plant_prints_its_poles_and_gain():
    text = str(linearize_plant())
    assert "-100 +0j 1/s" in text
    assert "446.8 Hz, damping ratio 0.005949" in text
    assert re.search(r"velocity gain of knee_angle: -0\.0007\d+$", text)


# -------------------------------------------------------------------- sampled loop: structure

PI = PidParameters(
    proportional_per_s=11.89, integral_per_s2=380.5, derivative=0.02, filter_s=0.01915
)
SCENARIOS = {
    "smc": Scenario(),
    "pid": Scenario(controller=PidParameters()),
    "pid_tuned": Scenario(controller=PI),
    "can_1": Scenario(bus={"latency_samples": 1}),
    "can_2": Scenario(bus={"latency_samples": 2}),
    "difference": Scenario(estimator=DifferenceParameters()),
    "exact": Scenario(
        estimator=ExactParameters(), controller=SlidingModeParameters(phi_m_s2=31.75)
    ),
    "weight": Scenario(plant=PlantParameters(load=KneeLoadParameters())),
    "other_plant": Scenario(
        plant=plant_parameters(SOFT | {"stiffness": 0.0}, rod_map="polynomial"),
        nominal=PlantParameters(),
    ),
}


@pytest.fixture(scope="module")
def loops():
    return {name: linearize_loop(scenario) for name, scenario in SCENARIOS.items()}


def eq_27(slope_per_s):
    """k/Φ with k = β η, β = √(1.8/1.4)."""
    phi = math.sqrt(1.8 / 1.4) * 2.8e5 / slope_per_s
    return Scenario(estimator=ExactParameters(), controller=SlidingModeParameters(phi_m_s2=phi))


@pytest.fixture(scope="module")
def unstable():
    return linearize_loop(eq_27(1.3e4))


def test_states_and_sizes(loops):
    sizes = {name: loop.g_z.shape[0] for name, loop in loops.items()}
    # Command and estimator; the PID's filter, and its integral where it has integral action.
    assert sizes == {
        "smc": 4,
        "pid": 2,
        "pid_tuned": 3,
        "can_1": 5,
        "can_2": 6,
        "difference": 3,
        "exact": 1,
        "weight": 4,
        "other_plant": 4,
    }
    for name, loop in loops.items():
        m = sizes[name]
        assert loop.a.shape == (4, 4)
        assert loop.b.shape == (4, 1)
        assert loop.c.shape == (1, 4)
        assert loop.g_x.shape == (m, 4)
        assert loop.g_r.shape == (m, 4)
        assert loop.c_u.shape == (1, m)
        assert loop.monodromy.shape == (4 + m, 4 + m)
        assert loop.sample_time_s == T
        assert loop.stable
        assert loop.to_control().dt == T


@pytest.mark.parametrize("name", ["smc", "pid_tuned", "other_plant"])
def test_the_held_plant_is_that_of_the_modal_sum(loops, name):
    loop = loops[name]
    values, right = np.linalg.eig(loop.a)
    left = np.linalg.inv(right)
    a_d = right @ np.diag(np.exp(values * T)) @ left
    integral = [T if abs(v) < 1e-12 else (np.exp(v * T) - 1.0) / v for v in values]
    b_d = right @ np.diag(integral) @ left @ loop.b
    found = loop.plant_step()
    assert np.abs(found[0] - a_d).max() < 1e-11 * np.abs(a_d).max()
    assert np.abs(found[1] - b_d).max() < 1e-11 * np.abs(b_d).max()
    sampled = control.sample_system(control.ss(loop.a, loop.b, loop.c, [[0.0]]), T, method="zoh")
    assert np.abs(found[0] - sampled.A).max() < 1e-12 * np.abs(a_d).max()
    assert np.abs(found[1] - sampled.B).max() < 1e-12 * np.abs(b_d).max()


def test_the_plant_of_a_loop_is_the_linearized_plant(loops):
    plant = linearize_plant()
    for name in ("smc", "pid", "can_2", "exact"):
        assert np.abs(loops[name].a - plant.a).max() < 1e-9 * np.abs(plant.a).max()
        assert np.abs(loops[name].b - plant.b).max() < 1e-12 * np.abs(plant.b).max()


@pytest.mark.parametrize(
    "controller",
    [
        # With these the integral's update differs from the identity by rounding.
        PidParameters(
            proportional_per_s=11.3, moment_arm_m=0.0931, derivative=0.03, filter_s=0.013
        ),
        PidParameters(proportional_per_s=7.7, moment_arm_m=0.113, velocity_feedforward=0.9),
        PidParameters(proportional_per_s=3.1, moment_arm_m=0.077, anti_windup_s=0.37),
    ],
)
def test_an_unused_integral_is_no_state_of_the_loop(controller):
    loop = linearize_loop(Scenario(controller=controller))
    assert loop.g_z.shape == (2, 2)
    assert loop.stable


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
    command = loop.c_u @ loop.g_r
    assert command[0, 3] == pytest.approx(slope_of_table_1(40.0) / EQ_27_GAIN, rel=1e-7)
    # û has λ² and 2λ on the velocity and the acceleration, k/Φ times sat's slope 2λ and 1.
    slope = math.sqrt(1.8 / 1.4) * 2.8e5 / 3.2
    expected = (
        slope_of_table_1(40.0)
        / EQ_27_GAIN
        * np.array([20.0**2 * slope, 20.0**2 + 40.0 * slope, 40.0 + slope])
    )
    assert command[0, :3] == pytest.approx(expected, rel=1e-7)


# ------------------------------------------------------------- sampled loop: one sample by Drake


def at_rest(scenario, angle_deg):
    """The scenario with a constant reference and without the quantizer."""
    return scenario.model_copy(
        update={
            "encoder": EncoderParameters(quantized=False),
            "reference": StepReference(start_deg=angle_deg, end_deg=angle_deg),
        }
    )


def fixed_step(diagram, step, scheme="runge_kutta5"):
    """Simulator at a fixed step.

    The fifth order changes the 447 Hz mode by (ωh)⁶/720 a step: 3e-9 at 40 µs, 7e-7 at 0.1 ms,
    where RK3 at 20 µs changes it by (ωh)⁴/24 = 4e-7.
    """
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, scheme, step)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    return simulator


def perturbations(scenario):
    """Small steps of all states, by their units.

    |x⃛_d − 2λë − λ²ė| of Eq. 27 has a kink where the loop rests; s stays below Φ/1000.
    """
    plant = [1e-4, 1e-7, 1e-5, 1e-3]  # krad/s, m, m/s, MPa
    if scenario.controller.kind == "pid":
        controller = [1e-2, 1e-3, 1e-6]  # rad/s, rad/s, rad
    else:
        estimator = {"observer": [1e-7, 1e-5, 1e-3], "difference": [1e-7, 1e-5], "exact": []}
        controller = [1e-2, *estimator[scenario.estimator.kind]]  # rad/s; m, m/s, m/s²
    return np.diag([*plant, *controller, *[1e-2] * scenario.bus.latency_samples])


def monodromy_by_differences(scenario, angle_deg=40.0, step=4e-5):
    """Map of all states over one sample by Drake's Simulator, around where the loop rests.

    ``AdvanceTo(T)`` from t = 0 makes the update at 0 and leaves that at T undone. States in the
    order of the Context; the update of the estimator by initialization is suppressed.
    """
    diagram = make_closed_loop(at_rest(scenario, angle_deg), signals=(), external_reference=True)
    simulator = fixed_step(diagram, step)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("knee_reference").FixValue(
        context, [math.radians(angle_deg), 0.0, 0.0, 0.0]
    )
    simulator.Initialize()
    groups = [
        context.get_discrete_state(i).size() for i in range(context.num_discrete_state_groups())
    ]
    n = context.num_continuous_states()
    bounds = list(itertools.pairwise([n, *(n + np.cumsum(groups)).tolist()]))

    def state():
        discrete = [context.get_discrete_state(i).CopyToVector() for i in range(len(groups))]
        return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])

    def sample(start):
        context.SetTime(0.0)
        context.SetContinuousState(start[:n])
        for index, (low, high) in enumerate(bounds):
            context.SetDiscreteState(index, start[low:high])
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.AdvanceTo(T)
        return state()

    rest = state()
    if scenario.plant.load.kind == "knee":  # the load shifts the rest: let it settle
        for _ in range(600):
            rest = sample(rest)
    return np.array(
        [
            (sample(rest + delta) - sample(rest - delta)) / (2.0 * delta.sum())
            for delta in perturbations(scenario)
        ]
    ).T


def compare_with_differences(loop, found):
    """Largest difference of the matrices, each row by its largest element."""
    scale = np.abs(found).max(axis=1, keepdims=True)
    return (np.abs(found - loop.monodromy) / scale).max()


@pytest.mark.parametrize(
    "name", ["smc", "pid", "pid_tuned", "can_1", "can_2", "difference", "other_plant"]
)
def test_monodromy_is_that_of_the_simulator(loops, name):
    found = monodromy_by_differences(SCENARIOS[name])
    if name == "pid":  # the unused integral, of which nothing depends
        assert np.abs(found[5] - np.eye(7)[5]).max() < 1e-7
        found = np.delete(np.delete(found, 5, axis=0), 5, axis=1)
    assert compare_with_differences(loops[name], found) < 1e-6
    # Multiple eigenvalues near zero (delays) amplify the rounding of the differences.
    values = np.linalg.eigvals(found)
    expected = loops[name].eigenvalues
    large = np.abs(expected) > 0.05
    assert distance(values[np.abs(values) > 0.05], expected[large]) < 1e-6


def test_monodromy_with_exact_states_is_that_of_the_simulator(loops):
    # The differences are taken beside the rest, which Table 1 puts a little off the start.
    found = monodromy_by_differences(SCENARIOS["exact"])
    assert compare_with_differences(loops["exact"], found) < 1e-6
    assert distance(np.linalg.eigvals(found), loops["exact"].eigenvalues) < 1e-6


@pytest.mark.slow
def test_monodromy_under_load_is_that_of_the_simulator(loops):
    found = monodromy_by_differences(SCENARIOS["weight"], step=1e-4)
    assert compare_with_differences(loops["weight"], found) < 2e-5  # 20 steps of 7e-7
    assert distance(np.linalg.eigvals(found), loops["weight"].eigenvalues) < 1e-5


def test_eigenvalues_are_sorted_and_become_poles(loops):
    loop = loops["can_2"]
    values = loop.eigenvalues
    assert np.all(np.diff(np.abs(values)) <= 1e-12)
    kept = values[np.abs(values) > 1e-9]
    assert np.exp(loop.poles() * T) == pytest.approx(kept, rel=1e-12)


# ------------------------------------------------------------------------ stability boundary


def test_exact_states_lose_stability_between_1_0e4_and_1_3e4():
    def stable(slope):
        return linearize_loop(eq_27(slope)).stable

    low, high = 1.0e4, 1.3e4
    assert stable(low)
    assert not stable(high)
    for _ in range(25):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    assert high - low < 1e-3
    assert low == pytest.approx(BOUNDARY_PER_S, rel=1e-4)
    # There the hydraulic mode leaves the unit circle, seen folded below the Nyquist frequency.
    loop = linearize_loop(eq_27(low))
    critical = loop.eigenvalues[0]
    assert abs(critical) == pytest.approx(1.0, abs=1e-6)
    hydraulic = linearize_plant().poles[-1]
    folded = abs(np.angle(np.exp(hydraulic * T)))
    assert abs(np.angle(critical)) == pytest.approx(folded, abs=0.05)


BOUNDARY_PER_S = 11_781.5
"""k/Φ where the loop with exact states loses stability, found by the bisection above."""


@pytest.mark.slow
def test_the_unstable_loop_grows_as_its_eigenvalue_says(unstable):
    inner = make_closed_loop(at_rest(EQ_27_EXACT_STATES["13000"], 40.0), signals=())
    builder = DiagramBuilder()
    builder.AddSystem(inner)
    sink = LogVectorOutput(inner.GetOutputPort("load_pressure"), builder, publish_period=T)
    simulator = fixed_step(builder.Build(), 1e-4)
    simulator.AdvanceTo(2.4)
    log = sink.FindLog(simulator.get_context())
    time, pressure = log.sample_times(), log.data()[0]
    # Three states of the mode and a constant in each window: y = Re(c zᵏ) + const.
    value = unstable.eigenvalues[0]
    amplitudes, centres = [], np.arange(1.3, 2.3, 0.1)
    for centre in centres:
        rows = np.abs(time - centre) < 0.05
        shift = time[rows] - centre
        mode = np.exp(1j * np.angle(value) * shift / T)
        basis = np.stack([mode.real, mode.imag, np.ones_like(shift), shift], axis=1)
        fit = np.linalg.lstsq(basis, pressure[rows], rcond=None)[0]
        amplitudes.append(math.hypot(fit[0], fit[1]))
    growth = np.polyfit(centres, np.log(amplitudes), 1)[0]
    assert np.abs(pressure).max() < 1e5  # still small: inside the boundary layer
    assert growth == pytest.approx(math.log(abs(value)) / T, rel=0.01)


# -------------------------------------------------------------------------------- margins

STABLE = ["smc", "pid", "pid_tuned", "can_2", "difference", "exact"]


@pytest.fixture(scope="module")
def margins(loops):
    return {name: loops[name].margins() for name in STABLE}


def frequency_response(loop, frequencies_hz):
    """L by python-control on the same matrices."""
    return loop.to_control()(np.exp(2j * math.pi * np.asarray(frequencies_hz) * T))


@pytest.mark.parametrize("name", STABLE)
def test_margins_are_those_of_python_control(loops, margins, name):
    loop, m = loops[name], margins[name]
    assert m.stable
    f = np.geomspace(0.05, 249.9, 1500)
    data = control.FRD(frequency_response(loop, f), 2.0 * math.pi * f, smooth=True)
    gain, phase, _, omega_phase, omega_gain, _ = control.stability_margins(data)
    assert m.gain_margin == pytest.approx(gain, rel=1e-6)
    assert m.phase_margin_deg == pytest.approx(phase, rel=1e-6)
    # The argument of a crossing is as exact as the spline through the data.
    assert 2.0 * math.pi * m.gain_margin_frequency_hz == pytest.approx(omega_phase, rel=1e-5)
    assert 2.0 * math.pi * m.phase_margin_frequency_hz == pytest.approx(omega_gain, rel=1e-5)


@pytest.mark.filterwarnings("ignore:stability_margins")
@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "difference"])
def test_margins_are_those_of_python_control_on_the_state_space(loops, margins, name):
    m = margins[name]
    gain, phase, *_ = control.stability_margins(loops[name].to_control())
    assert m.gain_margin == pytest.approx(gain, rel=1e-6)
    assert m.phase_margin_deg == pytest.approx(phase, rel=1e-6)


@pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning:control")  # its own code
@pytest.mark.parametrize("name", STABLE)
def test_disk_margins_are_those_of_python_control(loops, margins, name):
    loop, m = loops[name], margins[name]
    # The minimum of a dense grid about it: flat to 1e-8 between its points.
    f = m.disk_margin_frequency_hz * (1.0 + np.linspace(-0.03, 0.03, 401))
    f = np.sort(np.concatenate([np.geomspace(0.05, 249.9, 600), f[f < 250.0]]))
    disk, gain_db, phase = control.disk_margins(loop.to_control(), 2.0 * math.pi * f, skew=0.0)
    assert m.disk_margin == pytest.approx(disk, rel=1e-6)
    assert 20.0 * math.log10(m.disk_gain_margin) == pytest.approx(gain_db, rel=1e-6)
    assert m.disk_phase_margin_deg == pytest.approx(phase, rel=1e-6)


def scaled(loop, factor):
    """The loop with its gain multiplied."""
    return dataclasses.replace(loop, b=factor * loop.b)


@pytest.mark.parametrize("name", STABLE)
def test_the_gain_margin_puts_an_eigenvalue_on_the_unit_circle(loops, margins, name):
    loop, m = loops[name], margins[name]
    critical = np.exp(2j * math.pi * m.gain_margin_frequency_hz * T)
    values = scaled(loop, m.gain_margin).eigenvalues
    assert abs(nearest(values, critical) - critical) < 1e-6
    assert scaled(loop, 0.999 * m.gain_margin).stable
    assert not scaled(loop, 1.001 * m.gain_margin).stable
    assert m.lower_gain_margin == 0.0
    assert scaled(loop, 1e-3).stable


def test_the_lower_gain_margin_makes_an_unstable_loop_stable(unstable):
    m = unstable.margins()
    assert not m.stable
    assert 0.0 < m.lower_gain_margin < 1.0
    values = scaled(unstable, m.lower_gain_margin).eigenvalues
    assert abs(values[0]) == pytest.approx(1.0, abs=1e-6)
    assert scaled(unstable, 0.999 * m.lower_gain_margin).stable


@pytest.mark.parametrize("name", STABLE)
def test_the_phase_margin_puts_an_eigenvalue_on_the_unit_circle(loops, margins, name):
    loop, m = loops[name], margins[name]
    system = loop.to_control()
    turned = system.A - np.exp(-1j * math.radians(m.phase_margin_deg)) * (system.B @ system.C)
    critical = np.exp(2j * math.pi * m.phase_margin_frequency_hz * T)
    assert abs(nearest(np.linalg.eigvals(turned), critical) - critical) < 1e-6


@pytest.mark.parametrize("name", STABLE)
def test_the_delay_margin_is_the_smallest_of_all_crossings(loops, margins, name):
    f = np.geomspace(0.05, 249.9, 4000)
    data = control.FRD(frequency_response(loops[name], f), 2.0 * math.pi * f, smooth=True)
    _, phases, _, _, omegas, _ = control.stability_margins(data, returnall=True)
    expected = min(np.radians(np.mod(phases, 360.0)) / omegas)
    # The spline is good for 1e-6 where the loop bends most (the 447 Hz mode, exact states).
    assert margins[name].delay_margin_s == pytest.approx(expected, rel=1e-5)


# ------------------------------------------------------------------ a conditionally stable loop


@pytest.fixture(scope="module")
def conditional():
    """A wide boundary layer: three crossings of |L| = 1, of which one has turned past −180°."""
    return linearize_loop(Scenario(controller=SlidingModeParameters(phi_m_s2=18.0)))


@pytest.mark.filterwarnings("ignore:stability_margins")
def test_a_conditionally_stable_loop_has_a_phase_margin_in_both_directions(conditional):
    m = conditional.margins()
    _, phases, *_ = control.stability_margins(conditional.to_control(), returnall=True)
    assert m.stable
    assert m.phase_margin_deg == pytest.approx(phases[phases > 0.0].min(), rel=1e-6)
    assert m.phase_lead_margin_deg == pytest.approx(-phases[phases < 0.0].max(), rel=1e-6)
    assert (m.phase_margin_deg, m.phase_lead_margin_deg) == pytest.approx((22.5, 9.07), abs=0.05)
    # The smaller one, as a negative number, is what python-control calls the phase margin.
    assert control.stability_margins(conditional.to_control())[1] == pytest.approx(
        -m.phase_lead_margin_deg, rel=1e-6
    )
    assert m.disk_phase_margin_deg < min(m.phase_margin_deg, m.phase_lead_margin_deg)


@pytest.mark.parametrize(
    ("name", "sign"), [("phase_margin", -1.0), ("phase_lead_margin", 1.0)], ids=["lag", "lead"]
)
def test_a_turn_by_the_margin_puts_an_eigenvalue_on_the_unit_circle(conditional, name, sign):
    m = conditional.margins()
    turn = np.exp(1j * sign * math.radians(getattr(m, f"{name}_deg")))
    system = conditional.to_control()
    values = np.linalg.eigvals(system.A - turn * (system.B @ system.C))
    critical = np.exp(2j * math.pi * getattr(m, f"{name}_frequency_hz") * T)
    assert abs(nearest(values, critical) - critical) < 1e-6


def test_a_conditionally_stable_loop_prints_both_phase_margins(conditional):
    m, text = conditional.margins(), str(conditional)
    lag = f"phase margin {m.phase_margin_deg:.4g} deg at {m.phase_margin_frequency_hz:.4g} Hz"
    lead = f"lead {m.phase_lead_margin_deg:.4g} deg at {m.phase_lead_margin_frequency_hz:.4g} Hz"
    assert f"{lag}, {lead}, delay margin" in text
    assert "lower" not in text


def test_a_loop_that_loses_stability_with_less_gain_prints_that_margin():
    # Three integrators with the feedback (s + 10/s)³ less s³: Routh asks for a gain above 1/9.
    three = delayed(np.eye(3, k=1), np.array([[0.0], [0.0], [1.0]]), 1.0, 0)
    loop = dataclasses.replace(three, g_x=-np.array([[1e3, 3e2, 30.0]]))
    m = loop.margins()
    assert m.lower_gain_margin == pytest.approx(1.0 / 9.0, rel=0.05)  # T adds a short delay
    assert scaled(loop, 1.001 * m.lower_gain_margin).stable
    assert not scaled(loop, 0.999 * m.lower_gain_margin).stable
    assert f", lower {m.lower_gain_margin:.4g}\n" in str(loop)


def delayed(a, b, gain, samples):
    """The first state of a plant, fed back with a gain after a delay."""
    size = samples + 1
    g_x = np.zeros((size, len(a)))
    g_x[0, 0] = -gain
    return SampledLoop(
        a=a,
        b=b,
        c=np.eye(1, len(a)),
        g_x=g_x,
        g_z=np.eye(size, k=-1),
        g_r=np.zeros((size, 4)),
        c_u=np.eye(size)[-1:],
        sample_time_s=T,
        output="rod_extension",
        knee_angle_rad=0.0,
        scenario=Scenario(),
    )


def test_the_phase_in_a_bode_plot_starts_below_90_deg():
    # L = g T²/2 (z + 1)/(z − 1)² z⁻ⁿ turns by −180° − (n + ½) ωT: the first angle is +179.9°.
    loop = delayed(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 50.0, 2)
    magnitude, phase = loop.plot()
    f, values = (part[:-1] for part in phase.lines[0].get_data())  # L is zero at Nyquist
    omega = 2.0 * math.pi * f
    assert values == pytest.approx(-180.0 - 2.5 * np.degrees(omega * T), abs=1e-3)
    assert f.max() == pytest.approx(250.0, rel=0.01)
    gain = 50.0 * T**2 / 4.0 * np.cos(0.5 * omega * T) / np.sin(0.5 * omega * T) ** 2
    assert magnitude.lines[0].get_ydata()[:-1] == pytest.approx(20.0 * np.log10(gain), abs=1e-3)


def test_a_bode_plot_leaves_out_the_margin_that_a_loop_has_not():
    # An integrator crosses |L| = 1; a lag with less gain than one does not. Both reach −180°.
    integrator = delayed(np.array([[0.0]]), np.array([[1.0 / T]]), 0.1, 0)
    small = delayed(np.array([[-500.0]]), np.array([[100.0]]), 0.5, 1)
    for loop, phase_margin, gain_margin in ((integrator, True, True), (small, False, True)):
        magnitude, phase = loop.plot()
        assert math.isfinite(loop.margins().phase_margin_deg) == phase_margin
        assert math.isfinite(loop.margins().gain_margin) == gain_margin
        shown = [line.get_label() for axis in (magnitude, phase) for line in axis.lines]
        assert any("crossover" in label for label in shown) == phase_margin
        assert any("phase margin" in label for label in shown) == phase_margin
        assert any("gain margin" in label for label in shown) == gain_margin


@pytest.mark.parametrize("delay", [0, 2])
def test_the_phase_margin_of_a_delayed_integrator_is_that_of_the_closed_form(delay):
    # L = g z⁻ⁿ/(z − 1) has |L| = 1 at 2 sin(ωT/2) = g, and there the phase −90° − (n + ½) ωT.
    g = 1.2
    loop = delayed(np.array([[0.0]]), np.array([[1.0 / T]]), g, delay)
    angle = 2.0 * math.asin(0.5 * g)
    margin = 90.0 - math.degrees((delay + 0.5) * angle)
    m = loop.margins()
    assert m.stable is (margin > 0.0)  # 53.1° and −94.4°: a lead of 94.4° is missing
    assert m.phase_margin_deg == pytest.approx(margin % 360.0, rel=1e-9)
    assert m.phase_lead_margin_deg == pytest.approx(-margin % 360.0, rel=1e-9)
    assert m.phase_margin_frequency_hz == pytest.approx(angle / (2.0 * math.pi * T), rel=1e-9)
    assert m.phase_lead_margin_frequency_hz == m.phase_margin_frequency_hz
    # A delay only turns the phase back: an unstable loop is as far from −180° the other way round.
    turn = margin % 360.0 / 360.0
    assert m.delay_margin_s == pytest.approx(turn / m.phase_margin_frequency_hz, rel=1e-9)


@pytest.mark.parametrize("name", ["difference", "pid_tuned"])
def test_the_delay_margin_is_what_the_can_bus_may_take(margins, name):
    samples = margins[name].delay_margin_s / T
    assert 1.0 < samples < 10.0
    below, above = (
        linearize_loop(changed(SCENARIOS[name], {"bus.latency_samples": n}))
        for n in (math.floor(samples), math.ceil(samples))
    )
    assert below.stable
    assert not above.stable


def test_can_delay_is_a_delay_of_the_loop(loops):
    f = np.array([0.3, 5.0, 90.0, 240.0])
    z = np.exp(2j * math.pi * f * T)
    for name, n in (("can_1", 1), ("can_2", 2)):
        expected = loops["smc"].loop_response(f) / z**n
        assert loops[name].loop_response(f) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("unit_rpm", [1.0, 0.001])
@pytest.mark.parametrize(("latency", "same"), [(0, "smc"), (1, "can_1"), (2, "can_2")])
def test_the_loop_of_a_drive_is_the_one_without_rounding(loops, margins, unit_rpm, latency, same):
    bus = {"kind": "cia402", "velocity_unit_rpm": unit_rpm, "latency_samples": latency}
    loop = linearize_loop(Scenario(bus=bus))
    np.testing.assert_array_equal(loop.monodromy, loops[same].monodromy)
    # A delay in the loop takes itself from the delay margin, and nothing from the crossover.
    m, immediate = loop.margins(), margins["smc"]
    assert m.delay_margin_s == pytest.approx(immediate.delay_margin_s - latency * T, rel=1e-6)
    assert m.delay_margin_frequency_hz == pytest.approx(
        immediate.delay_margin_frequency_hz, rel=1e-9
    )


# ------------------------------------------------------------------------------ responses


@pytest.mark.parametrize("name", ["smc", "pid_tuned", "difference"])
def test_sensitivities_are_those_of_the_closed_loop(loops, name):
    loop = loops[name]
    f = np.array([0.1, 1.0, 17.0, 130.0])
    s, t = loop.sensitivity(f), loop.complementary_sensitivity(f)
    assert s + t == pytest.approx(np.ones(4), abs=1e-12)
    assert loop.loop_response(f) == pytest.approx(frequency_response(loop, f), rel=1e-8)
    # det(zI − closed) = det(zI − open)(1 + L)
    z = np.exp(2j * math.pi * f * T)
    eye = np.eye(loop.monodromy.shape[0])
    ratio = [np.linalg.det(v * eye - loop.to_control().A) for v in z]
    ratio /= np.array([np.linalg.det(v * eye - loop.monodromy) for v in z])
    assert s == pytest.approx(ratio, rel=1e-6)


@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "can_2", "difference", "weight"])
def test_the_output_follows_a_slow_reference(loops, name):
    loop = loops[name]
    # P action alone lags by f/0.8 Hz; so does a slow rest under the weight, less than 1e-2.
    assert loop.output_response(1e-3)[0] == pytest.approx(1.0, abs=2e-2)
    f = 0.05
    s, z = 2j * math.pi * f, np.exp(2j * math.pi * f * T)
    b_d = loop.plant_step()[1]
    drive = np.vstack([b_d @ loop.c_u @ loop.g_r, loop.g_r]) @ np.array([1.0, s, s**2, s**3])
    state = np.linalg.solve(z * np.eye(loop.monodromy.shape[0]) - loop.monodromy, drive)
    sampled = (loop.c @ state[:4])[0]
    # What the samples fold down from beyond 499 Hz is all that tells them apart.
    assert loop.output_response(f)[0] == pytest.approx(sampled, rel=1e-6)


def test_the_output_may_be_another_port(loops):
    rod = linearize_loop(output="rod_extension")
    assert rod.c == pytest.approx(np.array([[0.0, 1.0, 0.0, 0.0]]))
    f = np.array([0.5, 30.0])
    slope = 1.0 / loops["smc"].c[0, 1]
    assert rod.output_response(f) == pytest.approx(slope * loops["smc"].output_response(f))


def test_a_frequency_of_zero_is_refused(loops):
    with raises_one_line(LinearizationError, "must be > 0"):
        loops["smc"].output_response([0.0, 1.0])


@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "difference", "exact"])
def test_the_bandwidth_is_the_first_crossing(loops, name):
    loop = loops[name]
    bandwidth = loop.bandwidth_hz()
    threshold = math.sqrt(0.5) * abs(loop.output_response(0.01)[0])
    assert abs(loop.output_response(bandwidth)[0]) == pytest.approx(threshold, rel=1e-9)
    below = np.abs(loop.output_response(np.geomspace(1e-3, 0.9999 * bandwidth, 300)))
    assert below.min() > threshold


def test_the_bandwidth_does_not_depend_on_the_unit_of_the_output(loops):
    loud = dataclasses.replace(loops["smc"], c=10.0 * loops["smc"].c)
    assert loud.bandwidth_hz() == pytest.approx(loops["smc"].bandwidth_hz(), rel=1e-9)


def test_the_bandwidth_of_the_complementary_sensitivity_is_that_of_the_closed_form():
    # L = g/(z − 1): T = g/(z − 1 + g), and |T|² = 1/2 at cos ωT = (1 + (1 − g)² − 2g²)/(2(1 − g)).
    g = 0.3
    loop = delayed(np.array([[0.0]]), np.array([[1.0 / T]]), g, 0)
    angle = math.acos((1.0 + (1.0 - g) ** 2 - 2.0 * g**2) / (2.0 * (1.0 - g)))
    expected = angle / (2.0 * math.pi * T)
    # It is relative to the gain at 0.01 Hz: 1 − 9e-8.
    assert loop.complementary_sensitivity_bandwidth_hz() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "can_2", "difference"])
def test_the_bandwidth_of_the_complementary_sensitivity_is_that_of_python_control(loops, name):
    loop = loops[name]
    bandwidth = loop.complementary_sensitivity_bandwidth_hz()
    f = np.concatenate([[0.01], np.geomspace(0.02, bandwidth, 400)])
    opened = loop.to_control()(np.exp(2j * math.pi * f * T))
    gain = np.abs(opened / (1.0 + opened))
    assert gain[-1] == pytest.approx(gain[0] / math.sqrt(2.0), rel=1e-6)
    assert gain[:-1].min() > gain[0] / math.sqrt(2.0)


def test_the_feedforward_is_no_part_of_the_complementary_sensitivity(loops):
    smc = loops["smc"]
    without = dataclasses.replace(smc, g_r=smc.g_r * [1.0, 0.0, 0.0, 0.0])
    feedback = smc.complementary_sensitivity_bandwidth_hz()
    assert without.bandwidth_hz() < 0.6 * smc.bandwidth_hz()
    assert without.complementary_sensitivity_bandwidth_hz() == feedback


def test_a_torque_on_a_plant_without_load_is_refused():
    with raises_one_line(LinearizationError, "knee_torque = 5 N·m: the plant has no load"):
        find_operating_point(PlantParameters(), 40.0, knee_torque_n_m=5.0)


def test_an_unstable_loop_says_so(unstable):
    assert not unstable.stable
    assert not unstable.margins().stable
    for bandwidth in (unstable.bandwidth_hz, unstable.complementary_sensitivity_bandwidth_hz):
        with raises_one_line(LinearizationError, "unstable .* it has no bandwidth"):
            bandwidth()
    largest = max(abs(unstable.eigenvalues))
    assert str(unstable) == (  # exact states hold the rod that Table 1 has at 40 deg
        f"knee at 40.01 deg, T = 0.002 s: unstable, largest eigenvalue {largest:.6g}; "
        f"it has no margins"
    )
    axes = unstable.plot()
    shown = [text.get_text() for ax in axes for text in ax.get_legend().get_texts()]
    assert shown == ["Nyquist, 250 Hz"] * 2
    plt.close(axes[0].figure)


def test_a_loop_with_hardly_any_gain_has_no_gain_margin():
    law = PidParameters(proportional_per_s=1e-300)  # products of two values of the loop are zero
    loop = linearize_loop(Scenario(controller=law, estimator={"kind": "exact"}))
    assert loop.margins().gain_margin > 1e100


def test_a_loop_prints_its_margins_and_plots(loops):
    loop = loops["smc"]
    m, text = loop.margins(), str(loop)
    feedback = loop.complementary_sensitivity_bandwidth_hz()
    f_gain, f_phase, f_disk = (
        getattr(m, f"{name}_margin_frequency_hz") for name in ("gain", "phase", "disk")
    )
    assert text.splitlines() == [
        f"knee at 40 deg, T = 0.002 s: stable, largest eigenvalue {max(abs(loop.eigenvalues)):.6g}",
        f"  gain margin {m.gain_margin:.4g} at {f_gain:.4g} Hz",
        f"  phase margin {m.phase_margin_deg:.4g} deg at {f_phase:.4g} Hz, "
        f"delay margin {1e3 * m.delay_margin_s:.4g} ms",
        f"  disk margin {m.disk_margin:.4g} at {f_disk:.4g} Hz: "
        f"gain {m.disk_gain_margin:.4g}, phase {m.disk_phase_margin_deg:.4g} deg",
        f"  small-signal bandwidth {loop.bandwidth_hz():.4g} Hz, with feedforward",
        f"  complementary sensitivity bandwidth {feedback:.4g} Hz, feedback alone",
    ]
    magnitude, phase = loop.plot()
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in (magnitude, phase)]
    assert labels == [("", "loop magnitude (dB)"), ("frequency (Hz)", "loop phase (deg)")]
    lines = {line.get_label(): line.get_data() for ax in (phase, magnitude) for line in ax.lines}
    assert set(lines["Nyquist, 250 Hz"][0]) == {250.0}
    f, zero = lines[f"crossover {m.phase_margin_frequency_hz:.3g} Hz"]
    assert (*f, *zero) == pytest.approx((m.phase_margin_frequency_hz, 0.0))
    f, ends = lines[f"phase margin {m.phase_margin_deg:.3g}°"]
    assert f == pytest.approx([m.phase_margin_frequency_hz] * 2)
    assert ends == pytest.approx([-180.0, m.phase_margin_deg - 180.0], abs=0.01)
    for ax, level in ((magnitude, 0.0), (phase, -180.0)):
        assert [line for line in ax.lines if set(line.get_ydata()) == {level}]
    line = magnitude.lines[0]
    at_1_hz = np.interp(0.0, np.log10(line.get_xdata()), line.get_ydata())
    assert at_1_hz == pytest.approx(20.0 * math.log10(abs(loop.loop_response(1.0)[0])), abs=0.01)
    assert phase.get_ylabel() == "loop phase (deg)"
    (margin,) = (line for line in magnitude.lines if line.get_label().startswith("gain margin"))
    f, ends = margin.get_data()
    assert f == pytest.approx([m.gain_margin_frequency_hz] * 2)
    assert 10.0 ** (-ends / 20.0) == pytest.approx([m.gain_margin, 1.0])
    assert f"({-ends[0]:.3g} dB)" in margin.get_label()


def test_the_phase_of_a_bode_plot_is_unwrapped_also_through_a_resonance(loops):
    loop = loops["exact"]  # its 447 Hz mode, folded to 53 Hz, turns the phase within 2 Hz
    magnitude, phase = loop.plot()
    f, values = phase.lines[0].get_data()
    assert np.abs(np.diff(values)).max() < 30.0
    assert -270.0 <= values[0] < 90.0
    mode = np.abs(np.angle(loop.eigenvalues)) / (2.0 * math.pi * T)
    (mode,) = mode[np.abs(mode - 53.0) < 3.0][:1]
    near = f[np.abs(f / mode - 1.0) < 0.09]
    assert np.diff(near).max() <= 1.01e-3 * mode  # five times as dense as elsewhere
    turned = np.degrees(np.angle(loop.loop_response(f))) - values
    assert turned == pytest.approx(360.0 * np.round(turned / 360.0), abs=1e-6)
    assert magnitude.get_legend().get_texts()[0].get_text() == "Nyquist, 250 Hz"
    shown = [text.get_text() for ax in (magnitude, phase) for text in ax.get_legend().get_texts()]
    margins = loop.margins()
    assert f"phase margin {margins.phase_margin_deg:.3g}°" in shown
    assert any(text.startswith(f"gain margin {margins.gain_margin:.3g} (") for text in shown)
    plt.close(phase.figure)


@pytest.mark.slow
def test_a_loop_without_gain_has_plots_too():
    loop = linearize_loop(Scenario(controller=PidParameters(proportional_per_s=0.0)))
    for axes in (*loop.plot(), loop.plot_nyquist(), loop.plot_poles()):
        axes.figure.canvas.draw()
        plt.close(axes.figure)


def test_a_loop_below_gain_one_has_an_infinite_phase_margin_in_words():
    # A spring holds the rod, and the controller pushes it by a thousandth of what is needed.
    controller = PidParameters(proportional_per_s=0.001)
    loop = linearize_loop(Scenario(plant=plant_parameters(SPRING), controller=controller))
    assert "  phase margin infinite, delay margin infinite\n" in str(loop)
    assert "nan" not in str(loop)


@pytest.mark.parametrize("name", ["smc", "pid_tuned", "difference", "can_2"])
def test_the_loop_touches_the_disk_that_it_keeps_out(loops, margins, name):
    axes = loops[name].plot_nyquist()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("real part of L", "imaginary part of L")
    lines = {line.get_label(): line.get_data() for line in axes.lines}
    real, imaginary = lines["L, f > 0"]
    np.testing.assert_array_equal(lines["L, f < 0"], (real, -imaginary))
    assert np.hypot(*lines["|L| = 1"]) == pytest.approx(np.ones(361))
    assert np.ravel(lines["−1"]).tolist() == [-1.0, 0.0]
    # L has one value at each frequency, and 250 Hz makes it real.
    assert imaginary[-1] == pytest.approx(0.0, abs=1e-6)
    assert real[-1] == pytest.approx(loops[name].loop_response(250.0)[0].real, abs=1e-6)
    assert (axes.get_xlim(), axes.get_ylim()) == ((-3.5, 1.5), (-2.5, 2.5))
    shown = axes.patches[0].get_label()
    assert shown == f"disk margin {margins[name].disk_margin:.3g}"
    circle = axes.patches[0].get_path().vertices @ [1.0, 1.0j]
    m = margins[name]
    # On the real axis the disk spans the gains that the loop stands.
    assert circle.real.min() == pytest.approx(-m.disk_gain_margin, rel=1e-9)
    assert circle.real.max() == pytest.approx(-1.0 / m.disk_gain_margin, rel=1e-9)
    centre = 0.5 * (circle.real.min() + circle.real.max())
    radius = 0.5 * np.ptp(circle.real)
    assert np.abs(circle - centre) == pytest.approx(np.full(circle.size, radius), rel=1e-9)
    at = loops[name].loop_response(m.disk_margin_frequency_hz)[0]
    assert abs(at - centre) == pytest.approx(radius, rel=1e-9)
    everywhere = loops[name].loop_response(np.geomspace(0.01, 250.0, 5000))
    assert np.abs(everywhere - centre).min() >= (1.0 - 1e-9) * radius
    plt.close(axes.figure)


def test_an_unstable_loop_has_no_disk(unstable):
    axes = unstable.plot_nyquist()
    assert not axes.patches
    plt.close(axes.figure)


def test_the_pole_plot_tells_unstable_eigenvalues(loops, unstable):
    for loop in (loops["smc"], unstable):
        axes = loop.plot_poles()
        marks = [line for line in axes.lines if line.get_label() in ("stable", "unstable")]
        drawn = np.concatenate([line.get_xdata() + 1j * line.get_ydata() for line in marks])
        assert distance(drawn, loop.eigenvalues) == 0.0
        outside = [line for line in marks if line.get_label() == "unstable"]
        assert bool(outside) is not loop.stable
        plt.close(axes.figure)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("real part of z", "imaginary part of z")
    assert [line.get_label() for line in axes.lines[-2:]] == ["stable", "unstable"]
    for text, damping in zip(axes.texts, (0.1, 0.3, 0.5, 0.7, 0.9), strict=True):
        z = np.log(complex(*text.get_position()))
        assert -z.real / abs(z) == pytest.approx(damping, rel=1e-9)
        assert text.get_text() == f"ζ = {damping:g}"
    for line in axes.lines[:12]:
        assert line.get_xdata()[0] == 1.0
        assert line.get_ydata()[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-12)
    # A line of damping ζ: z = e^{(−ζ + j√(1 − ζ²))ωT}.
    line = axes.lines[2]
    z = np.log(line.get_xdata()[1:] + 1j * line.get_ydata()[1:])
    assert -z.real / np.abs(z) == pytest.approx(np.full(z.size, 0.1), rel=1e-9)


@pytest.mark.parametrize("name", STABLE)
def test_the_delay_margin_puts_an_eigenvalue_on_the_unit_circle(loops, margins, name):
    loop, m = loops[name], margins[name]
    f = m.delay_margin_frequency_hz
    delayed = loop.loop_response(f)[0] * np.exp(-2j * math.pi * f * m.delay_margin_s)
    assert delayed == pytest.approx(-1.0, abs=1e-9)


def test_one_diagram_serves_all_loops_of_a_structure(loops, monkeypatch):
    monkeypatch.setattr(loop_equilibrium, "_built", {})
    for name in ("smc", "other_plant", "weight", "exact", "pid", "pid_tuned", "can_2"):
        for scenario in (Scenario(plant=plant_parameters(LEAKY, load=WEIGHT)), SCENARIOS[name]):
            found = linearize_loop(scenario, 52.0)
        monkeypatch.setattr(loop_equilibrium, "_built", {})
        fresh = linearize_loop(SCENARIOS[name], 52.0)
        monkeypatch.setattr(loop_equilibrium, "_built", {})
        for matrix in ("a", "b", "c", "g_x", "g_z", "g_r", "c_u"):
            assert np.array_equal(getattr(found, matrix), getattr(fresh, matrix)), matrix


def test_loops_that_differ_in_numbers_share_a_diagram(monkeypatch):
    monkeypatch.setattr(loop_equilibrium, "_built", {})
    for n in (PAPER, LEAKY, SOFT):
        linearize_loop(Scenario(plant=plant_parameters(n), nominal=PlantParameters()))
    assert len(loop_equilibrium._built) == 1


# -------------------------------------------------------------------------------- refusals


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


@pytest.mark.parametrize("share", [0.99, 0.5])
@pytest.mark.parametrize("kind", [SlidingModeParameters, PidParameters])
def test_a_command_limit_below_the_leakage_leaves_no_rest(share, kind):
    plant, speed = pushed(200.0)
    controller = kind(command_limit_rad_s=share * speed)
    with raises_one_line(LinearizationError, "does not rest at knee angle 40 deg"):
        linearize_loop(Scenario(plant=plant, controller=controller))


def test_a_search_that_leaves_the_linkage_says_so():
    plant = PlantParameters(load=KneeLoadParameters(disturbance_n=2000.0))
    where = "Newton's method goes where the equations are not finite; reduce the load"
    with raises_one_line(LinearizationError, f"does not rest at knee angle 45 deg: {where}"):
        linearize_loop(Scenario(plant=plant, controller=PidParameters()), 45.0)


def overflowing(diagram):
    """A diagram with the ports of another one, and an output ``overflow`` that is infinite."""
    builder, x, rest = DiagramBuilder(), Variable("x"), Variable("rest")
    inner = builder.AddNamedSystem("inner", diagram)
    for index in range(diagram.num_input_ports()):
        port = inner.get_input_port(index)
        builder.ExportInput(port, port.get_name())
    for index in range(diagram.num_output_ports()):
        port = inner.get_output_port(index)
        builder.ExportOutput(port, port.get_name())
    symbolic = SymbolicVectorSystem(  # without a state Drake refuses it in a continuous diagram
        state=[rest], input=[x], dynamics=[-rest], output=[exp(1e6 * x)]
    )
    system = builder.AddNamedSystem("overflow", symbolic)
    builder.Connect(inner.GetOutputPort("knee_angle"), system.get_input_port())
    builder.ExportOutput(system.get_output_port(), "overflow")
    return builder.Build()


def test_a_derivative_that_is_not_finite_is_no_linearization():
    plant = overflowing(make_plant())
    message = "the derivative of output 1 is not finite at knee angle 40 deg: there is no linear"
    with raises_one_line(LinearizationError, message):
        linearize_plant(plant, outputs=("knee_angle", "overflow"))
    posture = StepReference(start_deg=40.0, end_deg=40.0)
    scenario = Scenario(reference=posture).without_quantizers()
    loop = overflowing(make_closed_loop(scenario, signals=(), external_reference=True))
    with raises_one_line(LinearizationError, message.replace("output 1", "output 0")):
        linearize_loop(scenario, output="overflow", diagram=loop)


@pytest.mark.parametrize("frequency", [math.nan, math.inf, -math.inf])
def test_frequencies_must_be_finite(frequency):
    plant, loop = linearize_plant(), linearize_loop()
    for response in (plant.response, loop.loop_response, loop.output_response, loop.sensitivity):
        with raises_one_line(LinearizationError, f"frequency = {frequency:g} Hz: must be finite"):
            response([1.0, frequency])
    with raises_one_line(LinearizationError, f"frequency = {frequency:g} Hz: must be finite"):
        error_model().response(frequency)


def test_a_rest_at_the_speed_limit_is_refused():
    plant, speed = pushed(200.0)
    controller = PidParameters(proportional_per_s=50.0, command_limit_rad_s=speed * (1.0 + 1e-10))
    with raises_one_line(LinearizationError, "motor_speed_command = .* is at its limit of"):
        linearize_loop(Scenario(plant=plant, controller=controller))


@pytest.mark.parametrize("eta", [3e3, 5e3, 8e3])
def test_a_boundary_layer_too_weak_for_the_leakage_leaves_no_rest(eta):
    plant, speed = pushed(800.0)
    controller = SlidingModeParameters(eta_m_s3=eta)
    assert speed > 100.0
    with raises_one_line(LinearizationError, "does not rest at knee angle 40 deg"):
        linearize_loop(Scenario(plant=plant, controller=controller))


def test_a_rest_outside_the_boundary_layer_is_refused():
    # Without η nothing pulls s to zero; Table 1 and the linkage differ by λ²·0.03 mm.
    controller = SlidingModeParameters(eta_m_s3=0.0, phi_m_s2=1e-6)
    with raises_one_line(LinearizationError, "outside the boundary layer"):
        linearize_loop(Scenario(estimator=ExactParameters(), controller=controller))


# ------------------------------------------------------------------- by brute force, in time


def small_sine(scenario, frequency_hz, amplitude_deg, settle_s, window_s, step=1e-4):
    """Fundamental of the knee angle over that of the reference, by Drake's Simulator.

    The window holds whole periods of the sine and of the sampling. The samples' images at
    500k ± f Hz are fitted along, under a Hann window that keeps out what is left of the transient.
    """
    reference = SineReference(
        mean_deg=40.0, amplitude_deg=amplitude_deg, frequency_hz=min(frequency_hz, 250.0)
    )
    inner = make_closed_loop(
        at_rest(scenario, 40.0).model_copy(update={"reference": reference}), signals=()
    )
    builder = DiagramBuilder()
    builder.AddSystem(inner)
    sink = LogVectorOutput(inner.GetOutputPort("knee_angle"), builder, publish_period=0.2e-3)
    simulator = fixed_step(builder.Build(), step)
    source = inner.GetSubsystemByName("reference")
    context = source.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    source.set_parameter(context, "frequency_hz", frequency_hz)  # also beyond the parameter's range
    simulator.AdvanceTo(settle_s + window_s)
    log = sink.FindLog(simulator.get_context())
    count = round(window_s / 0.2e-3)
    time, angle = log.sample_times()[-count:], log.data()[0, -count:] - math.radians(40.0)
    rates = {frequency_hz, *(abs(500.0 * k + i * frequency_hz) for k in (1, 2) for i in (1, -1))}
    phases = 2.0 * math.pi * np.array([frequency_hz, *sorted(rates - {frequency_hz})])[:, None]
    basis = [np.cos(phases * time), np.sin(phases * time), [np.ones(count)], [time - time[0]]]
    weight = np.hanning(count + 1)[:-1]
    rows = np.concatenate(basis) * weight
    fit = np.linalg.lstsq(rows.T, weight * angle, rcond=None)[0]
    return -(fit[0] - 1j * fit[len(rates)]) / math.radians(amplitude_deg)


def assert_response(scenario, frequency_hz, *settings):
    expected = linearize_loop(scenario).output_response(frequency_hz)[0]
    ratio = small_sine(scenario, frequency_hz, *settings) / expected
    assert abs(ratio) == pytest.approx(1.0, abs=1e-3)
    assert math.degrees(np.angle(ratio)) == pytest.approx(0.0, abs=0.1)


# Amplitudes stay inside the boundary layer, whose s grows with f², and below the motor's
# acceleration limit, 100 rad/s of sudden command.
@pytest.mark.parametrize(
    ("frequency_hz", "amplitude_deg"),
    [pytest.param(20.0, 1e-3, marks=pytest.mark.slow), (100.0, 1e-4)],
)
def test_the_response_to_a_small_sine_is_that_of_the_simulator(frequency_hz, amplitude_deg):
    assert_response(SCENARIOS["smc"], frequency_hz, amplitude_deg, 0.5, 0.1, 2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frequency_hz", "amplitude_deg", "settle_s", "window_s"),
    [
        ("smc", 0.5, 1e-2, 1.0, 4.0),
        ("smc", 2.0, 1e-2, 0.6, 1.0),
        ("smc", 8.0, 1e-3, 0.6, 0.5),
        ("smc", 240.0, 1e-5, 0.6, 0.4),
        ("smc", 300.0, 1e-5, 0.6, 0.4),
        ("pid", 8.0, 1e-3, 1.0, 1.0),
        ("pid_tuned", 2.0, 1e-3, 2.0, 1.0),
        ("difference", 20.0, 1e-4, 0.6, 0.3),
        ("can_2", 40.0, 1e-4, 0.6, 0.3),
        ("weight", 8.0, 1e-3, 0.6, 0.5),
    ],
)
def test_more_responses_to_small_sines(name, frequency_hz, amplitude_deg, settle_s, window_s):
    assert_response(SCENARIOS[name], frequency_hz, amplitude_deg, settle_s, window_s)
