"""Wires on a grid, against paths that a hand draws."""

import itertools

import pytest

from kneexo.view.wiring import Box, Wiring, corners


def beside(*columns, rows=(5, 5, 5)):
    """Boxes a, b, … of 4 × 2 with centres in the given columns."""
    places = zip("abc", columns, rows, strict=False)
    return {name: Box(column, row, 2, 1) for name, column, row in places}


def test_boxes_in_a_row_have_a_straight_wire_between_the_middles_of_their_sides():
    path = Wiring(beside(5, 15), (20, 10)).connect("a", "b")
    assert path == [(x, 5) for x in range(7, 14)]
    assert corners(path) == [(7, 5), (13, 5)]


def test_a_wire_goes_around_a_box_in_its_way():
    boxes = beside(5, 25, 15)
    path = Wiring(boxes, (30, 10)).connect("a", "b")
    assert not set(path) & set(boxes["c"].points())
    assert set(path[:1]) <= set(boxes["a"].points())
    assert set(path[-1:]) <= set(boxes["b"].points())
    steps = [abs(x - u) + abs(y - v) for (x, y), (u, v) in itertools.pairwise(path)]
    assert steps == [1] * (len(path) - 1)


def test_a_wire_enters_its_target_from_outside():
    boxes = beside(5, 15, rows=(2, 12))
    path = Wiring(boxes, (20, 15)).connect("a", "b")
    inside = set(boxes["b"].points())
    assert path[-1] in inside
    assert not inside & set(path[:-1])
    assert not set(path[1:]) & set(boxes["a"].points())
    assert len(corners(path)) == 3  # one bend


def test_wires_share_no_step():
    wiring = Wiring(beside(5, 15), (20, 10))
    there, back, again = (wiring.connect(*ends) for ends in ("ab", "ba", "ab"))
    steps = [{frozenset(s) for s in itertools.pairwise(p)} for p in (there, back, again)]
    assert not steps[0] & steps[1]
    assert not steps[0] & steps[2]
    assert not steps[1] & steps[2]
    assert len({there[0], back[-1], again[0]}) == 3


def test_a_detour_is_better_than_many_crossings_but_not_than_a_single_one():
    boxes = {"a": Box(10, 3, 2, 1), "b": Box(10, 17, 2, 1), "c": Box(3, 10, 1, 2)}
    boxes["d"] = Box(17, 10, 1, 2)
    wiring = Wiring(boxes, (20, 20))
    assert len(corners(wiring.connect("c", "d"))) == 2
    assert len(corners(wiring.connect("a", "b"))) == 2  # crosses the first one


def test_a_box_without_a_way_to_it_is_refused():
    wall = {"wall": Box(10, 5, 1, 5)}
    with pytest.raises(ValueError, match="no way from a to b"):
        Wiring(beside(3, 17) | wall, (20, 10)).connect("a", "b")


def test_two_crossings_are_better_than_a_common_piece_in_a_gap():
    walls = {f"wall {y}": Box(10, y, 0, half) for y, half in ((2, 2), (7, 1), (12, 2))}
    ends = {name: Box(x, y, 2, 1) for name, x, y in (("a", 3, 5), ("b", 17, 5))}
    ends |= {name: Box(x, y, 2, 1) for name, x, y in (("c", 3, 1), ("d", 17, 1))}
    wiring = Wiring(ends | walls, (20, 14))
    first, second = wiring.connect("a", "b"), wiring.connect("c", "d")
    assert (10, 5) in first
    assert (10, 9) in second
