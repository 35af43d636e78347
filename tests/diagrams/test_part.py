"""Parts of a diagram say the states of their leaf systems."""

import pytest

from kneexo.diagrams import SIGNALS
from kneexo.diagrams.closed_loop import plant_of, plant_start, plant_states
from kneexo.diagrams.part import Part, add_parts, state_names
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import simulate
from kneexo.simulation.compiled import compile_scenario
from kneexo.systems import StateVariable

SCENARIOS = {
    "reduced": Scenario(initial_offset_m=0.001),
    "full": changed(Scenario(), {"plant.full_order": {}}),
    "ideal": changed(Scenario(), {"plant.ideal_motor": True}),
}


def two_states(start):
    states = (StateVariable("angle_rad"), StateVariable("pressure_pa", 1e6))
    return Part("tank", lambda: None, dict, states, start)


def test_a_part_starts_in_the_units_of_the_context():
    assert two_states(lambda: (0.5, 3e6)).start_state() == [0.5, 3.0]


def test_each_state_needs_a_start():
    with pytest.raises(ValueError, match="zip"):
        two_states(lambda: (0.5,)).start_state()


def test_states_are_numbered_in_their_part():
    assert state_names(two_states(None), "plant") == ["plant/tank.x[0]", "plant/tank.x[1]"]


def test_parts_are_added_by_their_names():
    class Builder:
        def AddNamedSystem(self, name, system):
            return name, system

    parts = [Part("a", lambda: 1, dict), Part("b", lambda: 2, dict)]
    assert add_parts(Builder(), parts) == {"a": ("a", 1), "b": ("b", 2)}


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_states_of_the_plant_are_named_as_in_the_compiled_loop(name):
    scenario = SCENARIOS[name]
    assert tuple(plant_states(scenario)) == tuple(compile_scenario(scenario).state_names)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_plant_starts_as_its_parts_say(name):
    scenario = SCENARIOS[name]
    context = plant_of(scenario).CreateDefaultContext()
    start = context.get_continuous_state_vector().CopyToVector()
    assert list(plant_start(scenario).values()) == start.tolist()


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_column_of_a_state_begins_at_its_start(name):
    scenario = changed(SCENARIOS[name], {"simulation.duration_s": 0.01})
    run, start = simulate(scenario), plant_start(scenario)
    for state, (column, factor) in plant_states(scenario).items():
        assert any(column in columns for columns in SIGNALS.values())
        assert run[column][0] == pytest.approx(factor * start[state], rel=1e-14)
