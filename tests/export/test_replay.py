"""The exported controller in C, back to back with the compiled one, over 30 s of closed loop.

The tolerance in double is 1e-12 of full speed, in float 1 rpm. Two cases cannot meet it, for they
amplify the last bit of the knee angle, which the elementary functions of two libraries round each
in their way:

- A PID with integral action integrates it in a replay, where no loop corrects it. `BIAS_RAD` is the
  constant error of the angle that explains what 30 s make of it.
- Plain differences divide it by T²: two counts of 1/T² = 2.5e5 1/s² and the slope k/Φ of the law.
"""

import importlib
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from diagramc.c.vectors import recorded_vectors
from diagramc.equations.contexts import parameters_of, state_of
from diagramc.equations.tree import Node
from kneexo.export.firmware import loop_inputs
from kneexo.export.target import largest_step_s, make_target
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.uncertainty import UNCERTAIN_KNEE, UNCERTAINTY, draw, realize
from kneexo.simulation import simulate_compiled
from kneexo.studies.paper import PID_TUNED

RPM = 2.0 * math.pi / 60.0
FULL_SPEED = 5000.0 * RPM
DURATION_S = 30.0
TOLERANCES = {"double": 1e-12 * FULL_SPEED, "float": 1.0 * RPM}
BIAS_RAD = {"double": 1e-16, "float": 4.8e-7}
"""Half a bit of an angle near π/4 in double; a bit of 2π, which the angle is wrapped by, in float.
"""
DIFFERENCES = {"double": 5e-11 * FULL_SPEED, "float": 50.0 * RPM}

SCENARIOS = {
    "smc": Scenario(),
    "load": UNCERTAIN_KNEE,
    "pid": changed(Scenario(), {"controller": {"kind": "pid"}}),
    "pid_tuned": Scenario(controller=PID_TUNED),
    "difference": changed(Scenario(), {"estimator": {"kind": "difference"}}),
}
SAMPLES = 200
RMS_SHARE = 0.01


def largest_difference(exported, scenario, precision, duration_s=DURATION_S):
    diagram, source = exported.exported_source(scenario, "controller", precision)
    vectors = exported.replayed(scenario, diagram, source, duration_s)
    assert np.ptp(vectors.outputs) > 0.1 * FULL_SPEED  # it works
    return np.abs(exported.Replay(source)(vectors.inputs) - vectors.outputs).max()


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *(("smc", "double"), ("pid", "float")),
        *(
            pytest.param(name, precision, marks=pytest.mark.slow)
            for name, precision in (
                *(("smc", "float"), ("pid", "double")),
                *(("load", "double"), ("load", "float")),
            )
        ),
    ],
)
def test_c_gives_the_commands_of_the_compiled_controller(exported, name, precision):
    difference = largest_difference(exported, SCENARIOS[name], precision)
    assert difference <= TOLERANCES[precision]


@pytest.mark.parametrize("precision", ["double", "float"])
def test_c_gives_the_commands_of_the_users_controller(exported, backstepping, precision):
    assert largest_difference(exported, backstepping, precision) <= TOLERANCES[precision]


@pytest.mark.parametrize("precision", ["double", "float"])
def test_an_integral_adds_up_the_bias_of_the_angle_alone(exported, precision):
    scenario = SCENARIOS["pid_tuned"]
    _, source = exported.exported_source(scenario, "controller", precision)
    values = dict(zip(source.equations.parameters, source.parameters, strict=True))
    per_rate = values["controller/law.speed_gain_rad_per_m"] * PID_TUNED.moment_arm_m
    per_bias = per_rate * (PID_TUNED.integral_per_s2 * DURATION_S + PID_TUNED.proportional_per_s)
    difference = largest_difference(exported, scenario, precision)
    assert difference <= per_bias * BIAS_RAD[precision]


@pytest.mark.parametrize("precision", ["double", "float"])
def test_plain_differences_amplify_the_last_bit(exported, precision):
    difference = largest_difference(exported, SCENARIOS["difference"], precision)
    assert difference <= DIFFERENCES[precision]


