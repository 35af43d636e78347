"""Converts a leaf system to its symbolic form, and refuses leaves whose events do not compile."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from os import sep
from pathlib import Path
from threading import RLock
from traceback import extract_tb, format_exception_only
from typing import Any

import pydrake
from pydrake.symbolic import Expression
from pydrake.systems.framework import LeafSystem_, UnrestrictedUpdateEvent_

from ..errors import CompilationError, shown
from .tree import Node
from .truth import truth_of_scalars

_NOT_OF_USERS = tuple(
    f"{folder}{sep}" for folder in (Path(__file__).parents[1], Path(pydrake.__file__).parent)
)


def symbolic_value(where: str, evaluate: Callable[[], Any], form: str = "symbolic") -> Any:
    """Return ``evaluate()``, which calls a user's leaf system with symbolic values.

    ``form`` is the scalar type for the message, if it is another one.

    The leaf's code can raise any error, for example at a branch on a symbolic value
    (`truth_of_scalars`). The function raises `CompilationError` in place of this error, with a
    message that begins with ``where`` and names file and line of the user's code.
    """
    try:
        with truth_of_scalars():
            return evaluate()
    except (Exception, SystemExit) as error:
        raise CompilationError(f"{where}: has no {form} form ({reason_of(error)})") from error


def reason_of(error: BaseException) -> str:
    """Return the first line of an error of a user's code, with the file and line of this code."""
    # str(error) could raise an error itself.
    text = format_exception_only(error)[0].strip().partition(": ")[2]
    reason = (text.splitlines() or [type(error).__name__])[0]
    if "`__bool__`" in reason:  # also of a Formula, whose own text does not help
        reason = "the code branches on a symbolic value"
    frames = extract_tb(error.__traceback__)
    users = [frame for frame in frames if not frame.filename.startswith(_NOT_OF_USERS)]
    if users:
        reason += f"; {shown(Path(users[-1].filename).name)}, line {users[-1].lineno}"
    return reason


def to_symbolic(leaf: Node) -> Any:
    """Return a copy of a leaf system for Drake's symbolic scalar type Expression.

    Raises `CompilationError` if the leaf does not convert to Expression, or if the leaf has an
    update that is not a periodic discrete update.
    """
    with _recorded_declarations() as declarations:
        symbolic = symbolic_value(leaf.name, leaf.system.ToSymbolicMaybe)
    if symbolic is None:
        raise CompilationError(
            f"{leaf.name}: {leaf.type_name} does not convert to symbolic Expression (see Drake's "
            f"TemplateSystem)"
        )
    for system, method, arguments in declarations:
        if system is symbolic and (update := _unfit_update(method, arguments)):
            raise CompilationError(
                f"{leaf.name}: {leaf.type_name} has {update}; of updates only periodic discrete "
                f"ones compile"
            )
    return symbolic


def refuse_witness_functions(leaf: Node, context: Any) -> None:
    """Raise `CompilationError` if a leaf has witness functions in its default ``context``."""
    witnesses = leaf.system.GetWitnessFunctions(context)
    if not witnesses:
        return
    # The leaf holds its witness functions, yet pydrake deletes them with their Python objects. An
    # extra reference to the functions and to the leaf keeps both until the process ends.
    for immortal in (leaf.system, *witnesses):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(immortal))
    raise CompilationError(
        f"{leaf.name}: {leaf.type_name} has a witness function; only sampled events compile"
    )


_DECLARATIONS = (
    "DeclarePerStepEvent",
    "DeclarePerStepDiscreteUpdateEvent",
    "DeclarePerStepUnrestrictedUpdateEvent",
    "DeclarePeriodicEvent",
    "DeclarePeriodicUnrestrictedUpdateEvent",
)
_declarations_lock = RLock()


@contextmanager
def _recorded_declarations() -> Iterator[list[tuple[Any, str, Sequence[Any]]]]:
    """Context manager: record each event that a symbolic leaf in Python declares during the body.

    The value is a list with an entry (leaf, method, arguments) for each declaration. The record is
    necessary because Drake lists the events of a leaf in C++ only. The events of a leaf written in
    C++ stay unknown, except witness functions and periodic discrete updates.
    """
    declarations: list[tuple[Any, str, Sequence[Any]]] = []
    leaf_type = LeafSystem_[Expression]

    def recorded(method: str, declare: Any) -> Any:
        def record(leaf: Any, *args: Any, **kwargs: Any) -> Any:
            declarations.append((leaf, method, (*args, *kwargs.values())))
            return declare(leaf, *args, **kwargs)

        return record

    with _declarations_lock:  # the class belongs to all threads
        originals = {method: getattr(leaf_type, method) for method in _DECLARATIONS}
        try:
            for method, declare in originals.items():
                setattr(leaf_type, method, recorded(method, declare))
            yield declarations
        finally:
            for method, declare in originals.items():
                setattr(leaf_type, method, declare)


def _unfit_update(method: str, arguments: Sequence[Any]) -> str | None:
    """Return the kind of an update that does not compile, such as "a per-step discrete update".

    Returns None for publish events and periodic discrete updates, which compile. In Python a
    DiscreteUpdateEvent has no constructor, so only methods declare discrete updates.
    """
    trigger = "per-step" if "PerStep" in method else "periodic"
    event_type = UnrestrictedUpdateEvent_[Expression]
    if "Unrestricted" in method or any(isinstance(a, event_type) for a in arguments):
        return f"a {trigger} unrestricted update"
    return "a per-step discrete update" if "PerStepDiscrete" in method else None
