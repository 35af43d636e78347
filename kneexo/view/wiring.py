"""Routes wires between boxes on a grid: few bends, few crossings, none through a box."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush

Point = tuple[int, int]
"""A point of the grid, (x, y)."""

_DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1))
_BEND, _SHARED, _END_IN_USE, _BESIDE_BOX, _OFF_CENTRE = 4.0, 5.0, 60.0, 2.0, 0.4
"""Costs of a route in steps of the grid. A point in another wire costs `_SHARED`."""


@dataclass(frozen=True)
class Box:
    """A box on the grid: its centre, and the distances from the centre to its sides."""

    x: int
    y: int
    half_width: int
    half_height: int

    def points(self, margin: int = 0) -> Iterator[Point]:
        """Yield the points in the box and at most ``margin`` outside of it."""
        width, height = self.half_width + margin, self.half_height + margin
        for x in range(self.x - width, self.x + width + 1):
            for y in range(self.y - height, self.y + height + 1):
                yield x, y

    def ports(self) -> Iterator[tuple[Point, Point, float]]:
        """Yield the points at which a wire can end, with the direction outwards and the cost.

        Points near the middle of a side are cheap. No wire ends next to a corner.
        """
        for way in _DIRECTIONS:
            span = self.half_height if way[0] else self.half_width
            for offset in range(1 - span, span):
                x = self.x + way[0] * self.half_width + abs(way[1]) * offset
                y = self.y + way[1] * self.half_height + abs(way[0]) * offset
                yield (x, y), way, _OFF_CENTRE * abs(offset)


class Wiring:
    """Wires among ``boxes`` on a grid of ``size`` (columns, rows)."""

    def __init__(self, boxes: Mapping[str, Box], size: Point) -> None:
        self._boxes, self._size = boxes, size
        self._owner = {point: name for name, box in boxes.items() for point in box.points()}
        self._beside = {point for box in boxes.values() for point in box.points(1)}
        self._points: set[Point] = set()

    def connect(self, source: str, target: str) -> list[Point]:
        """Add the cheapest wire from ``source`` to ``target``; return its points from end to end.

        The search is Dijkstra's, over points and the direction of the last step.
        """
        ends = {(p, (-way[0], -way[1])): cost for p, way, cost in self._boxes[target].ports()}
        queue: list[tuple[float, Point, Point]] = []
        best: dict[tuple[Point, Point], float] = {}
        came: dict[tuple[Point, Point], tuple[Point, Point]] = {}
        for point, way, cost in self._boxes[source].ports():
            price = cost + (_END_IN_USE if point in self._points else 0.0)
            best[point, way] = price
            heappush(queue, (price, point, way))
        goal, lowest = None, float("inf")
        while queue and queue[0][0] < lowest:
            price, point, way = heappop(queue)
            if price > best[point, way]:
                continue
            if (point, way) in ends and (point, way) in came:
                shared = _END_IN_USE if point in self._points else 0.0
                if price + ends[point, way] + shared < lowest:
                    goal, lowest = (point, way), price + ends[point, way] + shared
                continue
            for turn in _DIRECTIONS if (point, way) in came else (way,):
                if turn == (-way[0], -way[1]):
                    continue
                after = (point[0] + turn[0], point[1] + turn[1])
                step = self._step(after, target)
                if step is None:
                    continue
                total = price + step + (_BEND if turn != way else 0.0)
                if total < best.get((after, turn), float("inf")):
                    best[after, turn], came[after, turn] = total, (point, way)
                    heappush(queue, (total, after, turn))
        if goal is None:
            raise ValueError(f"no way from {source} to {target}")
        return self._laid(goal, came)

    def _step(self, after: Point, target: str) -> float | None:
        """Return the cost of a step to ``after``, or None outside the grid or in another box."""
        if not (0 < after[0] < self._size[0] and 0 < after[1] < self._size[1]):
            return None
        if self._owner.get(after, target) != target:
            return None
        cost = 1.0 + (_BESIDE_BOX if after in self._beside else 0.0)
        return cost + (_SHARED if after in self._points else 0.0)

    def _laid(
        self, goal: tuple[Point, Point], came: Mapping[tuple[Point, Point], tuple[Point, Point]]
    ) -> list[Point]:
        """Return the points of the found wire to ``goal``, which cost more for later wires.

        ``came`` maps each place of the search to the place before.
        """
        path, at = [goal[0]], goal
        while at in came:
            at = came[at]
            path.append(at[0])
        path.reverse()
        self._points.update(path)
        return path


def corners(path: Sequence[Point]) -> list[Point]:
    """Return the ends and the bends of a path."""
    inner = [
        b
        for a, b, c in zip(path, path[1:], path[2:], strict=False)
        if (b[0] - a[0], b[1] - a[1]) != (c[0] - b[0], c[1] - b[1])
    ]
    return [path[0], *inner, path[-1]]
