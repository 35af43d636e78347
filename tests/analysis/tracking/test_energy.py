"""The energy of a run: it closes, and its terms are those of the logged signals."""

import numpy as np
import pytest

from kneexo.analysis import energy_balance, simulate
from kneexo.analysis.tracking.energy import SPENT, SUPPLIED, EnergyBalance
from kneexo.errors import ParameterError
from kneexo.parameters import (
    FullCylinderParameters,
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    gait_reference,
)
from kneexo.parameters.paths import changed

STRIDE = Scenario(
    plant=PlantParameters(full_order=FullCylinderParameters(), load=KneeLoadParameters()),
    wearer={"kind": "leg"},
    controller="torque",
    reference=gait_reference(0.5, 1),
    simulation=SimulationParameters(duration_s=2.0),
)
LOSSES = {
    "plant.pump.external_leakage_m3_per_s_pa": 5e-13,
    "plant.cylinder.leakage_m3_per_s_pa": 3e-13,
    "plant.cylinder.stiffness_n_per_m": 300.0,
    "plant.full_order.cap_external_leakage_m3_per_s_pa": 2e-13,
    "plant.full_order.coulomb_friction_n": 20.0,
    "plant.load.disturbance_n": 10.0,
}
INERTIA = {"plant.load.inertia_kg_m2": 0.064}


@pytest.mark.slow
@pytest.mark.parametrize("values", [{}, LOSSES, INERTIA], ids=["defaults", "losses", "inertia"])
def test_the_energy_of_a_stride_closes(values):
    balance = energy_balance(changed(STRIDE, values))
    assert set(balance.energies) == {*SUPPLIED, *SPENT}
    # Relief and make-up valves open; the leg gives more than 100 J.
    assert balance.energies["wearer_j"][-1] > 100.0
    assert balance.energies["valves_j"][-1] > 50.0
    # Required is 1e-6; the solver's tolerance of 1e-8 a sample leaves some 1e-11.
    assert np.abs(balance.residual_j).max() <= 1e-8 * balance.throughput_j
    assert balance.throughput_j == max(np.abs(e).max() for e in balance.energies.values())


def fault(place, size, kind="value"):
    return {"place": place, "kind": kind, "size": size, "start_s": 0.5}


@pytest.mark.slow
@pytest.mark.parametrize(
    "values",
    [
        fault("encoder", 2.0, "offset"),
        fault("plant.motor.supply_voltage_v", 15.0),
        fault("wearer.cuff.stiffness_n_m_per_rad", 750.0),
    ],
    ids=lambda values: values["place"],
)
def test_the_energy_with_a_fault_elsewhere_closes(values):
    healthy = changed(STRIDE, {"plant.motor": {}})
    balance = energy_balance(changed(healthy, {"faults": [values]}))
    assert np.abs(balance.residual_j).max() <= 1e-8 * balance.throughput_j
    other = energy_balance(healthy).energies["wearer_j"]
    assert np.abs(balance.energies["wearer_j"] - other).max() > 1e-3


@pytest.mark.slow
def test_the_energies_are_those_of_the_signals():
    balance, run = energy_balance(STRIDE), simulate(STRIDE)
    energies, time = balance.energies, run.time_s
    assert balance.time_s == pytest.approx(time, abs=1e-12)

    def integral(power):
        return np.trapezoid(power, time)

    # Trapezoids of 2 ms, smoother than the records of the oil's mode: they agree to 1e-4.
    for name, power in (
        ("motor_j", run["shaft_power_w"]),
        ("wearer_j", run["power_into_exoskeleton_w"]),
        ("leakage_j", 2e-13 * run["load_pressure_pa"] ** 2),
        ("friction_j", 0.05 * run["rod_velocity_m_s"] ** 2),
    ):
        assert energies[name][-1] == pytest.approx(integral(power), rel=1e-3), name
    weight = -1.6 * 9.81 * 0.2 * np.cos(run["knee_angle_rad"])
    assert energies["load_j"] == pytest.approx(weight - weight[0], abs=1e-6)
    motion = 0.8 * run["rod_velocity_m_s"] ** 2
    assert energies["motion_j"] == pytest.approx(motion - motion[0], abs=1e-9)


@pytest.mark.slow
def test_an_inertia_has_its_kinetic_energy():
    scenario = changed(STRIDE, INERTIA)
    balance, run = energy_balance(scenario), simulate(scenario)
    rate = run["rod_velocity_m_s"] / run["moment_arm_m"]
    motion = 0.5 * 0.064 * rate**2
    # Two runs with another choice of steps, to the tolerance of the solver.
    assert balance.energies["motion_j"] == pytest.approx(motion - motion[0], abs=1e-9)
    assert np.ptp(motion) > 0.1


def balance_of(values):
    zero = np.zeros(3)
    energies = {name: values.get(name, zero) for name in (*SUPPLIED, *SPENT)}
    return EnergyBalance(np.array([0.0, 1.0, 2.0]), energies)


def test_residual_throughput_and_parts_of_a_run():
    balance = balance_of(
        {
            "motor_j": np.array([0.0, 3.0, 1.0]),
            "wearer_j": np.array([0.0, -1.0, 4.0]),
            "valves_j": np.array([0.0, 1.5, 5.0]),
        }
    )
    assert balance.residual_j.tolist() == [0.0, 0.5, 0.0]
    assert balance.throughput_j == 5.0
    part = balance.between(1.0, 2.0)
    assert (part["motor_j"], part["wearer_j"], part["valves_j"]) == (-2.0, 5.0, 3.5)
    assert balance.to_dataframe()["valves_j"].tolist() == [0.0, 1.5, 5.0]


@pytest.mark.parametrize(("start", "end"), [(1.0, 1.0), (-1.0, 1.0), (1.0, 3.0)])
def test_a_part_lies_in_the_run(start, end):
    with pytest.raises(ParameterError, match=r"must ascend within 0 … 2 s"):
        balance_of({}).between(start, end)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"plant.full_order": None}, "plant.full_order: is left out; must be given"),
        ({"plant.bypass": True}, "plant.bypass: must be left out"),
        ({"plant.end_stops": True}, "plant.end_stops: must be left out"),
        ({"plant.full_order.entrained_air": 0.01}, "entrained_air = 0.01: must be 0"),
        (
            {"simulation.integrator": "radau3"},
            "integrator = radau3: must be exact_hold, rk4 or rosenbrock",
        ),
        (
            {"wearer": "none", "controller": "smc", "push": {"torque_n_m": 5.0, "start_s": 1.0}},
            "push: must be left out for an energy balance",
        ),
        *(
            ({"faults": [fault(f"plant.{name}", size)]}, f"faults.0: place = plant.{name}: must be")
            for name, size in (
                ("pump.internal_leakage_m3_per_s_pa", 5e-12),
                ("cylinder.leakage_m3_per_s_pa", 5e-12),
                ("full_order.coulomb_friction_n", 80.0),
                ("load.knee_torque_n_m", 20.0),
            )
        ),
    ],
)
def test_a_run_without_balance_is_refused_in_one_line(values, message):
    with pytest.raises(ParameterError, match=message) as caught:
        energy_balance(changed(STRIDE, values))
    assert "\n" not in str(caught.value)
