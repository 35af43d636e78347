"""What README.md shows must run."""

import math
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kneexo.analysis import interaction_metrics, linearize_plant, simulate
from kneexo.command_line.main import main
from kneexo.parameters import Cia402Parameters, Scenario
from kneexo.parameters.device.safety_states import SAFE_STATES
from kneexo.parameters.scenario_file import load_scenario

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(language, text=README):
    code, *_ = re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return code


@pytest.mark.parametrize("command", re.findall(r"^\| `kneexo (\w+)", README, re.MULTILINE))
def test_every_command_of_the_table_has_help(command, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    assert f"usage: kneexo {command}" in capsys.readouterr().out


def test_the_readme_is_short():
    assert len(README.split()) <= 600


@pytest.mark.slow
def test_the_example_for_drake_flexes_the_knee_and_has_the_poles_of_the_plant(tmp_path, capsys):
    code = block("python", README.partition("## In Drake")[2])
    angle_deg, poles = output_of(code, tmp_path, capsys).split("\n", 1)
    assert 10.0 < float(angle_deg) < 20.0
    expected = linearize_plant(Scenario().plant, knee_angle_deg=10.0).poles
    found = [complex(number) for number in re.findall(r"[-+.\de]+j", re.sub(r"\s+\+", "+", poles))]
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected), rtol=1e-6)


@pytest.mark.slow
def test_the_python_example_prints_the_verdict_of_the_readme_in_an_empty_directory(tmp_path):
    code = "import matplotlib; matplotlib.use('Agg')\n" + block("python")
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout == block("text")
    assert (tmp_path / "tracking.png").stat().st_size > 10_000


def output_of(code, tmp_path, capsys):
    """What an example prints."""
    path = tmp_path / "example.py"
    path.write_text(code, encoding="utf-8")
    runpy.run_path(str(path))
    return capsys.readouterr().out


@pytest.mark.slow
def test_the_example_of_the_engine_runs():
    code = block("python", (ROOT / "docs/engine.md").read_text(encoding="utf-8"))
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    records, spread, log = done.stdout.splitlines()
    assert (records, log) == ("(15001, 1)", "(1, 501)")
    assert 0.0 < float(spread) < 1e-3


@pytest.mark.slow
def test_the_example_of_the_live_view_runs(tmp_path):
    code = block("python", (ROOT / "docs/view.md").read_text(encoding="utf-8"))
    command = [sys.executable, "-c", code.replace("AdvanceTo(1.0)", "AdvanceTo(0.02)")]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    assert "set_animation" in (tmp_path / "knees.html").read_text("utf-8")


DRIVE = (ROOT / "docs/drive.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_table_of_the_drive_is_what_its_example_prints(tables):
    command = [sys.executable, "-c", block("python", DRIVE)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    (printed,) = tables(done.stdout)
    shown = next(table[1:] for table in tables(DRIVE) if table[0][0] == "controller")
    assert [row[:3] for row in shown] == [row[:3] for row in printed]
    assert len(shown) == 15
    # All digits are the same where these were printed; other processors may round otherwise.
    numbers = [[float(cell) for cell in row[3:]] for row in printed]
    assert [[float(cell) for cell in row[3:]] for row in shown] == [
        pytest.approx(row, rel=0.02) for row in numbers
    ]


def test_the_codes_and_the_step_of_the_drive_are_those_of_the_model(tables):
    units, codes = next(table for table in tables(DRIVE) if table[0][0] == "unit (rpm)")
    for unit, code in zip(units[1:], codes[1:], strict=True):
        drive = Cia402Parameters(velocity_unit_rpm=float(unit))
        assert drive.si_unit_velocity == int(code, 16)
    gain = abs(linearize_plant().velocity_gain)  # rad/s of the knee per rad/s
    turn_deg = math.degrees(gain * math.radians(6.0) * 0.002)  # at 1 rpm, for a sample
    assert f"by {turn_deg:.1e}°".replace("e-0", "e-") in DRIVE
    finest = Cia402Parameters(velocity_unit_rpm=1e-6)
    limit_rpm = math.degrees(Scenario(bus=finest).command_limit_rad_s) / 6.0
    assert f"that is {limit_rpm:.2f} rpm" in DRIVE


SCENARIO_FILES = (ROOT / "docs/scenario_files.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "text", re.findall(r"^\| `(\{kind: [^`]*\})", SCENARIO_FILES, re.MULTILINE)
)
def test_the_references_of_the_scenario_files_load(text, tmp_path):
    (tmp_path / "gait.csv").write_text("time_s,knee_angle_deg\n0,10\n1,20\n2,15\n")
    angles = "knee_angle_r\n0\t10\n50\t20\n100\t11\n"
    (tmp_path / "ik.mot").write_text(f"inDegrees=yes\nendheader\ntime\t{angles}")
    (tmp_path / "stride.csv").write_text("percent,knee_angle_deg\n0,10\n50,20\n100,11\n")
    path = tmp_path / "scenario.yaml"
    path.write_text(f"reference: {text}", encoding="utf-8")
    kind = re.match(r"\{kind: (\w+)", text)[1]
    assert load_scenario(path).reference.kind == ("samples" if kind == "csv" else kind)


