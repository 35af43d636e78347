import csv
import html
import json
import math
from dataclasses import asdict, fields
from pathlib import Path

import matplotlib.pyplot as plt
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
    assert main(["simulate", short, "--out", str(tmp_path / "out")]) == 0
    assert not plt.get_fignums()
    names = ["metrics.json", "scenario.yaml", "signals.csv", "tracking.pdf", "tracking.png"]
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == names
    with (tmp_path / "out" / "signals.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0][:2] == ["time_s", "knee_reference_rad"]
    assert "load_pressure_pa" in rows[0]
    assert len(rows) == 1 + 601
    text, m = capsys.readouterr().out, track(load_scenario(short)).metrics
    back_j = m.shaft_energy_delivered_j - m.shaft_energy_j
    assert f"  error (root mean square)  {m.rms_error_deg:.3g} deg\n" in text
    assert f"  change of the command     {m.mean_command_change_rpm:.3g} rpm per sample\n" in text
    work = f"{m.shaft_energy_delivered_j:.3g} J; {back_j:.3g} J flows back to the motor"
    assert f"  work of the motor         {work}\n" in text
    assert text.split()[-5:] == ", ".join(names).split()


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
    assert page.index(f"</nav>\n<ul>\n{items}") < page.index("<table>")
    # The terminal: the verdict, what is left out, notices, three numbers, the files.
    lines = text.splitlines()
    assert text.startswith("\n".join((*verdict.lines, *verdict.model_lines)) + "\n  error")
    after = text[text.index("  work of the motor") :].splitlines()[1]
    assert after.startswith(f"In {tmp_path}:")
    assert 5 <= len(lines) <= 20
    assert max(map(len, lines)) <= max(100, len(f"In {tmp_path}:") + 20)


@pytest.mark.parametrize(
    ("part", "values"),
    [
        ("step", ["reference={kind: step, start_deg: 30, end_deg: 40, time_s: 0.2}"]),
        pytest.param(
            "push",
            ["plant.load=knee", "push={torque_n_m: 60, start_s: 0.5}"],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_response_to_a_step_or_push_is_in_text_and_document(
    part, values, capsys, tmp_path, undrawn
):
    changes = [f"--set={value}" for value in (*values, "simulation.duration_s=1.5")]
    assert main(["simulate", *changes, "--out", str(tmp_path)]) == 0
    expected = getattr(track(load_scenario(tmp_path / "scenario.yaml")), part)
    assert expected.line in " ".join(capsys.readouterr().out.split())
    document = json.loads((tmp_path / "metrics.json").read_text())
    assert document[part] == asdict(expected)
    assert document["verdict"]["tracks"] is True


def test_every_key_of_the_results_is_documented():
    text = (Path(__file__).parents[2] / "docs/results.md").read_text(encoding="utf-8")
    keys = [field.name for cls in (TrackingMetrics, StepMetrics) for field in fields(cls)]
    verdict = track(changed(Scenario(), {"simulation.duration_s": 0.1})).verdict.results()
    for key in (*keys, *verdict, "kneexo", "scenario", "verdict", "step"):
        assert f"`{key}`" in text, key


@pytest.mark.slow
def test_linearize_writes_what_it_finds(capsys, tmp_path):
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
    assert "</nav>\n<ul>\n<li>Stable at 40°; " in page
    assert f"<li>{html.escape(lines[2])}</li>" in page


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
