"""Breaks the loop of a diagram at a port and returns its transfer function."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg

from ..errors import ParameterError
from ..run_data import Array
from .linearize import linearize
from .loops import Transfer
from .model import over_period
from .periodic import PeriodicLoop, opened, updates_last
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
        As in `linearize`.
    port
        Name of a port inside the diagram, ``path/of/system:port``. ``path/of/system:port[i]`` is
        element i of a port with several elements.

    Raises
    ------
    ParameterError
        The element does not exist, or no element is named of a port with several.
    CompilationError, LinearizationError
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
    loop = PeriodicLoop(opened(model.ticks, column, row), row, model.period_s)
    return _transfer(loop) or loop


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


def _transfer(loop: PeriodicLoop) -> Transfer | None:
    """Return L if the signal is constant over a period that begins before or after some updates.

    The result is the first transfer function that gives the loop itself when it is closed once a
    period, for two loop gains. The result is None if there is none.
    """
    for first in range(len(loop.ticks)):
        before = loop.ticks[first:] + loop.ticks[:first]
        for ticks in (before, updates_last(before)):
            transfer = Transfer(*over_period(ticks), -loop.row, 0.0, loop.period_s)
            expected = replace(loop, ticks=ticks).closed_matrices(_FACTORS).real
            if all(map(_equal, _closed(transfer), expected)):
                return transfer
    return None


def _closed(transfer: Transfer) -> Iterator[Array]:
    """Yield the matrix of the loop that is closed once a period, for each loop gain."""
    return (transfer.a - factor * transfer.b @ transfer.c for factor in _FACTORS)


def _equal(matrix: Array, expected: Array) -> bool:
    """Return whether two matrices are equal, also if their states have different units."""
    _, (scale, _) = scipy.linalg.matrix_balance(expected, permute=False, separate=True)
    difference, size = (
        float(np.linalg.norm(m * scale / scale[:, None])) for m in (matrix - expected, expected)
    )
    return difference <= _SAME * size
