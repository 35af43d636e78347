"""Finished pieces of a long sweep, kept on disk so that an interrupted one can go on."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import stat
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary, finalize

from pydantic import BaseModel

from kneexo.errors import OutputError, shown
from kneexo.user_file import MIB, read_bytes
from kneexo.version import __version__

_HEADER = b'{"kneexo checkpoint": 1}'  # raise the number when the lines change
_MOST_BYTES = 4096 * MIB


class Checkpoint:
    """A file with one JSON line for each finished piece of work.

    A piece is known by its function, its input and kneexo's version, so a sweep takes from the
    file what it would compute itself, and nothing else. Results are plain JSON data; floats come
    back bit by bit. Each line has a checksum: damaged lines are skipped, a warning counts them.

    Pieces that are in the file are used. ``resume`` False deletes them instead. The file is locked
    until `close` or `remove`, until this process dies, or until it opens the file again. ``path``
    None keeps nothing on disk.

    Raises `OutputError` when the file cannot be read or written, when another process has locked
    it, and when it is no checkpoint: such a file is never changed.
    """

    def __init__(self, path: Path | None = None, *, resume: bool = True) -> None:
        self.path = path
        self._results: dict[str, Any] = {}
        self._used: set[str] = set()
        self._file: FileIO | None = None
        self._torn = False  # the file does not end with a whole line
        if path is None:
            return
        try:
            file = self._open(path)
            self._read(path)
            if not resume:
                file.truncate(0)
                self._results.clear()
        except OSError as error:
            self.close()
            raise error if isinstance(error, OutputError) else _fault(path, error) from None

    def _open(self, path: Path) -> FileIO:
        """Open and lock the file; it is made when missing."""
        while self._file is None:
            file = FileIO(path, "a+")
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise _foreign(path)
            place = (status.st_dev, status.st_ino)
            former = _OPEN.pop(place, None)
            if former is not None:  # an error may keep it alive, such as the last of a notebook
                former._release()
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise OutputError(
                    f"checkpoint {shown(path)}: another process is at work on it; wait until "
                    f"it has ended, or choose another directory"
                ) from None
            except OSError:  # a file system without locks
                pass
            if path.exists() and path.stat().st_ino == status.st_ino:  # else: just removed
                self._file = file
                _OPEN[place] = self
                finalize(self, file.close)
        return self._file

    def _read(self, path: Path) -> None:
        data = read_bytes(path, _MOST_BYTES)
        if _HEADER.startswith(data):  # empty, or the first write was cut short
            self._open(path).truncate(0)
            return
        self._torn = not data.endswith(b"\n")
        damaged = 0
        for line in data.splitlines():
            payload = line[_PAYLOAD:-1]
            try:
                if line != _sealed(payload):
                    raise ValueError
                key, result = json.loads(payload)
                self._results[key] = result
            except (ValueError, TypeError, RecursionError):
                damaged += line != _HEADER
        if not (self._results or data.startswith(_HEADER)):
            raise _foreign(path)
        if damaged:
            warnings.warn(
                f"checkpoint {shown(path)}: {damaged} damaged "
                f"{'line is' if damaged == 1 else 'lines are'} skipped",
                stacklevel=4,
            )

    def __len__(self) -> int:
        """Number of finished pieces."""
        return len(self._results)

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        result = self._results[key]
        self._used.add(key)
        return result

    def keep(self, key: str, result: Any) -> Any:
        """Note the result of a piece; returns it as it will be read back."""
        payload = json.dumps([key, result])
        if self.path is not None:
            try:
                self._write(self._open(self.path), _sealed(payload.encode()))
            except OSError as error:
                raise (
                    error if isinstance(error, OutputError) else _fault(self.path, error)
                ) from None
        self._results[key] = json.loads(payload)[1]
        return self[key]

    def _write(self, file: FileIO, line: bytes) -> None:
        start = b"\n" if self._torn else b""
        if not os.fstat(file.fileno()).st_size:
            start = _HEADER + b"\n"
        data = start + line + b"\n"
        self._torn = True
        while data:  # a disk that is full takes a part, then it says why
            data = data[file.write(data) :]
        self._torn = False

    def close(self) -> None:
        """Release the file; an empty one is deleted."""
        if self._file and self.path and not os.fstat(self._file.fileno()).st_size:
            self.path.unlink(missing_ok=True)
        self._release()

    def _release(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def remove(self) -> int:
        """Delete the file: the sweep is complete and its results are elsewhere.

        Where it also holds pieces of other settings, which nobody asked for yet, it stays as it is;
        returns their number.
        """
        others = len(self._results.keys() - self._used)
        if not others and self.path is not None:
            self.path.unlink(missing_ok=True)
        self.close()
        return others


_OPEN: WeakValueDictionary[tuple[int, int], Checkpoint] = WeakValueDictionary()
"""The checkpoints that this process has locked, by device and inode of the file."""


def _sealed(payload: bytes) -> bytes:
    """The line of a piece."""
    seal = hashlib.sha256(payload).hexdigest().encode()
    return b'{"sha256": "' + seal + b'", "piece": ' + payload + b"}"


_PAYLOAD = len(_sealed(b"")) - len(b"}")  # where it begins in a line


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
    """Plain data for a value that JSON lacks."""
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
    return OutputError(f"checkpoint {shown(path)}: {reason}; the pieces that it holds are kept")


def _foreign(path: Path) -> OutputError:
    return OutputError(
        f"checkpoint {shown(path)}: this is not a checkpoint of kneexo; move it away or choose "
        f"another directory"
    )
