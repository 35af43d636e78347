"""Writes JSON data to files, and reads and checks JSON data from files that may be damaged."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import OutputError, ParameterError, shortened, shown
from .files import write_whole
from .root import ROOT

MOST_BYTES = 64 * 2**20
"""Size in bytes of the largest file that `read_document` accepts."""

NOT_FINITE = ("nan", "inf", "-inf")
"""Texts that stand for numbers which JSON lacks."""


def document_text(kind: str, document: Mapping[str, Any]) -> str:
    """Return JSON data as the text of a file that `read_document` reads with the same ``kind``.

    Raises `ParameterError` if the data are no JSON data.
    """
    try:
        return json.dumps({"kind": _mark(kind), **document}, indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise ParameterError(f"note: cannot be written as JSON ({error})") from None


def write_document(path: str | os.PathLike[str], text: str) -> None:
    """Write the text of a document to a file, replacing an earlier document.

    Raises `OutputError` if the path exists and is no such file, or if the file cannot be written.
    After an error no new file is left, and an earlier file is unchanged.
    """
    file = Path(path)
    try:
        is_foreign = file.exists() and not _is_document(file)
        if not is_foreign:
            write_whole(file, text.encode())
    except (OSError, ValueError) as error:  # a null byte in the name is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{shown(path)}: cannot be written ({reason})") from None
    if is_foreign:
        raise OutputError(
            f"{shown(path)}: exists and is no document of {ROOT}; choose another file"
        )


def _is_document(path: Path) -> bool:
    """Return whether a path is a regular file that `document_text` began."""
    if not path.is_file():  # opening a pipe may wait for ever
        return False
    with path.open("rb") as file:
        return f'"kind": "{ROOT}: '.encode() in file.read(100)


def read_document(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """Return the JSON data of a regular file of this ``kind`` and of at most `MOST_BYTES`.

    Raises `ParameterError` if the file cannot be read or is of no such kind.
    """
    name = shown(path)
    try:
        if not Path(path).is_file():  # reading a pipe or a device may never end
            raise OSError("is no file")
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # a null byte in the name is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise ParameterError(f"{name}: cannot be read ({reason})") from None
    if len(data) > MOST_BYTES:
        raise ParameterError(f"{name}: is too large, must have at most {MOST_BYTES} bytes")
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or document.get("kind") != _mark(kind):
        raise ParameterError(f"{name}: must be a file of {ROOT} with a {kind}")
    return document


def _mark(kind: str) -> str:
    return f"{ROOT}: {kind}, format 1"


def mapping_of(name: str, value: Any) -> dict[str, Any]:
    """Return ``value`` if it is a JSON object; raise `ParameterError` otherwise."""
    if not isinstance(value, dict):
        raise ParameterError(f"{name}: must be an object")
    return value


def text_of(name: str, value: Any) -> str:
    """Return ``value`` if it is a text; raise `ParameterError` otherwise."""
    if not isinstance(value, str):
        raise ParameterError(f"{name}: must be a text")
    return value


def numbers_of(name: str, value: Any, *, finite: bool = True) -> dict[str, float]:
    """Return a JSON object of numbers; see `number_of`."""
    items = mapping_of(name, value).items()
    return {key: number_of(f"{name}.{key}", item, finite=finite) for key, item in items}


def number_of(name: str, value: Any, *, finite: bool = True) -> float:
    """Return a JSON number as a float.

    If ``finite`` is False, also convert the texts of `NOT_FINITE`. Raises `ParameterError` for any
    other value.
    """
    if not finite and value in NOT_FINITE:
        return float(value)
    try:
        number = float(value) if isinstance(value, int | float) else math.nan
    except OverflowError:
        number = math.nan
    if isinstance(value, bool) or not math.isfinite(number):
        raise ParameterError(f"{shortened(name)} = {shortened(repr(value), 40)}: must be a number")
    return number
