"""Pages of runs: content, files, and what a browser shows."""

import errno
import json
import os
import shutil
import stat
import subprocess

import numpy as np
import pytest
from matplotlib.image import imread

from kneexo.cli import main
from kneexo.errors import OutputError, ScenarioError, SimulationError
from kneexo.parameters import Scenario
from kneexo.scenario_file import load_scenario
from kneexo.simulation import simulate
from kneexo.view.legs import leg_of_results, leg_of_scenario
from kneexo.view.page import MARK, Leg, view_page, write_page

SHORT = {"simulation": {"duration_s": 0.5}}


def scenario_of(**fields):
    return Scenario.model_validate(SHORT | fields)


def test_a_page_tells_its_runs_in_safe_html():
    time = np.linspace(0.0, 1.0, 11)
    leg = Leg(
        "<b>mine</b>", Scenario().plant.linkage, time, 0.5 + 0 * time, 0.6 + 0 * time, -2e6 * time
    )
    page = view_page([leg])
    assert MARK in page
    assert "&lt;b&gt;mine&lt;/b&gt;" in page
    assert "−2 MPa … red 2 MPa" in page
    assert len(page) < 8e6


def test_a_leg_has_the_signals_of_its_run():
    scenario = scenario_of()
    leg, failure = leg_of_scenario("mine", scenario)
    run = simulate(scenario)
    assert (leg.name, failure) == ("mine", "")
    np.testing.assert_array_equal(leg.time_s, run.time_s)
    np.testing.assert_array_equal(leg.knee_angle_rad, run["knee_angle_rad"])
    np.testing.assert_array_equal(leg.reference_rad, run["knee_reference_rad"])
    np.testing.assert_array_equal(leg.pressure_pa, run["load_pressure_pa"])


FAILING = scenario_of(
    controller={
        "kind": "pid",
        "proportional_per_s": 0.0,
        "integral_per_s2": 0.0,
        "velocity_feedforward": 2.0,
    },
    reference={"kind": "sine", "mean_deg": 45.0, "amplitude_deg": 44.0, "frequency_hz": 0.1},
    simulation={"duration_s": 8.0},
)


def test_a_run_that_fails_is_shown_up_to_there():
    with pytest.raises(SimulationError) as error:
        simulate(FAILING)
    leg, failure = leg_of_scenario("failing", FAILING)
    assert failure == str(error.value)
    told = float(failure.partition("t = ")[2].partition(" ")[0])
    assert told - 0.005 < leg.time_s[-1] < told
    assert np.isfinite(leg.knee_angle_rad).all()


def test_results_of_simulate_are_a_leg(tmp_path, capsys):
    scenario = tmp_path / "g3.yaml"
    scenario.write_text("plant: {linkage: G3}\nsimulation: {duration_s: 0.5}\n")
    out = tmp_path / "run"
    assert main(["simulate", str(scenario), "--out", str(out)]) == 0
    written = load_scenario(out / "scenario.yaml")
    read = leg_of_results("mine", out, written)
    run, _ = leg_of_scenario("run", scenario_of(plant={"linkage": "G3"}))
    assert read.name == "mine"
    assert read.linkage == run.linkage
    for column in ("time_s", "knee_angle_rad", "reference_rad", "pressure_pa"):
        expected = getattr(run, column)
        np.testing.assert_allclose(getattr(read, column), expected, rtol=1e-9, atol=1e-12)
    signals = out / "signals.csv"
    head = "time_s,knee_angle_rad,knee_reference_rad,load_pressure_pa\n"
    for text, match in (
        ("time_s,knee_angle_rad\n0,1\n", "signals.csv: has no column knee_reference_rad$"),
        (f"{head}0,1,2,x\n", "is not a table of numbers"),
        (head, "has no rows"),
        (f"{head}0,1,2,nan\n", "not finite"),
    ):
        signals.write_text(text)
        with pytest.raises(ScenarioError, match=match):
            leg_of_results("mine", out, written)
    signals.unlink()
    with pytest.raises(ScenarioError, match="cannot be read"):
        leg_of_results("mine", out, written)


