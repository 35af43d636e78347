"""The linear plant against the exact solution by matrix exponential, and its poles."""

import math

import numpy as np
import pytest
from plant_cases import PAPER, SOFT, by_name, plant_parameters, set_state, with_command
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Linearize, Sine

from kneexo.diagrams import make_plant

# ------------------------------------------------------------- exact solution of the model


def matrix_exponential(matrix):
    """exp(matrix) by scaling and squaring of its Taylor series."""
    squarings = max(0, math.ceil(math.log2(np.linalg.norm(matrix, 1) / 0.5)))
    scaled = matrix / 2.0**squarings
    result = term = np.eye(len(matrix))
    for n in range(1, 19):  # 0.5^19/19! is far below rounding
        term = term @ scaled / n
        result = result + term
    for _ in range(squarings):
        result = result @ result
    return result


def linear_model(n):
    """A and B of Eq. 12, 13, 15, 16 for the state ω, x, v, P_L (MPa) and inputs ω_cmd, F_L."""
    stiffness = 4.0 * n["bulk"] / n["volume"]
    leakage = n["c_im"] + 0.5 * n["c_em"] + n["c_l"]
    a = np.zeros((4, 4))
    a[0, 0] = -1.0 / n["lag"]
    a[1, 2] = 1.0
    a[2, 1] = -n["stiffness"] / n["mass"]
    a[2, 2] = -n["damping"] / n["mass"]
    a[2, 3] = 1e6 * n["area"] / n["mass"]
    a[3, 0] = 1e-6 * stiffness * n["displacement"] / n["gear"]
    a[3, 2] = -1e-6 * stiffness * n["area"]
    a[3, 3] = -stiffness * leakage
    b = np.array([[1.0 / n["lag"], 0.0], [0.0, 0.0], [0.0, -1.0 / n["mass"]], [0.0, 0.0]])
    return a, b


def exact_solution(n, start, times, *, force, amplitude, frequency=None):
    """States at ``times`` for a step or, with a frequency in rad/s, a sine of the command."""
    a, b = linear_model(n)
    omega = frequency or 0.0
    augmented = np.zeros((7, 7))  # state, constant one, sin ωt, cos ωt
    augmented[:4, :4] = a
    augmented[:4, 4] = force * b[:, 1]
    augmented[:4, 5 if frequency else 4] += amplitude * b[:, 0]
    augmented[5, 6], augmented[6, 5] = omega, -omega
    z = np.array([*start, 1.0, 0.0, 1.0])
    step = matrix_exponential(augmented * (times[1] - times[0]))
    states = [z]
    for _ in times[1:]:
        states.append(step @ states[-1])
    return np.array(states)[:, :4]


def simulated(fixed_step, n, start, times, step, *, force, amplitude, frequency=None):
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", make_plant(plant_parameters(n)))
    source = builder.AddNamedSystem(
        "source",
        Sine(amplitude, frequency, 0.0, 1) if frequency else ConstantVectorSource([amplitude]),
    )
    builder.Connect(source.get_output_port(0), plant.GetInputPort("motor_speed_command"))
    simulator = fixed_step(builder.Build(), "runge_kutta5", step)
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.GetInputPort("disturbance_force").FixValue(context, [force])
    speed, x, v, pressure = start
    set_state(plant, root, speed=speed, extension=x, velocity=v, pressure=1e6 * pressure)
    states = []
    for time in times:
        simulator.AdvanceTo(time)
        names = ("motor_speed", "rod_extension", "rod_velocity", "load_pressure")
        states.append([by_name(plant, name, context) for name in names])
    return np.array(states) * [1.0, 1.0, 1.0, 1e-6]


# The motor accelerates by at most 100 rad/s in 10 ms: below its limit, so the plant is linear.
CASES = {
    "step": (PAPER, 0.014, 5e-5, (0.0, 0.1, 0.0, 0.0), {"amplitude": 50.0}),
    "sine": (
        PAPER,
        0.014,
        5e-5,
        (0.0, 0.1, 0.0, 0.0),
        {"amplitude": 40.0, "frequency": 2.0 * math.pi * 40.0},
    ),
    "soft, loaded, moving, sine": (
        SOFT,
        0.075,
        2.5e-4,
        (30.0, 0.1, 0.02, 1.0),
        {"amplitude": 60.0, "frequency": 2.0 * math.pi * 15.0, "force": 20.0},
    ),
}


@pytest.mark.parametrize(
    "case", ["sine", *(pytest.param(c, marks=pytest.mark.slow) for c in CASES if c != "sine")]
)
def test_every_state_follows_the_exact_solution(case, fixed_step):
    numbers, duration, step, start, command = CASES[case]
    command = {"force": 0.0} | command
    times = np.linspace(0.0, duration, 11)
    exact = exact_solution(numbers, start, times, **command)
    runs = [simulated(fixed_step, numbers, start, times, h, **command) for h in (step, 0.5 * step)]
    peak = np.max(np.abs(exact), axis=0)
    # The fifth order loses 3e-7 of the hydraulic mode's pressure with these steps (measured); with
    # half of them a thirty-second.
    assert np.max(np.abs(runs[0] - exact) / peak) <= 3e-7
    assert np.max(np.abs(runs[1] - exact) / peak) <= 1e-8


def linearized_poles(n):
    plant = make_plant(plant_parameters(n))
    context = with_command(plant)
    set_state(plant, context, extension=0.0 if n["stiffness"] else 0.1)
    system = Linearize(
        plant,
        context,
        plant.GetInputPort("motor_speed_command").get_index(),
        plant.GetOutputPort("rod_extension").get_index(),
    )
    return np.sort_complex(np.linalg.eigvals(system.A()))


def test_linearized_poles_are_integrator_motor_lag_and_hydraulic_pair():
    n = PAPER
    hydraulic = 4.0 * n["bulk"] * n["area"] ** 2 / (n["mass"] * n["volume"])
    leakage = 4.0 * n["bulk"] / n["volume"] * n["c_im"]
    friction = n["damping"] / n["mass"]
    real = -0.5 * (leakage + friction)
    imaginary = math.sqrt(hydraulic - 0.25 * (leakage - friction) ** 2)
    expected = [-1.0 / n["lag"], complex(real, -imaginary), complex(real, imaginary), 0.0]
    # 1e-8 1/s of 2807: rounding of eigenvalues of a matrix whose norm is 5e4.
    np.testing.assert_allclose(linearized_poles(n), np.sort_complex(expected), atol=1e-8)
    # In round numbers: 447 Hz and a damping ratio of 0.0059.
    assert abs(expected[1]) / (2.0 * math.pi) == pytest.approx(447.0, abs=0.5)
    assert -real / abs(expected[1]) == pytest.approx(0.0059, abs=1e-4)


def test_linearized_poles_with_spring_and_all_leakages_solve_the_cubic():
    n = SOFT
    k = 4.0 * n["bulk"] / n["volume"]
    c = k * (n["c_im"] + 0.5 * n["c_em"] + n["c_l"])
    cubic = np.polyadd(
        np.polymul([n["mass"], n["damping"], n["stiffness"]], [1.0, c]), [k * n["area"] ** 2, 0.0]
    )
    expected = np.sort_complex([*np.roots(cubic), -1.0 / n["lag"]])
    # 1e-8 1/s of 500: as above.
    np.testing.assert_allclose(linearized_poles(n), expected, atol=1e-8)
