"""Winding and case of the motor, against the matrix exponential of the two nodes."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from scipy.linalg import expm

from diagramc.testing import check_leaf
from kneexo.analysis import linearize_plant
from kneexo.diagrams import make_plant
from kneexo.export.firmware import export_firmware
from kneexo.parameters import MotorParameters, PlantParameters, Scenario, ThermalParameters
from kneexo.systems import MotorTemperature, TorqueLimitedPump

COLD = ThermalParameters()
OWN = ThermalParameters(
    winding_capacity_j_per_k=15.0, case_capacity_j_per_k=300.0, winding_to_case_k_per_w=0.8,
    case_to_air_k_per_w=2.5, air_degc=18.0, start_degc=40.0,
)  # fmt: skip


def nodes(time_s, loss_w, n=OWN):
    """Temperatures after ``time_s`` of a constant loss, by a matrix exponential."""
    to_case, to_air = 1.0 / n.winding_to_case_k_per_w, 1.0 / n.case_to_air_k_per_w
    capacities = np.array([[n.winding_capacity_j_per_k], [n.case_capacity_j_per_k]])
    matrix = np.zeros((3, 3))  # of both temperatures and a one
    matrix[:2] = np.array(
        [
            [-to_case, to_case, loss_w],
            [to_case, -to_case - to_air, to_air * n.air_degc],
        ]
    )
    matrix[:2] /= capacities
    return (expm(matrix * time_s) @ [n.start_degc, n.start_degc, 1.0])[:2]


def at_loss(loss_w, parameters=OWN):
    system = MotorTemperature(parameters)
    context = system.CreateDefaultContext()
    system.GetInputPort("winding_loss").FixValue(context, loss_w)
    return system, context


def test_conversions_agree_and_keep_arguments_and_changes():
    ranges = {"winding_loss": (0.0, 60.0), "continuous_state": (0.2, 1.5)}
    check_leaf(MotorTemperature(OWN), ranges)


def test_a_constant_loss_warms_both_nodes_as_their_matrix_exponential_says():
    system, context = at_loss(24.0)
    simulator = Simulator(system, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-6)
    simulator.get_mutable_integrator().set_maximum_step_size(20.0)
    for time_s in (40.0, 1800.0):  # half an hour
        simulator.AdvanceTo(time_s)
        got = system.GetOutputPort("motor_temperatures").Eval(simulator.get_context())
        np.testing.assert_allclose(got, nodes(time_s, 24.0), rtol=1e-4)
    # Long after, the heat flows through both resistances.
    assert nodes(1e5, 24.0) == pytest.approx([18.0 + 24.0 * 3.3, 18.0 + 24.0 * 2.5], rel=1e-9)


# ----------------------------------------------------------------------- the motor that is warm


def warm_motor(winding_degc, *, motor=MotorParameters(), pressure=0.0, command=0.0, output):
    system = TorqueLimitedPump(motor=motor, thermal=COLD)
    context = system.CreateDefaultContext()
    system.GetInputPort("motor_speed_command").FixValue(context, command)
    system.GetInputPort("load_pressure").FixValue(context, pressure)
    system.GetInputPort("motor_temperatures").FixValue(context, [winding_degc, 30.0])
    return system.GetOutputPort(output).Eval(context)[0]


def test_conversions_of_the_warm_motor_agree_and_keep_arguments_and_changes():
    system = TorqueLimitedPump(thermal=COLD, motor=MotorParameters())
    inputs = {
        "motor_speed_command": [(-600.0, 600.0)],
        "load_pressure": [(-3e6, 3e6)],
        "motor_temperatures": [(110.0, 160.0), (20.0, 90.0)],
    }
    check_leaf(system, inputs | {"continuous_state": (-0.3, 0.3)})


def test_the_loss_is_that_of_the_current_in_warm_copper():
    current = warm_motor(90.0, pressure=3e6, output="motor_current")
    loss = warm_motor(90.0, pressure=3e6, output="winding_loss")
    assert loss == pytest.approx(current**2 * 0.15 * (1.0 + 0.0039 * 65.0), rel=1e-12)
    volts = warm_motor(90.0, pressure=3e6, output="motor_voltage")
    assert volts == pytest.approx(loss / current, rel=1e-12)
    assert current == pytest.approx(warm_motor(25.0, pressure=3e6, output="motor_current"))


@pytest.mark.parametrize(
    ("winding_degc", "share"),
    [(20.0, 1.0), (120.0, 1.0), (127.5, 0.84375), (135.0, 0.5), (150.0, 0.0), (200.0, 0.0)],
)
def test_a_hot_winding_gets_less_current_and_none_at_the_end(winding_degc, share):
    """From rest 1e4 rad/s² with 1e-3 kg·m² would take 250 A. Halfway along the ramp is 1/2."""
    heavy = MotorParameters(inertia_kg_m2=1e-3)
    current = warm_motor(winding_degc, motor=heavy, command=500.0, output="motor_current")
    assert current == pytest.approx(15.0 * share, abs=1e-12)


def test_the_plant_closes_the_loop_of_loss_and_temperature():
    plant = make_plant(PlantParameters(motor=MotorParameters(), thermal=ThermalParameters()))
    context = plant.CreateDefaultContext()
    plant.GetInputPort("motor_speed_command").FixValue(context, [300.0])
    temperatures = plant.GetOutputPort("motor_temperatures")
    assert list(temperatures.Eval(context)) == [25.0, 25.0]
    rates = plant.EvalTimeDerivatives(context).CopyToVector()
    current = plant.GetOutputPort("motor_current").Eval(context)[0]
    assert current > 1.0
    # The two temperatures are the last states of the plant.
    np.testing.assert_allclose(rates[-2:], [0.01 * 0.15 * current**2 / 20.0, 0.0], rtol=1e-12)


def test_linear_analyses_take_a_cold_motor():
    """A temperature would be a slow pole that hides the integrator of the plant."""
    warm = PlantParameters(motor=MotorParameters(), thermal=ThermalParameters())
    gains = [linearize_plant(p).velocity_gain for p in (warm, warm.without_temperatures())]
    assert gains[0] == gains[1] != 0.0
    assert Scenario(plant=warm).without_quantizers().plant == warm.without_temperatures()


@pytest.mark.slow
def test_a_hot_motor_in_c_has_the_current_of_the_compiled_engine(tmp_path):
    scenario = Scenario(
        plant={"motor": True, "thermal": {"start_degc": 146.0}},
        reference={"kind": "sine", "frequency_hz": 1.0},
        simulation={"duration_s": 0.5},
    )
    measured = export_firmware(scenario, tmp_path, "loop")
    assert measured.replay.passed
    assert measured.replay.difference["motor_current_a"] < 1e-9
    # The ramp from 120 to 150 °C leaves z²(3 − 2z) of the 15 A, with z = 4/30.
    largest = measured.replay.largest["motor_current_a"]
    assert largest == pytest.approx(15.0 * (4.0 / 30.0) ** 2 * (3.0 - 8.0 / 30.0), rel=0.01)
