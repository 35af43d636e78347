import numpy as np
import pytest

from kneexo.analysis import simulate
from kneexo.errors import SimulationError, StiffnessError
from kneexo.parameters import Scenario, SimulationParameters
from kneexo.simulation import compiled

SHORT = Scenario(simulation=SimulationParameters(duration_s=0.2))


def test_small_steps_stand_in_where_the_exact_hold_gives_up(monkeypatch):
    expected = simulate(SHORT, signals=("rod_extension",))
    original = compiled.simulate_together

    def refusing(scenarios, signals, integrator, *options):
        if integrator == "exact_hold":
            return [StiffnessError("the derivatives jump too often")]
        return original(scenarios, signals, integrator, *options)

    monkeypatch.setattr(compiled, "simulate_together", refusing)
    run = simulate(SHORT, signals=("rod_extension",))
    assert (run.settings.integrator, run.settings.step_s) == ("rk4", 2e-5)
    assert expected.settings.integrator == "exact_hold"
    # Both are far more accurate than that; the rod moves by 1 mm.
    np.testing.assert_allclose(run["rod_extension_m"], expected["rod_extension_m"], atol=1e-10)


def test_another_failure_is_not_repeated(monkeypatch):
    calls = []

    def failing(scenarios, *options):
        calls.append(options)
        return [SimulationError("left the stroke")]

    monkeypatch.setattr(compiled, "simulate_together", failing)
    with pytest.raises(SimulationError, match="left the stroke"):
        simulate(SHORT)
    assert len(calls) == 1


@pytest.mark.parametrize("integrator", ["exact_hold", "radau3"])
def test_progress_ends_at_the_duration(integrator):
    told = []
    settings = SimulationParameters(duration_s=0.1, integrator=integrator)
    simulate(Scenario(simulation=settings), signals=("knee_angle",), progress=told.append)
    assert told[-1] == pytest.approx(0.1)
