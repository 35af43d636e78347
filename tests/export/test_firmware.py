"""C of a scenario: vectors against the closed loop, and the command line."""

import json
import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest

import diagramc
import kneexo
from diagramc.c import build as c_build, export as c_export
from kneexo.analysis import simulate
from kneexo.command_line.main import main
from kneexo.errors import ParameterError
from kneexo.export import firmware
from kneexo.export.firmware import loop_inputs, make_firmware, make_sil
from kneexo.export.target import largest_step_s, make_target
from kneexo.geometry.rod_polynomial import completed
from kneexo.parameters import Scenario
from kneexo.parameters.presets import with_preset
from kneexo.parameters.scenario_file import load_scenario
from kneexo.simulation import simulate_compiled
from kneexo.studies.paper import PID_TUNED

FIRMWARE_MD = Path(__file__).parents[2] / "docs" / "firmware.md"
SHORT = {"simulation": {"duration_s": 0.4}}
needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs the C compiler gcc")


def scenario_of(**fields):
    return Scenario.model_validate(SHORT | fields)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"controller": {"kind": "pid"}},
        {"estimator": {"kind": "exact"}, "bus": {"latency_samples": 0}},
    ],
)
def test_vectors_of_a_controller_are_the_commands_of_the_loop(fields):
    scenario = scenario_of(**fields)
    source, vectors = make_firmware(scenario, vectors_s=0.3)
    run = simulate(scenario)
    assert vectors.outputs.shape == (150, 1)
    np.testing.assert_allclose(
        vectors.outputs[:, 0], run["motor_speed_command_rad_s"][1:151], rtol=0, atol=1e-9
    )
    names = [field.name for field in source.plan.inputs]
    counts = vectors.inputs[:, names.index("encoder_count")]
    np.testing.assert_allclose(counts * 2 * np.pi / 4096, run["encoder_reading_rad"][:150])
    np.testing.assert_array_equal(counts, np.round(counts))
    for name in names[1:5]:
        np.testing.assert_array_equal(vectors.inputs[:, names.index(name)], run[name][:150])


@pytest.mark.parametrize("what", ["plant", "loop"])
def test_vectors_of_plant_and_loop_follow_the_loop(what):
    scenario = scenario_of().with_steps(largest_step_s(Scenario(), "loop"))
    source, vectors = make_firmware(scenario, what, vectors_s=0.3)
    run = simulate(scenario)
    for column, name in enumerate(field.name for field in source.plan.outputs):
        if what == "plant" and name in ("encoder_reading_rad", "encoder_count"):
            continue  # a count may differ
        expected = run[name][1:151]
        atol = 1e-12 if what == "loop" else 1e-7 * np.abs(expected).max()
        np.testing.assert_allclose(
            vectors.outputs[:, column], expected, rtol=0, atol=atol, err_msg=name
        )


PLANTS = {
    "default": {},
    "loaded": {"load": {"kind": "knee"}},
    "full order": {"full_order": {}},
    "friction": {"full_order": {"coulomb_friction_n": 40.0}},
    "loaded full order": {"load": {"kind": "knee"}, "full_order": {}},
}


QUICK = ("default",)


