"""The plant with the full-order cylinder: what the loaded chamber, the valves and the pump do."""

import math

import numpy as np
import pytest
from plant_cases import by_name, with_command
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Linearize, LogVectorOutput

from kneexo.analysis import linearize_loop, sinestream, track
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.diagrams import make_closed_loop, make_plant
from kneexo.errors import ParameterError
from kneexo.parameters import (
    RPM,
    BldcPumpParameters,
    BypassParameters,
    CylinderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SlidingModeParameters,
)
from kneexo.parameters.scenario_file import load_scenario

# Lee et al. 2020, Tables 2 and 3: bore 20 mm, rod 10 mm, 0.8 cm³/rev behind a gear of 6:1.
AREA_1, AREA_2 = math.pi / 4.0 * 0.020**2, math.pi / 4.0 * (0.020**2 - 0.010**2)
MEAN_AREA = 0.5 * (AREA_1 + AREA_2)
FLOW = 0.8e-6 * 5000.0 / 60.0 / 6.0
SWITCHING_N = 0.2e6 * (AREA_1 - AREA_2)
TIGHT = BldcPumpParameters(internal_leakage_m3_per_s_pa=0.0)


def parameters(force=0.0, *, pump=TIGHT, cylinder=CylinderParameters(), **full_order):
    return PlantParameters(
        pump=pump,
        cylinder=cylinder,
        load=KneeLoadParameters(segment_mass_kg=0.0, disturbance_n=force),
        full_order=FullCylinderParameters(**full_order),
    )


def run(fixed_step, plant, rpm, duration, step=0.002):
    """The Context after ``duration`` at a constant motor speed command."""
    simulator = fixed_step(plant, "radau3", step)
    context = simulator.get_mutable_context()
    plant.GetInputPort("motor_speed_command").FixValue(context, [rpm * RPM])
    simulator.AdvanceTo(duration)
    return context


