"""Integrators of the compiled closed loop, against Drake and against finer steps."""

import numpy as np
import pytest

from kneexo.errors import SimulationError
from kneexo.parameters import (
    BldcPumpParameters,
    EncoderParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SineReference,
)
from kneexo.parameters.paths import changed
from kneexo.simulation import simulate_compiled
from kneexo.simulation.engines import simulate

FREE = EncoderParameters(quantized=False)
TARGET_M = 1e-6 * 0.15  # a millionth of the stroke


def scenario_of(duration_s, **fields):
    settings = SimulationParameters(duration_s=duration_s, integrator="runge_kutta3", step_s=2e-4)
    return Scenario(encoder=FREE, simulation=settings, **fields)


# -------------------------------------------------------------------------- integrators


def test_runge_kutta3_is_that_of_drake():
    scenario = scenario_of(0.1, reference=SineReference(amplitude_deg=10.0, frequency_hz=0.3))
    drake = simulate(scenario)
    ours = simulate_compiled(scenario, integrator="runge_kutta3", step_s=2e-4)
    np.testing.assert_array_equal(ours.time_s, drake.time_s)
    assert list(ours.data) == list(drake.data)
    for column, values in drake.data.items():
        error = np.max(np.abs(ours[column] - values))
        assert error <= 1e-9 * np.max(np.abs(values)), column
    assert ours.settings.integrator == "runge_kutta3"
    assert ours.settings.step_s == 2e-4


def test_runge_kutta3_stretches_its_last_step_as_drake_does():
    # 2 ms are 4 steps of 0.499 ms and 0.8 % of one: Drake stretches the last; of 0.4 ms they are 5.
    for step in (0.499e-3, 0.4e-3):
        settings = SimulationParameters(duration_s=0.1, integrator="runge_kutta3", step_s=step)
        scenario = Scenario(encoder=FREE, simulation=settings)
        drake, ours = (
            simulate(scenario),
            simulate_compiled(scenario, integrator="runge_kutta3", step_s=step),
        )
        for column in ("load_pressure_pa", "rod_velocity_m_s"):
            scale = np.max(np.abs(drake[column]))
            np.testing.assert_allclose(ours[column], drake[column], rtol=0, atol=1e-9 * scale)


