"""Report an error in the user's code in one line, with its cause, file and line."""

from __future__ import annotations

import os
import sys
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from kneexo.common import PACKAGE
from kneexo.errors import KneexoError, ParameterError, shortened, shown

_PACKAGE = f"{PACKAGE}{os.sep}"
_LIBRARIES = tuple(
    f"{sysconfig.get_path(name)}{os.sep}" for name in ("stdlib", "purelib", "platlib")
)
NOT_OF_USERS = (_PACKAGE, *_LIBRARIES)
"""Beginnings of the paths of code that the versions of kneexo and of the libraries identify."""


@contextmanager
def user_code(failure: str) -> Iterator[None]:
    """Context manager for a body that runs code of the user.

    An error in the body becomes a `ParameterError`, and so does a call of ``sys.exit``. The message
    is one line that begins with ``failure`` and goes on with the text of ``cause_of``. A
    `KneexoError` and a `KeyboardInterrupt` are raised unchanged. If the body changes the working
    directory or Python's limit of recursion, they are restored, because kneexo needs them. To close
    ``sys.stdout`` is an error.
    """
    directory, limit = os.getcwd(), sys.getrecursionlimit()
    try:
        yield
        if getattr(sys.stdout, "closed", False):
            raise ValueError("the code closes sys.stdout")
    except (KneexoError, KeyboardInterrupt):
        raise
    except BaseException as error:
        sys.setrecursionlimit(limit)
        raise ParameterError(
            f"{failure}: {cause_of(error)}; correct that code, or name another function"
        ) from error
    finally:
        sys.setrecursionlimit(limit)
        if os.getcwd() != directory:
            os.chdir(directory)


def function_at(name: str, subject: str) -> Any:
    """Import and return a function by its name ``module:function``.

    ``subject`` begins the message of every `ParameterError`.
    """
    module, _, path = name.partition(":")
    try:
        with user_code(f"{subject}: the module cannot be imported"):
            found: Any = import_module(module)
    except ParameterError as error:
        cause = error.__cause__
        missing = cause.name if isinstance(cause, ModuleNotFoundError) else None
        # A missing module that the user's module imports is a fault inside the user's code.
        if missing is None or not f"{module}.".startswith(f"{missing}."):
            raise
        raise ParameterError(
            f"{subject}: no module named {shortened(missing)!r}; must be module:function on the "
            f"Python path"
        ) from None
    with user_code(f"{subject}: the module fails"):
        for attribute in path.split("."):
            try:
                found = getattr(found, attribute)
            except AttributeError as error:
                raise ParameterError(
                    f"{subject}: {shortened(text_of(error), 300)}; must be module:function on the "
                    f"Python path"
                ) from None
    return found


def cause_of(error: BaseException) -> str:
    """Return a text with an error's type, first line of message, and file and line of the cause."""
    place: tuple[str | None, int | None] | None
    if isinstance(error, SyntaxError):
        reason, place = error.msg, (error.filename, error.lineno)
    else:
        reason = text_of(error)
        places = _places(error)
        place = place_in_user_code(error) or (places[-1] if places else None)
    message = ": ".join(part for part in (type(error).__name__, reason.partition("\n")[0]) if part)
    where = f" ({shown(place[0])}, line {place[1]})" if place and place[0] else ""
    return f"{shortened(message, 300)}{where}"


def text_of(error: BaseException) -> str:
    """Return the text of an error, also if ``str(error)`` raises an error itself."""
    return traceback.format_exception_only(error)[0].strip().partition(": ")[2]


def place_in_user_code(error: BaseException) -> tuple[str, int] | None:
    """Return file and line of the innermost frame outside kneexo and all libraries.

    Returns None if there is no such frame.
    """
    places = [place for place in _places(error) if not place[0].startswith(_LIBRARIES)]
    return places[-1] if places else None


def _places(error: BaseException) -> list[tuple[str, int]]:
    """Return file and line of each frame of the traceback outside kneexo, the innermost last."""
    return [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if not frame.f_code.co_filename.startswith((_PACKAGE, "<frozen "))
    ]
