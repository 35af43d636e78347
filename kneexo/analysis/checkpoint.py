"""Finished pieces of a long sweep, kept on disk so that an interrupted one can go on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

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
                with self.path.open("a", encoding="utf-8") as file:
                    file.write(line + "\n")
            except OSError as error:
                raise _fault(self.path, error) from None
        self._results[key] = json.loads(line)[1]
        return self._results[key]

    def remove(self) -> None:
        """Delete the file: the sweep is complete and its results are elsewhere."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def piece_keys(function: Any, items: Iterable[Any]) -> list[str]:
    """Names of the pieces ``function(item)``: the same in every process and session."""

    def text(value: Any) -> bytes:
        return json.dumps(_plain(value), sort_keys=True).encode()

    shared = hashlib.sha256(text([__version__, function]))
    keys = []
    for item in items:
        own = shared.copy()
        own.update(text(item))
        keys.append(own.hexdigest()[:32])
    return keys


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return [type(value).__name__, value.model_dump(mode="json")]
    if isinstance(value, partial):
        return [_plain(value.func), _plain(value.args), _plain(value.keywords)]
    if is_dataclass(value) and not isinstance(value, type):
        return [
            type(value).__name__,
            {f.name: _plain(getattr(value, f.name)) for f in fields(value)},
        ]
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if callable(value):
        return f"{value.__module__}.{value.__qualname__}"
    if isinstance(value, str | int | float | bool) or value is None:
        return value
    raise TypeError(f"{type(value).__name__} cannot be part of a checkpointed piece of work")


def _fault(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"checkpoint {path}: {reason}; what it holds stays readable (--resume)")
