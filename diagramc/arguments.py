"""Checks the types and ranges of arguments: names, and numbers with a unit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from numbers import Real
from typing import Any

from .errors import ParameterError, shown


def quoted(name: object) -> str:
    """Return a value as Python text for a message: one line of at most 300 characters."""
    return shown(repr(name))


def names(setting: str, value: str | Iterable[str]) -> tuple[str, ...]:
    """Return names as a tuple; a single text is one name.

    Raises `ParameterError` for another type and for a name that occurs twice. ``setting`` is the
    name of the argument.
    """
    try:
        texts = (value,) if isinstance(value, str) else tuple(value)
    except TypeError:
        raise ParameterError(f"{setting} = {quoted(value)}: must be a list of names") from None
    for text in texts:
        if not isinstance(text, str):
            raise ParameterError(f"{setting}: has {quoted(text)}; must be names")
        if texts.count(text) > 1:
            raise ParameterError(f"{setting}: has {quoted(text)} twice; give each name once")
    return texts


def number(
    setting: str, value: Any, unit: str, range_text: str, accepts: Callable[[float], bool]
) -> float:
    """Return a real number as a float.

    Raises `ParameterError` for another type, such as a bool, and for a number that ``accepts``
    refuses. ``range_text`` describes the accepted range in the message.
    """
    try:
        result = float(value) if isinstance(value, Real) and not isinstance(value, bool) else None
    except OverflowError:  # an integer beyond the largest float
        result = None
    if result is None:
        raise ParameterError(f"{setting} = {quoted(value)}: must be a number, {range_text}")
    if not accepts(result):
        raise ParameterError(f"{setting} = {result:g}{unit and ' '}{unit}: must be {range_text}")
    return result


def positive(setting: str, value: Any, unit: str = "") -> float:
    """Return a finite number above zero: see `number`."""
    return number(setting, value, unit, "finite and > 0", lambda x: 0.0 < x < math.inf)
