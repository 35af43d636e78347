"""Powers of the meter: each by hand, and all together against the rates of the model."""

import math

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from diagramc.testing import check_leaf
from kneexo.diagrams import make_plant
from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    PlantParameters,
)
from kneexo.systems import EnergyMeter
from kneexo.systems.energy_meter import ENERGIES

CAP = math.pi / 4.0 * 0.020**2  # A_1 and A_2 in m², Lee et al. 2020, Table 3
ROD_SIDE = math.pi / 4.0 * (0.020**2 - 0.010**2)
PUMP = BldcPumpParameters(internal_leakage_m3_per_s_pa=3e-13, external_leakage_m3_per_s_pa=5e-13)
CYLINDER = CylinderParameters(
    leakage_m3_per_s_pa=2e-13, damping_n_s_per_m=40.0, stiffness_n_per_m=300.0
)
FULL = FullCylinderParameters(
    cap_external_leakage_m3_per_s_pa=1e-13,
    rod_side_external_leakage_m3_per_s_pa=4e-13,
    coulomb_friction_n=30.0,
    stribeck_friction_n=10.0,
)
LOAD = KneeLoadParameters(
    knee_torque_n_m=3.0,
    disturbance_n=5.0,
    disturbance_amplitude_n=7.0,
    disturbance_frequency_hz=2.0,
    thigh_inclination_rad=0.4,
)
PARAMETERS = (PUMP, CYLINDER, FULL, LOAD)
INPUTS = {
    "shaft_power": [(-100.0, 100.0)],
    "rod_extension": [(0.02, 0.13)],
    "rod_velocity": [(0.02, 0.2)],
    "chamber_pressures": [(0.3e6, 3e6), (0.3e6, 3e6)],
    "makeup_flow": [(1e-6, 1e-4), (1e-6, 1e-4)],
    "relief_flow": [(1e-6, 1e-4), (1e-6, 1e-4)],
    "knee_angle": [(0.2, 1.4)],
    "moment_arm": [(0.03, 0.11)],
    "interaction_power": [(-50.0, 50.0), (-50.0, 50.0)],
}


def powers(meter, **values):
    context = meter.CreateDefaultContext()
    zero = {name: [0.0] * len(ranges) for name, ranges in INPUTS.items()} | {"moment_arm": [0.1]}
    for name, value in (zero | values).items():
        meter.GetInputPort(name).FixValue(context, value)
    return dict(zip(ENERGIES, meter.EvalTimeDerivatives(context).CopyToVector(), strict=True))


def test_conversions_agree_and_keep_arguments_and_changes():
    check_leaf(EnergyMeter(*PARAMETERS), INPUTS | {"continuous_state": (-5.0, 5.0)})


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ({"shaft_power": [12.0]}, {"motor_j": 12.0}),
        ({"interaction_power": [3.0, 2.0]}, {"wearer_j": 2.0}),
        # 1e-6 m³/s from 0.2 MPa to a line without pressure: 0.2 W, which the valve takes.
        ({"makeup_flow": [1e-6, 0.0]}, {"reservoir_j": 0.2, "valves_j": 0.2}),
        # The same flow from 1.2 MPa back to the reservoir: the valve takes 1 W.
        (
            {"relief_flow": [0.0, 1e-6], "chamber_pressures": [0.0, 1.2e6]},
            {"reservoir_j": -0.2, "valves_j": 1.0, "leakage_j": 2e-13 * 1.2e6**2},
        ),
        # 0.05 N·s/m at 2 m/s; the oil's pressure is zero.
        ({"rod_velocity": [2.0]}, {"friction_j": 0.2}),
    ],
)
def test_powers_by_hand(inputs, expected):
    result = powers(EnergyMeter(), **inputs)
    assert result == pytest.approx(dict.fromkeys(ENERGIES, 0.0) | expected, abs=1e-12)


def test_displaced_energy_by_hand():
    result = powers(EnergyMeter(), rod_velocity=[0.1], chamber_pressures=[2e6, 1e6])
    # ½ (1.256637e9 − 0.235619e9) N·Pa · 0.1 m/s/1.72e9 Pa
    assert result["displaced_j"] == pytest.approx(0.0296807, rel=1e-5)


def test_the_load_takes_weight_torque_and_disturbance():
    meter = EnergyMeter(load=LOAD)
    result = powers(meter, rod_velocity=[0.2], knee_angle=[1.0], moment_arm=[0.08])
    # At t = 0: (m g l sin(α − θ) + τ_0)/r + F_0, times 0.2 m/s.
    expected = ((1.6 * 9.81 * 0.2 * math.sin(-0.6) + 3.0) / 0.08 + 5.0) * 0.2
    assert result["load_j"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_powers_balance_the_rates_of_pressures_and_speed(seed):
    """Supplied − spent = Σ V_i/β_e P_i dP_i/dt + (m a + K x) v in any state, valves open."""
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem(
        "plant",
        make_plant(PlantParameters(pump=PUMP, cylinder=CYLINDER, full_order=FULL, load=LOAD)),
    )
    meter = builder.AddNamedSystem("meter", EnergyMeter(*PARAMETERS))
    for name in INPUTS:
        if plant.HasOutputPort(name):
            builder.Connect(plant.GetOutputPort(name), meter.GetInputPort(name))
    builder.ExportInput(plant.GetInputPort("motor_speed_command"), "command")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("command").FixValue(context, 0.0)
    random = np.random.default_rng(seed)
    context.SetTime(random.uniform(0.0, 1.0))
    x, v, *pressures = random.uniform((0.02, -0.2, -0.05, -0.05), (0.13, 0.2, 3.8, 3.8))
    cylinder = plant.GetSubsystemByName("cylinder")
    motor = plant.GetSubsystemByName("motor")
    cylinder.GetMyMutableContextFromRoot(context).SetContinuousState([x, v, *pressures])
    motor.GetMyMutableContextFromRoot(context).SetContinuousState([random.uniform(-0.5, 0.5)])
    rates = diagram.EvalTimeDerivatives(context)
    _, acceleration, *pressure_rates = cylinder.EvalTimeDerivatives(
        cylinder.GetMyContextFromRoot(context)
    ).CopyToVector()
    assert rates.size() == 5 + 8
    power = dict(
        zip(
            ENERGIES,
            meter.EvalTimeDerivatives(meter.GetMyContextFromRoot(context)).CopyToVector(),
            strict=True,
        )
    )
    volumes = (5e-6 + CAP * x, 5e-6 + ROD_SIDE * (0.150 - x))
    oil = sum(
        volume / 1.72e9 * 1e12 * pressure * rate
        for volume, pressure, rate in zip(volumes, pressures, pressure_rates, strict=True)
    )
    supplied = power["motor_j"] + power["reservoir_j"] + power["wearer_j"]
    spent = sum(power[f"{name}_j"] for name in ("leakage", "valves", "friction", "load"))
    stored = oil + (1.6 * acceleration + 300.0 * x) * v
    largest = max(abs(oil), *map(abs, power.values()))
    # Differences of powers of that size; 15 digits, a factor of 1000 for cancellation.
    assert supplied - spent == pytest.approx(stored, abs=1e-11 * largest)
