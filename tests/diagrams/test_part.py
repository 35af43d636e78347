"""Parts of a diagram say the states of their leaf systems."""

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain

from kneexo.diagrams import SIGNALS
from kneexo.diagrams.closed_loop import plant_of, plant_start, plant_states
from kneexo.diagrams.part import NO_SIGNAL, Part, export_inputs, state_names, wire
from kneexo.errors import ParameterError
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
    assert state_names(two_states(None), "plant/tank") == ["plant/tank.x[0]", "plant/tank.x[1]"]


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


def wired(*parts, names=None):
    """The built diagram of the parts, whose open inputs have the names of their signals."""
    builder = DiagramBuilder()
    ports, inputs = wire(builder, parts)
    export_inputs(builder, inputs, names or {signal: signal for signal in inputs})
    for signal, port in ports.items():
        builder.ExportOutput(port, signal)
    return builder.Build()


def gain(name, factor, reads, offers, through=""):
    return Part(
        name, lambda: Gain(factor, 1), reads={"u0": reads}, offers={offers: "y0"}, through=through
    )


def value(diagram, output, **inputs):
    context = diagram.CreateDefaultContext()
    for name, number in inputs.items():
        diagram.GetInputPort(name).FixValue(context, number)
    return diagram.GetOutputPort(output).Eval(context)[0]


def test_parts_are_wired_by_the_names_of_signals_whatever_their_order():
    diagram = wired(gain("second", 3.0, "middle", "end"), gain("first", 2.0, "start", "middle"))
    assert value(diagram, "end", start=5.0) == 30.0


def test_a_signal_passes_through_parts_in_their_order_and_all_others_read_it_behind_them():
    diagram = wired(
        gain("source", 1.0, "start", "speed"),
        gain("reader", 1.0, "speed", "read"),
        gain("double", 2.0, "speed", "speed", through="speed"),
        gain("triple", 3.0, "speed", "speed", through="speed"),
    )
    assert value(diagram, "read", start=1.0) == 6.0


def test_one_input_serves_all_parts_that_read_a_signal_which_nobody_offers():
    diagram = wired(
        gain("one", 2.0, "force", "a"), gain("two", 3.0, "force", "b"), names={"force": "push"}
    )
    assert [value(diagram, name, push=1.5) for name in ("a", "b")] == [3.0, 4.5]
    assert diagram.num_input_ports() == 1


def test_a_part_that_offers_a_port_which_its_system_lacks_is_told():
    part = Part("first", lambda: Gain(2.0, 1), offers={"speed": "velocity"})
    message = "part first: offers 'speed' by the output port 'velocity', .* its ports y0"
    with pytest.raises(ParameterError, match=message):
        wired(part)


def test_a_port_that_reads_no_signal_stays_unconnected():
    diagram = wired(gain("source", 1.0, "start", "speed"), gain("deaf", 1.0, NO_SIGNAL, "heard"))
    assert [diagram.get_input_port(i).get_name() for i in range(1)] == ["start"]
    assert diagram.num_input_ports() == 1
