"""Reads bytes, or text in UTF-8, from regular files of limited size."""

from __future__ import annotations

import codecs
import os
import stat

from kneexo.errors import ScenarioError, close_names, question, shortened, shown

MIB = 2**20
"""Number of bytes in one MiB."""

_CHUNK = MIB
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)


def read_bytes(path: str | os.PathLike[str], most_bytes: int) -> bytes:
    """Read a regular file of at most ``most_bytes`` bytes.

    Raises `OSError` for every other file, because reading a pipe or a device may never end.
    """
    try:
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
            raise OSError("is not a regular file")
        # A file of the kernel may wait for data, and a pipe may have replaced the file.
        with open(path, "rb", buffering=0, opener=_open_without_waiting) as file:
            size = os.fstat(file.fileno()).st_size
            chunks: list[bytes] = []
            while size <= most_bytes:
                chunk = file.read(_CHUNK)
                if chunk is None:
                    raise OSError("has no data now; must be an ordinary file")
                if not chunk:
                    return b"".join(chunks)
                chunks.append(chunk)
                size = max(size, sum(map(len, chunks)))
    except MemoryError:
        raise OSError("is too large for the free memory") from None
    except ValueError:  # its message changes with the version of Python
        raise OSError("a null byte in its name") from None
    raise OSError(f"is too large, must have at most {most_bytes} bytes")


def read_text(path: str | os.PathLike[str], most_bytes: int) -> str:
    """Read a text file in UTF-8, with or without a byte order mark; see `read_bytes`.

    Raises `ScenarioError` with the file and the reason.
    """
    try:
        data = read_bytes(path, most_bytes)
        if data.startswith(_UTF_16):
            raise file_error(path, None, "is in UTF-16 or UTF-32; save it as UTF-8")
        if (place := data.find(b"\0")) >= 0:
            message = "has a null byte; must be text in UTF-8, not UTF-16 or binary data"
            raise file_error(path, data.count(b"\n", 0, place) + 1, message)
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = error.object.count(b"\n", 0, error.start) + 1, error.object[error.start]
        message = f"is not UTF-8: byte 0x{byte:02x}; save it as UTF-8"
        raise file_error(path, line, message) from None
    except FileNotFoundError as error:
        similar = question(_similar(path))
        raise file_error(path, None, f"cannot be read: {error.strerror}{similar}") from error
    except OSError as error:
        raise file_error(path, None, f"cannot be read: {error.strerror or error}") from error
    except MemoryError:
        message = "cannot be read: is too large for the free memory"
        raise file_error(path, None, message) from None


def _similar(path: str | os.PathLike[str]) -> list[str]:
    """Return the path of the file in the same directory whose name is most like that of ``path``.

    The list is empty if no name is similar, or if the directory is missing or cannot be read.
    """
    directory, name = os.path.split(os.fspath(path))
    try:
        with os.scandir(directory or ".") as entries:
            files = [entry.name for entry, _ in zip(entries, range(1000), strict=False)]
    except OSError:
        return []
    return [
        shown(os.path.join(directory, close)) for close in close_names(name, files, 0.8, most=1)
    ]


def file_error(path: str | os.PathLike[str], line: int | None, message: str) -> ScenarioError:
    """Return an error with the name of the file, the line if given, and ``message``."""
    place = "" if line is None else f":{line}"
    return ScenarioError(f"{shown(os.fspath(path))}{place}: {shortened(message, 800)}")


def _open_without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)