def logged(fixed_step, plant, rpm, duration, step, *names):
    """Times and the named outputs, each (size, n), at every ``step``."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("plant", plant)
    command = builder.AddNamedSystem("command", ConstantVectorSource([rpm * RPM]))
    builder.Connect(command.get_output_port(), plant.GetInputPort("motor_speed_command"))
    logs = [LogVectorOutput(plant.GetOutputPort(n), builder, publish_period=step) for n in names]
    simulator = fixed_step(builder.Build(), "radau3", step)
    simulator.AdvanceTo(duration)
    records = [log.FindLog(simulator.get_context()) for log in logs]
    return records[0].sample_times().copy(), *(log.data().copy() for log in records)


# ------------------------------------------------------------------------------ structure


def test_pump_s_external_leakage_reaches_both_lines():
    pump = BldcPumpParameters(internal_leakage_m3_per_s_pa=0.0, external_leakage_m3_per_s_pa=5e-12)
    plant = make_plant(parameters(300.0, pump=pump, makeup_conductance_m3_per_s_pa=0.0))
    context = with_command(plant)
    cap, rod_side = by_name(plant, "chamber_pressures", context)
    *_, rate_1, rate_2 = plant.EvalTimeDerivatives(context).CopyToVector()
    x = by_name(plant, "rod_extension", context)
    # Each line loses C_em (P − P_r) (Eq. 12); the rod rests and P_2 is at P_r.
    expected = -1.72e9 / (5e-6 + AREA_1 * x) * 5e-12 * (cap - 0.2e6)
    assert rod_side == pytest.approx(0.2e6, rel=1e-14)
    assert 1e6 * rate_1 == pytest.approx(expected, rel=1e-9)
    assert rate_2 == pytest.approx(0.0, abs=1e-9 * abs(rate_1))


@pytest.mark.parametrize("degrees", [5.0, 60.0])
@pytest.mark.parametrize("force", [-300.0, 0.0, 10.0, 25.0, 300.0])
def test_plant_starts_in_equilibrium_with_the_lower_line_at_the_reservoir(degrees, force):
    plant = make_plant(parameters(force), initial_knee_angle_rad=math.radians(degrees))
    context = with_command(plant)
    pressures = by_name(plant, "chamber_pressures", context)
    assert min(pressures) == pytest.approx(0.2e6, rel=1e-14)
    assert (pressures[0] > pressures[1]) == (force > SWITCHING_N)
    assert by_name(plant, "rod_state", context)[2] == pytest.approx(0.0, abs=1e-9)
    rates = plant.EvalTimeDerivatives(context).CopyToVector()
    # Within the make-up valves' band (25 N is 0.03 MPa beyond it) both would be open.
    if force != 10.0 and force != 25.0:
        np.testing.assert_allclose(rates, 0.0, atol=1e-9)


# ----------------------------------------------------------------------- the loaded chamber


@pytest.mark.parametrize(
    ("force", "area", "printed", "direction"),
    [
        (200.0, AREA_1, 35.4, -1.0),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (200.0, AREA_1, 35.4, 1.0),
                (-200.0, AREA_2, 47.2, 1.0),
                (-200.0, AREA_2, 47.2, -1.0),
            )
        ),
    ],
)
def test_rod_speed_follows_the_loaded_chamber_not_the_direction(
    force, area, printed, direction, fixed_step
):
    plant = make_plant(parameters(force), initial_knee_angle_rad=math.radians(40.0))
    context = run(fixed_step, plant, 5000.0 * direction, 0.4)
    velocity = by_name(plant, "rod_velocity", context)
    # 0.4 s are 40 lags of the motor; the hydraulic mode has died down to 1e-5.
    assert velocity == pytest.approx(direction * FLOW / area, rel=1e-4)
    assert 1e3 * abs(velocity) == pytest.approx(printed, abs=0.05)
    loaded = by_name(plant, "chamber_pressures", context)
    assert (loaded[0] > loaded[1]) == (force > 0.0)
    # The reservoir takes or gives what the areas differ by.
    exchanged = by_name(plant, "makeup_flow", context).sum()
    assert exchanged == pytest.approx((AREA_1 - AREA_2) * velocity, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("direction", "area"), [(1.0, AREA_1), (-1.0, AREA_2)])
def test_friction_without_load_makes_the_speeds_of_the_directions_differ(
    direction, area, fixed_step
):
    plant = make_plant(
        parameters(coulomb_friction_n=40.0), initial_knee_angle_rad=math.radians(40.0)
    )
    context = run(fixed_step, plant, 5000.0 * direction, 0.4)
    velocity = by_name(plant, "rod_velocity", context)
    assert velocity == pytest.approx(direction * FLOW / area, rel=1e-4)  # 35.4 out, 47.2 in


def test_linearized_mode_is_that_of_the_loaded_chamber_damped_by_the_make_up_valve():
    plant = make_plant(parameters(200.0), initial_knee_angle_rad=math.radians(40.0))
    context = with_command(plant)
    x = by_name(plant, "rod_extension", context)
    system = Linearize(
        plant,
        context,
        plant.GetInputPort("motor_speed_command").get_index(),
        plant.GetOutputPort("rod_extension").get_index(),
    )
    volume_1, volume_2 = 5e-6 + AREA_1 * x, 5e-6 + AREA_2 * (0.150 - x)
    stiffness_1, stiffness_2 = 1.72e9 * AREA_1**2 / volume_1, 1.72e9 * AREA_2**2 / volume_2
    valve = 1.72e9 * 2e-10 / volume_2  # the tied line relaxes at this rate
    cubic = np.polymul([1.6, 0.05, stiffness_1], [1.0, valve])
    cubic[2] += stiffness_2
    expected = np.sort_complex([*np.roots(cubic), -100.0, 0.0])  # motor lag, integrator
    # Rounding of eigenvalues of a matrix whose norm is 1e5.
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(system.A())), expected, atol=1e-5)
    # 280 Hz at 40 deg where the reduced order, in which both chambers are stiff, has 447 Hz.
    assert np.max(np.roots(cubic).imag) / (2.0 * math.pi) == pytest.approx(280.0, abs=1.0)


# --------------------------------------------------------------------------------- valves


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "force", "rpm"), [(0, 0.0, 5000.0), (1, -1600.0, -5000.0)], ids=["P_1", "P_2"]
)
def test_relief_valve_limits_the_pressure_and_takes_the_whole_flow(line, force, rpm, fixed_step):
    spring = CylinderParameters(stiffness_n_per_m=10_000.0)
    plant = make_plant(
        parameters(force, cylinder=spring), initial_knee_angle_rad=math.radians(40.0)
    )
    _, pressures, relieved, velocity = logged(
        fixed_step, plant, rpm, 1.0, 0.002, "chamber_pressures", "relief_flow", "rod_velocity"
    )
    # The spring stalls the rod: the valve's line is 22 kPa at full flow, after half its band.
    stalled = 3.5e6 + FLOW / 5e-10 + 0.5 * 0.02e6
    assert pressures[line, -1] == pytest.approx(stalled, rel=1e-4)
    assert relieved[line, -1] == pytest.approx(FLOW, rel=1e-3)
    assert velocity[0, -1] == pytest.approx(0.0, abs=1e-5)
    assert pressures.max() < 1.02 * 3.5e6
    assert not relieved[1 - line].any()


@pytest.mark.slow
def test_oil_is_balanced_over_a_run(fixed_step):
    full_order = {
        "cap_external_leakage_m3_per_s_pa": 4e-13,
        "rod_side_external_leakage_m3_per_s_pa": 7e-13,
    }
    pump = BldcPumpParameters(external_leakage_m3_per_s_pa=2e-12)
    plant = make_plant(
        parameters(300.0, pump=pump, **full_order), initial_knee_angle_rad=math.radians(40.0)
    )
    time, pressures, makeup, relieved, x = logged(
        fixed_step,
        plant,
        3000.0,
        0.4,
        2e-4,
        *("chamber_pressures", "makeup_flow", "relief_flow", "rod_extension"),
    )
    above = pressures - 0.2e6
    leaked = (np.array([4e-13, 7e-13]) + 2e-12) @ above
    gained = np.trapezoid(makeup.sum(axis=0) - relieved.sum(axis=0) - leaked, time)
    volumes = np.vstack([5e-6 + AREA_1 * x[0], 5e-6 + AREA_2 * (0.150 - x[0])])
    stored = volumes.sum(axis=0)[-1] - volumes.sum(axis=0)[0]
    stored += sum(np.trapezoid(v / 1.72e9, p) for v, p in zip(volumes, pressures, strict=True))
    assert gained > 3e-7  # 0.3 cm³ came from the reservoir
    # The trapezoidal rule over a mode of 300 Hz and radau3, both at 0.2 ms.
    assert stored == pytest.approx(gained, rel=1e-4)


# Measured with radau3 at 1 ms, peak to peak over the last 0.3 s of 0.6 s at −5000 rpm: about
# 130 mm/s at 12…23 N and below 1e-3 mm/s at 10 N and less and at 25 N and more; with make-up valves
# that open over 0.05 MPa the zone is 5…30 N. At +5000 rpm nothing oscillates. 145 mm/s is what
# radau3 at 0.1 ms and runge_kutta3 at 40 µs agree upon; coarser steps damp the mode.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("force", "rpm", "lowest", "highest"),
    [
        (0.0, -5000.0, 0.0, 1e-3),
        (40.0, -5000.0, 0.0, 1e-3),
        (14.0, 5000.0, 0.0, 1e-3),
        (14.0, -5000.0, 50.0, 250.0),
    ],
)
def test_rod_oscillates_near_the_switching_force_when_it_retracts(
    force, rpm, lowest, highest, fixed_step
):
    plant = make_plant(
        parameters(force, pump=BldcPumpParameters()), initial_knee_angle_rad=math.radians(40.0)
    )
    time, velocity = logged(fixed_step, plant, rpm, 0.4, 0.001, "rod_velocity")
    spread = 1e3 * np.ptp(velocity[0][time > 0.2])
    assert lowest <= spread <= highest


def test_bare_simulator_with_drakes_defaults_runs_the_full_order():
    plant = make_plant(PlantParameters(full_order=FullCylinderParameters()))
    simulator = Simulator(plant)
    context = simulator.get_mutable_context()
    plant.GetInputPort("motor_speed_command").FixValue(context, [-2000.0 * RPM])
    simulator.AdvanceTo(0.2)
    # Without load P_2 is the loaded chamber; 1e-3 is Drake's accuracy.
    velocity = by_name(plant, "rod_velocity", context)
    assert velocity == pytest.approx(-0.4 * FLOW / AREA_2, abs=1e-3)


# ---------------------------------------------------------------------------- closed loop


@pytest.mark.slow
def test_a_smaller_loaded_area_moves_the_rod_farther_and_costs_margin():
    phase_margin_deg, complementary_hz = {}, {}
    for name in ("reduced", "cap", "rod_side"):
        plant = PlantParameters(
            load=KneeLoadParameters(disturbance_n=-60.0 if name == "rod_side" else 60.0),
            full_order=None if name == "reduced" else FullCylinderParameters(),
        )
        loop = linearize_loop(Scenario(plant=plant), knee_angle_deg=40.0)
        phase_margin_deg[name] = loop.margins().phase_margin_deg
        complementary_hz[name] = loop.complementary_sensitivity_bandwidth_hz()
    # As measured: docs/cylinder_order.md.
    expected = {"reduced": 57.1, "cap": 61.5, "rod_side": 51.1}
    assert phase_margin_deg == pytest.approx(expected, abs=0.2)
    assert complementary_hz["cap"] < complementary_hz["reduced"] < complementary_hz["rod_side"]


@pytest.mark.slow
@pytest.mark.parametrize("force", [None, 200.0, -200.0], ids=["no load", "P_1", "P_2"])
def test_area_error_of_the_reduction_sets_the_tracking_error(force):
    load = {} if force is None else {"load": parameters(force).load}
    plant = PlantParameters(full_order=FullCylinderParameters(), **load)
    result = track(Scenario(plant=plant, simulation=SimulationParameters(duration_s=20.0)))
    # e = |1 − A_i/Ā| |dx/dt| ω̂²/(λ² k/Φ) with k = β η, and e/r in the knee: 0.38 deg rms.
    smc, knee_rate = SlidingModeParameters(), 30.0 * 2.0 * math.pi * 0.1
    hydraulic = 4.0 * 1.72e9 * MEAN_AREA**2 / (smc.mass_estimate_kg * 41_233e-9)
    slope = smc.gain_ratio * smc.eta_m_s3 / smc.phi_m_s2
    delay = (AREA_1 - MEAN_AREA) / MEAN_AREA * hydraulic / (smc.lambda_per_s**2 * slope)
    # Measured 0.382, 0.386, 0.393: leakage and the encoder add to it.
    assert result.metrics.rms_error_deg == pytest.approx(delay * knee_rate / math.sqrt(2), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("force", "friction", "frequencies", "expected"),
    [
        (60.0, 0.0, (0.18, 0.19, 0.20, 0.21), 0.196),
        (-60.0, 0.0, (0.24, 0.255, 0.27, 0.285), 0.262),
        (0.0, 60.0, (0.20, 0.215, 0.23, 0.245), 0.2195),
    ],
    ids=["P_1 loaded", "P_2 loaded", "friction"],
)
def test_loaded_chamber_sets_the_bandwidth(force, friction, frequencies, expected):
    plant = PlantParameters(
        full_order=FullCylinderParameters(coulomb_friction_n=friction), load=parameters(force).load
    )
    response = sinestream(
        Scenario(plant=plant),
        SinestreamSettings(frequencies_hz=frequencies, transient_cycles=1, measured_cycles=2),
        trials=[{}],
    )
    # Expected: a kinematic follower of speeds Q/A_1 and Q/A_2. Measured: 0.1958, 0.2618 and
    # 0.2177 Hz; in the last, 0.2185 Hz without the pump's leakage, which slows both directions
    # against friction, and the loaded chamber must change over at each reversal.
    assert response.bandwidth_hz == pytest.approx(expected, abs=0.003)


# --------------------------------------------------------------------------------- bypass


def test_the_reduced_order_refuses_a_bypass_and_names_the_remedy(tmp_path):
    with pytest.raises(ParameterError, match=r"bypass: must be left out .*; add full_order: true"):
        PlantParameters(bypass=BypassParameters())
    file = tmp_path / "bypass.yaml"
    file.write_text(
        "plant: {full_order: true, bypass: {time_constant_s: 0.05}}\n", encoding="utf-8"
    )
    plant = load_scenario(file).plant
    assert plant.bypass == BypassParameters(time_constant_s=0.05)
    file.write_text("plant: {full_order: true, bypass: true}\n", encoding="utf-8")
    assert load_scenario(file).plant.bypass == BypassParameters()


def test_a_load_falls_through_an_open_bypass_at_a_known_speed(fixed_step):
    """V = (P_r (A_1 − A_2) − F_L) K/(A_1² + A_2²), without leakage and make-up."""
    plant = make_plant(
        parameters(60.0, makeup_conductance_m3_per_s_pa=0.0).changed(
            {"bypass": BypassParameters(time_constant_s=1e-3)}
        ),
        initial_knee_angle_rad=math.radians(40.0),
    )
    simulator = fixed_step(plant, "radau3", 1e-3)
    context = simulator.get_mutable_context()
    plant.GetInputPort("motor_speed_command").FixValue(context, [0.0])
    plant.GetInputPort("bypass").FixValue(context, [1.0])
    simulator.AdvanceTo(0.04)
    expected = (SWITCHING_N - 60.0) * 5e-10 / (AREA_1**2 + AREA_2**2)
    assert by_name(plant, "bypass_opening", context) == pytest.approx(1.0, abs=1e-9)
    assert by_name(plant, "rod_velocity", context) == pytest.approx(expected, rel=1e-3)
    assert expected == pytest.approx(-0.1436, abs=1e-3)


def test_the_command_of_a_bypass_is_an_input_of_the_loop():
    loop = make_closed_loop(Scenario(plant={"full_order": True, "bypass": True}), signals=())
    assert loop.HasInputPort("bypass")
    assert loop.HasOutputPort("bypass_opening")
    assert not make_closed_loop(Scenario(plant={"full_order": True}), signals=()).HasInputPort(
        "bypass"
    )
