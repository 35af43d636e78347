import json

import pytest

from kneexo.command_line.main import main
from kneexo.page import playground


@pytest.fixture
def calls(monkeypatch):
    """The scenarios and names of each page, which is only its mark."""
    calls = []

    def page(scenarios, names):
        calls.append((scenarios, names))
        return "a page"

    monkeypatch.setattr(playground, "playground_page", page)
    return calls


def test_the_command_writes_a_page_of_the_paper_by_default(tmp_path, capsys, calls):
    page = tmp_path / "knee.html"
    assert main(["play", "--out", str(page), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scenarios"] == ["the paper's setup"]
    assert page.read_text() == "a page"
    assert main(["play", "--out", str(page)]) == 0  # its own page may be replaced
    assert "open it in a browser" in capsys.readouterr().out


def test_files_values_and_presets_make_the_scenarios(tmp_path, calls):
    file = tmp_path / "mine.yaml"
    file.write_text("plant: {pump: {gear_ratio: 4.5}}\n")
    out = ["--out", str(tmp_path / "knee.html")]
    change = ["--set", "plant.pump.lag_s=0.02", "--preset", "bench", "--compare", "paper"]
    assert main(["play", str(file), *change, *out]) == 0
    ((scenarios, names),) = calls
    assert names == ["mine, plant.pump.lag_s=0.02", "preset paper"]
    assert scenarios[0].plant.pump.gear_ratio == 4.5
    assert [scenario.plant.pump.lag_s for scenario in scenarios] == [0.02, 0.01]
    assert [scenario.plant.load.kind for scenario in scenarios] == ["knee", "none"]


@pytest.mark.parametrize(("duration_s", "cut"), [(60, False), (61, True)])
def test_a_run_that_is_too_long_for_the_page_is_named(tmp_path, capsys, calls, duration_s, cut):
    change = ["--set", f"simulation.duration_s={duration_s}"]
    assert main(["play", *change, "--out", str(tmp_path / "knee.html")]) == 0
    notice = f"kneexo: the paper's setup, simulation.duration_s={duration_s}: a run on the page "
    expected = f"{notice}has the first 60 of {duration_s} s\n" if cut else ""
    assert capsys.readouterr().err == expected


def test_the_page_opens_where_there_is_a_browser(tmp_path, monkeypatch, calls):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or True)
    page = tmp_path / "my knee.html"
    assert main(["play", "--out", str(page), "--open"]) == 0
    assert opened == [page.as_uri()]