@pytest.mark.parametrize("what", ["plant", pytest.param("loop", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(plant, id=name, marks=() if name in QUICK else pytest.mark.slow)
        for name, plant in PLANTS.items()
    ],
)
def test_c_in_its_own_steps_agrees_with_exact_hold(exported, plant, what):
    scenario = scenario_of(plant=plant, simulation={"duration_s": 2.0, "tolerance": 1e-10})
    source, vectors = make_firmware(scenario, what, vectors_s=1.5)
    outputs = exported.Replay(source)(vectors.inputs)
    run = simulate_compiled(scenario, tolerance=1e-10)
    names = [field.name for field in source.plan.outputs]
    for name, share in {
        "rod_extension_m": 1e-8,
        "knee_angle_rad": 1e-8,
        "load_pressure_pa": 1e-3,
    }.items():
        expected = run[name][1:751]
        difference = np.abs(outputs[:, names.index(name)] - expected).max()
        assert difference <= share * np.ptp(expected), name


@pytest.mark.parametrize("preset", ["leg", pytest.param("wearer", marks=pytest.mark.slow)])
def test_a_stiff_plant_in_c_agrees_with_exact_hold(exported, preset):
    """By the Rosenbrock method with its own substeps: 1e-6 of the stroke, 1e-3 of the pressure."""
    scenario = Scenario.model_validate(with_preset(preset, {"simulation": {"duration_s": 1.0}}))
    source, vectors = make_firmware(
        scenario, "plant", integrator="rosenbrock", outputs=("rod_extension", "load_pressure")
    )
    outputs = exported.Replay(source)(vectors.inputs)
    errors = np.abs(outputs - vectors.outputs).max(axis=0)
    assert errors[0] <= 1e-6 * scenario.plant.cylinder.stroke_m
    assert errors[1] <= 1e-3 * np.ptp(vectors.outputs[:, 1])


@pytest.mark.slow
def test_a_controller_in_c_takes_a_sampled_reference(tmp_path, no_compiler):
    options = ["export", "c", "--out", str(tmp_path / "out"), "--set", "reference=gait"]
    assert main([*options, "--what", "controller", "--vectors-s", "0.1"]) == 0


WEARER = {
    "plant": {"load": {"kind": "knee", "inertia_kg_m2": 0.064}},
    "wearer": {"kind": "leg", "motion": "active", "cuff": {"slip_torque_n_m": 0.1}},
    "controller": {"kind": "torque", "mode": "impedance"},
    "load_cell": {"noise_n": 2.0, "seed": 5, "dropout_start_s": 0.101, "dropout_s": 0.03},
}


@pytest.mark.slow
def test_a_loop_with_a_wearer_in_c_is_the_compiled_loop(exported):
    scenario = scenario_of(**WEARER).with_steps(largest_step_s(scenario_of(**WEARER), "loop"))
    source, vectors = make_firmware(scenario, "loop", vectors_s=0.3)
    outputs, run = exported.Replay(source)(vectors.inputs), simulate(scenario)
    assert np.ptp(run["measured_force_n"]) > 4.0
    assert run["measured_force_age_s"].max() == pytest.approx(0.03)
    for column, name in enumerate(field.name for field in source.plan.outputs):
        scale = np.abs(run[name]).max()
        # Rounding, amplified by the gain on the differences of the observer, 1/T = 500 1/s.
        np.testing.assert_allclose(
            outputs[:, column], run[name][1:151], rtol=0, atol=1e-9 * scale, err_msg=name
        )


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_torque_controller_in_c_is_that_of_the_loop(exported, precision):
    scenario = scenario_of(**WEARER)
    source, vectors = make_firmware(scenario, "controller", vectors_s=0.3, precision=precision)
    assert [field.name for field in source.plan.inputs][-2:] == [
        "measured_force_n",
        "measured_force_age_s",
    ]
    command = simulate_compiled(scenario)["motor_speed_command_rad_s"][1:151]
    outputs = exported.Replay(source)(vectors.inputs)[:, 0]
    # In float, 24 bits of an angle of 1 rad are 6e-8 rad, 3e-5 rad/s of the estimated rate and
    # 0.03 rad/s of the motor.
    atol = 1e-9 if precision == "double" else 1e-3
    np.testing.assert_allclose(outputs, command, rtol=0, atol=atol * np.abs(command).max())


def test_a_loop_in_c_takes_no_table_of_a_moment():
    wearer = {"kind": "leg", "moment": {"times_s": (0, 1), "moments_n_m": (0, 9)}}
    with pytest.raises(
        ParameterError, match=r"^wearer\.moment: a loop in C .* or the loop as FMU$"
    ):
        make_firmware(scenario_of(plant=WEARER["plant"], wearer=wearer), "loop")


@pytest.mark.slow
def test_what_comes_from_outside_is_zero():
    scenario = scenario_of(plant={"load": {"kind": "knee"}})
    exported = make_target(scenario, "plant")
    source, vectors = make_firmware(scenario, "plant", vectors_s=0.1)
    names = [field.name for field in source.plan.inputs]
    assert names == ["motor_speed_command_rad_s", "disturbance_force_n", "knee_torque_n_m"]
    assert not vectors.inputs[:, 1:].any()
    assert vectors.inputs[:, 0].any()
    np.testing.assert_array_equal(loop_inputs(scenario, exported, source, 50), vectors.inputs)


def test_vectors_are_as_long_as_asked_or_as_the_run():
    assert len(make_firmware(scenario_of())[1].inputs) == 200
    assert len(make_firmware(Scenario())[1].inputs) == 1000
    for wrong in (0.001, 0.5, float("nan")):
        with pytest.raises(ParameterError, match=r"vectors_s = .* s: must be 0.002 … 0.4 s"):
            make_firmware(scenario_of(), vectors_s=wrong)


def test_a_duration_below_a_sample_is_refused():
    scenario = Scenario(simulation={"duration_s": 0.001})
    for vectors_s in (None, 0.002):
        with pytest.raises(ParameterError, match=r"duration_s = 0.001 s: must be at least 0.002 s"):
            make_firmware(scenario, vectors_s=vectors_s)


# --------------------------------------------------------------------------- command line


@pytest.fixture
def short(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text("simulation: {duration_s: 0.4}\n")
    return str(path)


@needs_compiler
def test_export_c_prints_what_it_measured(tmp_path, short, capsys, no_targets):
    out = tmp_path / "out"
    options = ["export", "c", short, "--out", str(out), "--precision", "float"]
    assert main([*options, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    source, _ = make_firmware(scenario_of(), precision="float")
    assert result["operations"] == dict(source.operations)
    assert result["state_bytes"] == source.state_bytes
    assert result["replay"]["passed"]
    difference = result["replay"]["difference"]["motor_speed_command_rad_s"]
    assert 0.0 < difference < 0.1
    assert result["scenario"]["simulation"]["duration_s"] == 0.4
    assert main(options) == 0
    text = capsys.readouterr().out
    assert f"controller in float precision: {out}" in text
    assert f"{source.operations.total()} operations a step" in text
    assert f"{source.state_bytes} bytes of state" in text
    assert f"difference {difference:.3g} (largest value" in text
    assert (out / "controller.c").exists()


def test_export_c_prints_flash_and_stack_in_bytes(tmp_path, short, capsys, monkeypatch):
    replayed = c_build.Replay({"u_rad_s": 2.5e-10}, {"u_rad_s": 523.6}, passed=True)
    sizes = {"Cortex-M7": c_build.CodeSize(flash=2040, stack=96)}
    measurement = c_export.Measurement({"*": 3}, 24, replayed, sizes, {"power": "no meter"})
    monkeypatch.setattr(firmware, "export_firmware", lambda *_, **__: measurement)
    assert main(["export", "c", short, "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  3 operations a step",
        "  24 bytes of state",
        "  u_rad_s: difference 2.5e-10 (largest value 523.6)",
        "  Cortex-M7: 2040 bytes of flash, 96 bytes of stack",
        "  power not measured: no meter",
    ]


def test_export_c_says_what_was_not_measured(tmp_path, short, capsys, monkeypatch):
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "cc").write_text("#!/bin/sh\necho 'error: no licence' >&2\nexit 1\n")
    (tools / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", str(tools))
    options = ["export", "c", short, "--out", str(tmp_path / "out"), "--vectors-s", "0.01"]
    assert main(options) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == [
        "  differences not measured: cc: error: no licence",
        "  flash and stack not measured: this machine has no arm-none-eabi-gcc",
    ]


@pytest.mark.parametrize(
    "options",
    [
        {"integrator": "rosenbrock", "tolerance": 1e-6},
        pytest.param({"step_s": 5e-4}, marks=pytest.mark.slow),
        pytest.param({"outputs": ("load_pressure", "icr")}, marks=pytest.mark.slow),
    ],
    ids=["integrator", "step", "outputs"],
)
def test_options_of_the_command_line_are_those_of_the_code(tmp_path, short, no_compiler, options):
    words, out = ["--what", "plant", "--vectors-s", "0.01"], tmp_path / "out"
    for name, value in options.items():
        words += [f"--{name.replace('_', '-')}", *map(str, value if name == "outputs" else [value])]
    assert main(["export", "c", short, "--out", str(out), *words]) == 0
    code = (out / "plant.c").read_text()
    chosen, default = (
        make_firmware(scenario_of(), "plant", vectors_s=0.01, **more)[0].files()["plant.c"]
        for more in (options, {})
    )
    assert code == chosen != default
    told = "by the tolerance 1e-06, at most 1000 in a step" in (out / "README.md").read_text()
    assert told == ("tolerance" in options)


def test_the_export_has_the_scenario_that_it_came_from(tmp_path, short, capsys, no_compiler):
    out = tmp_path / "out"
    options = ["export", "c", short, "--out", str(out), "--vectors-s", "0.01"]
    assert main([*options, "--set", "controller.phi_m_s2=1.5"]) == 0
    scenario = load_scenario(out / "scenario.yaml")
    assert scenario == completed(Scenario(**SHORT, controller={"phi_m_s2": 1.5}))
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["origin"] == "scenario.yaml"
    assert manifest["tool"] == f"kneexo {kneexo.__version__}, diagramc {diagramc.__version__}"
    source, _ = make_firmware(scenario, vectors_s=0.01)
    assert source.files()["controller.c"] == (out / "controller.c").read_text()


@pytest.mark.slow
def test_outputs_that_nobody_asks_for_are_not_computed():
    ports = ["load_pressure", "icr"]
    chosen, vectors = make_firmware(scenario_of(), "plant", outputs=ports, vectors_s=0.1)
    whole, all_vectors = make_firmware(scenario_of(), "plant", vectors_s=0.1)
    columns = [[f.port for f in whole.plan.outputs].index(port) for port in ports]
    columns.append(columns[1] + 1)  # the instantaneous centre has two coordinates
    np.testing.assert_array_equal(vectors.outputs, all_vectors.outputs[:, columns])
    assert chosen.operations.total() < whole.operations.total()
    assert "out->knee_angle_rad" not in chosen.files()["plant.c"]


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    "values",
    [
        [],
        ["encoder.quantized=false"],
        ["controller.kind=pid", "plant.load.kind=knee"],
        ["reference=gait", "estimator.kind=difference"],
    ],
)
def test_controller_and_plant_in_c_are_the_compiled_loop(
    tmp_path, short, capsys, no_targets, values
):
    out = tmp_path / "out"
    options = [word for value in values for word in ("--set", value)]
    assert main(["export", "sil", short, "--out", str(out), *options, "--json"]) == 0
    printed = capsys.readouterr()
    assert "the replay differs" not in printed.err
    replay = json.loads(printed.out)["replay"]
    assert replay["passed"]
    assert replay["largest"]["motor_speed_command_rad_s"] > 10.0
    # The compiled loop, apart from its test vectors. Without quantizer the law amplifies a
    # difference between integrators to 1e-9, so the vectors must come from the same steps of RK4.
    scenario = load_scenario(out / "plant" / "scenario.yaml")
    run = simulate_compiled(scenario.with_steps(largest_step_s(scenario, "plant")))
    largest = np.abs(run["knee_angle_rad"][1:201]).max()
    assert replay["largest"]["knee_angle_rad"] == pytest.approx(largest, rel=1e-5)  # six digits
    for name, difference in replay["difference"].items():
        assert difference <= 1e-10 * replay["largest"][name], name


def test_a_loop_with_a_push_is_refused():
    pushed = Scenario.model_validate({"plant": {"load": "knee"}, "push": {}})
    with pytest.raises(ParameterError, match=r"^push: neither controller nor plant contains"):
        make_sil(pushed)


TWO_C = """
#include "left.h"
#include "right.h"
#include "left_vectors.h"
#include "right_vectors.h"
#include <math.h>

int main(void)
{
    left_state_t left;
    right_state_t right;
    int wrong = (left_init(&left, &left_params, &left_vectors[0].inputs) != LEFT_OK)
        || (right_init(&right, &right_params, &right_vectors[0].inputs) != RIGHT_OK);

    for (uint32_t k = 0U; k < LEFT_VECTORS; k++) {
        left_outputs_t a;
        right_outputs_t b;

        wrong += left_step(&left_params, &left, &left_vectors[k].inputs, &a) != LEFT_OK;
        wrong += right_step(&right_params, &right, &right_vectors[k].inputs, &b) != RIGHT_OK;
        wrong += !(fabs(a.motor_speed_command_rad_s
            - left_vectors[k].outputs.motor_speed_command_rad_s) < 1e-6);
        wrong += !(fabs(b.motor_speed_command_rad_s
            - right_vectors[k].outputs.motor_speed_command_rad_s) < 1e-6);
    }
    return (wrong == 0) && (LEFT_VECTORS == RIGHT_VECTORS) ? 0 : 1;
}
"""


def test_two_controllers_link_into_one_program(tmp_path, tool):
    """An SMC and a PID, whose commands differ by far more than the tolerance of 1e-6 rad/s."""
    compiler, commands = tool("gcc"), []
    for name, kind in (("left", "smc"), ("right", "pid")):
        scenario = scenario_of(controller={"kind": kind})
        source, vectors = make_firmware(scenario, name=name, vectors_s=0.1)
        commands.append(vectors.outputs)
        for file, text in c_export.files_of(source, vectors).items():
            if not file.endswith("_test.c"):
                (tmp_path / file).write_text(text)
    assert np.abs(commands[0] - commands[1]).max() > 0.1
    (tmp_path / "two.c").write_text(TWO_C)
    files = sorted(path.name for path in tmp_path.glob("*.c"))
    flags = (*c_build.FLAGS, "-Wall", "-Wextra", "-Werror")
    command = [compiler, *flags, *files, "-o", "two", "-lm"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (built.returncode, built.stderr) == (0, "")
    assert subprocess.run([tmp_path / "two"]).returncode == 0


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(("precision", "fails"), [("float", True), ("double", False)])
def test_a_replay_that_differs_is_reported(tmp_path, capsys, precision, fails, no_targets):
    """In float the loop reads another count sooner or later."""
    options = ["--what", "loop", "--precision", precision, "--json"]
    assert main(["export", "c", "--out", str(tmp_path / "out"), *options]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["replay"]["passed"] is not fails
    line = "loop in float precision: the replay differs by more than the harness allows; make"
    assert (line in printed.err) is fails
    assert ("the replay differs" in printed.err) is fails


REFUSED = {
    "c --what plant --step-s 0": "step_s = 0 s: must be 1e-07 … 1 s",
    "c --what plant --tolerance 1e-6": "tolerance = 1e-06: integrator = 'rk4' has none",
    "c --name 2_legs": "name = '2_legs': must be a C identifier of at most 31 letters",
    "c --outputs speed": "output 'speed' is unknown; known: motor_speed_command",
    "c --vectors-s 9": "vectors_s = 9 s: must be 0.002 … 0.4 s",
    "c --set plant.cylinder.mass_kg=-1": "plant.cylinder.mass_kg",
    "c --what loop --set reference=gait": "must not be sampled; export plant and controller",
    "sil --set bus.latency_samples=2": "bus.latency_samples = 2: neither controller nor plant cont",
    "sil --set estimator.kind=exact": "estimator.kind = 'exact': no sensor measures the state of t",
    "sil --set controller=torque": "controller.kind = 'torque': the plant contains neither wearer ",
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_exported_is_one_line_and_leaves_nothing_behind(
    tmp_path, short, capsys, words
):
    kind, *options = words.split()
    out = tmp_path / "out"
    assert main(["export", kind, short, "--out", str(out), *options]) == 2
    error = capsys.readouterr().err
    assert REFUSED[words] in error
    assert error.count("\n") == 1
    assert not out.exists()


@needs_compiler
def test_a_controller_of_the_user_is_exported_too(tmp_path, capsys, monkeypatch, no_targets):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "examples")
    law = "{kind: law, function: backstepping:make, values: {k_1: 20}, sample_time_s: 0.001}"
    out = tmp_path / "out"
    options = ["--out", str(out), "--set", f"controller={law}", "--vectors-s", "0.2"]
    assert main(["export", "c", *options, "--json"]) == 0
    assert 'function: "backstepping.py:make"' in (out / "scenario.yaml").read_text()
    assert load_scenario(out / "scenario.yaml").with_loaded_law().controller.values["k_1"] == 20.0
    result = json.loads(capsys.readouterr().out)
    assert result["replay"]["difference"]["motor_speed_command_rad_s"] < 1e-12 * 523.6
    assert "timer interrupt at 1000 Hz" in (out / "README.md").read_text()


@pytest.mark.slow
def test_the_documented_command_exports_the_users_controller_of_its_directory(tmp_path):
    (command,) = re.findall(r"```sh\n(cd examples\n.*?)```", FIRMWARE_MD.read_text(), re.DOTALL)
    shutil.copytree(FIRMWARE_MD.parents[1] / "examples", tmp_path / "examples")
    scripts = sysconfig.get_path("scripts")
    path = f"{scripts}{os.pathsep}{os.environ['PATH']}"
    ran = subprocess.run(
        ["sh", "-e", "-c", command],
        cwd=tmp_path,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "examples" / "firmware" / "controller.c").exists()


@needs_compiler
@pytest.mark.slow
def test_a_table_takes_the_drift_from_a_pid_in_float():
    """The knee angle of a count is rounded once: the integral no longer adds up its error."""
    scenario = Scenario(controller=PID_TUNED)
    differences = []
    for look_up in (False, True):
        options = {"precision": "float", "look_up": look_up, "vectors_s": 30.0}
        _, measured = c_export.exported(*make_firmware(scenario, **options))
        (difference,) = measured.replay.difference.values()
        differences.append(difference * 60.0 / (2.0 * np.pi))
    computed_rpm, looked_up_rpm = differences
    assert looked_up_rpm <= 1.0
    assert computed_rpm > 10.0  # what the table is for


def test_a_controller_has_no_states_for_the_rosenbrock_method():
    files = [
        make_firmware(Scenario(), integrator=name, vectors_s=0.01)[0].files()
        for name in ("rk4", "rosenbrock")
    ]
    assert files[0] == files[1]


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["leg", "wearer"])
def test_a_loop_in_c_takes_the_substeps_of_simulate(exported, preset):
    """By the Rosenbrock method with one tolerance; other substeps would differ by 1e-7."""
    steps = {"integrator": "rosenbrock", "tolerance": 1e-6, "duration_s": 1.0}
    scenario = Scenario.model_validate(with_preset(preset, {"simulation": steps}))
    options = {"integrator": "rosenbrock", "tolerance": 1e-6}
    outputs = ("rod_extension", "load_pressure")
    source, vectors = make_firmware(scenario, "loop", outputs=outputs, **options)
    replayed = exported.Replay(source)(vectors.inputs)
    run = simulate(scenario, signals=outputs)
    for column, name in enumerate(("rod_extension_m", "load_pressure_pa")):
        expected = run[name][-len(replayed) :]
        atol = 1e-11 * np.abs(expected).max()
        np.testing.assert_allclose(replayed[:, column], expected, rtol=0, atol=atol)
