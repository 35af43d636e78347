"""A file of finished results, from which an interrupted sweep continues."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from kneexo.common.files.locking import LockedFile
from kneexo.common.files.reading import MIB
from kneexo.errors import KneexoError, OutputError, shown
from kneexo.parameters import Scenario
from kneexo.simulation.compiled import called_code, users_code_key
from kneexo.version import __version__

_MOST_BYTES = 4096 * MIB  # the results of some million runs


class Checkpoint:
    """A file with one JSON line for each finished piece of work.

    A piece of work is one call of a function. The key of a piece contains the name of the function,
    the input and kneexo's version. A sweep reads a result from the file only if the key of its own
    piece is the same. Results are plain JSON data, and floats are restored bit by bit. Each line
    has a checksum. Damaged lines are skipped, and a warning says how many.

    Parameters
    ----------
    path
        The file. The lock on it ends with `close`, with `remove`, and with this process. The lock
        also ends when another `Checkpoint` of this process opens the file, for the reason that
        `kneexo.common.files.locking.LockedFile` gives.
    resume
        True: use the pieces of work in the file. False: delete these pieces.

    Raises
    ------
    OutputError
        The file is no regular file or cannot be read or written, or another process has locked it.
    """

    def __init__(self, path: Path, *, resume: bool = True) -> None:
        self.path = path
        self._results: dict[str, Any] = {}
        self._used: set[str] = set()
        self._torn = False  # whether the last line of the file is incomplete
        with self._output_errors():
            self._file = LockedFile(path)
            try:
                if resume:
                    self._read()
                else:
                    self._file.clear()
            except OSError:
                self.close()
                raise

    def _read(self) -> None:
        """Read the results in the undamaged lines of the file; warn of damaged lines."""
        data = self._file.read(_MOST_BYTES)
        self._torn = not data.endswith(b"\n") and bool(data)
        damaged = 0
        # After a failed write, ``keep`` begins its next line with a line end, so that the torn line
        # is a damaged line of its own. If nothing of the torn line was written, an empty line is
        # left.
        for line in filter(None, data.splitlines()):
            payload = line[_PAYLOAD_START:-1]
            try:
                if line != _sealed(payload):
                    raise ValueError
                key, result = json.loads(payload)
                self._results[key] = result
            except (ValueError, TypeError, RecursionError):
                damaged += 1
        if damaged:
            warnings.warn(
                f"checkpoint {shown(self.path)}: {damaged} damaged "
                f"{'line is' if damaged == 1 else 'lines are'} skipped",
                stacklevel=4,  # the warning names the line of the caller of Checkpoint(…)
            )

    def __len__(self) -> int:
        """Return the number of finished pieces of work, including pieces read from the file."""
        return len(self._results)

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        """Return the result of a piece of work, and count the piece as used: see `remove`."""
        result = self._results[key]
        self._used.add(key)
        return result

    def keep(self, key: str, result: Any) -> Any:
        """Append the result of the piece of work with the key ``key`` to the file.

        Returns the result after conversion to JSON and back, so that a sweep that continues from
        the file gets the same data. Raises `OutputError` if the file cannot be written.
        """
        payload = json.dumps([key, result])
        start = b"\n" if self._torn else b""
        self._torn = True  # until the whole line is written
        with self._output_errors():
            self._file.append(start + _sealed(payload.encode()) + b"\n")
        self._torn = False
        self._results[key] = json.loads(payload)[1]
        return self[key]

    def close(self) -> None:
        """Release the lock on the file. Delete the file if it is empty."""
        self._file.close()

    def remove(self) -> int:
        """Close the file after a complete sweep; delete the file if all its results were used.

        Returns the number of unused pieces. An unused piece is a piece of work in the file whose
        result this sweep did not use, such as a run with other settings. If there are unused
        pieces, the file stays, so that a sweep with those settings can continue.
        """
        unused = len(self._results.keys() - self._used)
        if not unused:
            self._file.delete()
        self.close()
        return unused

    @contextmanager
    def _output_errors(self) -> Iterator[None]:
        """Context manager: raise an `OutputError` for an `OSError` of the file in the body."""
        try:
            yield
        except OSError as error:
            reason = f"{error.strerror or error}; the pieces that it holds are kept"
            if isinstance(error, BlockingIOError):
                reason = (
                    "another process is at work on it; wait until it has ended, or choose another "
                    "directory"
                )
            raise OutputError(f"checkpoint {shown(self.path)}: {reason}") from None


class UnknownLawError(KneexoError):
    """A law is called as Python, and its name leads to no file: a checkpoint has no key for it.

    A later process could not decide whether its law is the same one.
    """


# A line with a damaged digit is still JSON, but with a wrong result. The checksum finds such a
# line. Only the piece of work of this line is lost, and the others are kept.
def _sealed(payload: bytes) -> bytes:
    """Return a line of the file without line end: a checksum, and then ``payload``.

    ``payload`` is the JSON of a list of key and result.
    """
    seal = hashlib.sha256(payload).hexdigest().encode()
    return b'{"sha256": "' + seal + b'", "piece": ' + payload + b"}"


_PAYLOAD_START = len(_sealed(b"")) - len(b"}")
"""Index at which the payload of a line begins. All lines begin with equally many characters."""


def piece_keys(function: Any, items: Iterable[Any]) -> list[str]:
    """Return the key of each piece of work ``function(item)``, by which a later sweep finds it.

    The key is a digest of kneexo's version, the name of the function with its bound arguments, and
    the item. Raises `UnknownLawError` for an item with a law that another process cannot recognize:
    see `kneexo.simulation.compiled.users_code_key`.
    """
    shared = hashlib.sha256(_text([__version__, function]))
    keys = []
    for item in items:
        piece = shared.copy()
        piece.update(_text(item))
        keys.append(piece.hexdigest()[:32])  # 128 bits, so that two pieces never share a key
    return keys


def _text(value: Any) -> bytes:
    """Return a function or an item as JSON. Equal values have equal texts."""
    return _ENCODER.encode(value).encode()


def _plain(value: Any) -> Any:
    """Return data for JSON that stands for a value in a key, such as a scenario or a function.

    Raises `UnknownLawError` as `piece_keys` does, and `TypeError` for a value of another type.
    """
    if isinstance(value, Scenario) and value.users_code():
        if (key := users_code_key(value)) is None:
            subject = next(law.subject for law in called_code(value) if not law.digest)
            raise UnknownLawError(
                f"{subject}: it is called as Python, and its name in no file leads to it, so a "
                f"later run cannot recognize it and no finished pieces are kept"
            )
        makers = {place: {"make"} for place in value.parts.chosen()}
        numbers = value.model_dump_json(exclude={"controller": {"function"}, "parts": makers})
        # The key contains the equations of the law, not the text of the law. A law with the same
        # equations in another text finds its pieces again. A law with the same text that reads
        # other values has other equations, and so does not find these pieces.
        return [type(value).__name__, numbers, key]
    if isinstance(value, BaseModel):
        return [type(value).__name__, value.model_dump_json()]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__name__, {f.name: getattr(value, f.name) for f in fields(value)}]
    if isinstance(value, Mapping):
        return dict(value)
    if callable(value):
        # A function enters the key by its name alone. For a function of kneexo, the version in the
        # key stands for its code. The cost: a function that is edited at an unchanged version, such
        # as a function of the user, finds its old results.
        return f"{value.__module__}.{value.__qualname__}"
    raise TypeError(f"{type(value).__name__} cannot be part of a checkpointed piece of work")


_ENCODER = json.JSONEncoder(sort_keys=True, default=_plain)
