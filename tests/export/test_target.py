"""What is exported of a scenario."""

import numpy as np
import pytest

from kneexo.analysis import linearize_plant
from kneexo.diagrams import make_closed_loop, make_plant
from kneexo.errors import ParameterError
from kneexo.export.firmware import make_firmware
from kneexo.export.target import WHAT, count_range, largest_step_s, make_target, require_step
from kneexo.geometry import linkage
from kneexo.parameters import MotorParameters, Scenario

LOADED = {"plant": {"load": {"kind": "knee"}}}


def scenario_of(**fields):
    return Scenario.model_validate(fields)


def ports(diagram):
    inputs = [diagram.get_input_port(i).get_name() for i in range(diagram.num_input_ports())]
    outputs = [diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())]
    return inputs, outputs


def test_a_controller_reads_counts_or_the_angle():
    counts, angle = (make_target(Scenario(), "controller", counts=flag) for flag in (True, False))
    assert counts.inputs == ("encoder_count", "knee_reference")
    assert set(angle.inputs) == {"encoder_reading", "knee_reference"}
    assert counts.interface.integers == {"encoder_count"}
    assert not angle.interface.integers
    assert counts.outputs == angle.outputs == ("motor_speed_command",)
    assert counts.tick_s is None
    # One count is a 4096th of a turn.
    diagram = counts.diagram
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("encoder_count").FixValue(context, [3.0])
    gain = diagram.GetSubsystemByName("encoder_count")
    value = gain.get_output_port().Eval(gain.GetMyContextFromRoot(context))
    np.testing.assert_allclose(value, [3.0 * 2.0 * np.pi / 4096.0], rtol=1e-15)


def test_an_encoder_that_is_not_quantized_has_no_counts():
    exact = make_target(scenario_of(encoder={"quantized": False}), "controller", counts=True)
    assert set(exact.inputs) == {"encoder_reading", "knee_reference"}
    assert set(exact.interface.ranges) == {"knee_reference_rad"}


def test_exact_states_are_an_input():
    exact = make_target(scenario_of(estimator={"kind": "exact"}), "controller", counts=True)
    assert exact.inputs == ("encoder_count", "knee_reference", "rod_state")


def test_fields_of_the_rod_state_follow_its_port():
    exported = make_target(scenario_of(estimator={"kind": "exact"}), "controller")
    plant = make_plant()
    context = plant.CreateDefaultContext()
    state = np.array([0.3, 0.12, 0.034, 0.5])  # motor speed, extension, velocity, pressure
    context.SetContinuousState(state)
    plant.GetInputPort("motor_speed_command").FixValue(context, [0.0])
    rates = plant.EvalTimeDerivatives(context).CopyToVector()
    values = plant.GetOutputPort("rod_state").Eval(context)
    expected = {
        "rod_extension_m": plant.GetOutputPort("rod_extension").Eval(context)[0],
        "rod_velocity_m_s": plant.GetOutputPort("rod_velocity").Eval(context)[0],
        "rod_acceleration_m_s2": rates[2],
    }
    assert len(set(expected.values())) == 3
    assert dict(zip(exported.interface.fields["rod_state"], values, strict=True)) == expected


@pytest.mark.parametrize("fields", [{}, {"encoder": {"mounting_error_rad": 0.05}}])
def test_counts_are_taken_where_the_knee_may_be(fields):
    scenario = scenario_of(**fields)
    low, high = count_range(scenario)
    knee = scenario.plant.knee
    resolution = 2.0 * np.pi / 4096.0
    error = scenario.encoder.mounting_error_rad / resolution
    stops = np.radians([knee.flexion_min_deg, knee.flexion_max_deg])
    counts = linkage.encoder_angle(scenario.plant.linkage, stops) / resolution
    assert low < counts.min() - error
    assert high > counts.max() + error
    # No more than the overshoot of 5 deg at some 2 counts in a degree of four-bar and encoder.
    assert low > counts.min() - error - 100
    assert high < counts.max() + error + 100


def test_the_plant_has_its_encoder_and_all_signals_of_the_plant():
    exported = make_target(scenario_of(**LOADED), "plant")
    assert exported.inputs == ("motor_speed_command", "disturbance_force", "knee_torque")
    assert exported.outputs[:2] == ("encoder_reading", "encoder_count")
    assert {"knee_angle", "rod_extension", "load_pressure"} <= set(exported.outputs)
    assert ports(exported.diagram) == (list(exported.inputs), list(exported.outputs))
    assert exported.tick_s == 0.002
    assert "encoder_reading_rad" in exported.interface.fields["encoder_reading"]
    exact = make_target(scenario_of(encoder={"quantized": False}), "plant")
    assert "encoder_count" not in exact.outputs


def test_the_loop_is_the_closed_loop():
    exported = make_target(Scenario(), "loop")
    loop = make_closed_loop(Scenario(), signals=())
    assert ports(exported.diagram) == ports(loop)
    sampled = scenario_of(
        reference={"kind": "samples", "times_s": [0, 1, 2], "angles_deg": [10, 20, 10]}
    )
    assert "knee_reference" in make_target(sampled, "loop").inputs


