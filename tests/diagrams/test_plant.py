"""The plant against solutions that share no code with it: exact, closed-form or by energy."""

import math
import re

import numpy as np
import pytest
from plant_cases import PAPER, SOFT, by_name, plant_parameters, set_state, with_command
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp

from kneexo.diagrams import PLANT_OUTPUTS, make_plant
from kneexo.errors import LinkageError, SimulationError
from kneexo.parameters import (
    G1,
    G2,
    G3,
    BldcPumpParameters,
    CylinderParameters,
    KneeLoadParameters,
    KneeParameters,
    LinkageParameters,
    PlantParameters,
)

LOADED = PlantParameters(load=KneeLoadParameters())
WEIGHTLESS = KneeLoadParameters(segment_mass_kg=0.0)


def acceleration(plant, context):
    return by_name(plant, "rod_state", context)[2]


def load_force(plant, context, cylinder):
    """F_L by Eq. 16 from the plant's own motion."""
    x, v, a = by_name(plant, "rod_state", context)
    pressure = by_name(plant, "load_pressure", context)
    area = math.pi / 4.0 * (cylinder.bore_m**2 - 0.5 * cylinder.rod_diameter_m**2)
    return (
        area * pressure
        - cylinder.damping_n_s_per_m * v
        - cylinder.stiffness_n_per_m * x
        - cylinder.mass_kg * a
    )


# ------------------------------------------------------------------------------ structure


@pytest.mark.parametrize("loaded", [False, True])
def test_subsystems_and_exported_ports_are_named(loaded):
    plant = make_plant(LOADED if loaded else PlantParameters())
    systems = {"motor", "cylinder", "knee"} | ({"load"} if loaded else set())
    inputs = {"motor_speed_command": 1, "disturbance_force": 1}
    if loaded:
        inputs["knee_torque"] = 1
    sizes = {"icr": 2, "rod_state": 3}
    outputs = {
        name: sizes.get(name, 1)
        for name in (
            *("knee_angle", "encoder_angle", "moment_arm", "icr"),
            *("rod_extension", "rod_velocity", "rod_state", "load_pressure", "rod_force"),
            *("motor_speed", "load_flow", "shaft_torque", "shaft_power", "hydraulic_power"),
        )
    }
    assert {system.get_name() for system in plant.GetSystems()} == systems
    ports = [plant.get_input_port(i) for i in range(plant.num_input_ports())]
    assert {port.get_name(): port.size() for port in ports} == inputs
    ports = [plant.get_output_port(i) for i in range(plant.num_output_ports())]
    assert {port.get_name(): port.size() for port in ports} == outputs
    assert {name for names in PLANT_OUTPUTS.values() for name in names} == set(outputs)


@pytest.mark.parametrize(
    ("parameters", "states"),
    [(PlantParameters(), 4), (LOADED, 4), (PlantParameters(ideal_motor=True), 3)],
)
def test_plant_is_continuous_only(parameters, states):
    context = make_plant(parameters).CreateDefaultContext()
    assert context.num_continuous_states() == states
    assert context.num_discrete_state_groups() == 0
    assert context.num_abstract_states() == 0


@pytest.mark.parametrize("degrees", [2.0, 30.0, 60.0, 88.0])
@pytest.mark.parametrize(
    "load",
    [
        KneeLoadParameters(),
        KneeLoadParameters(thigh_inclination_rad=1.2, knee_torque_n_m=-4.0, disturbance_n=30.0),
        None,
    ],
    ids=["hanging", "leaning", "none"],
)
@pytest.mark.parametrize(
    ("geometry", "angle_error", "acceleration_error"),
    # The fit of the rod's inverse is good to 1e-12 rad for linkages and to 3e-10 rad for Table 1;
    # its moment arm to 1e-12, for G3 to 1e-10 and for Table 1 to 1e-9, of loads of 60 N on 1.6 kg.
    [
        ({"linkage": G1}, 1e-11, 1e-9),
        ({"linkage": G2}, 1e-11, 1e-9),
        ({"linkage": G3}, 1e-11, 5e-9),
        ({"rod_map": "polynomial"}, 1e-9, 1e-7),
    ],
    ids=["G1", "G2", "G3", "table_1"],
)
def test_plant_starts_at_rest_with_the_pressure_holding_the_load(
    degrees, load, geometry, angle_error, acceleration_error
):
    parameters = PlantParameters(**geometry, **({"load": load} if load else {}))
    plant = make_plant(parameters, initial_knee_angle_rad=math.radians(degrees))
    context = with_command(plant)
    angle = by_name(plant, "knee_angle", context)
    assert angle == pytest.approx(math.radians(degrees), abs=angle_error)
    assert by_name(plant, "motor_speed", context) == 0.0
    assert by_name(plant, "rod_velocity", context) == 0.0
    assert acceleration(plant, context) == pytest.approx(0.0, abs=acceleration_error)
    assert (by_name(plant, "load_pressure", context) != 0.0) == (load is not None)


