"""Names the blocks of a diagram that spoil its linear model, with the reason and a remedy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arguments import names
from ..equations.equations import Section
from ..equations.operations import OPERATIONS, Role
from ..equations.ports import can_bypass
from ..run_data import Array
from .point import EQUILIBRIUM_TOLERANCE, Point, Slopes, read_point, require_tolerance

_AT_CORNER = 1e-9  # relative distance of two numbers that counts as equal
_CORNERS = {"where": "a switch", "abs": "an absolute value", "min": "a minimum", "max": "a maximum"}
_ROUNDING = 1e-9  # relative size of a difference that counts as zero
_RANK = 1e-10  # relative size of a singular value that counts as zero


@dataclass(frozen=True)
class Obstacle:
    """What prevents a useful linear model at an operating point: block, reason and remedy."""

    path: str
    """Path of the leaf system."""
    port: str
    """The output port, update or state, such as ``output port y0``."""
    reason: str
    remedy: str

    def __str__(self) -> str:
        """Return the obstacle as one line."""
        return f"{self.path}: {self.port}: {self.reason}; {self.remedy}"


def advice(
    diagram: Any,
    context: Any = None,
    *,
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    bypass: Iterable[str] = (),
    equilibrium_tolerance: float = EQUILIBRIUM_TOLERANCE,
) -> list[Obstacle]:
    """Return what spoils a linear model of a diagram at an operating point, in Drake's order.

    The function reads the equations that the states and ``outputs`` depend on. It reports these
    obstacles.

    - The derivative of a quantizer is zero.
    - A port depends on a signal, but its derivative is zero. The block is a saturation at its
      limit, a dead zone, or a switch to a constant.
    - A switch, an absolute value, a minimum or a maximum is at its corner. The derivatives on both
      sides differ.
    - A derivative is not finite, such as that of a root at zero.
    - No state can bring the rate of a state to zero. The state is, for example, an integrator of a
      constant.
    - The point is not an equilibrium, for another reason.

    Parameters
    ----------
    diagram
        A Diagram or leaf system that `compile_diagram` accepts.
    context
        The operating point: parameters, state, time and values of the input ports. None: the
        default Context.
    inputs, outputs
        Names of ports, ``path/of/system:port`` for a port inside the diagram, as in `linearize`.
    bypass
        Paths of systems without state that count as wires, as in `linearize`.
    equilibrium_tolerance
        Largest rate of a continuous state, and change of a discrete state, at an equilibrium.

    Raises
    ------
    CompilationError, ParameterError
        As in `linearize`.
    LinearizationError
        A state or an input is not finite.
    """
    in_names, out_names = names("inputs", inputs), names("outputs", outputs)
    require_tolerance(equilibrium_tolerance)
    point = read_point(diagram, context, in_names, out_names, bypass)
    slopes = point.slopes(out_names)
    if not np.isfinite([*point.state, *point.inputs]).all():
        point.require_finite(slopes, out_names)
    found = [*obstacles(point, out_names)]
    if not found:
        point.require_finite(slopes, out_names)
    rest = list(_blocked_states(point, slopes, equilibrium_tolerance))
    return found + (rest or _moving_state(point, slopes, equilibrium_tolerance))


def obstacles(point: Point, outputs: Iterable[str] = ()) -> list[Obstacle]:
    """Return the obstacles in the equations of states and outputs at a point, as `advice` does."""
    survey = _Survey(point, outputs)
    by_port: dict[tuple[str, str], Obstacle] = {}
    for section, reason, remedy in survey.faults():
        path, _, port = section.where.rpartition(": ")
        if can_bypass(point.read.root, path):
            remedy += f", or bypass=[{path!r}]"
        by_port.setdefault((path, port), Obstacle(path, port, reason, remedy))
    return list(by_port.values())


class _Survey:
    """Values and derivatives of all nodes that states and outputs depend on at a point."""

    def __init__(self, point: Point, outputs: Iterable[str]) -> None:
        self.point = point
        self.graph = point.read.equations.graph
        self.roots = point.roots(outputs)
        self.derivatives = point.derivatives(outputs)
        self.nodes, self.place = self.derivatives.nodes, self.derivatives.place
        names = {node: str(self.graph.nodes[node][0]) for node in self.nodes}
        self.roles = {n: OPERATIONS[name].role for n, name in names.items() if name in OPERATIONS}
        self.values, self.rows = self._derivatives(())
        rounding = self._rounding(self.nodes)
        self.smooth_rows = self._derivatives(rounding)[1] if rounding else self.rows
        """The derivatives if all quantizers had the derivative 1."""

    def faults(self) -> Iterator[tuple[Section, str, str]]:
        """Yield the section of each obstacle with reason and remedy, in the order of sections.

        The first pass finds quantizers. The second pass finds corners, as if these quantizers had
        the derivative 1. Otherwise all derivatives behind a quantizer would be zero.
        """
        sections = list(self._sections())
        rounded = [self._rounds(ends, inside) for _, ends, inside in sections]
        if any(rounded):
            self.rows = self._derivatives([node for nodes in rounded for node in nodes])[1]
        for (section, ends, inside), nodes in zip(sections, rounded, strict=True):
            if nodes:
                yield section, "rounds its input: its derivative is zero", "remove the quantizer"
            for node in inside:
                if fault := self._fault(node, ends):
                    yield section, *fault

    def _sections(self) -> Iterator[tuple[Section, list[int], list[int]]]:
        """Yield each section with the nodes that it computes, and the nodes of its own.

        Nodes without effect are left out, such as those of the other branch of a choice.
        """
        acting = set(self.graph.reachable(self.roots, self.taken))
        known: set[int] = set()
        for section in self.point.read.equations.sections:
            ends = [node for node in section.nodes if node in acting]
            inside = set(self.graph.reachable(ends, self.taken)) - known
            known |= inside
            yield section, ends, sorted(inside)

    def taken(self, node: int) -> tuple[int, ...]:
        """Return the arguments that act on the value of a node. A choice has its taken branch."""
        arguments = self.graph.arguments(node)
        if self.graph.nodes[node][0] == "where":
            condition, positive, otherwise = arguments
            return (positive if self.value(condition) else otherwise,)
        return arguments

    def value(self, node: int) -> float:
        return float(self.values[self.place[node]])

    def row(self, node: int) -> Array:
        return np.asarray(self.rows[self.place[node]])

    def _derivatives(self, rounding: Iterable[int]) -> tuple[Array, Array]:
        """Return values and derivatives of all nodes, with the derivative 1 of some quantizers."""
        return self.derivatives.at(self.point.sources, rounding)

    def _rounding(self, nodes: Iterable[int]) -> list[int]:
        return [node for node in nodes if self.roles.get(node) is Role.ROUNDING]

    def _rounds(self, ends: list[int], inside: list[int]) -> list[int]:
        """Return the quantizers in a section that cost one of its results a derivative."""
        rounding = self._rounding(inside)
        return rounding if rounding and any(self._is_rounded(end) for end in ends) else []

    def _fault(self, node: int, ends: list[int]) -> tuple[str, str] | None:
        """Return reason and remedy if a node of the section that computes ``ends`` is at fault."""
        name = str(self.graph.nodes[node][0])
        if not self._is_finite(node) and all(map(self._is_finite, self.taken(node))):
            return f"the derivative of {name} is not finite", "choose another operating point"
        if self.roles.get(node) is not Role.CORNER:
            return None
        if self._at_corner(node):
            return (
                f"{_CORNERS[name]} is at its corner: the derivatives on both sides differ",
                "choose another operating point",
            )
        if self._is_constant(node) and any(self._blocks(node, end) for end in ends):
            return (
                f"is constant at {self.value(node):.6g} here, as at a limit or in a dead zone: its "
                f"derivative is zero",
                "choose an operating point inside the limits",
            )
        return None

    def _is_finite(self, node: int) -> bool:
        """Return whether all derivatives of a node are finite."""
        return bool(np.isfinite(self.row(node)).all())

    def _blocks(self, node: int, end: int) -> bool:
        """Return whether ``node`` may be why the result ``end`` has no derivative.

        The result depends on the node, but all its derivatives are zero.
        """
        return not self.row(end).any() and node in self.graph.reachable([end], self.taken)

    def _is_rounded(self, node: int) -> bool:
        """Return whether a node loses its derivative, or a part of it, by a quantizer.

        An angle without whole turns, ψ − 2π ⌈ψ/2π − ½⌉, loses nothing. With the derivative 1 of
        the quantizer its derivative would be zero.
        """
        smooth, rounded = self.smooth_rows[self.place[node]], self.row(node)
        changes = bool((smooth != rounded).any())
        return changes and np.abs(smooth).max() > _ROUNDING * np.abs(rounded).max()

    def _at_corner(self, node: int) -> bool:
        """Return whether a corner operation is at its corner, and its two derivatives differ."""
        name, arguments = self.graph.nodes[node][0], self.graph.arguments(node)
        if name == "abs":
            return bool(abs(self.value(arguments[0])) <= _AT_CORNER and self.row(*arguments).any())
        branches = arguments[-2:]
        if np.array_equal(self.row(branches[0]), self.row(branches[1])):
            return False
        if name != "where":
            return self._equal(*arguments)
        compared = [
            self.graph.arguments(n)
            for n in self.graph.reachable(arguments[:1], self._conditions)
            if self.roles.get(n) is Role.COMPARISON
        ]
        return any(self._equal(*pair) and self._moves(pair) for pair in compared)

    def _conditions(self, node: int) -> tuple[int, ...]:
        return self.graph.arguments(node) if self.roles.get(node) is Role.LOGIC else ()

    def _moves(self, nodes: Iterable[int]) -> bool:
        return any(self.row(node).any() for node in nodes)

    def _equal(self, left: int, right: int) -> bool:
        a, b = self.value(left), self.value(right)
        return abs(a - b) <= _AT_CORNER * max(1.0, abs(a), abs(b))

    def _is_constant(self, node: int) -> bool:
        """Return whether a corner operation has the derivative zero, and its other branch not."""
        branches = self.graph.arguments(node)[-2:]
        return not self.row(node).any() and self._moves(branches)


def _moving_state(point: Point, slopes: Slopes, tolerance: float) -> list[Obstacle]:
    """Return an obstacle for the state that moves most, or no obstacle at an equilibrium."""
    if not np.isfinite(slopes.rates_jacobian).all():  # see `_Survey.faults`
        return []
    if not (moving := point.motion(slopes, tolerance)):
        return []
    name = point.state_names[int(np.nanargmax(np.abs(point.residual(slopes.rates))))]
    return [
        Obstacle(
            name.rpartition(".")[0] or name,
            f"state {name}",
            f"is not at rest: {moving}",
            "use find_equilibrium, or equilibrium_tolerance=math.inf",
        )
    ]


def _blocked_states(point: Point, slopes: Slopes, tolerance: float) -> Iterator[Obstacle]:
    """Yield an obstacle for each combination of rates that no state can bring to zero.

    Such a combination w is a left null vector of the Jacobian of the residual r, with w·r ≠ 0.
    """
    residual, jacobian = point.residual(slopes.rates), point.residual_jacobian(slopes)
    jacobian = jacobian[:, : residual.size]
    if not residual.size or not np.isfinite(jacobian).all():
        return
    size = np.linalg.norm(jacobian, axis=1)
    size[size == 0.0] = 1.0
    basis, singular, _ = np.linalg.svd(jacobian / size[:, None])
    for vector in basis.T[singular <= _RANK * max(1.0, singular[0])]:
        if abs(vector @ (residual / size)) <= tolerance * np.max(np.abs(vector) / size):
            continue
        index = int(np.argmax(np.abs(vector * residual / size)))
        name = point.state_names[index]
        rate = "per s" if index < len(point.read.state_names) else "per update"
        yield Obstacle(
            name.rpartition(".")[0] or name,
            f"state {name}",
            f"changes by {residual[index]:.6g} {rate}, and no state brings this to zero",
            "close a loop around it, set its input to zero, or pass equilibrium_tolerance=math.inf",
        )
