import csv
import html
import json
import math
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest

from kneexo.analysis import TrackingMetrics, linearize_loop, linearize_plant, track
from kneexo.analysis.tracking.tracking import StepMetrics
from kneexo.analysis.tracking.verdict import loop_lines
from kneexo.command_line.main import main
from kneexo.command_line.output import to_json
from kneexo.parameters import PlantParameters, Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario


def test_simulate_writes_signals_metrics_scenario_and_plot(capsys, short, tmp_path):
    out = tmp_path / "out"
    assert main(["simulate", short, "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {file.name for file in out.iterdir()} == {
        "signals.csv",
        "metrics.json",
        "scenario.yaml",
        "tracking.png",
        "tracking.pdf",
    }
    assert json.loads((out / "metrics.json").read_text()) == printed
    assert printed["max_error_deg"] < 0.5
    assert load_scenario(out / "scenario.yaml").reference.frequency_hz == 1.0
    with (out / "signals.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0][:2] == ["time_s", "knee_reference_rad"]
    assert "load_pressure_pa" in rows[0]
    assert len(rows) == 1 + 601


def test_a_short_run_prints_the_error_of_the_whole_run(capsys, scenario_file, tmp_path, undrawn):
    path = scenario_file("simulation: {duration_s: 0.1}")
    assert main(["simulate", path, "--out", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "nan" not in text
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    rms_deg = metrics["rms_error_overall_deg"]
    assert f"  error (root mean square)  {float(f'{rms_deg:.3g}'):g} deg\n" in text
    assert "Tracks: largest error" in text
    assert "nan" not in (tmp_path / "out" / "signals.csv").read_text()


@pytest.mark.slow
def test_a_wearer_who_walks_opens_valves_and_draws_a_vacuum(capsys, tmp_path, undrawn):
    gait = [
        "--set",
        "reference={kind: gait, frequency_hz: 0.5}",
        "--set",
        "simulation.duration_s=1",
    ]
    out = tmp_path / "out"
    assert main(["simulate", "--preset", "wearer", *gait, "--out", str(out)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    with (out / "signals.csv").open() as file:
        rows = list(csv.DictReader(file))
    lowest = min(rows, key=lambda row: float(row["cap_pressure_pa"]))
    pressure, time = (float(lowest[name]) for name in ("cap_pressure_pa", "time_s"))
    angle = math.degrees(float(lowest["knee_angle_rad"]))
    assert pressure < -0.2e6
    place = f"the cap falls to {1e-6 * pressure:.3g} MPa at {time:.4g} s and {angle:.3g}°, below"
    assert place in text
    torque = np.array([float(row["interaction_torque_n_m"]) for row in rows])
    # the mean square of the trapezoidal rule
    rms = math.sqrt(np.trapezoid(torque**2) / (torque.size - 1))
    assert text.startswith(
        f"Interaction torque {rms:.3g} N·m rms, peak {abs(torque).max():.3g} N·m"
    )
    assert "relief valves open for" in text
    assert "rms from the reference" in text
    assert "error (root mean square)" not in text


def test_a_csv_reference_runs_for_its_own_length(capsys, scenario_file, tmp_path, undrawn):
    (tmp_path / "steps.csv").write_text("time_s,knee_angle_deg\n0,30\n0.2,31\n0.4,30\n")
    path = scenario_file("reference: {kind: csv, file: steps.csv}")
    command = ["simulate", path, "--out", str(tmp_path / "out"), "--json"]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["scenario"]["simulation"]["duration_s"] == 0.4
    assert "the reference ends" not in printed.out
    assert load_scenario(tmp_path / "out" / "scenario.yaml").simulation.duration_s == 0.4
    rows = (tmp_path / "out" / "signals.csv").read_text().splitlines()
    assert rows[-1].startswith("0.4,")
    assert main([*command, "--set", "simulation.duration_s=0.6"]) == 0
    (notice,) = json.loads(capsys.readouterr().out)["verdict"]["notices"]
    assert notice.startswith("the reference ends at 0.4 s")


@pytest.mark.slow
def test_terminal_json_and_page_have_the_verdict(capsys, short, tmp_path, undrawn):
    command = ["simulate", short, "--preset", "leg", "--set", "plant.cylinder.mass_kg=3.2"]
    assert main([*command, "--out", str(tmp_path), "--html"]) == 0
    text = capsys.readouterr().out
    printed = json.loads((tmp_path / "metrics.json").read_text())
    verdict = track(load_scenario(tmp_path / "scenario.yaml")).verdict
    assert printed["verdict"] == json.loads(to_json(verdict.results()))
    assert printed["verdict"]["lines"] == list(verdict.lines)
    page = (tmp_path / "simulate.html").read_text()
    items = "".join(f"<li>{html.escape(line)}</li>\n" for line in verdict.lines)
    assert page.index(f"</h1>\n<ul>\n{items}") < page.index("<table>")
    # The terminal: the verdict, what is left out, notices, three numbers, the files.
    lines = text.splitlines()
    assert text.startswith("\n".join((*verdict.lines, *verdict.model_lines)) + "\n  error")
    after = text[text.index("  work of the motor") :].splitlines()[1]
    assert after.startswith(f"In {tmp_path}:")
    assert 5 <= len(lines) <= 20
    assert max(map(len, lines)) <= max(100, len(f"In {tmp_path}:") + 20)


def test_numbers_of_the_terminal_have_words_and_units(capsys, short, tmp_path, undrawn):
    assert main(["simulate", short, "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    m = track(load_scenario(short)).metrics
    back_j = m.shaft_energy_delivered_j - m.shaft_energy_j
    assert f"  error (root mean square)  {m.rms_error_deg:.3g} deg\n" in text
    assert f"  change of the command     {m.mean_command_change_rpm:.3g} rpm per sample\n" in text
    work = f"{m.shaft_energy_delivered_j:.3g} J; {back_j:.3g} J flows back to the motor"
    assert f"  work of the motor         {work}\n" in text


def test_a_step_has_rise_time_overshoot_and_settling_time(capsys, tmp_path, undrawn):
    step = "reference={kind: step, start_deg: 30, end_deg: 40, time_s: 0.2}"
    command = ["simulate", "--set", step, "--set", "simulation.duration_s=1.5"]
    assert main([*command, "--out", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    expected = track(load_scenario(tmp_path / "scenario.yaml")).step
    assert printed["step"] == asdict(expected)
    assert printed["verdict"]["lines"][0] == expected.line
    assert printed["verdict"]["tracks"] is True


@pytest.mark.slow
def test_a_push_has_a_deviation_and_a_recovery_time(capsys, tmp_path, undrawn):
    values = ("plant.load=knee", "push={torque_n_m: 60, start_s: 0.5}", "simulation.duration_s=1.5")
    command = ["simulate", *(word for value in values for word in ("--set", value))]
    assert main([*command, "--out", str(tmp_path)]) == 0
    words = " ".join(capsys.readouterr().out.split())
    expected = track(load_scenario(tmp_path / "scenario.yaml")).push
    assert expected.line in words
    assert json.loads((tmp_path / "metrics.json").read_text())["push"] == asdict(expected)


@pytest.mark.slow
def test_the_reference_engine_can_be_asked_for(capsys, short, tmp_path, undrawn):
    results = {}
    for engine in ("compiled", "drake"):
        arguments = ["simulate", short, "--engine", engine, "--json"]
        assert main([*arguments, "--out", str(tmp_path / engine)]) == 0
        results[engine] = json.loads(capsys.readouterr().out)
        saved = load_scenario(tmp_path / engine / "scenario.yaml")
        assert saved.simulation.compiled == (engine == "compiled")
    for name in ("max_error_deg", "rms_error_deg", "mean_command_change_rpm"):
        # radau3 at 2 ms against the exact hold; a count of the encoder may fall a sample later.
        assert results["compiled"][name] == pytest.approx(results["drake"][name], rel=2e-2)


def test_a_run_that_would_not_fit_into_memory_is_refused(capsys, scenario_file, tmp_path):
    path = scenario_file("simulation: {duration_s: 86400}")
    assert main(["simulate", path, "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "simulation.duration_s = 86400 s" in line
    assert "43200000 samples" in line
    assert "at most 2 GiB" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("plant: {cylinder: {mass_kg: -1}}", "plant.cylinder.mass_kg = -1 kg is out of range"),
        (
            "reference: {frequency_hz: 1.0, amplitude_deg: 2.0}\n"
            "simulation: {duration_s: 1.2, integrator: runge_kutta3}",
            "t = 0.002 s: runge_kutta3",
        ),
        (
            "reference: {kind: samples, times_s: [0, 1, 2, 3], angles_deg: [5, 89, 89, 5]}\n"
            "simulation: {duration_s: 1.0}",
            "interpolation cubic passes the range of motion",
        ),
    ],
)
def test_bad_scenarios_are_one_line_exit_2_and_leave_nothing(
    capsys, scenario_file, tmp_path, text, message
):
    out = tmp_path / "out"
    assert main(["simulate", scenario_file(text), "--out", str(out)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("kneexo:")]
    assert len(lines) == 1
    assert message in lines[0]
    assert "scenario.yaml" in lines[0]
    assert not out.exists()


def test_every_key_of_the_results_is_documented():
    text = (Path(__file__).parents[2] / "docs/results.md").read_text(encoding="utf-8")
    keys = [field.name for cls in (TrackingMetrics, StepMetrics) for field in fields(cls)]
    verdict = track(changed(Scenario(), {"simulation.duration_s": 0.1})).verdict.results()
    for key in (*keys, *verdict, "kneexo", "scenario", "verdict", "step"):
        assert f"`{key}`" in text, key


@pytest.mark.slow
def test_linearize_writes_what_it_finds_and_refuses_a_posture_out_of_range(capsys, tmp_path):
    posture = ["--knee-angle", "30"]
    assert main(["linearize", *posture, "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "out" / "linearization.json").read_text()) == printed
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "linearization.json",
        *(f"{name}.{kind}" for name in ("loop", "nyquist", "poles") for kind in ("png", "pdf")),
    }
    plant = linearize_plant(PlantParameters(), knee_angle_deg=30.0)
    frequency, damping = plant.damping
    assert [complex(*pole) for pole in printed["plant_poles_per_s"]] == list(plant.poles)
    assert printed["plant_frequencies_rad_s"] == list(frequency)
    assert printed["plant_damping_ratios"] == list(damping)
    assert printed["plant_velocity_gain"] == plant.velocity_gain
    assert printed["operating_point"] == json.loads(to_json(asdict(plant.operating_point)))
    loop = linearize_loop(Scenario(), knee_angle_deg=30.0)
    assert printed["loop_eigenvalues"] == [[z.real, z.imag] for z in loop.eigenvalues]
    margins = loop.margins()
    assert printed["margins"] == {
        name: None if value != value or math.isinf(value) else value
        for name, value in vars(margins).items()
    }
    assert printed["bandwidth_hz"] == loop.bandwidth_hz()
    feedback = loop.complementary_sensitivity_bandwidth_hz()
    assert printed["complementary_sensitivity_bandwidth_hz"] == feedback
    assert main(["linearize", "--knee-angle", "200", "--out", str(tmp_path / "no")]) == 2
    line = "kneexo: --knee-angle = 200 deg is out of range: must be >= 0 and <= 90 deg\n"
    assert capsys.readouterr().err == line
    assert not (tmp_path / "no").exists()


@pytest.mark.slow
def test_linearize_begins_with_stability_margins_and_bandwidths(capsys, tmp_path, undrawn):
    command = ["linearize", "--preset", "leg", "--set", "plant.cylinder.mass_kg=3.2", "--html"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out.splitlines()
    heavy = changed(Scenario.preset("leg"), {"plant.cylinder.mass_kg": 3.2})
    lines = list(loop_lines(linearize_loop(heavy, knee_angle_deg=40.0)))
    assert len(lines) == 3
    assert printed[:3] == lines
    assert printed[3] == "Left out: torque of the wearer, air in the oil, torque of the motor."
    assert printed[4].startswith("Note: plant.cylinder.mass_kg = 3.2 kg is outside")
    assert len(printed) <= 20
    document = json.loads((tmp_path / "linearization.json").read_text())
    assert document["verdict"] == {"lines": lines, "stable": True}
    page = (tmp_path / "linearize.html").read_text()
    assert "</h1>\n<ul>\n<li>Stable at 40°; " in page
    assert f"<li>{html.escape(lines[2])}</li>" in page


def test_the_margins_and_bandwidths_of_an_unstable_loop_are_null(capsys, tmp_path, undrawn):
    # Exact states at k/Φ = 1.3e4 1/s: docs/controllers.md.
    command = ["linearize", "--set", "estimator={kind: exact}", "--set", "controller.phi_m_s2=24.4"]
    assert main([*command, "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["margins"].pop("stable") is False
    assert set(printed["margins"].values()) == {None}
    assert printed["bandwidth_hz"] is None
    assert printed["complementary_sensitivity_bandwidth_hz"] is None
    (line,) = printed["verdict"]["lines"]
    assert line.startswith("Not stable at 40°")


def test_linearize_takes_values_of_the_scenario(capsys, tmp_path, undrawn):
    command = ["linearize", "--set", "plant.cylinder.mass_kg=0.4", "--out", str(tmp_path / "out")]
    assert main([*command, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["scenario"]["plant"]["cylinder"]["mass_kg"] == 0.4
    plant = linearize_plant(PlantParameters(cylinder={"mass_kg": 0.4}), knee_angle_deg=40.0)
    assert printed["plant_frequencies_rad_s"] == list(plant.damping[0])


def write_law(folder):
    """Write a scenario, its law, which leaves the file `ran`, and a module of the law."""
    folder.mkdir()
    (folder / "laws").mkdir()
    (folder / "laws" / "gain_of_law.py").write_text("K = 1e5\n")
    (folder / "laws" / "my law.py").write_text(
        "from pathlib import Path\n"
        "from gain_of_law import K\n"
        "Path(__file__).with_name('ran').touch()\n"
        "def law(rod_extension, rod_reference, gain=1.0):\n"
        "    return gain * K * (rod_reference[0] - rod_extension)\n"
    )
    path = folder / "my.yaml"
    law = "{kind: law, function: 'laws/my law.py:law', values: {gain: 1.25}}"
    path.write_text(f"controller: {law}\nsimulation: {{duration_s: 0.1}}\n")
    return path


@pytest.mark.slow
def test_the_folder_of_a_run_with_a_law_repeats_the_run_elsewhere(tmp_path, capsys, undrawn):
    path = write_law(tmp_path / "first")
    out, moved, again = (tmp_path / name for name in ("out", "moved", "again"))
    assert main(["simulate", str(path), "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert "kneexo: runs Python of my law.py\n" in printed.err
    assert "gain_of_law.py, metrics.json, my law.py" in " ".join(printed.out.split())
    out.rename(moved)
    (path.parent / "laws" / "gain_of_law.py").write_text("K = 2e5  # the user goes on\n")
    assert main(["simulate", str(moved / "scenario.yaml"), "--out", str(again)]) == 0
    assert (moved / "signals.csv").read_bytes() == (again / "signals.csv").read_bytes()
    assert main(["simulate", str(path), "--out", str(again)]) == 0
    assert (moved / "signals.csv").read_bytes() != (again / "signals.csv").read_bytes()
    assert (again / "gain_of_law.py").read_text().startswith("K = 2e5")  # in place of the earlier


@pytest.mark.slow
def test_commands_that_need_no_law_run_none(tmp_path, capsys, undrawn):
    path = write_law(tmp_path / "first")
    run = tmp_path / "run"
    assert main(["simulate", str(path), "--out", str(run)]) == 0
    for ran in (path.parent / "laws" / "ran", run / "ran"):
        ran.unlink(missing_ok=True)
    capsys.readouterr()
    for scenario in (str(path), str(run / "scenario.yaml")):
        assert main(["params", scenario, "--json"]) == 0
        assert main(["params", scenario, "--yaml"]) == 0
        assert main(["diagram", scenario, "--out", str(tmp_path / "drawn")]) == 0
    assert main(["view", str(run), "--out", str(tmp_path / "view.html")]) == 0
    assert "law.py:law" in (tmp_path / "drawn" / "closed_loop.svg").read_text()
    assert "runs Python" not in capsys.readouterr().err
    assert not list(tmp_path.rglob("ran"))


@pytest.mark.parametrize("name", ["os:abort", "signal:pause", "cProfile:main"])
def test_a_scenario_file_cannot_name_a_module(name, scenario_file, tmp_path, capsys):
    path = scenario_file(f"controller: {{kind: law, function: '{name}'}}")
    assert main(["simulate", path, "--out", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert f"law {name!r}: must be NAME.py:function" in line
    assert "--law" in line
    law = f"{Path(__file__).parents[2] / 'examples' / 'own_law.py'}:law"
    assert main(["params", path, "--law", law, "--find", "controller.function"]) == 0