@pytest.mark.slow(gate=0)
def test_parameters_of_the_uncertainty_set_go_into_a_single_build(exported):
    targets = {
        precision: exported.exported_source(
            UNCERTAIN_KNEE, "controller", precision, check_ranges=False
        )
        for precision in TOLERANCES
    }
    replays = {precision: exported.Replay(source) for precision, (_, source) in targets.items()}
    nominal, source = targets["double"]
    steps = round(DURATION_S / source.plan.schedule.tick_s)
    largest, kinds = dict.fromkeys(TOLERANCES, 0.0), set()
    for values in draw(UNCERTAINTY, SAMPLES, seed=2020):
        scenario = realize(UNCERTAIN_KNEE, UNCERTAINTY, values)
        sample = make_target(scenario, "controller", counts=True)
        root, context = Node(sample.diagram), sample.diagram.CreateDefaultContext()
        state = state_of(root, context)
        sampled = replace(source, parameters=parameters_of(root, context), state=state)
        inputs = loop_inputs(scenario, sample, sampled, steps)
        vectors = recorded_vectors(nominal.diagram, sampled, inputs)
        kinds.add(sampled.parameters.tobytes())
        for precision, (_, built) in targets.items():
            single = replace(built, parameters=sampled.parameters, state=state)
            commands = replays[precision](vectors.inputs, single)
            difference = np.abs(commands - vectors.outputs).max()
            largest[precision] = max(largest[precision], difference)
    print({precision: value / FULL_SPEED for precision, value in largest.items()})
    assert len(kinds) == SAMPLES
    assert all(largest[precision] <= TOLERANCES[precision] for precision in TOLERANCES), largest


@pytest.mark.parametrize(
    "name",
    ["smc", *(pytest.param(n, marks=pytest.mark.slow) for n in ("pid_tuned", "pid", "load"))],
)
def test_single_precision_tracks_as_well_as_double(exported, name):
    scenario = SCENARIOS[name]
    runs, rms = {}, {}
    for precision in ("double", "float"):
        _, source = exported.exported_source(scenario, "controller", precision)
        runs[precision] = exported.Loop(scenario, source).run(DURATION_S)
        error = runs[precision]["knee_angle_rad"] - runs[precision]["knee_reference_rad"]
        rms[precision] = math.sqrt(np.mean(error**2))
    assert rms["float"] == pytest.approx(rms["double"], rel=RMS_SHARE)
    commands = [run["motor_speed_command_rad_s"] for run in runs.values()]
    assert (commands[0] != commands[1]).mean() > 0.5  # they are two programs


def test_the_loop_in_c_is_the_compiled_loop(exported):
    scenario = SCENARIOS["smc"]
    diagram, source = exported.exported_source(scenario, "controller")
    run = exported.Loop(scenario, source).run(2.0)
    compiled = exported.replayed(scenario, diagram, source, 2.0)
    np.testing.assert_array_equal(run["encoder_count"][:1000], compiled.inputs[:, 0])
    np.testing.assert_allclose(
        run["motor_speed_command_rad_s"][:1000],
        compiled.outputs[:, 0],
        rtol=0.0,
        atol=TOLERANCES["double"],
    )


def test_compensated_sums_keep_the_time_of_an_hour(exported):
    hour_s = importlib.import_module("float_loop").hour_in_float()
    assert hour_s["compensated"] == pytest.approx(3600.0, abs=5e-4)  # a float has 2.4e-4 there
    assert abs(hour_s["plain"] - 3600.0) > 10.0


@pytest.mark.slow
def test_rows_of_the_table_have_their_units(exported, monkeypatch, capsys):
    float_loop = importlib.import_module("float_loop")
    scenario = changed(SCENARIOS["smc"], {"simulation.duration_s": 2.0})
    double, single, plain = float_loop.rows("SMC", scenario, 2.0)
    options = {"integrator": "rk4", "step_s": largest_step_s(scenario, "plant")}
    run = simulate_compiled(scenario, signals=("knee_angle", "knee_reference"), **options)
    error_deg = np.degrees(run["knee_angle_rad"] - run["knee_reference_rad"])
    assert double.rms_error_deg == pytest.approx(np.sqrt(np.mean(error_deg**2)), rel=1e-6)
    assert double.largest_error_deg == pytest.approx(np.abs(error_deg).max(), rel=1e-6)
    assert (double.counts, double.command_rpm) == (0, 0.0)
    commands = []
    for precision in TOLERANCES:
        _, source = exported.exported_source(scenario, "controller", precision)
        commands.append(exported.Loop(scenario, source).run(2.0)["motor_speed_command_rad_s"])
    assert single.command_rpm == pytest.approx(np.abs(commands[0] - commands[1]).max() / RPM)
    difference = largest_difference(exported, scenario, "float", 2.0)
    assert single.replay_rpm == pytest.approx(difference / RPM)
    assert plain.replay_rpm != single.replay_rpm
    monkeypatch.setattr(float_loop, "SCENARIOS", {"SMC": scenario})
    monkeypatch.setattr(float_loop, "rows", lambda *_: [single])
    float_loop.main(["--duration", "2"])
    line = capsys.readouterr().out.splitlines()[2]
    cells = [float(text) for text in re.findall(r"[\d.e+-]+", line.partition("float | ")[2])]
    assert cells == pytest.approx(single[2:], rel=0.01, abs=1e-4)
