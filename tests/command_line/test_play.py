import pytest

from kneexo.command_line.main import main
from kneexo.page import playground


@pytest.fixture
def calls(monkeypatch):
    """The scenarios and names of each page, which is only its mark."""
    calls = []

    def data(scenarios, names):
        calls.append((scenarios, names))
        return {"scenarios": []}

    monkeypatch.setattr(playground, "playground_data", data)
    monkeypatch.setattr(playground, "page_of", lambda data: "a page")
    return calls


def test_files_values_and_presets_make_the_scenarios(tmp_path, calls):
    file = tmp_path / "mine.yaml"
    file.write_text("plant: {pump: {gear_ratio: 4.5}}\n")
    out = ["--out", str(tmp_path / "knee.html")]
    change = ["--set", "plant.pump.lag_s=0.02", "--preset", "bench", "--compare", "paper"]
    assert main(["play", str(file), *change, *out]) == 0
    assert (tmp_path / "knee.html").read_text() == "a page"
    ((scenarios, names),) = calls
    assert names == ["mine, plant.pump.lag_s=0.02", "preset paper"]
    assert scenarios[0].plant.pump.gear_ratio == 4.5
    assert [scenario.plant.pump.lag_s for scenario in scenarios] == [0.02, 0.01]
    assert [scenario.plant.load.kind for scenario in scenarios] == ["knee", "none"]
