"""A hinge in place of the four-bar knee: every diagram, analysis and export works with it."""

import numpy as np
import pytest

from kneexo.analysis import linearize_loop, track
from kneexo.command_line.main import main
from kneexo.parameters import HINGE, Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import PRESETS
from kneexo.simulation import simulate


def with_hinge(preset, duration_s):
    return changed(
        Scenario.preset(preset), {"plant.linkage": HINGE, "simulation.duration_s": duration_s}
    )


def test_the_controller_knows_the_hinge_and_the_paper_s_loop_tracks_as_with_g1():
    scenario = with_hinge("paper", 1.0)
    metrics = track(scenario).metrics
    assert metrics.max_error_overall_deg < 0.1
    # The lever of both differs by 4 % at most, and the gain margin with it.
    assert linearize_loop(scenario).margins().gain_margin == pytest.approx(
        linearize_loop(Scenario()).margins().gain_margin, rel=0.05
    )


def test_both_engines_agree_with_a_hinge():
    scenario = changed(with_hinge("paper", 0.1), {"simulation.integrator": "radau3"})
    compiled = simulate(with_hinge("paper", 0.1)).data["knee_angle_rad"]
    drake = simulate(scenario).data["knee_angle_rad"]
    # Radau at 2 ms against the exact hold, as for the four-bar knees.
    np.testing.assert_allclose(drake, compiled, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_runs_models_exports_and_views_have_a_hinge(preset, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for command in (
        "simulate --out run",
        "linearize --out model",
        "export c --out code",
        "export fmu --out knee.fmu",
        "play --out page.html",
        "view --out view.html",
    ):
        options = ["--preset", preset, "--set", "plant.linkage=hinge"]
        assert main([*command.split(), *options]) == 0, capsys.readouterr().err
