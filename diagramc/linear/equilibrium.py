"""Finds equilibria of diagrams whose states are continuous, discrete or both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import names, quoted
from ..equations.contexts import set_state
from ..errors import NoEquilibriumError, ParameterError, shown
from ..run_data import Array, Integers, State, slices
from .newton import newton
from .point import EQUILIBRIUM_TOLERANCE, Point, require_tolerance
from .reading import read_point, system_of


def find_equilibrium(
    diagram: Any,
    context: Any = None,
    *,
    fixed: Iterable[str] = (),
    free_inputs: Iterable[str] = (),
    outputs: Mapping[str, ArrayLike] | None = None,
    bypass: Iterable[str] = (),
    equilibrium_tolerance: float = EQUILIBRIUM_TOLERANCE,
) -> Any:
    """Return a new Context in which all states of a diagram of floats rest.

    A state rests if its rate is zero, or, for a discrete state, if no update changes the state. The
    search is Newton's method with exact derivatives, from the state in ``context``. If Newton's
    method fails, a search by least squares follows. A state without influence keeps its value. The
    time is the time of the Context.

    Parameters
    ----------
    diagram, context
        As in `linearize`. Input ports have the values of the Context.
    fixed
        Names of states that keep their values, such as ``pendulum.theta``.
    free_inputs
        Names of input ports of the diagram whose values the search finds, as in trimming a vehicle.
        The search starts at the value in the Context, or at zero.
    outputs
        Dictionary from names of output ports, or ``path/of/system:port``, to the values that they
        must have.
    bypass
        Paths of systems that count as wires, as in `linearize`.
    equilibrium_tolerance
        As in `linearize`, and the largest absolute error of ``outputs``.

    Raises
    ------
    NoEquilibriumError
        There is no equilibrium near the start. The message names the state that still moves most.
    CompilationError, ParameterError
        As in `linearize`. Also for a name in ``fixed`` that is no state, and for an output value of
        a wrong size.
    """
    targets = {} if outputs is None else outputs
    if not isinstance(targets, Mapping):
        raise ParameterError(
            f"outputs = {quoted(outputs)}: must be a dictionary from names of ports to values"
        )
    in_names, out_names = names("free_inputs", free_inputs), names("outputs", targets)
    require_tolerance(equilibrium_tolerance)
    system = system_of(diagram)
    context = system.CreateDefaultContext() if context is None else context
    start = read_point(diagram, context, in_names, out_names, bypass, "free_inputs")
    for name in in_names:
        if not system.HasInputPort(name):
            raise ParameterError(
                f"free_inputs: {quoted(name)} is no input port of the diagram itself"
            )
    required = _required_values(start, targets)
    free_inputs_count = len(start.element_names(in_names))
    inputs_after_states = start.state.size + np.arange(free_inputs_count)
    free = np.concatenate([_free_states(start, fixed), inputs_after_states])
    problem = _Problem(start, free, out_names, required)
    for unknowns in _searches(problem.residual, problem.start_values[problem.free]):
        point = problem.point(unknowns)
        slopes = point.slopes(out_names)
        fault = point.motion(slopes, equilibrium_tolerance)
        is_reached = np.abs(slopes.outputs - required) <= equilibrium_tolerance  # False for nan
        if not fault and not is_reached.all():
            fault = _wrong_output(point.element_names(out_names), slopes.outputs, required)
        if not fault:
            return _context_at(system, context, point, in_names)
    raise NoEquilibriumError(
        f"no equilibrium near the start: where the search ends, {fault}; start nearer, free an "
        f"input (free_inputs), or fix fewer states (fixed)",
        fault,
    )


@dataclass(frozen=True)
class _Problem:
    """The search for an equilibrium as equations for Newton's method.

    The unknowns are the free states and the free inputs. The rates of continuous states, the
    changes of discrete states and the errors of ``outputs`` must become zero. ``required`` has the
    values that these outputs must have. ``free`` has the indices of the unknowns among all states
    followed by all inputs.
    """

    start: Point
    free: Integers
    outputs: tuple[str, ...]
    required: Array

    @property
    def start_values(self) -> Array:
        """States and inputs at the start, one after the other."""
        return np.concatenate([self.start.state, self.start.inputs])

    def point(self, unknowns: Array) -> Point:
        """Return the point with these values of the unknowns; all else is as at the start."""
        values = self.start_values
        values[self.free] = unknowns
        state_count = self.start.state.size
        return self.start.at(values[:state_count], values[state_count:])

    def residual(self, unknowns: Array) -> tuple[Array, Array]:
        """Return the rates, changes and errors that must become zero, and their Jacobian.

        The Jacobian has a column for each unknown.
        """
        point = self.point(unknowns)
        slopes = point.slopes(self.outputs)
        jacobian = np.vstack([point.residual_jacobian(slopes), slopes.outputs_jacobian])
        return (
            np.concatenate([point.residual(slopes.rates), slopes.outputs - self.required]),
            jacobian[:, self.free],
        )


def _wrong_output(names: tuple[str, ...], values: Array, required: Array) -> str:
    """Return a text that names the output with the largest error."""
    element = int(np.argmax(np.abs(values - required)))
    return f"{names[element]} = {values[element]:.6g} in place of {required[element]:.6g}"


def _required_values(point: Point, targets: Mapping[str, ArrayLike]) -> Array:
    """Flatten ``targets``, the values that the equilibrium must have at output ports, to a vector.

    Raises `ParameterError` for values that are not finite, or too many or too few.
    """
    vectors = [np.empty(0)]
    for name, value in targets.items():
        size = len(point.element_names([name]))
        try:
            vector = np.atleast_1d(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            vector = np.empty(0)
        if vector.shape != (size,) or not np.isfinite(vector).all():
            kind = "a finite number" if size == 1 else f"{size} finite numbers"
            raise ParameterError(f"outputs: {shown(name)} = {quoted(value)}: must be {kind}")
        vectors.append(vector)
    return np.concatenate(vectors)


def _free_states(point: Point, fixed: Iterable[str]) -> Array:
    """Return the indices of the states that are not fixed."""
    held = names("fixed", fixed)
    for name in held:
        if name not in point.state_names:
            raise ParameterError(
                f"fixed: {quoted(name)} is no state; the states are "
                f"{shown(', '.join(point.state_names))}"
            )
    return np.array([i for i, name in enumerate(point.state_names) if name not in held], dtype=int)


def _searches(function: Any, start: Array) -> Iterator[Array]:
    """Yield points that may be zeros of a function, by Newton's method and by least squares.

    ``function(point)`` returns value and Jacobian.
    """
    if not start.size:
        yield start
        return
    yield newton(function, start)
    if not all(np.isfinite(part).all() for part in function(start)):
        return  # least_squares refuses such a start
    # Newton's steps can grow: those for arctan x = 0 do from |x| = 1.39 on. Least squares then
    # comes near the zero, and Newton's method gives the last digits.
    nearest = scipy.optimize.least_squares(
        lambda point: function(point)[0],
        start,
        lambda point: function(point)[1],
        xtol=1e-15,
        max_nfev=50,
    )
    yield newton(function, nearest.x)
    yield nearest.x


def _context_at(diagram: Any, context: Any, point: Point, in_names: Iterable[str]) -> Any:
    """Return a copy of ``context`` with the state and the inputs of a point.

    ``in_names``: names of the input ports of the diagram whose values are set.
    """
    context = context.Clone()
    count = len(point.read.state_names)
    set_state(point.read.root, context, State(point.state[:count], point.state[count:]))
    places = slices(point.read.equations.inputs)
    for name in in_names:
        diagram.GetInputPort(name).FixValue(context, point.inputs[places[name]])
    return context