def test_initial_offset_shifts_the_rod_and_nothing_else():
    at, off = (make_plant(initial_offset_m=offset) for offset in (0.0, -0.089))
    shift = [
        with_command(plant).get_continuous_state_vector().CopyToVector() for plant in (at, off)
    ]
    # 1e-15 m: one rounding of the sum.
    np.testing.assert_allclose(shift[1] - shift[0], [0.0, -0.089, 0.0, 0.0], atol=1e-15)


# ---------------------------------------------------------------------------------- loads


def postures(count=6):
    rng = np.random.default_rng(5)
    return [
        {"extension": x, "velocity": v, "pressure": p, "speed": w}
        for x, v, p, w in zip(
            rng.uniform(0.004, 0.147, count),
            rng.uniform(-0.04, 0.04, count),
            rng.uniform(-2e6, 2e6, count),
            rng.uniform(-500.0, 500.0, count),
            strict=True,
        )
    ]


def slope(function, x, step=1e-6):
    return (function(x + step) - function(x - step)) / (2.0 * step)


@pytest.mark.parametrize("posture", postures(), ids=lambda p: f"x={p['extension']:.3f}")
def test_knee_torque_does_the_work_that_the_rod_feels(posture, four_bar):
    parameters = PlantParameters(load=WEIGHTLESS.model_copy(update={"knee_torque_n_m": 3.0}))
    plant = make_plant(parameters)
    context = with_command(plant)
    set_state(plant, context, **posture)
    plant.GetInputPort("knee_torque").FixValue(context, [4.0])
    knee_rate = slope(four_bar.knee_of_rod, posture["extension"]) * posture["velocity"]
    rod_power = -load_force(plant, context, parameters.cylinder) * posture["velocity"]
    # 1e-7: central differences over 1 µm of a rod angle known to 1e-15 rad.
    assert rod_power == pytest.approx((3.0 + 4.0) * knee_rate, rel=1e-7)


@pytest.mark.parametrize("inclination", [0.0, 0.9])
@pytest.mark.parametrize("posture", postures(), ids=lambda p: f"x={p['extension']:.3f}")
def test_weight_on_the_rod_is_the_slope_of_the_potential_energy(posture, inclination, four_bar):
    load = KneeLoadParameters(
        segment_mass_kg=2.0, centre_of_mass_m=0.25, thigh_inclination_rad=inclination
    )
    parameters = PlantParameters(load=load)
    plant = make_plant(parameters)
    context = with_command(plant)
    set_state(plant, context, **posture)

    def energy(extension):  # flexion turns the shank back from the thigh's direction
        return -2.0 * 9.81 * 0.25 * math.cos(inclination - four_bar.knee_of_rod(extension))

    force = load_force(plant, context, parameters.cylinder)
    # 1e-7 of 50 N: as above; absolute, because the force changes sign with the posture.
    assert force == pytest.approx(slope(energy, posture["extension"]), abs=5e-6)


@pytest.mark.parametrize("load", [None, WEIGHTLESS], ids=["without load", "with load"])
def test_disturbance_force_opposes_extension(load):
    parameters = PlantParameters(**({"load": load} if load else {}))
    plant = make_plant(parameters)
    context = with_command(plant)
    plant.GetInputPort("disturbance_force").FixValue(context, [8.0])
    # From rest without pressure, m dv/dt = −F.
    assert acceleration(plant, context) == pytest.approx(-8.0 / 1.6, rel=1e-14)


@pytest.mark.parametrize("loaded", [False, True])
def test_unconnected_disturbance_and_knee_torque_count_as_zero(loaded):
    plant = make_plant(LOADED if loaded else PlantParameters())
    context = with_command(plant, 100.0)
    set_state(plant, context, **postures()[0])
    unconnected = plant.EvalTimeDerivatives(context).CopyToVector()
    for name in ("disturbance_force", "knee_torque") if loaded else ("disturbance_force",):
        plant.GetInputPort(name).FixValue(context, [0.0])
        np.testing.assert_array_equal(
            plant.EvalTimeDerivatives(context).CopyToVector(), unconnected
        )
        plant.GetInputPort(name).FixValue(context, [1.0])
        assert np.any(plant.EvalTimeDerivatives(context).CopyToVector() != unconnected)
        plant.GetInputPort(name).FixValue(context, [0.0])


# --------------------------------------------------------------------------------- energy


