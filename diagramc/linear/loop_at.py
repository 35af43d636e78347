"""Breaks the loop of a diagram at a port and returns its transfer function."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from ..equations.ports import vector_names
from ..errors import ParameterError, shown
from .linearize import linearize
from .loops import Transfer
from .model import over_period
from .periodic import PeriodicLoop, opened, updates_last
from .point import EQUILIBRIUM_TOLERANCE
from .reading import system_of


def loop_at(
    diagram: Any,
    port: str,
    context: Any = None,
    *,
    bypass: Iterable[str] = (),
    equilibrium_tolerance: float = EQUILIBRIUM_TOLERANCE,
) -> Transfer | PeriodicLoop:
    """Break the loop of a diagram at a port and return the loop transfer L, for negative feedback.

    The signal y of the port is cut. All systems that read the port get another signal v, and
    y = −L v. All other loops stay closed. `margins`, `sensitivity` and `complementary_sensitivity`
    accept the transfer function.

    In a sampled diagram v and y are constant over the common period of all updates, and L is exact.
    If y changes more than once in this period, or between samples where systems read it, there is
    no transfer function of one input and output. The result is then a `PeriodicLoop`, which
    `margins` accepts.

    The loop follows from the linear model with a perturbation d that adds to the signal, v = y + d.
    The substitution d = v − y opens the loop, between and at the updates.

    Parameters
    ----------
    diagram, context, bypass, equilibrium_tolerance
        As in `linearize`. Input ports of the diagram without a value have the value zero.
    port
        Name of a port inside the diagram, ``path/of/system:port``. ``path/of/system:port[i]`` is
        element i of a port with several elements.

    Raises
    ------
    ParameterError
        The port is not inside the diagram, or its element does not exist. Or the port has several
        elements, and ``port`` names none.
    CompilationError, LinearizationError
        As in `linearize`.
    """
    name, element = _name_and_element(str(port))
    model = linearize(
        diagram,
        context,
        inputs=dict.fromkeys([name, *vector_names(system_of(diagram), "input")]),
        outputs=[name],
        bypass=bypass,
        equilibrium_tolerance=equilibrium_tolerance,
    )
    index = _index(name, element, len(model.output_names))
    b, c = model.b[:, index : index + 1], model.c[index : index + 1]
    if model.period_s is None:
        return Transfer(model.a - b @ c, b, -c, 0.0, None)  # d = v − y in ẋ = A x + B d
    loop = PeriodicLoop(opened(model.ticks, index, c), c, model.period_s)
    return _transfer(loop) or loop


def _name_and_element(port: str) -> tuple[str, int | None]:
    """Return ``path:port`` and i of the text ``path:port[i]``. Without brackets i is None."""
    if ":" not in port:
        raise ParameterError(
            f"port {shown(port)!r}: must be a port inside the diagram, path/of/system:port"
        )
    match = re.fullmatch(r"(.+)\[(\d+)\]", port)
    return (match[1], int(match[2])) if match else (port, None)


def _index(name: str, element: int | None, size: int) -> int:
    """Return the index of an element of a port with ``size`` elements."""
    if element is None and size > 1:
        raise ParameterError(f"port {name}: has {size} elements; name one, such as {name}[0]")
    if element is not None and element >= size:
        raise ParameterError(f"port {name}[{element}]: must be 0…{size - 1}")
    return element or 0


def _transfer(loop: PeriodicLoop) -> Transfer | None:
    """Return L if the signal keeps its value from its first to its last use in a period.

    The period of L begins at the first use, before or after the updates at that time. The result is
    None if the signal changes between two uses.
    """
    events = list(_uses_and_changes(loop))
    # The first event follows the last one, because the ticks repeat.
    after_change = [
        event
        for before, event in zip(events[-1:] + events, events, strict=False)
        if event.is_use and not before.is_use
    ]
    if len(after_change) > 1:
        return None
    # The uses tell the start. To close the loop from each start, and compare, takes a time that
    # grows with the square of the number of updates.
    start = after_change[0] if after_change else _Event(True, 0, False)
    ticks = loop.ticks[start.tick :] + loop.ticks[: start.tick]
    a, b = over_period(updates_last(ticks) if start.after_updates else ticks)
    return Transfer(a, b, -loop.row, 0.0, loop.period_s)


class _Event(NamedTuple):
    """A use of the signal, at which systems read the signal, or a change of the signal."""

    is_use: bool
    tick: int
    """Index of the tick in the period."""
    after_updates: bool
    """Whether the event comes after the updates of the tick."""


def _uses_and_changes(loop: PeriodicLoop) -> Iterator[_Event]:
    """Yield the uses and the changes of the signal, in the order of time.

    An update reads the signal before the signal changes.
    """
    for index, tick in enumerate(loop.ticks):
        jump = np.hstack([tick.jump_state - np.eye(loop.row.size), tick.jump_input])
        rate = np.hstack([tick.rate_state, tick.rate_input])
        if tick.jump_input.any():
            yield _Event(True, index, after_updates=False)
        if (loop.row @ jump).any():
            yield _Event(False, index, after_updates=True)
        is_used, moves = tick.rate_input.any(), (loop.row @ rate).any()
        for _ in range(2 if is_used and moves else 1):  # twice: both go on until the next updates
            if is_used:
                yield _Event(True, index, after_updates=True)
            if moves:
                yield _Event(False, index, after_updates=True)
