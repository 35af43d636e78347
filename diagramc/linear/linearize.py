"""Exact linear models of diagrams whose states are continuous, discrete or both."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ..arguments import names, positive
from ..equations.equations import Update
from ..equations.ports import vector_names
from ..errors import LinearizationError, ParameterError
from ..native.timing import timing
from ..run_data import Array
from .advice import obstacles
from .leafwise import LeafwisePoint
from .model import LinearModel, OperatingPoint, TickModel, over_period
from .point import EQUILIBRIUM_TOLERANCE, Point, mean_slopes, require_tolerance
from .reading import read_points, system_of

_PACKAGE = Path(__file__).parents[1]
_MOST_TICKS = 100_000  # each has a matrix J of its own: 0.3 GB for 20 states
_MOST_TIME_CONSTANTS = 1e9  # seven digits of the matrix exponential are left


def linearize(
    diagram: Any,
    context: Any = None,
    *,
    inputs: Iterable[str] | None = None,
    outputs: Iterable[str] | None = None,
    bypass: Iterable[str] = (),
    period_s: float | None = None,
    equilibrium_tolerance: float = EQUILIBRIUM_TOLERANCE,
    beside: Sequence[Any] = (),
) -> LinearModel:
    """Linearize a continuous, sampled, mixed or multirate diagram of floats at an equilibrium.

    The derivatives are exact, from the symbolic equations of the leaf systems. If a leaf has none,
    such as Drake's ``MultibodyPlant``, the derivatives are those of Drake's AutoDiffXd. For a leaf
    of floats they are central differences, which a warning names. A diagram with sample periods
    becomes a discrete model over their least common multiple. The matrix exponential moves its
    continuous states between the updates. See `LinearModel` for the definitions.

    At a corner, such as the limit of a saturation, the derivatives hold on one side only. The
    derivative of a quantizer is zero. A warning of one line names each such block, and `advice`
    returns these blocks as data.

    Parameters
    ----------
    diagram
        A Diagram or leaf system, which need not be symbolic. Or the result of `read_diagram`, which
        a caller of many models reads only once. The ``inputs`` of `read_diagram` must begin with
        those of this function, and its ``outputs`` must contain those inside the diagram.
    context
        Its Context with parameters, state and time, by default the default Context. Values of input
        ports come from the Context too. An input port in ``inputs`` without a value has the value
        zero. A port inside that nothing drives has its value in the Context too. A value fixed at a
        connected port inside does not count, as in Drake's own `Linearize`: see `loop_at`.
    inputs
        Names of input ports of the diagram, by default of all its vector ports. A name
        ``path/of/system:port`` stands for a port inside the diagram. The input is then a
        perturbation that adds to the signal of this port, for all systems that read the signal
        through this port.
    outputs
        Names of output ports of the diagram, by default of all its vector ports, or
        ``path/of/system:port`` for ports inside. The signal of a port includes the perturbation of
        the same port. Without ports the model is autonomous, with poles but no response.
    bypass
        Paths of systems without state, such as quantizers, that count as wires: the first input is
        the output. `advice` sees what lies behind a quantizer only if the quantizer is in
        ``bypass``.
    period_s
        Period of the model in s, a multiple of all sample periods. The default is the least common
        multiple. If the diagram has no sample periods, the model is discretized exactly for inputs
        that are constant during ``period_s``. By default such a model stays continuous.
    equilibrium_tolerance
        Largest absolute rate of a continuous state, and change of a discrete state in an update, in
        the units of the state. ``math.inf`` accepts every point, such as a point of a trajectory.
        The time is frozen at the time of the Context, as in Drake's `Linearize`. A warning says so
        if the model depends on the time.
    beside
        Contexts close to ``context``, on both sides of a corner. The derivatives are then the mean
        of those in these Contexts, as a small motion across the corner sees them. Warnings
        then come only if a leaf has no symbolic form.

    Raises
    ------
    CompilationError
        A leaf has no derivative here: it has an abstract state, its AutoDiffXd form gives other
        values than floats (`DifferenceError`), or it cannot be called at the point. Or a port does
        not exist or is no vector.
    LinearizationError
        The point is no equilibrium, or a derivative or the motion over the period is not finite.
    ParameterError
        ``inputs`` or ``outputs`` has a name twice, ``period_s`` is no multiple of the sample
        periods or exceeds 1e9 time constants of the fastest mode, the Context belongs to another
        diagram, or the tolerance is below zero.
    """
    options = bypass, period_s, equilibrium_tolerance
    return _models(diagram, [context], inputs, outputs, *options, beside)[0]


def linearize_at(
    diagram: Any,
    contexts: Iterable[Any],
    *,
    inputs: Iterable[str] | None = None,
    outputs: Iterable[str] | None = None,
    bypass: Iterable[str] = (),
    period_s: float | None = None,
    equilibrium_tolerance: float = EQUILIBRIUM_TOLERANCE,
) -> list[LinearModel]:
    """Return the linear models of a diagram at several operating points, one for each Context.

    The equations are read once, so the function takes much less time than many calls of
    `linearize`.

    Parameters
    ----------
    diagram
        A Diagram or leaf system, as in `linearize`.
    contexts
        The operating points, one Context each.
    inputs, outputs, bypass, period_s, equilibrium_tolerance
        As in `linearize`.

    Raises
    ------
    CompilationError, LinearizationError, ParameterError
        As in `linearize`.
    """
    options = bypass, period_s, equilibrium_tolerance
    return _models(diagram, contexts, inputs, outputs, *options)


def _models(
    diagram: Any,
    contexts: Iterable[Any],
    inputs: Iterable[str] | None,
    outputs: Iterable[str] | None,
    bypass: Iterable[str],
    period_s: float | None,
    equilibrium_tolerance: float,
    beside: Sequence[Any] = (),
) -> list[LinearModel]:
    system = system_of(diagram)
    if inputs is None:
        inputs = vector_names(system, "input")
    if outputs is None:
        outputs = vector_names(system, "output")
    in_names, out_names = names("inputs", inputs), names("outputs", outputs)
    require_tolerance(equilibrium_tolerance)
    points = read_points(diagram, chain(contexts, beside), in_names, out_names, bypass)
    count = len(points) - len(beside)
    near = points[count:]
    models = []  # no comprehension, which would be a stack frame for warnings on Python 3.11
    for point in points[:count]:
        models.append(_model(point, near, in_names, out_names, period_s, equilibrium_tolerance))
    return models


def _model(
    point: Point,
    beside: Sequence[Point],
    in_names: tuple[str, ...],
    out_names: tuple[str, ...],
    period_s: float | None,
    equilibrium_tolerance: float,
) -> LinearModel:
    slopes = point.slopes(out_names)
    point.require_finite(slopes, out_names)
    if moving := point.motion(slopes, equilibrium_tolerance):
        raise LinearizationError(
            f"the operating point is no equilibrium: {moving} (equilibrium_tolerance = "
            f"{equilibrium_tolerance:g}); use find_equilibrium, or equilibrium_tolerance=math.inf"
        )
    if beside:
        slopes = mean_slopes([near.slopes(out_names) for near in beside])
        point.require_finite(slopes, out_names)
    if not beside or isinstance(point, LeafwisePoint):  # a mean has no error, but differences
        _warn(point, out_names)
    input_names = point.element_names(in_names)
    n, columns = point.state.size, point.state.size + len(input_names)
    updates = point.read.equations.updates
    jacobian = slopes.rates_jacobian[:, :columns]
    ticks: tuple[TickModel, ...] = ()
    period: float | None
    if not updates and period_s is None:
        a, b, period = jacobian[:, :n], jacobian[:, n:], None
    else:
        ticks, period = tick_models(updates, jacobian, len(point.read.state_names), period_s)
        a, b = over_period(ticks)
        _require_period(a, b, jacobian[:, :n], period, sampled=bool(updates))
    return LinearModel(
        *(a, b, slopes.outputs_jacobian[:, :n], slopes.outputs_jacobian[:, n:columns]),
        period_s=period,
        state_names=point.state_names,
        input_names=input_names,
        output_names=point.element_names(out_names),
        operating_point=OperatingPoint(
            point.time_s, point.state, point.inputs[: len(input_names)], slopes.outputs
        ),
        ticks=ticks,
    )


def _require_period(a: Array, b: Array, rates: Array, period_s: float, sampled: bool) -> None:
    """Raise an error if A or B over a period is not finite, or is lost to rounding errors.

    The relative error of the matrix exponential is about 1e-16 times |λ| P, with the fastest
    eigenvalue λ of the continuous states.
    """
    fastest = 0.0 if sampled else np.abs(np.linalg.eigvals(rates)).max(initial=0.0)
    if fastest * period_s > _MOST_TIME_CONSTANTS:
        raise ParameterError(
            f"period_s = {period_s:g} s: must be at most {_MOST_TIME_CONSTANTS / fastest:.3g} s, "
            f"{_MOST_TIME_CONSTANTS:g} time constants of the fastest mode"
        )
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise LinearizationError(
            f"the motion over the period, {period_s:g} s, is not finite; choose a shorter period_s"
        )


def _warn(point: Point, out_names: tuple[str, ...]) -> None:
    """Warn of obstacles, and of derivatives that depend on the time."""
    level, frame = 1, sys._getframe()
    while frame.f_back and Path(frame.f_code.co_filename).is_relative_to(_PACKAGE):
        level, frame = level + 1, frame.f_back  # up to the line of the user, also from `loop_at`
    for obstacle in obstacles(point, out_names):
        warnings.warn(str(obstacle), stacklevel=level)
    if varying := point.time_varying(out_names):
        warnings.warn(
            f"the derivatives of {varying[0]} depend on the time: the model has those of "
            f"t = {point.time_s:g} s",
            stacklevel=level,
        )


def tick_models(
    updates: Sequence[Update], jacobian: Array, continuous: int, period_s: float | None
) -> tuple[tuple[TickModel, ...], float]:
    """Return the linear models between and at the updates of a period, and the period in s.

    ``jacobian`` (n, n + m) has the derivatives by n states and m inputs. Its first rows are the
    rates of the ``continuous`` states, and its other rows are the discrete states after their
    updates. `linearize` describes ``period_s`` and the errors.
    """
    n, m = len(jacobian), jacobian.shape[1] - len(jacobian)
    rates = jacobian.copy()
    rates[continuous:] = 0.0
    rate_state, rate_input = rates[:, :n], rates[:, n:]
    unchanged = np.eye(n, n + m)
    ticks = []
    schedule, period = events(updates, period_s)
    for number, (time_s, due) in enumerate(schedule):
        end_s = schedule[number + 1][0] if number + 1 < len(schedule) else period
        jump = unchanged.copy()
        for update in due:
            rows = [continuous + index for index, _ in update.values]
            jump[rows] = jacobian[rows]
        ticks.append(
            TickModel(time_s, end_s - time_s, jump[:, :n], jump[:, n:], rate_state, rate_input)
        )
    return tuple(ticks), period


def events(
    updates: Sequence[Update], period_s: float | None
) -> tuple[list[tuple[float, list[Update]]], float]:
    """Return the times of a period with the updates at each time, and the period in s.

    The first time is 0, without updates if all updates have an offset. ``period_s`` None stands for
    the least common multiple of the sample periods.
    """
    if period_s is not None:
        period_s = positive("period_s", period_s, "s")
    if not updates:
        assert period_s is not None
        return [(0.0, [])], period_s
    pairs = tuple((update.period_s, update.offset_s) for update in updates)
    grid = timing(pairs, period_s)
    periods, offsets = grid.periods.tolist(), grid.offsets.tolist()
    common = math.lcm(*periods)
    last = common if period_s is None else grid.record_every
    if last % common:
        raise ParameterError(
            f"period_s = {period_s:g} s: must be a multiple of {grid.times(common):g} s, the least "
            f"common multiple of the sample periods"
        )
    count = sum(last // period for period in periods)
    if count > _MOST_TICKS:
        raise LinearizationError(
            f"the least common multiple of the sample periods, {grid.times(last):g} s, has {count} "
            f"updates: at most {_MOST_TICKS}; choose sample periods with a smaller multiple"
        )
    due: dict[int, list[Update]] = {0: []}
    for update, period, offset in zip(updates, periods, offsets, strict=True):
        for tick in range(offset % period, last, period):
            due.setdefault(tick, []).append(update)
    return [(float(grid.times(tick)), due[tick]) for tick in sorted(due)], float(grid.times(last))
