"""Equations as data: what belongs to what."""

from diagramc.equations.equations import Equations
from diagramc.equations.reader import read_equations


def test_new_equations_share_nothing():
    first, second = Equations(), Equations()
    first.states.append("x")
    first.outputs["y"] = [first.graph.source("state", 0)]
    assert (second.states, second.outputs) == ([], {})
    assert first.graph is not second.graph


def test_each_name_has_its_nodes(multirate):
    equations = read_equations(multirate, ())
    assert len(equations.derivatives) == len(equations.states) == 2
    assert len(equations.initial_discrete) == len(equations.discrete) == 2
    assert {name: len(nodes) for name, nodes in equations.outputs.items()} == {
        "y": 1,
        "sampled": 1,
        "held": 1,
    }
    updates = {(update.period_s, update.offset_s): update.values for update in equations.updates}
    assert {times: values[0][0] for times, values in updates.items()} == {
        (0.004, 0.0): equations.discrete.index("hold.0[0]"),
        (0.010, 0.005): equations.discrete.index("sampler.0[0]"),
    }


def test_sections_can_be_computed_in_their_order(multirate):
    """A value that a later section computes first is read by no earlier one."""
    equations = read_equations(multirate, ())
    places = {}
    for place, section in enumerate(equations.sections):
        for node in filter(equations.graph.arguments, section.nodes):  # sources are always there
            places.setdefault(node, place)
    assert len({section.where for section in equations.sections}) > 3
    for node, place in places.items():
        assert all(places.get(n, 0) <= place for n in equations.graph.reachable([node]))
