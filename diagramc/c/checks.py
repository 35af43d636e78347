"""Checks the types of arguments of an export. Each refusal is a `CompilationError` of one line."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Real
from typing import Any

import numpy as np

from ..errors import CompilationError, shown


def require_type(what: str, value: Any, kind: type | tuple[type, ...], words: str) -> None:
    """Raise `CompilationError` unless ``value`` has the type ``kind``, in words ``words``.

    True and False are no numbers.
    """
    is_bool = isinstance(value, (bool, np.bool_)) and kind is not bool
    if is_bool or not isinstance(value, kind):
        raise CompilationError(f"{what} = {shown(f'{value!r:.60}')}: must be {words}")


def require_positive(what: str, value: Any, unit: str) -> None:
    """Raise `CompilationError` unless ``value`` is a finite positive number."""
    words = f"finite and > 0 {unit}"
    require_type(what, value, Real, words)
    try:
        number = float(value)
    except OverflowError:  # an integer
        number = math.inf
    if not 0.0 < number < math.inf:
        raise CompilationError(f"{what} = {number:g} {unit}: must be {words}")


def distinct_names(what: str, names: Any) -> tuple[str, ...]:
    """Return names as a tuple; a string is a single name.

    Raises `CompilationError` if ``names`` has anything but strings, or a name twice.
    """
    require_type(what, names, Iterable, "names, such as ['u', 'v']")
    result = (names,) if isinstance(names, str) else tuple(names)
    for name in result:
        require_type(f"an element of {what}", name, str, "a name")
        if result.count(name) > 1:
            raise CompilationError(f"{what}: has {shown(repr(name))} twice; give each name once")
    return result
