"""The examples run, print what they should, and stay short enough to be copied."""

import csv
import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis import track
from kneexo.parameters import CylinderParameters, KneeLoadParameters, PlantParameters, Scenario

EXAMPLES = Path(__file__).parents[1] / "examples"
MASS, BULK_MODULUS = "plant.cylinder.mass_kg", "plant.cylinder.bulk_modulus_pa"
SHORT = ("own_law", "drake_loop", "bode", "thousand_runs", "pendulum", "stride_load")


@pytest.fixture
def run_example(monkeypatch, capsys):
    """Run an example as a script; return the lines that it prints, and the axes of its picture."""

    def run(name):
        pictures = {}
        monkeypatch.setattr(plt, "savefig", lambda path: pictures.update({path: plt.gcf().axes}))
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        assert list(pictures) == [f"{name}.png"]
        return capsys.readouterr().out.splitlines(), pictures[f"{name}.png"]

    return run


@pytest.mark.parametrize("name", SHORT)
def test_an_example_has_at_most_40_lines(name):
    assert len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= 40


@pytest.mark.slow
def test_the_law_of_the_example_moves_the_knee_to_its_target(run_example):
    (line,), (ax,) = run_example("drake_loop")
    angle = float(re.fullmatch(r"knee angle after 1 s: (.*) deg", line)[1])
    # After 1 s the error has fallen below 0.1 deg, monotonically.
    assert angle == pytest.approx(20.0, abs=0.1)
    time_s, angles = ax.lines[0].get_data()
    assert angles[[0, -1]] == pytest.approx([10.0, angle], abs=0.01)
    assert time_s[-1] == 1.0
    assert np.all(np.diff(angles) > -1e-9)
    assert ax.get_ylabel() == "knee angle (deg)"


def test_the_own_law_example_prints_metrics_and_margins(capsys):
    runpy.run_path(str(EXAMPLES / "own_law.py"), run_name="__main__")
    text = capsys.readouterr().out
    error = float(re.search(r"max_error_deg=([\d.]+)", text)[1])
    # A proportional law lags: the error is the rod's largest speed over the loop gain, as an angle.
    assert 1.0 < error < 3.0
    assert "phase margin" in text


def test_the_bode_example_shows_the_phase_margin_that_it_prints(run_example):
    lines, (_, closed, phase, _) = run_example("bode")
    margin = float(re.fullmatch(r"the phase margin is (.*) deg", lines[-1])[1])
    assert 0.0 < margin < 90.0
    (vertical,) = [line for line in phase.lines if "phase margin" in str(line.get_label())]
    assert np.ptp(vertical.get_ydata()) == pytest.approx(margin, abs=0.06)
    labels = [line.get_label() for line in closed.lines]
    assert labels[:2] == ["knee angle / reference", "L/(1 + L), feedback alone"]


@pytest.mark.slow
def test_the_table_of_many_runs_has_a_line_for_each(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = (EXAMPLES / "thousand_runs.py").read_text(encoding="utf-8")
    assert "\nRUNS = 1000\n" in source
    names = {}
    exec(source.replace("RUNS = 1000", "RUNS = 3"), names)
    with open("thousand_runs.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len({row[MASS] for row in rows}) == 3
    errors = [float(row["max_error_deg"]) for row in rows]
    assert f"largest max_error_deg {max(errors):.4g} at" in capsys.readouterr().out
    assert names["worst"].metrics.max_error_deg == max(errors)
    last = rows[-1]
    plant = PlantParameters(
        cylinder=CylinderParameters(
            mass_kg=float(last[MASS]), bulk_modulus_pa=float(last[BULK_MODULUS])
        ),
        load=KneeLoadParameters(segment_mass_kg=float(last["plant.load.segment_mass_kg"])),
    )
    again = track(Scenario(plant=plant, nominal=PlantParameters()))
    assert errors[-1] == again.metrics.max_error_deg


def test_the_pendulum_of_the_example_loses_its_energy(run_example):
    (parameters, *ends), (ax,) = run_example("pendulum")
    assert "'.length': 0.5" in parameters
    starts, last = np.array([re.findall(r"(\S+) deg", line) for line in ends], dtype=float).T
    assert starts.tolist() == [30.0, 90.0, 170.0]
    for line, start, end in zip(ax.lines, starts, last, strict=True):
        angles = line.get_ydata()
        assert angles[[0, -1]] == pytest.approx([start, end], abs=0.01)
        # Damping b/(2 m l²) = 0.2 1/s: after 5 s a small swing has at most exp(−1) of its start.
        assert np.abs(angles[500:]).max() < (0.5 if start < 100.0 else 0.4) * start


def test_the_chapter_on_sizing_has_the_table_that_the_example_prints(capsys):
    runpy.run_path(str(EXAMPLES / "stride_load.py"), run_name="__main__")
    whole, half = capsys.readouterr().out.split("share 0.5 of the moment\n")
    rows = [line for line in whole.splitlines() if line.startswith("|")]
    assert len(rows) == 7
    chapter = (EXAMPLES.parent / "docs" / "sizing.md").read_text(encoding="utf-8")
    assert "\n".join(rows) in chapter
    for line, sentence in (
        ("power -162 … 77 W", "power into the knee is −162 … 77 W"),
        ("follow the rod in 13% of the samples", "follow the rod in 13 % of the samples"),
        ("27.6% of the samples: below -0.1 MPa", "In 28 % of the samples"),
    ):
        assert line in whole
        assert sentence in chapter
    assert "| 1.41 | 1.38 |" in half
    assert "| 1.87 |" in half
    assert "P_1 1.38 MPa and P_2 1.87 MPa" in chapter
