"""Reads bytes, or text in UTF-8, from regular files of limited size."""

from __future__ import annotations

import os
import stat

from kneexo.errors import ScenarioError, close_names, question, shortened, shown

MIB = 2**20
"""Number of bytes in one MiB."""


# The size is looked at before the file is read, so that a file of many GiB ends in one line.
def read_bytes(path: str | os.PathLike[str], most_bytes: int) -> bytes:
    """Read a regular file of at most ``most_bytes`` bytes.

    Raises `OSError` for every other file, because reading a pipe or a device may never end.
    """
    status = os.stat(path)
    regular = stat.S_ISREG(status.st_mode)
    if not regular and not stat.S_ISDIR(status.st_mode):  # open refuses a directory
        raise OSError("is not a regular file")
    if regular and status.st_size > most_bytes:
        raise OSError(f"is too large, must have at most {most_bytes} bytes")
    with open(path, "rb") as file:
        return file.read()


def read_text(path: str | os.PathLike[str], most_bytes: int) -> str:
    """Read a text file in UTF-8, with or without a byte order mark; see `read_bytes`.

    Raises `ScenarioError` with the file and the reason.
    """
    try:
        return read_bytes(path, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = error.object.count(b"\n", 0, error.start) + 1, error.object[error.start]
        message = f"is not UTF-8: byte 0x{byte:02x}; save it as UTF-8"
        raise file_error(path, line, message) from None
    except FileNotFoundError as error:
        hint = question(_similar_path(path))
        raise file_error(path, None, f"cannot be read: {error.strerror}{hint}") from error
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        reason = getattr(error, "strerror", None) or error
        raise file_error(path, None, f"cannot be read: {reason}") from error


def _similar_path(path: str | os.PathLike[str]) -> list[str]:
    """Return the path that a user may have meant by ``path``, as text for a message.

    The path belongs to the file in the same directory whose name is most similar. The list has this
    path alone. It is empty if no name is similar, or if the directory cannot be read.
    """
    directory, name = os.path.split(os.fspath(path))
    try:
        with os.scandir(directory or ".") as entries:
            # 1000 is a choice, which bounds the time in a directory with very many files. A similar
            # name among the further files is not found.
            files = [entry.name for entry, _ in zip(entries, range(1000), strict=False)]
    except OSError:
        return []
    # 0.8 is a choice, stricter than the default 0.6 of `close_names`. The cost: a name with more
    # typing errors gets no hint.
    similar_names = close_names(name, files, 0.8, most=1)
    return [shown(os.path.join(directory, similar_name)) for similar_name in similar_names]


def file_error(path: str | os.PathLike[str], line: int | None, message: str) -> ScenarioError:
    """Return an error with the name of the file, the line if given, and ``message``."""
    place = "" if line is None else f":{line}"
    return ScenarioError(f"{shown(os.fspath(path))}{place}: {shortened(message, 800)}")
