"""Writes files and folders completely or not at all, and deletes what killed processes left.

Each function can raise `OSError`, unless its docstring says otherwise.
"""

from __future__ import annotations

import atexit
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from .errors import OutputError, shown
from .root import ROOT

_STALE_S = 3600.0  # a younger temporary file may be one that another process is writing
_UNFINISHED = f".{ROOT}_"  # first letters of a temporary folder of `write_folder`


class FileStatus(NamedTuple):
    """The path of a file, its size, and the time of its last use."""

    path: Path
    size_bytes: int
    last_use_s: float
    """Unix time of the last use in s. The modification time of the file records the last use."""


def files_in(directory: Path, names: re.Pattern[str]) -> list[FileStatus]:
    """Return the files of a directory whose whole name matches the regular expression ``names``.

    A directory that cannot be read gives an empty list.
    """
    files = []
    with suppress(OSError), os.scandir(directory) as items:
        for item in items:
            if names.fullmatch(item.name) and not item.is_dir(follow_symlinks=False):
                with suppress(FileNotFoundError):  # another process deleted it
                    status = item.stat(follow_symlinks=False)
                    files.append(FileStatus(Path(item.path), status.st_size, status.st_mtime))
    return files


# --------------------------------------------------------------------------------- one file


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, then rename it to ``path``, replacing an earlier file.

    If writing fails, the earlier file stays.
    """
    # In the same directory, because a rename to another file system is no single step.
    temporary = path.with_name(f".{path.name}.{os.urandom(8).hex()}")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except BaseException:  # KeyboardInterrupt too
        with suppress(OSError):
            temporary.unlink()
        raise


def delete_stale(directory: Path, names: str) -> None:
    """Delete temporary files of `write_whole` older than an hour, left by killed processes.

    ``names`` is a regular expression for the final names of the files. Never raises `OSError`.
    """
    for file in files_in(directory, re.compile(rf"\.{names}\.[0-9a-f]{{16}}")):
        if file.last_use_s < time.time() - _STALE_S:
            with suppress(OSError):
                file.path.unlink()


# ------------------------------------------------------------------------------ directories


def process_directory() -> Path:
    """Make a temporary directory that is deleted when this process ends.

    The end of a forked process does not delete the directory.
    """
    directory = Path(tempfile.mkdtemp(prefix=f"{ROOT}-"))
    atexit.register(_delete_directory, directory, os.getpid())
    return directory


def _delete_directory(directory: Path, process: int) -> None:
    if os.getpid() == process:  # not in a fork
        shutil.rmtree(directory, ignore_errors=True)


@contextmanager
def temporary_folder(files: Mapping[str, str]) -> Iterator[Path]:
    """Context manager: give a temporary folder that holds ``files``, which maps names to texts."""
    with tempfile.TemporaryDirectory(prefix=f"{ROOT}-") as folder:
        _write_texts(Path(folder), files)
        yield Path(folder)


def require_empty(folder: Path) -> None:
    """Raise `OutputError` if a folder has files. A missing folder is no error."""
    try:
        names = os.listdir(folder)
    except FileNotFoundError:
        return
    except OSError as error:
        reason = f"cannot be read ({error.strerror})"
    else:
        reason = "has other files and no export"
        if all(name.startswith(_UNFINISHED) for name in names):
            return
    raise OutputError(f"directory {shown(folder)}: {reason}; choose another directory")


def write_folder(folder: Path, files: Mapping[str, str]) -> None:
    """Write files into a folder. Other files in the folder stay.

    ``files`` maps the name of a file to its text. A missing folder is created. No earlier file is
    replaced before all new files are written. Temporary folders of killed calls are deleted. Raises
    `OutputError` if writing fails.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(f"{_UNFINISHED}*"):
            shutil.rmtree(left)
        with tempfile.TemporaryDirectory(dir=folder, prefix=_UNFINISHED) as new:
            _write_texts(Path(new), files)
            for name in files:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(Path(new, name), folder / name)
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(
            f"directory {shown(folder)}: cannot write there ({reason}); choose another directory"
        ) from None


def _write_texts(folder: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", errors="surrogateescape")  # a file may be Latin-1
