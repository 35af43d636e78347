"""Operating points and linear plants against closed forms and python-control."""

import math
import re

import numpy as np
import pytest
from linear_cases import (
    AREA,
    DISPLACEMENT,
    GRAVITY,
    LEAKY,
    PAPER,
    SETS,
    SOFT,
    SPRING,
    WEIGHT,
    distance,
    nearest,
    plant_parameters,
    raises_one_line,
    slope_of_table_1,
    total_leakage,
)

from kneexo.analysis.linear.plant_linearization import find_operating_point, linearize_plant
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.diagrams import make_plant
from kneexo.errors import KneexoError, LinearizationError, LinkageError, ParameterError
from kneexo.parameters import (
    EncoderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    LinkageParameters,
    PlantParameters,
    Scenario,
)


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
    point = find_operating_point(parameters, knee_angle_deg=angle, **forces)
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


def test_an_operating_point_prints_in_the_papers_units():
    point = find_operating_point(
        plant_parameters(PAPER), knee_angle_deg=40.0, disturbance_n=1e7 * AREA
    )
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
            knee_angle_deg=40.0,
            knee_torque_n_m=torque,
            disturbance_n=7.0,
        )


@pytest.mark.parametrize("angle", [-30.0, 95.0, 400.0, math.nan, math.inf])
def test_a_posture_beyond_the_knee_is_refused(angle):
    with raises_one_line(KneexoError, "") as caught:
        find_operating_point(PlantParameters(), knee_angle_deg=angle)
    assert isinstance(caught.value, ParameterError | LinkageError)


def test_a_linkage_that_does_not_close_is_refused():
    with raises_one_line(LinkageError, "cannot be assembled"):
        linearize_plant(PlantParameters(linkage=LinkageParameters(a_3_m=0.5)))


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("angle", [5.0, 40.0])
def test_poles_are_those_of_the_closed_form(name, angle):
    n = SETS[name]
    expected = np.append(roots(cubic(n)), -1.0 / n["lag"])
    poles = linearize_plant(plant_parameters(n), knee_angle_deg=angle).poles
    assert np.all(np.diff(np.abs(poles)) > -1e-6 * np.abs(poles[1:]))
    for pole in expected:
        # 1e-9 of each pole, and rounding of the largest for one that is zero or slow.
        floor = 1e-15 * np.abs(expected).max()
        assert abs(nearest(poles, pole) - pole) <= 1e-9 * abs(pole) + floor
    assert distance(poles, expected) <= 1e-9 * np.abs(expected).max()


def test_an_ideal_motor_has_no_pole():
    poles = linearize_plant(plant_parameters(SOFT, ideal_motor=True)).poles
    assert distance(poles, roots(cubic(SOFT))) <= 1e-9 * np.abs(poles).max()


def test_the_inertia_of_the_shank_halves_the_hydraulic_mode():
    """√(k_q Ā² r²/I) with r = 102.1 mm at 45°, where 0.064 kg·m² are 6.1 kg."""
    shank = KneeLoadParameters(segment_mass_kg=0.0, inertia_kg_m2=0.064)
    plant = linearize_plant(PlantParameters(load=shank), knee_angle_deg=45.0)
    frequency, ratio = plant.damping
    expected = math.sqrt(4.0 * 1.72e9 * AREA**2 / 41_233e-9 * 0.1021**2 / 0.064)
    # The arm has four digits.
    assert frequency[-1] == pytest.approx(expected, rel=1e-3)
    assert frequency[-1] / (2.0 * math.pi) == pytest.approx(228.0, abs=0.5)
    assert ratio[-1] == pytest.approx(0.0059 * 446.8 / 228.0, rel=2e-2)


@pytest.mark.parametrize("name", SETS)
def test_the_response_is_that_of_the_closed_form(name):
    n = SETS[name]
    plant = linearize_plant(
        plant_parameters(n, rod_map="polynomial"),
        knee_angle_deg=52.0,
        outputs=("knee_angle", "rod_extension"),
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
    rod = linearize_plant(plant, knee_angle_deg=25.0, outputs=("rod_extension",)).velocity_gain
    assert rod == pytest.approx(gain, rel=1e-9)
    knee = linearize_plant(plant, knee_angle_deg=25.0).velocity_gain
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
    plant = linearize_plant(plant_parameters(SPRING | {"c_em": 1e-11}), knee_angle_deg=85.0)
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
    plant = linearize_plant(
        plant_parameters(n, load=WEIGHT), knee_angle_deg=angle, knee_torque_n_m=torque
    )
    expected = roots(cubic(n, stiffness))
    slow = expected[np.argmin(np.abs(expected))]
    assert abs(slow) > 0.01
    # The second derivative of the spline is exact to 1e-6.
    assert plant.poles[0] == pytest.approx(slow, rel=1e-5)


def test_a_diagram_may_take_the_place_of_the_parameters():
    parameters = plant_parameters(LEAKY, load=WEIGHT)
    ours = linearize_plant(
        make_plant(parameters), knee_angle_deg=55.0, knee_torque_n_m=2.0, disturbance_n=9.0
    )
    theirs = linearize_plant(
        parameters, knee_angle_deg=55.0, knee_torque_n_m=2.0, disturbance_n=9.0
    )
    for name in ("a", "b", "c", "d"):
        scale = np.abs(getattr(theirs, name)).max() + 1e-300
        assert np.abs(getattr(ours, name) - getattr(theirs, name)).max() <= 1e-9 * scale


def test_a_plant_prints_its_poles_and_gain():
    text = str(linearize_plant())
    assert "-100 +0j 1/s" in text
    assert "446.8 Hz, damping ratio 0.005949" in text
    assert re.search(r"velocity gain of knee_angle: -0\.0007\d+$", text)


def test_a_torque_on_a_plant_without_load_is_refused():
    with raises_one_line(LinearizationError, "knee_torque = 5 N·m: the plant has no load"):
        find_operating_point(PlantParameters(), knee_angle_deg=40.0, knee_torque_n_m=5.0)
