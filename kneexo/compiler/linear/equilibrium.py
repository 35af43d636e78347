"""Finds equilibria of diagrams whose states are continuous, discrete or both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import names, quoted
from ..equations.contexts import set_state
from ..errors import NoEquilibriumError, ParameterError, shown
from ..run_data import Array, State
from .newton import newton
from .point import EQUILIBRIUM_TOLERANCE, Point, read_point, require_tolerance, system_of


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

    There all rates of continuous states are zero, and no update changes a discrete state. The
    search is Newton's method with exact derivatives, from the state in ``context``. Where it fails,
    a search by least squares follows. A state without influence keeps its value. The time is that
    of the Context.

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
    required = _target(start, targets)
    n, m = start.state.size, len(start.element_names(in_names))
    free = np.concatenate([_free_states(start, fixed), n + np.arange(m)])

    def point_at(unknowns: Array) -> Point:
        values = np.concatenate([start.state, start.inputs])
        values[free] = unknowns
        return start.at(values[:n], values[n:])

    def function(unknowns: Array) -> tuple[Array, Array]:
        point = point_at(unknowns)
        slopes = point.slopes(out_names)
        return (
            np.concatenate([point.residual(slopes.rates), slopes.outputs - required]),
            np.vstack([point.residual_jacobian(slopes), slopes.outputs_jacobian])[:, free],
        )

    for unknowns in _searches(function, np.concatenate([start.state, start.inputs])[free]):
        point = point_at(unknowns)
        slopes = point.slopes(out_names)
        fault = point.motion(slopes, equilibrium_tolerance)
        error = slopes.outputs - required
        if not fault and not (np.abs(error) <= equilibrium_tolerance).all():
            fault = _wrong_output(point.element_names(out_names), slopes.outputs, required)
        if not fault:
            return _context_at(system, context, point, in_names)
    raise NoEquilibriumError(
        f"no equilibrium near the start: where the search ends, {fault}; start nearer, free an "
        f"input (free_inputs), or fix fewer states (fixed)",
        fault,
    )


def _wrong_output(names: tuple[str, ...], values: Array, required: Array) -> str:
    """Return a text that names the output with the largest error."""
    element = int(np.argmax(np.abs(values - required)))
    return f"{names[element]} = {values[element]:.6g} in place of {required[element]:.6g}"


def _target(point: Point, targets: Mapping[str, ArrayLike]) -> Array:
    """Return the values of all elements of the outputs, one after the other."""
    rows = [np.empty(0)]
    for name, value in targets.items():
        size = len(point.element_names([name]))
        try:
            row = np.atleast_1d(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            row = np.empty(0)
        if row.shape != (size,) or not np.isfinite(row).all():
            kind = "a finite number" if size == 1 else f"{size} finite numbers"
            raise ParameterError(f"outputs: {shown(name)} = {quoted(value)}: must be {kind}")
        rows.append(row)
    return np.concatenate(rows)


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
    """Yield points that may be zeros of a function with Jacobian, by Newton and least squares."""
    if not start.size:
        yield start
        return
    yield newton(function, start)
    if not all(np.isfinite(part).all() for part in function(start)):
        return
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
    """Return a copy of a Context with the state of a point, and its values of input ports."""
    context = context.Clone()
    count = len(point.read.state_names)
    set_state(point.read.root, context, State(point.state[:count], point.state[count:]))
    first = 0
    for name in in_names:
        size = point.read.equations.inputs[name]
        diagram.GetInputPort(name).FixValue(context, point.inputs[first : first + size])
        first += size
    return context