@pytest.mark.parametrize("posture", postures(), ids=lambda p: f"P={p['pressure']:.2g}")
def test_stored_energy_changes_by_hydraulic_power_less_losses_and_work(posture):
    n = SOFT
    plant = make_plant(plant_parameters(n))
    context = with_command(plant)
    set_state(plant, context, **posture)
    plant.GetInputPort("disturbance_force").FixValue(context, [15.0])
    pressure_rate = 1e6 * plant.EvalTimeDerivatives(context).CopyToVector()[3]
    x, v, a = by_name(plant, "rod_state", context)
    p = posture["pressure"]
    stored = n["mass"] * v * a + n["stiffness"] * x * v
    stored += n["volume"] / (4.0 * n["bulk"]) * p * pressure_rate
    lost = n["c_l"] * p**2 + n["damping"] * v**2 + 15.0 * v
    power = by_name(plant, "hydraulic_power", context)
    # 1e-9 W: rounding of terms up to some 1e4 W that cancel.
    assert stored == pytest.approx(power - lost, abs=1e-9)


# ------------------------------------------------------------------------------- geometry


@pytest.mark.slow
def test_a_shank_with_inertia_swings_as_a_pendulum(four_bar):
    """I d²θ/dt² = m g l sin(α − θ) + r K (x − x_0), integrated in θ, where the inertia is constant.

    Without leakage and damping, the oil of a huge volume is a soft spring K = 4 β_e Ā²/V_t.
    """
    plant = make_plant(
        PlantParameters(
            load=KneeLoadParameters(inertia_kg_m2=0.08, thigh_inclination_rad=math.radians(55.0)),
            cylinder=CylinderParameters(
                total_volume_m3=0.01, bulk_modulus_pa=1e6, damping_n_s_per_m=0.0
            ),
            pump=BldcPumpParameters(internal_leakage_m3_per_s_pa=0.0),
        )
    )
    start, times = math.radians(20.0), np.linspace(0.1, 1.2, 12)
    x_0, stiffness = four_bar.rod(start), 4.0 * 1e6 * PAPER["area"] ** 2 / 0.01
    assert stiffness > 30.0  # so that x_0 = 0 would show

    def rates(_, state):
        angle, rate = state
        weight = 1.6 * 9.81 * 0.2 * math.sin(math.radians(55.0) - angle)
        spring = four_bar.arm(angle) * stiffness * (four_bar.rod(angle) - x_0)
        return [rate, (weight + spring) / 0.08]

    options = {"rtol": 1e-11, "atol": 1e-12, "t_eval": times}
    expected = solve_ivp(rates, (0.0, 1.2), [start, 0.0], **options)
    context = with_command(plant)
    set_state(plant, context, extension=x_0)
    simulator = Simulator(plant, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    for time, angle in zip(times, expected.y[0], strict=True):
        simulator.AdvanceTo(time)
        # The accuracy of 1e-9 in metres and per step, over an arm of 0.06 m or more.
        assert by_name(plant, "knee_angle", context) == pytest.approx(angle, abs=1e-6)


# --------------------------------------------------------------------------------- errors


def test_linkage_that_cannot_be_assembled_is_refused():
    with pytest.raises(LinkageError, match=r"cannot be assembled") as error:
        make_plant(PlantParameters(linkage=LinkageParameters(a_2_m=1e-3)))
    assert "\n" not in str(error.value)


NARROW = PlantParameters(knee=KneeParameters(flexion_min_deg=30.0, flexion_max_deg=40.0))
SHORT = PlantParameters(cylinder=CylinderParameters(stroke_m=0.118))


@pytest.mark.parametrize(
    ("parameters", "command", "signal", "low", "high"),
    [
        (NARROW, 500.0, "knee: knee_angle", 29.0, 30.0),
        (NARROW, -500.0, "knee: knee_angle", 40.0, 41.0),
        (SHORT, 500.0, "cylinder: rod_extension", 0.118, 0.119),
    ],
)
def test_leaving_the_range_raises_with_time_and_signal(parameters, command, signal, low, high):
    plant = make_plant(parameters, initial_knee_angle_rad=math.radians(34.0))
    simulator = Simulator(plant)
    context = simulator.get_mutable_context()
    plant.GetInputPort("motor_speed_command").FixValue(context, [command])
    with pytest.raises(SimulationError) as error:
        simulator.AdvanceTo(5.0)
    message = str(error.value)
    match = re.match(rf"t = (\S+) s: {signal} = (\S+) (deg|m) left the ", message)
    assert match, message
    assert "\n" not in message
    # The message rounds to six digits.
    assert float(match[1]) == pytest.approx(context.get_time(), rel=1e-5)
    # Told at the step that leaves, not later: a step is shorter than 25 ms.
    assert low <= float(match[2]) < high


def test_command_that_is_not_a_number_raises_instead_of_hanging():
    plant = make_plant()
    simulator = Simulator(plant)
    port = plant.GetInputPort("motor_speed_command")
    port.FixValue(simulator.get_mutable_context(), [math.nan])
    with pytest.raises(SimulationError, match=r"^t = \S+ s: motor: .* not finite"):
        simulator.AdvanceTo(1.0)