def section(title):
    return SCENARIO_FILES.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def test_the_example_of_the_scenario_files_runs(tmp_path, capsys):
    others = SCENARIO_FILES
    for title in ("Faults", "Protection", "Safe states"):
        others = others.replace(section(title), "")
    example = block("python", others)
    assert 1.0 < float(output_of(example, tmp_path, capsys)) < 90.0


@pytest.mark.slow
def test_the_examples_of_protection_run(tmp_path, capsys):
    path = tmp_path / "scenario.yaml"
    path.write_text(block("yaml", section("Protection")), encoding="utf-8")
    assert load_scenario(path).protection.following_deg == 2.0
    lines = output_of(block("python", section("Protection")), tmp_path, capsys).splitlines()
    assert lines[0] == "3 healthy runs, 0.025 h, 0 failed, 0 false alarms"


@pytest.mark.slow
def test_the_examples_of_faults_run(tmp_path, capsys):
    path = tmp_path / "scenario.yaml"
    path.write_text(block("yaml", section("Faults")), encoding="utf-8")
    assert len(load_scenario(path).faults) == 3
    lines = output_of(block("python", section("Faults")), tmp_path, capsys).splitlines()
    assert lines[0] == "Within 5° of the run without the fault:"
    assert [line.partition(":")[0] for line in lines[1:]] == ["encoder frozen", "command scale 0"]


@pytest.mark.slow
def test_the_example_of_safe_states_runs(tmp_path, capsys):
    lines = output_of(block("python", section("Safe states")), tmp_path, capsys).splitlines()
    assert [line.partition(":")[0] for line in lines] == list(SAFE_STATES)
    zero_speed, brake, torque_off, bypass = (float(line.split()[3]) for line in lines)
    assert brake == pytest.approx(zero_speed, rel=0.05)  # 120, 120, 33 and 9 N·m
    assert zero_speed > 2.0 * torque_off > 4.0 * bypass > 10.0


@pytest.mark.slow
def test_the_example_of_a_dead_motor_counts_the_runs_that_a_fault_stops(tmp_path):
    """A share of 1 − exp(−15/20) = 0.53 of the runs has the fault."""
    page = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    examples = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (code,) = (code for code in examples if "mttf_s" in code)
    path = tmp_path / "dead_motor.py"
    path.write_text(code, encoding="utf-8")
    command = [sys.executable, str(path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    count, total = re.match(r"(\d+) of (\d+) runs end", done.stdout).groups()
    share = -math.expm1(-0.75)
    assert int(count) / int(total) == pytest.approx(share, abs=4.0 * math.sqrt(0.25 / int(total)))


@pytest.fixture
def wearer_example(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(block("yaml", section("A wearer and torque control")), encoding="utf-8")
    return load_scenario(path)


def test_the_example_of_a_wearer_loads(wearer_example):
    assert wearer_example.wearer.kind == "leg"
    assert wearer_example.controller.mode == "assist"


@pytest.mark.slow
def test_the_example_of_a_wearer_assists(wearer_example):
    metrics = interaction_metrics(simulate(wearer_example))
    assert 0.05 < metrics.assistance_ratio < wearer_example.controller.assistance
    assert metrics.peak_torque_n_m < wearer_example.wearer.cuff.slip_torque_n_m


def test_the_schema_line_is_printed_by_help(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["params", "--help"])
    assert "yaml-language-server: $schema=" in " ".join(capsys.readouterr().out.split())
