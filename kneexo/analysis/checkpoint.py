"""Finished pieces of a long sweep, kept on disk so that an interrupted one can go on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any
from weakref import finalize

from pydantic import BaseModel

from kneexo import __version__
from kneexo.errors import OutputError


class Checkpoint:
    """A file with one JSON line for each finished piece of work.

    A piece is known by its function, its input and kneexo's version, so a sweep that was changed
    meanwhile takes from the file only what still holds. Results are plain JSON data; floats come
    back bit by bit. A last line that a crash or a full disk cut short is ignored. With ``resume``
    the file's pieces are used, otherwise it starts empty. ``path`` None keeps nothing on disk.

    Raises `OutputError` when the file cannot be read or written.
    """

    def __init__(self, path: Path | None = None, *, resume: bool = False) -> None:
        self.path = path
        self._results: dict[str, Any] = {}
        self._file: FileIO | None = None
        if path is None:
            return
        try:
            if resume and path.exists():
                self._read(path)
            else:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise _fault(path, error) from None

    def _read(self, path: Path) -> None:
        kept = 0
        for line in path.read_bytes().splitlines(keepends=True):
            try:
                key, result = json.loads(line)
            except ValueError:
                break
            if not line.endswith(b"\n"):
                break
            self._results[key] = result
            kept += len(line)
        with path.open("r+b") as file:
            file.truncate(kept)

    def __len__(self) -> int:
        """Number of finished pieces."""
        return len(self._results)

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def keep(self, key: str, result: Any) -> Any:
        """Note the result of a piece; returns it as it will be read back."""
        line = json.dumps([key, result])
        if self.path is not None:
            try:
                if self._file is None:
                    self._file = self.path.open("ab", buffering=0)
                    finalize(self, self._file.close)
                data = line.encode() + b"\n"
                while data:  # a disk that is full takes a part, then it says why
                    data = data[self._file.write(data) :]
            except OSError as error:
                raise _fault(self.path, error) from None
        self._results[key] = json.loads(line)[1]
        return self._results[key]

    def remove(self) -> None:
        """Delete the file: the sweep is complete and its results are elsewhere."""
        if self._file is not None:
            self._file.close()
            self._file = None
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def piece_keys(function: Any, items: Iterable[Any]) -> list[str]:
    """Names of the pieces ``function(item)``: the same in every process and session."""
    shared = hashlib.sha256(_text([__version__, function]))
    keys = []
    for item in items:
        piece = shared.copy()
        piece.update(_text(item))
        keys.append(piece.hexdigest()[:32])
    return keys


def _text(value: Any) -> bytes:
    return _ENCODER.encode(value).encode()


def _plain(value: Any) -> Any:
    """What JSON does not know, by what it knows."""
    if isinstance(value, BaseModel):
        return [type(value).__name__, value.model_dump_json()]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__name__, {f.name: getattr(value, f.name) for f in fields(value)}]
    if isinstance(value, Mapping):
        return dict(value)
    if callable(value):
        return f"{value.__module__}.{value.__qualname__}"
    raise TypeError(f"{type(value).__name__} cannot be part of a checkpointed piece of work")


_ENCODER = json.JSONEncoder(sort_keys=True, default=_plain)


def _fault(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"checkpoint {path}: {reason}; what it holds stays readable (--resume)")
