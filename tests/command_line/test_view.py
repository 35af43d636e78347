import json
import os
import stat

import pytest

from kneexo.command_line.main import main


def test_a_file_name_may_have_bytes_that_are_no_text(tmp_path, capsys):
    scenario = tmp_path / os.fsdecode(b"knee\xff.yaml")
    scenario.write_text("simulation: {duration_s: 0.1}\n")
    page = tmp_path / "knee.html"
    assert main(["view", str(scenario), "--out", str(page)]) == 0
    assert "<title>kneexo: knee?</title>" in page.read_text()


def test_the_command_writes_a_page_and_replaces_only_pages(tmp_path, capsys):
    page = tmp_path / "knee.html"
    short = ["--set", "simulation.duration_s=0.5"]
    assert main(["view", "--out", str(page), *short, "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["runs"] == ["the paper's setup, simulation.duration_s=0.5"]
    assert all(line.startswith("compiling") for line in printed.err.splitlines())
    assert main(["view", "--out", str(page), *short, "--preset", "bench", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["runs"] == ["preset bench, simulation.duration_s=0.5"]
    assert "The knee in motion" in page.read_text()
    assert main(["view", "--out", str(page), *short]) == 0  # an earlier page is replaced
    other = tmp_path / "my.yaml"
    other.write_text("mine")
    endless = tmp_path / "socket.html"
    os.mknod(endless, stat.S_IFSOCK | 0o600)
    for path, message in (
        (other, "my.yaml: the name of a page must end in .html"),
        (endless, "socket.html is no regular file there"),
    ):
        assert main(["view", "--out", str(path), *short]) == 2
        assert message in capsys.readouterr().err
    assert other.read_text() == "mine"
    assert {file.name for file in tmp_path.iterdir()} == {"knee.html", "my.yaml", "socket.html"}


def test_a_page_opens_where_there_is_a_browser(tmp_path, monkeypatch, capsys):
    page = tmp_path / "my knee.html"
    command = ["view", "--out", str(page), "--set", "simulation.duration_s=0.5"]
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or len(opened) == 1)
    assert main([*command, "--open"]) == 0
    assert opened == [page.as_uri()]
    capsys.readouterr()
    page.unlink()
    assert main([*command, "--open"]) == 2
    message = capsys.readouterr().err
    assert message == f"kneexo: --open: no browser here; {page} is written, open it elsewhere\n"
    assert page.exists()
    assert main(command) == 0
    assert len(opened) == 2


def test_an_interrupt_of_the_browser_says_where_the_page_is(tmp_path, monkeypatch, capsys):
    def browser_in_terminal(url):
        raise KeyboardInterrupt

    monkeypatch.setattr("webbrowser.open", browser_in_terminal)
    page = tmp_path / "knee.html"
    short = ["--set", "simulation.duration_s=0.1"]
    assert main(["view", "--out", str(page), *short, "--open"]) == 130
    assert capsys.readouterr().err.endswith(f"kneexo: interrupted; the results are in {page}\n")


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


@pytest.mark.slow
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
    message = f"kneexo: --set: {run} holds a finished run; its values are fixed\n"
    assert capsys.readouterr().err == message
    assert not page.exists()


def test_a_fault_of_a_run_does_not_name_the_run_before(tmp_path, capsys, finished):
    good, empty = tmp_path / "good.yaml", tmp_path / "empty"
    good.write_text("simulation: {duration_s: 0.1}\n")
    empty.mkdir()
    assert main(["view", str(good), str(empty), "--out", str(tmp_path / "knee.html")]) == 2
    assert capsys.readouterr().err.startswith(f"kneexo: {empty}: has no scenario.yaml; must be")
