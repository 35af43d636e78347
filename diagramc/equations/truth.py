"""Truth values of Drake's scalars while a user's code calculates with them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock, get_ident
from typing import Any

from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, ExpressionKind, Formula, FormulaKind

_METHODS = ("__bool__", "__hash__", "__str__", "__repr__")
"""Methods by which a code can branch on a value: its truth, a dictionary, or its text."""
_COMPARISONS = ("__eq__", "__ne__")
"""Methods of a Formula that compare its form, not its truth, such as ``(x > 0.0) == True``."""
_CONSTANT = (ExpressionKind.Constant, FormulaKind.True_, FormulaKind.False_)
_ABSENT = object()
_lock = RLock()


@contextmanager
def truth_of_scalars() -> Iterator[None]:
    """Context manager: in its body, a user's code cannot follow a wrong branch on Drake's scalars.

    Python takes an object without the method ``__bool__`` for true. So ``if x:``, ``x and y``,
    ``not x`` and ``while x`` would follow one branch in silence. In the body ``bool(x)`` says
    whether the value of an AutoDiffXd or of a constant Expression differs from zero. A symbolic
    value has no number. There `TypeError` is raised by ``bool(x)``, by ``hash(x)``, with which a
    dictionary looks up a value, by ``str(x)``, and by ``formula == y``, which pydrake answers
    without a look at the truth of the formula. If the body catches the error, it is raised again at
    the end of the body.

    pydrake's classes get these methods for the body only, and other threads do not notice them.
    """
    errors: list[TypeError] = []
    methods: list[tuple[Any, str, Any]] = [(AutoDiffXd, "__bool__", _differs_from_zero)]
    for kind in (Expression, Formula):
        for name in _METHODS + (_COMPARISONS if kind is Formula else ()):
            methods.append((kind, name, _method(name, getattr(kind, name, None), errors)))
    with _lock:  # one body at a time, because the classes belong to all threads
        originals = [vars(kind).get(name, _ABSENT) for kind, name, _ in methods]
        for kind, name, method in methods:
            setattr(kind, name, method)
        try:
            yield
        finally:
            for (kind, name, _), original in zip(methods, originals, strict=True):
                if original is _ABSENT:
                    delattr(kind, name)
                else:
                    setattr(kind, name, original)
    if errors:
        raise errors[0]


def _differs_from_zero(scalar: Any) -> bool:
    return bool(scalar.value() != 0.0)


def _number(operand: Any) -> Any:
    """Return the value of a constant; any other operand is returned unchanged."""
    is_scalar = isinstance(operand, Expression | Formula)
    return operand.Evaluate() if is_scalar and operand.get_kind() in _CONSTANT else operand


def _method(name: str, original: Any, errors: list[TypeError]) -> Any:
    """Return the method ``name`` of symbolic values for the thread that calls this function."""
    owner = get_ident()

    def method(value: Any, *others: Any) -> Any:
        if get_ident() != owner:
            return True if original is None else original(value, *others)
        numbers = [_number(operand) for operand in (value, *others)]
        if not any(isinstance(number, Expression | Formula) for number in numbers):
            return getattr(numbers[0], name)(*numbers[1:])
        # Stored too, because a law can catch the error and then go on along one branch.
        errors.append(TypeError(f"`{name}` of a symbolic value, which has no number"))
        raise errors[-1]

    return method