CASES = {
    "0.1 Hz": scenario_of(5.0),
    "0.21 Hz, saturated": scenario_of(5.0, reference=SineReference(frequency_hz=0.21)),
    "acceleration limited": scenario_of(
        3.0,
        reference=SineReference(frequency_hz=1.0),
        plant=PlantParameters(pump=BldcPumpParameters(acceleration_limit_rad_s2=2e3)),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_exact_hold_is_exact_to_a_millionth_of_the_stroke(case):
    scenario = CASES[case]
    signals = ("rod_extension", "motor_speed", "motor_speed_command", "load_pressure")
    fine = simulate_compiled(scenario, signals=signals, integrator="rk4", step_s=1e-5)
    hold = simulate_compiled(scenario, signals=signals)
    if case != "0.1 Hz":  # the corners are there
        limit = scenario.command_limit_rad_s
        assert np.mean(np.abs(fine["motor_speed_command_rad_s"]) >= limit * (1 - 1e-9)) > 0.05
    assert np.max(np.abs(hold["rod_extension_m"] - fine["rod_extension_m"])) < TARGET_M / 10
    # rk4 itself is off by 1e-3 Pa in the mode of the oil at this step.
    assert np.max(np.abs(hold["load_pressure_pa"] - fine["load_pressure_pa"])) < 1.0


WEARER = {"plant": {"load": {"kind": "knee"}}, "wearer": {"kind": "leg"}}
PULLED = {
    "prescribed leg": (WEARER | {"controller": {"kind": "torque"}}, 2.8e-11, 3.8e-7),
    "active leg": (
        WEARER
        | {"wearer": {"kind": "leg", "motion": "active"}}
        | {"controller": {"kind": "torque", "mode": "impedance"}},
        9.4e-10,
        3.5e-7,
    ),
}
"""Scenarios whose stiff cuff follows a function of time.

Beside each, the errors in 30 s of an exact hold whose steps are never driven: the error of the rod
extension relative to the stroke, and that of the load pressure relative to its peak.
"""


@pytest.mark.parametrize(
    ("case", "duration_s"),
    [
        ("prescribed leg", 0.3),
        pytest.param("prescribed leg", 12.0, marks=pytest.mark.slow),
        pytest.param("active leg", 12.0, marks=pytest.mark.slow),
    ],
)
def test_a_stiff_cuff_that_follows_a_function_of_time_is_exact(case, duration_s):
    fields, most_of_stroke, most_of_peak = PULLED[case]
    scenario, signals = scenario_of(duration_s, **fields), ("rod_extension", "load_pressure")
    fine = simulate_compiled(scenario, signals=signals, integrator="rk4", step_s=1e-5)
    hold = simulate_compiled(scenario, signals=signals)
    error_m = np.max(np.abs(hold["rod_extension_m"] - fine["rod_extension_m"]))
    assert error_m <= most_of_stroke * scenario.plant.cylinder.stroke_m
    peak_pa = np.max(np.abs(fine["load_pressure_pa"]))
    error_pa = np.max(np.abs(hold["load_pressure_pa"] - fine["load_pressure_pa"]))
    assert error_pa <= most_of_peak * peak_pa


def test_tolerance_of_the_exact_hold_rules_its_error():
    scenario = CASES["acceleration limited"]
    fine = simulate_compiled(scenario, signals=["motor_speed"], integrator="rk4", step_s=2e-6)
    errors = []
    for tolerance in (1e-5, 1e-7, 1e-9):
        run = simulate_compiled(scenario, signals=["motor_speed"], tolerance=tolerance)
        errors.append(np.max(np.abs(run["motor_speed_rad_s"] - fine["motor_speed_rad_s"])))
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.2 * errors[1]


@pytest.mark.parametrize(
    ("preset", "duration_s"),
    [
        ("leg", 0.2),
        pytest.param("leg", 10.0, marks=pytest.mark.slow),
        pytest.param("wearer", 10.0, marks=pytest.mark.slow),
    ],
)
def test_the_rosenbrock_method_keeps_its_tolerance_on_stiff_plants(preset, duration_s):
    """With valves, friction and a cuff, against the exact hold at a small tolerance."""
    scenario = Scenario.preset(preset).without_quantizers()
    scenario = changed(scenario, {"simulation.duration_s": duration_s})
    exact = simulate_compiled(scenario, signals=("rod_extension",), tolerance=1e-11)
    errors_m = []
    for tolerance in (1e-5, 1e-7, 1e-9):
        steps = {"simulation.integrator": "rosenbrock", "simulation.tolerance": tolerance}
        run = simulate(changed(scenario, steps), signals=("rod_extension",))
        assert run.settings.integrator == "rosenbrock"
        errors_m.append(np.abs(run["rod_extension_m"] - exact["rod_extension_m"]).max())
    assert errors_m[0] < 1e-5
    assert errors_m[1] < min(1e-7, 0.3 * errors_m[0])
    assert errors_m[2] < min(1e-9, 0.3 * errors_m[1])


@pytest.mark.slow
def test_a_run_that_leaves_the_range_says_what_drake_says():
    scenario = Scenario(  # too slow a motor to turn in time
        encoder=FREE,
        reference=SineReference(mean_deg=75.0, amplitude_deg=14.9, frequency_hz=0.4),
        plant=PlantParameters(pump=BldcPumpParameters(acceleration_limit_rad_s2=500.0)),
        simulation=SimulationParameters(duration_s=5.0, integrator="runge_kutta3", step_s=5e-4),
    )
    with pytest.raises(SimulationError) as drake:
        simulate(scenario)
    with pytest.raises(SimulationError) as ours:
        simulate_compiled(scenario)
    # Drake looks after every step of 0.5 ms, the compiled run at the control instants.
    times = [float(str(e.value).split()[2]) for e in (drake, ours)]
    assert 0.0 <= times[1] - times[0] <= 0.002
    head, tail = (str(ours.value).split("= ")[n] for n in (1, 2))
    assert "knee: knee_angle" in head
    assert tail.split(" ", 1)[1] == str(drake.value).split("= ")[2].split(" ", 1)[1]


def test_a_step_that_is_too_large_ends_the_run():
    with pytest.raises(SimulationError, match="cannot follow plant/cylinder"):
        simulate_compiled(scenario_of(1.0), integrator="rk4", step_s=2e-3)
