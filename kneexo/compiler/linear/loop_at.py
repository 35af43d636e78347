"""Breaks the loop of a diagram at a port and returns its transfer function."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg

from ..errors import LinearizationError, ParameterError
from ..run_data import Array
from .linearize import linearize
from .loops import Transfer
from .model import LinearModel, TickModel, over_period
from .point import EQUILIBRIUM_TOLERANCE

_SAME = 1e-9  # relative difference of two equal matrices of a closed loop, with rounding
_FACTORS = (1.0, 0.5)  # loop gains at which a loop is closed again


def loop_at(
    diagram: Any,
    port: str,
    context: Any = None,
    *,
    bypass: Iterable[str] = (),
    equilibrium_tolerance: float = EQUILIBRIUM_TOLERANCE,
) -> Transfer:
    """Break the loop of a diagram at a port and return the loop transfer L, for negative feedback.

    The signal y of the port is cut. All systems that read the port get another signal v, and
    y = −L v. All other loops stay closed. For a sampled diagram v is constant over the common
    period, and L is exact at its multiples. `margins`, `sensitivity` and
    `complementary_sensitivity` accept the result.

    The transfer follows from the linear model by a perturbation d that adds to the signal,
    v = y + d. The substitution d = v − y opens the loop, between and at the updates.

    Parameters
    ----------
    diagram, context, bypass, equilibrium_tolerance
        As in `linearize`.
    port
        Name of a port inside the diagram, ``path/of/system:port``. ``path/of/system:port[i]`` is
        element i of a port with several elements.

    Raises
    ------
    LinearizationError
        The signal changes more than once in the common period, or changes while it is read. Then
        no transfer function with one input and one output describes the loop. Also as in
        `linearize`.
    ParameterError
        The element does not exist, or no element is named of a port with several.
    CompilationError
        As in `linearize`.
    """
    name, element = _name_and_element(port)
    model = linearize(
        diagram,
        context,
        inputs=[name],
        outputs=[name],
        bypass=bypass,
        equilibrium_tolerance=equilibrium_tolerance,
    )
    column = _index(name, element, len(model.input_names))
    row = model.c[column : column + 1]
    drive = model.b[:, column : column + 1]
    if model.period_s is None:
        return Transfer(model.a - drive @ row, drive, -row, 0.0, None)
    transfer = _sampled(model, column, row)
    if transfer is None:
        raise LinearizationError(
            f"{port}: its signal changes more than once in the common period of "
            f"{model.period_s:g} s, or while it is read: no transfer function describes the loop; "
            f"break it where the signal is constant for {model.period_s:g} s"
        )
    return transfer


def _name_and_element(port: str) -> tuple[str, int | None]:
    """Return ``path:port`` and i of the text ``path:port[i]``; i is None without brackets."""
    match = re.fullmatch(r"(.+)\[(\d+)\]", port)
    return (match[1], int(match[2])) if match else (port, None)


def _index(name: str, element: int | None, size: int) -> int:
    """Return the index of an element of a port with ``size`` elements."""
    if element is None and size > 1:
        raise ParameterError(f"port {name}: has {size} elements; name one, such as {name}[0]")
    if element is not None and element >= size:
        raise ParameterError(f"port {name}[{element}]: must be 0…{size - 1}")
    return element or 0


def _sampled(model: LinearModel, column: int, row: Array) -> Transfer | None:
    """Return L of a sampled model from perturbation ``column`` and y = c z with c ``row``.

    The period of L begins before or after the updates at one of the times of the model. The result
    is the first such L that gives the loop itself when the loop is closed again once a period, for
    two loop gains. The result is None if there is no such L.
    """
    opened = [_with_feedback(tick, column, row, -1.0) for tick in model.ticks]
    for first in range(len(opened)):
        before = opened[first:] + opened[:first]
        for ticks in (before, _updates_last(before)):
            transfer = Transfer(*over_period(ticks), -row, 0.0, model.period_s)
            if all(_closes(transfer, ticks, row, factor) for factor in _FACTORS):
                return transfer
    return None


def _updates_last(ticks: Sequence[TickModel]) -> list[TickModel]:
    """Return the ticks of a period that begins after the first updates and ends with them."""
    first, *others = ticks
    n, m = first.jump_input.shape
    flow = replace(first, jump_state=np.eye(n), jump_input=np.zeros((n, m)))
    return [flow, *others, replace(first, duration_s=0.0)]


def _with_feedback(tick: TickModel, column: int, row: Array, gain: float) -> TickModel:
    """Return a tick with the input ``column`` alone, to which ``gain`` c z adds."""
    drive, rate = (m[:, column : column + 1] for m in (tick.jump_input, tick.rate_input))
    return replace(
        tick,
        jump_state=tick.jump_state + gain * drive @ row,
        jump_input=drive,
        rate_state=tick.rate_state + gain * rate @ row,
        rate_input=rate,
    )


def _closes(transfer: Transfer, ticks: Sequence[TickModel], row: Array, factor: float) -> bool:
    """Return whether feedback of L once a period is feedback of y at all times, v = factor · y."""
    expected, _ = over_period([_with_feedback(tick, 0, row, factor) for tick in ticks])
    closed = transfer.a - factor * transfer.b @ transfer.c
    _, (scale, _) = scipy.linalg.matrix_balance(expected, permute=False, separate=True)
    balanced = [matrix * scale / scale[:, None] for matrix in (closed - expected, expected)]
    difference, size = (float(np.linalg.norm(matrix)) for matrix in balanced)
    return difference <= _SAME * size
