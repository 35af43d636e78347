"""Equations as data: what belongs to what."""

from diagramc.equations.reader import read_equations


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
