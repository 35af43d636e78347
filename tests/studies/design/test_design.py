"""Study `design`: what it searches, its words for the result, and the scenario that it writes."""

from dataclasses import replace

import numpy as np
import pytest
from design_cases import made_up

from kneexo.analysis import design_linkage
from kneexo.analysis.mechanism.alignment import align
from kneexo.command_line.main import main
from kneexo.geometry.linkage import rod_extension
from kneexo.parameters import G1, HINGE, DesignLimits, RodPolynomialParameters, Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario
from kneexo.studies.design import DesignSettings, design, design_study
from kneexo.studies.design.report import report


@pytest.fixture
def searched(monkeypatch):
    """What the study searches. The search itself returns the design that is made up."""
    passed = {}

    def search(motion, rod, limits, **options):
        passed.update(motion=motion, rod=rod, limits=limits, **options)
        return made_up().design

    monkeypatch.setattr(design, "design_linkage", search)
    return passed


def test_settings_are_those_of_the_search_and_the_linkage_is_the_scenario_s(tmp_path, searched):
    knee = tmp_path / "knee.csv"
    knee.write_text("knee_flexion_deg,anterior_mm,up_mm\n0,0,0\n50,1,-5\n100,2,-9\n")
    pairs = tmp_path / "rod.csv"
    pairs.write_text("knee_angle_deg,rod_extension_mm\n0,148\n45,73\n90,38\n")
    values = {"knee": str(knee), "rod": str(pairs), "limits.grashof": "grashof", "seed": 3}
    settings = changed(DesignSettings(), values | {"starts": 7})
    scenario = Scenario(plant={"load": "knee"})
    result = design_study(scenario, settings=settings)
    assert searched == {
        "motion": settings.knee,
        "rod": ([0.0, 45.0, 90.0], [148.0, 73.0, 38.0]),
        "limits": DesignLimits(grashof="grashof"),
        "seed": 3,
        "starts": 7,
    }
    assert result.scenario == changed(scenario, {"plant.linkage": made_up().design.linkage})
    assert result.others["linkage of the scenario"].rms_mm == align(G1, settings.knee).rms_mm
    assert result.others["hinge"].rms_mm == align(HINGE, settings.knee).rms_mm


def test_a_word_stands_for_table_1_or_for_no_rod_map(searched):
    design_study()
    assert searched["rod"] == RodPolynomialParameters()
    design_study(settings=DesignSettings(rod="none"))
    assert searched["rod"] is None


def test_the_scenario_of_the_file_has_the_linkage(tmp_path, capsys, searched, monkeypatch):
    monkeypatch.setattr("kneexo.studies.design.figures.figures", lambda result: {})
    assert main(["design", "--preset", "bench", "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    scenario = load_scenario(tmp_path / "linkage.yaml")
    linkage = made_up().design.linkage
    assert scenario == changed(Scenario.preset("bench"), {"plant.linkage": linkage})


def test_the_report_names_the_rod_map_and_the_limits_that_bind():
    def text(**settings):
        result = made_up()
        result = replace(result, settings=changed(result.settings, settings))
        return report(result)

    assert "at most 0.0695 mm) from Table 1.\n" in text()
    assert "from Table 1, which did not count.\n" in text(rod="none")
    assert "from my.csv.\n" in text(rod="my.csv")
    assert "It reaches least_link_m. A wider" in text()
    free = replace(made_up(), design=replace(made_up().design, binding=()))
    assert "- It reaches no limit.\n" in report(free)


@pytest.mark.slow
def test_the_command_designs_a_linkage_that_simulates(tmp_path, capsys):
    out = tmp_path / "linkage"
    assert main(["design", "--set", "starts=12", "--set", "rod=none", "--out", str(out)]) == 0
    link = load_scenario(out / "linkage.yaml").plant.linkage
    assert link == design_linkage(rod=None, starts=12).linkage
    assert np.all(np.diff(rod_extension(link, np.radians(np.arange(91.0)))) < 0.0)
    run = ["simulate", str(out / "linkage.yaml"), "--out", str(tmp_path / "run")]
    assert main(run) == 0
    assert "largest" in capsys.readouterr().out