def test_the_command_writes_a_page_and_keeps_other_files(tmp_path, capsys):
    page = tmp_path / "knee.html"
    short = ["--set", "simulation.duration_s=0.5"]
    assert main(["view", "--out", str(page), *short, "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["runs"] == ["the paper's setup, simulation.duration_s=0.5"]
    assert all(line.startswith("compiling") for line in printed.err.splitlines())
    assert MARK in page.read_text()
    assert main(["view", "--out", str(page), *short]) == 0  # its own page may be replaced
    other = tmp_path / "other.html"
    other.write_text("mine")
    endless = tmp_path / "socket.html"
    os.mknod(endless, stat.S_IFSOCK | 0o600)
    for path in (other, tmp_path, endless):
        assert main(["view", "--out", str(path), *short]) == 2
        assert "is no page of kneexo view" in capsys.readouterr().err
    assert other.read_text() == "mine"
    assert {file.name for file in tmp_path.iterdir()} == {"knee.html", "other.html", "socket.html"}


@pytest.fixture
def finished(tmp_path):
    """The directory of a run, which one row of signals stands for."""

    def make(path):
        directory = tmp_path / path
        directory.mkdir(parents=True)
        (directory / "scenario.yaml").write_text("simulation: {duration_s: 0.5}\n")
        (directory / "signals.csv").write_text(
            "time_s,knee_angle_rad,knee_reference_rad,load_pressure_pa\n0,0.5,0.5,1e6\n"
        )
        return str(directory)

    return make


def test_runs_have_names_that_differ(tmp_path, capsys, monkeypatch, finished):
    first, second, third = finished("a/run"), finished("b/run"), finished("c/walk")
    monkeypatch.chdir(third)
    page = str(tmp_path / "knee.html")
    assert main(["view", first, second, ".", "--out", page, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["runs"] == ["a/run", "b/run", "walk"]


def test_a_scenario_file_and_a_directory_of_one_name_have_names_that_differ(
    tmp_path, capsys, monkeypatch, finished
):
    finished("x")
    finished("y/x")
    (tmp_path / "x.yaml").write_text("simulation: {duration_s: 0.1}\n")
    monkeypatch.chdir(tmp_path)
    for runs, names in (
        (["x.yaml", "x"], ["x.yaml", "x"]),
        (["x", "x.yaml", "y/x"], ["x", "x.yaml", "y/x"]),
        (["x.yaml", "x.yaml", "x.yaml"], ["x.yaml", "x.yaml (2)", "x.yaml (3)"]),
    ):
        assert main(["view", *runs, "--out", "knee.html", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["runs"] == names


def test_values_of_a_finished_run_cannot_be_set(tmp_path, capsys, finished):
    run, page = finished("run"), tmp_path / "knee.html"
    assert main(["view", run, "--set", "plant.linkage=G3", "--out", str(page)]) == 2
    told = f"kneexo: --set: {run} holds a finished run; its values are fixed\n"
    assert capsys.readouterr().err == told
    assert not page.exists()


def test_a_fault_of_a_run_does_not_name_the_run_before(tmp_path, capsys, finished):
    good, empty = tmp_path / "good.yaml", tmp_path / "empty"
    good.write_text("simulation: {duration_s: 0.1}\n")
    empty.mkdir()
    assert main(["view", str(good), str(empty), "--out", str(tmp_path / "knee.html")]) == 2
    assert capsys.readouterr().err.startswith(f"kneexo: {empty}/scenario.yaml: cannot be read")


def test_a_page_follows_the_umask(tmp_path):
    for umask, mode in ((0o077, 0o600), (0o022, 0o644)):
        before = os.umask(umask)
        try:
            write_page(tmp_path / "knee.html", MARK)
        finally:
            os.umask(before)
        assert stat.S_IMODE((tmp_path / "knee.html").stat().st_mode) == mode


def test_a_failed_write_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("kneexo.view.page.os.replace", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_page(tmp_path / "knee.html", "page")
    assert list(tmp_path.iterdir()) == []


def test_a_page_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write there"):
        write_page(tmp_path / "file" / "knee.html", "page")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs the browser chromium")
def test_a_browser_shows_a_knee_that_moves(tmp_path):
    slow = {"kind": "sine", "frequency_hz": 0.1}
    leg, _ = leg_of_scenario("mine", Scenario.model_validate({"reference": slow}))
    page = tmp_path / "knee.html"
    write_page(page, view_page([leg]))
    options = ("--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader")
    options += ("--enable-logging=stderr", "--window-size=800,600")
    pictures = []
    for budget_ms in (2000, 6000):
        picture, profile = tmp_path / f"{budget_ms}.png", tmp_path / f"profile{budget_ms}"
        one_time = (f"--virtual-time-budget={budget_ms}", f"--user-data-dir={profile}")
        command = ["chromium", *options, *one_time, f"--screenshot={picture}", page.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
        assert not [line for line in console if "rror" in line or "Uncaught" in line]
        pictures.append(imread(picture)[..., :3])
    for picture in pictures:  # a leg on white ground
        assert 0.005 < (picture.min(axis=2) < 0.9).mean() < 0.5
    moved = np.abs(pictures[0] - pictures[1]).max(axis=2) > 0.1
    assert moved[150:].sum() > 300  # below the caption
