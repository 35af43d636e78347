"""Truth values of Drake's scalars while a user's code calculates with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import RLock, get_ident
from typing import Any

from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression

_lock = RLock()
_depth = 0
_ABSENT = object()


@contextmanager
def truth_of_scalars() -> Iterator[None]:
    """Context manager: in its body, a branch on a scalar of Drake follows the scalar's number.

    Python takes an object without the method ``__bool__`` for true. So ``if x:``, ``x and y``,
    ``not x`` and ``while x`` would follow one branch in silence. In the body ``bool(x)`` says
    whether the value of an AutoDiffXd differs from zero. For an Expression, which has no number,
    ``bool(x)`` raises `TypeError`. So does ``hash(x)``, by which a dictionary looks up a number.

    pydrake's classes get these methods for the body only, and other threads do not notice them.
    """
    global _depth
    owner = get_ident()

    def expression_raises(name: str) -> Callable[[Any], Any]:
        def method(expression: Any) -> Any:
            if get_ident() == owner:
                raise TypeError(f"`{name}` of a symbolic variable, which has no number")
            return True if name == "__bool__" else id(expression)

        return method

    def differs_from_zero(scalar: Any) -> bool:
        return bool(scalar.value() != 0.0)

    methods = (
        (Expression, "__bool__", expression_raises("__bool__")),
        (Expression, "__hash__", expression_raises("__hash__")),
        (AutoDiffXd, "__bool__", differs_from_zero),
    )
    with _lock:  # one body at a time, because the classes belong to all threads
        originals = [vars(kind).get(name, _ABSENT) for kind, name, _ in methods]
        _depth += 1
        try:
            if _depth == 1:
                for kind, name, method in methods:
                    setattr(kind, name, method)
            yield
        finally:
            _depth -= 1
            if _depth == 0:
                for (kind, name, _), original in zip(methods, originals, strict=True):
                    if original is _ABSENT:
                        delattr(kind, name)
                    else:
                        setattr(kind, name, original)
