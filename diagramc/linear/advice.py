"""Names the blocks of a diagram that spoil its linear model, with the reason and a remedy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from ..arguments import names
from ..equations.equations import Section
from ..equations.operations import OPERATIONS, Role
from ..equations.ports import can_bypass
from ..run_data import Array
from .leafwise import LeafwisePoint
from .point import (
    EQUILIBRIUM_TOLERANCE,
    Obstacle as Obstacle,
    Point,
    Slopes,
    require_tolerance,
)
from .reading import read_point

_AT_CORNER = 1e-9  # relative distance of two numbers that counts as equal
_CORNERS = {"where": "a switch", "abs": "an absolute value", "min": "a minimum", "max": "a maximum"}
_ROUNDING = 1e-9  # relative size of a difference that counts as zero
_RANK = 1e-10  # relative size of a singular value that counts as zero


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

    The function reads the equations on which the states and ``outputs`` depend, and reports these
    obstacles.

    - The derivative of a quantizer is zero.
    - A port depends on a signal, but its derivative is zero. The block is a saturation at its
      limit, a dead zone, or a switch to a constant.
    - A switch, an absolute value, a minimum or a maximum is at its corner. The derivatives on both
      sides differ.
    - A derivative is not finite, such as the derivative of a root at zero.
    - No state can bring the rate of a state to zero. The state is, for example, an integrator of a
      constant.
    - The point is not an equilibrium, for another reason.

    Parameters
    ----------
    diagram
        A Diagram or leaf system, as in `linearize`. Without symbolic equations, the obstacles are
        values that change without a derivative, derivatives by differences, and quaternions.
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
    """Return all obstacles to a useful linear model in the equations of states and outputs."""
    if isinstance(point, LeafwisePoint):
        point.slopes(tuple(outputs))
        return list(point.gaps.values())
    survey = _Survey(point, outputs)
    by_port: dict[tuple[str, str], Obstacle] = {}
    for section, reason, remedy in survey.faults():
        path, _, port = section.where.rpartition(": ")
        if can_bypass(point.read.root, path):
            remedy += f", or bypass=[{path!r}]"
        by_port.setdefault((path, port), Obstacle(path, port, reason, remedy))
    return list(by_port.values())


class _Survey:
    """Finds obstacles to a linear model by the values and derivatives of nodes at a point.

    The nodes are those on which the rates, the updates and the outputs ``outputs`` depend.
    """

    def __init__(self, point: Point, outputs: Iterable[str]) -> None:
        self.point = point
        self.graph = point.read.equations.graph
        self.roots = point.roots(outputs)
        self.derivatives = point.derivatives(outputs)
        self.nodes, self.place = self.derivatives.nodes, self.derivatives.place
        names = {node: str(self.graph.nodes[node][0]) for node in self.nodes}
        self.roles = {n: OPERATIONS[name].role for n, name in names.items() if name in OPERATIONS}
        self.values, self.gradients = self._evaluated(())
        """Value of each node (nodes,), and its derivatives by the variables (nodes, variables)."""
        quantizers = self._quantizers_among(self.nodes)
        self.smooth_gradients = self._evaluated(quantizers)[1] if quantizers else self.gradients
        """The derivatives if all quantizers had the derivative 1."""

    def faults(self) -> Iterator[tuple[Section, str, str]]:
        """Yield the section of the equations, the reason and the remedy of each obstacle.

        The obstacles come in the order of the sections. The first pass finds quantizers. The second
        pass finds corners, as if these quantizers had the derivative 1. Otherwise all derivatives
        behind a quantizer would be zero.
        """
        sections = list(self._sections())
        harmful = [self._harmful_quantizers(results, nodes) for _, results, nodes in sections]
        if any(harmful):
            self.gradients = self._evaluated([node for nodes in harmful for node in nodes])[1]
        for (section, results, own_nodes), quantizers in zip(sections, harmful, strict=True):
            if quantizers:
                yield section, "rounds its input: its derivative is zero", "remove the quantizer"
            for node in own_nodes:
                if fault := self._fault(node, results):
                    yield section, *fault

    def _sections(self) -> Iterator[tuple[Section, list[int], list[int]]]:
        """Yield each section of the equations, its results, and its own nodes.

        The own nodes are those that no earlier section has. Nodes without effect are left out, such
        as the nodes of a branch that is not taken.
        """
        acting = set(self.graph.reachable(self.roots, self.acting_arguments))
        known: set[int] = set()
        for section in self.point.read.equations.sections:
            results = [node for node in section.nodes if node in acting]
            own_nodes = set(self.graph.reachable(results, self.acting_arguments)) - known
            known |= own_nodes
            yield section, results, sorted(own_nodes)

    def acting_arguments(self, node: int) -> tuple[int, ...]:
        """Return the arguments that act on the value of a node.

        The only such argument of a choice (``where``) is the branch that is taken.
        """
        arguments = self.graph.arguments(node)
        if self.graph.nodes[node][0] == "where":
            condition, positive, otherwise = arguments
            return (positive if self.value(condition) else otherwise,)
        return arguments

    def value(self, node: int) -> float:
        return float(self.values[self.place[node]])

    def gradient(self, node: int) -> Array:
        return np.asarray(self.gradients[self.place[node]])

    def _evaluated(self, smooth: Iterable[int]) -> tuple[Array, Array]:
        """Return values and derivatives of all nodes.

        The quantizers ``smooth`` get the derivative 1. All other quantizers have the derivative 0.
        """
        return self.derivatives.at(self.point.sources, smooth)

    def _quantizers_among(self, nodes: Iterable[int]) -> list[int]:
        return [node for node in nodes if self.roles.get(node) is Role.ROUNDING]

    def _harmful_quantizers(self, results: list[int], own_nodes: list[int]) -> list[int]:
        """Return the quantizers of a section if they spoil the derivative of one of its results.

        ``own_nodes`` are the nodes of the section. Otherwise the list is empty.
        """
        quantizers = self._quantizers_among(own_nodes)
        if quantizers and any(map(self._loses_derivative, results)):
            return quantizers
        return []

    def _fault(self, node: int, results: list[int]) -> tuple[str, str] | None:
        """Return reason and remedy if a node spoils the derivatives of the nodes ``results``."""
        name = str(self.graph.nodes[node][0])
        if not self._is_finite(node) and all(map(self._is_finite, self.acting_arguments(node))):
            return f"the derivative of {name} is not finite", "choose another operating point"
        if self.roles.get(node) is not Role.CORNER:
            return None
        if self._at_corner(node):
            return (
                f"{_CORNERS[name]} is at its corner: the derivatives on both sides differ",
                "choose another operating point",
            )
        if self._is_constant(node) and any(self._blocks(node, result) for result in results):
            return (
                f"is constant at {self.value(node):.6g} here, as at a limit or in a dead zone: its "
                f"derivative is zero",
                "choose an operating point inside the limits",
            )
        return None

    def _is_finite(self, node: int) -> bool:
        """Return whether all derivatives of a node are finite."""
        return bool(np.isfinite(self.gradient(node)).all())

    def _blocks(self, node: int, result: int) -> bool:
        """Return whether ``node`` can be the cause of zero derivatives of the node ``result``.

        It can if ``result`` depends on ``node`` and all derivatives of ``result`` are zero.
        """
        if self.gradient(result).any():
            return False
        return node in self.graph.reachable([result], self.acting_arguments)

    def _loses_derivative(self, node: int) -> bool:
        """Return whether quantizers take the derivative, or a part of it, from a node.

        The node is compared with itself if all quantizers had the derivative 1. An angle without
        whole turns, ψ − 2π ⌈ψ/2π − ½⌉, loses nothing: with the derivative 1 of its quantizer, its
        own derivative would be zero.
        """
        smooth, actual = self.smooth_gradients[self.place[node]], self.gradient(node)
        differs = bool((smooth != actual).any())
        return differs and np.abs(smooth).max() > _ROUNDING * np.abs(actual).max()

    def _at_corner(self, node: int) -> bool:
        """Return whether a corner operation is at its corner, and its two derivatives differ."""
        name, arguments = self.graph.nodes[node][0], self.graph.arguments(node)
        if name == "abs":
            return abs(self.value(arguments[0])) <= _AT_CORNER and self._depends(arguments)
        branches = arguments[-2:]
        if np.array_equal(self.gradient(branches[0]), self.gradient(branches[1])):
            return False
        if name != "where":
            return self._equal(*arguments)
        compared = [
            self.graph.arguments(n)
            for n in self.graph.reachable(arguments[:1], self._conditions)
            if self.roles.get(n) is Role.COMPARISON
        ]
        return any(self._equal(*pair) and self._depends(pair) for pair in compared)

    def _conditions(self, node: int) -> tuple[int, ...]:
        return self.graph.arguments(node) if self.roles.get(node) is Role.LOGIC else ()

    def _depends(self, nodes: Iterable[int]) -> bool:
        """Return whether a derivative of one of the nodes is not zero."""
        return any(self.gradient(node).any() for node in nodes)

    def _equal(self, left: int, right: int) -> bool:
        a, b = self.value(left), self.value(right)
        return abs(a - b) <= _AT_CORNER * max(1.0, abs(a), abs(b))

    def _is_constant(self, node: int) -> bool:
        """Return whether a corner operation is constant here, although one of its branches is not.

        An example is a saturation at its limit.
        """
        branches = self.graph.arguments(node)[-2:]
        return not self.gradient(node).any() and self._depends(branches)


def _moving_state(point: Point, slopes: Slopes, tolerance: float) -> list[Obstacle]:
    """Return an obstacle for the state that moves most, or no obstacle at an equilibrium."""
    if not np.isfinite(slopes.rates_jacobian).all():  # see `_Survey.faults`
        return []
    if not (moving := point.motion(slopes, tolerance)):
        return []
    index = int(np.nanargmax(np.abs(point.residual(slopes.rates))))
    remedy = "use find_equilibrium, or equilibrium_tolerance=math.inf"
    return [_of_state(point, index, f"is not at rest: {moving}", remedy)]


def _of_state(point: Point, index: int, reason: str, remedy: str) -> Obstacle:
    name = point.state_names[index]
    return Obstacle(name.rpartition(".")[0] or name, f"state {name}", reason, remedy)


def _blocked_states(point: Point, slopes: Slopes, tolerance: float) -> Iterator[Obstacle]:
    """Yield an obstacle for each combination of rates that no state can bring to zero.

    The combinations are w·r of the rates r, where w is a left null vector of the Jacobian of r and
    w·r ≠ 0.
    """
    residual, jacobian = point.residual(slopes.rates), point.residual_jacobian(slopes)
    jacobian = jacobian[:, : residual.size]
    if not residual.size or not np.isfinite(jacobian).all():
        return
    scale = np.linalg.norm(jacobian, axis=1)  # the rates have different units
    scale[scale == 0.0] = 1.0
    left_vectors, singular_values, _ = np.linalg.svd(jacobian / scale[:, None])
    is_null = singular_values <= _RANK * max(1.0, singular_values[0])
    for weights in left_vectors.T[is_null]:
        if abs(weights @ (residual / scale)) <= tolerance * np.max(np.abs(weights) / scale):
            continue
        index = int(np.argmax(np.abs(weights * residual / scale)))
        rate = "per s" if index < len(point.read.state_names) else "per update"
        yield _of_state(
            point,
            index,
            f"changes by {residual[index]:.6g} {rate}, and no state brings this to zero",
            "close a loop around it, set its input to zero, or pass equilibrium_tolerance=math.inf",
        )