def test_a_reference_is_taken_within_the_range_of_motion_and_its_overshoot():
    scenario = scenario_of(plant={"knee": {"flexion_max_deg": 80.0, "overshoot_deg": 0.25}})
    exported = make_target(scenario, "controller", counts=True)
    (field, *_) = exported.interface.fields["knee_reference"]
    assert np.degrees(exported.interface.ranges[field]) == pytest.approx([-0.25, 80.25])


@pytest.mark.parametrize("what", WHAT)
def test_every_port_has_names_in_c_that_end_in_a_unit(what):
    exported = make_target(scenario_of(**LOADED), what)
    fields = exported.interface.fields
    units = ("_rad", "_rad_s", "_rad_s2", "_rad_s3", "_m", "_m_s", "_m_s2", "_m_s3", "_m3_s")
    for port in {*exported.inputs, *exported.outputs} - {"encoder_count"}:
        for name in fields[port]:
            assert name.endswith((*units, "_n", "_n_m", "_pa", "_w"))


@pytest.mark.parametrize(
    "plant",
    [
        {},
        pytest.param({"load": {"kind": "knee"}}, marks=pytest.mark.slow),
        pytest.param({"full_order": {"coulomb_friction_n": 40.0}}, marks=pytest.mark.slow),
    ],
)
def test_a_step_follows_the_fastest_pole_at_the_start(plant):
    scenario = scenario_of(plant=plant)
    fastest_per_s = np.abs(linearize_plant(scenario.plant, knee_angle_deg=10.0).poles).max()
    for what in ("plant", "loop"):
        assert largest_step_s(scenario, what) == pytest.approx(0.2 / fastest_per_s, rel=1e-3)


def test_a_step_follows_the_shorted_motor():
    """The windings brake with the rate k_t²/(R J), here faster than the oil oscillates."""
    motor = MotorParameters(inertia_kg_m2=2e-7)
    per_s = motor.torque_constant_n_m_per_a**2 / (motor.resistance_ohm * motor.inertia_kg_m2)
    braked = scenario_of(plant={"motor": motor}, protection={"safe_state": "dynamic_brake"})
    for what in ("plant", "loop"):
        assert largest_step_s(braked, what) == pytest.approx(0.2 / per_s, rel=0.1)
    free = braked.changed({"protection.safe_state": "torque_off"})
    assert largest_step_s(free, "loop") > 5.0 * largest_step_s(braked, "loop")
    source, _ = make_firmware(braked, "loop", vectors_s=0.004)
    assert source.plan.schedule.largest_step_s == largest_step_s(braked, "loop")


def test_a_controller_commands_zero_when_it_fails():
    zero, plain = (
        {"motor_speed_command_rad_s": 0.0},
        make_target(Scenario(), "controller").interface,
    )
    assert (plain.failed_outputs, plain.accepts_inputs) == (zero, False)
    for safe_state, state, release in (("zero_speed", 3, 0.0), ("dynamic_brake", 4, 1.0)):
        scenario = scenario_of(plant={"motor": {}}, protection={"safe_state": safe_state})
        interface = make_target(scenario, "controller").interface
        failed = zero | {"safety_state": state, "release": release}
        assert (interface.failed_outputs, interface.accepts_inputs) == (failed, True)
    for what in ("plant", "loop"):
        interface = make_target(scenario, what).interface
        assert (interface.failed_outputs, interface.accepts_inputs) == ({}, False)


def test_a_step_is_at_most_that_of_a_run_and_may_be_chosen():
    soft = scenario_of(plant={"cylinder": {"bulk_modulus_pa": 1e7}})
    assert largest_step_s(soft, "plant") == 2e-4
    assert largest_step_s(Scenario(), "controller") == 2e-4
    require_step(None)
    require_step(1e-3)
    for wrong in (0.0, -1e-4, 2.0, float("nan"), float("inf")):
        with pytest.raises(ParameterError, match=r"step_s = .* s: must be 1e-07 … 1 s"):
            require_step(wrong)


@pytest.mark.parametrize("fields", [{}, {"encoder": {"phase_rad": 0.3}}])
def test_a_count_falls_with_flexion_from_its_zero_at_the_phase(fields):
    """As docs/firmware.md tells it."""
    scenario = scenario_of(**fields)
    counts = []
    for degrees in (10.0, 90.0):
        posture = {"kind": "sine", "mean_deg": degrees, "amplitude_deg": 0.0}
        start = scenario_of(**fields, reference=posture)
        loop = make_closed_loop(start, signals=())
        reading = loop.GetOutputPort("encoder_reading").Eval(loop.CreateDefaultContext())[0]
        counts.append(reading / start.encoder.resolution_rad)
    shift = scenario.encoder.phase_rad * 4096.0 / (2.0 * np.pi)
    assert counts == pytest.approx([731.4 - shift, -54.0 - shift], abs=1.0)


def test_bad_targets_are_one_line():
    with pytest.raises(ParameterError, match="what = 'motor': must be one of controller, plant"):
        make_target(Scenario(), "motor")
    continuous = scenario_of(
        controller={"kind": "smc", "continuous": True}, estimator={"kind": "exact"}
    )
    with pytest.raises(ParameterError, match=r"controller.continuous = true: has no sample time"):
        make_target(continuous, "controller")
