"""Writes all files of a result or none. A regular file of the same name is replaced.

New files are written to a temporary directory ``.diagramc-…`` in the target directory and moved at
the end. A process holds a lock in its temporary directory. A temporary directory without a lock was
left by a killed process, and a later process deletes it.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from .errors import OutputError, shown
from .interruption import interrupt_later
from .root import ROOT

_PREFIX = f".{ROOT}-"
_LOCK = f"{ROOT}.lock"


def write_files(
    directory: str | os.PathLike[str], files: Mapping[str, str | bytes], place: str = ""
) -> None:
    """Write files into a directory: all or none, as `output_directory` does.

    Parameters
    ----------
    directory
        The directory. A missing directory is created, and other files in the directory stay.
    files
        Dictionary from the name of a file to its content. Text is written as UTF-8.
    place
        First words of an error message, such as ``file leg.fmu``; by default the directory.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    with output_directory(directory, place) as new:
        _write(new, files)


@contextmanager
def output_directory(
    path: str | os.PathLike[str],
    place: str = "",
    when_written: Callable[[], object] | None = None,
) -> Iterator[Path]:
    """Context manager: give a temporary directory, whose files move to ``path`` after the body.

    If the body fails or a file cannot be moved, no file moves and ``path`` is as before. Missing
    directories are created, and removed again after a failure.

    Parameters
    ----------
    path
        The directory for the files.
    place
        First words of an error message, such as ``--out run``; by default the directory.
    when_written
        Called when the files are in ``path``, before Ctrl-C or SIGTERM can interrupt.

    Raises
    ------
    OutputError
        Before the body if ``path`` cannot be written, and after the body if the files cannot be
        written. An `OSError` of the body becomes an `OutputError`.
    """
    target = Path(path)
    place = place or f"directory {shown(target)}"
    created: list[Path] = []
    try:
        created = [folder for folder in (target, *target.parents) if not folder.exists()]
        target.mkdir(parents=True, exist_ok=True)
        delete_leftovers(target)
        with temporary_in(target) as new:
            yield new
            with interrupt_later():
                _replace(target, new, place)
                if when_written is not None:
                    when_written()
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        reason = error.strerror or error
        raise OutputError(
            f"{place}: cannot write there ({reason}); choose another directory"
        ) from None
    finally:
        with interrupt_later():
            for folder in created:
                with suppress(OSError):  # not empty, or never created
                    folder.rmdir()


def _write(directory: Path, files: Mapping[str, str | bytes]) -> None:
    for name, content in files.items():
        # The text of a user's file in Latin-1 has surrogate escapes.
        data = content.encode(errors="surrogateescape") if isinstance(content, str) else content
        (directory / name).write_bytes(data)


def _replace(target: Path, new: Path, place: str) -> None:
    """Move the new files to ``target``. If a new file cannot be moved, restore the old files."""
    old = new.with_name("old")
    old.mkdir()
    files = sorted(new.iterdir())
    for file in files:
        destination = target / file.name
        if destination.exists() and not destination.is_file():
            raise OutputError(
                f"{place}: {file.name} is no regular file there; move it away or choose another "
                f"directory"
            )
        if os.path.lexists(destination):
            try:
                # A link in place of a rename: until its new file is moved, the old file stays in
                # its place.
                os.link(destination, old / file.name, follow_symlinks=False)
            except OSError:  # a file system without hard links
                shutil.copy2(destination, old / file.name, follow_symlinks=False)
    moved = []
    try:
        for file in files:
            os.replace(file, target / file.name)
            moved.append(file.name)
    except OSError:
        for name in moved:
            if os.path.lexists(old / name):
                os.replace(old / name, target / name)
            else:
                (target / name).unlink()
        raise


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
        if all(name.startswith(_PREFIX) for name in names):
            return
    raise OutputError(f"directory {shown(folder)}: {reason}; choose another directory")


# ------------------------------------------------------------------- temporary directories


@contextmanager
def temporary_in(directory: Path) -> Iterator[Path]:
    """Context manager: give a temporary directory in ``directory``, which this process locks.

    The given path ends in ``new``. Beside it lie the file of the lock, and ``old`` for the files
    that new ones replace. Raises `OSError` if the temporary directory cannot be made.
    """
    with ExitStack() as stack:
        with interrupt_later():
            workspace = _workspace(directory, stack)
        yield workspace / "new"


def _workspace(directory: Path, stack: ExitStack) -> Path:
    """Create and lock a temporary directory, which ``stack`` deletes."""
    while True:
        # In the target directory, because files can be moved in one step only within a file system.
        workspace = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=directory))
        # Before it is locked, another process may delete it as a leftover; then the loop repeats.
        with suppress(FileNotFoundError, BlockingIOError):
            lock_file(stack.enter_context((workspace / _LOCK).open("wb")))
            stack.callback(_delete, workspace)
            (workspace / "new").mkdir()
            return workspace


def lock_file(file: IO[bytes]) -> None:
    """Lock an open file for this process. The kernel releases the lock when the process ends.

    Raises `BlockingIOError` if the file is locked already.
    """
    try:
        # A lock of the kernel and not a file with a process number, which would outlive a killed
        # process.
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # a file system without locks, where the file stays unlocked
        pass


def delete_leftovers(directory: Path) -> None:
    """Delete the temporary directories in ``directory`` that no process locks."""
    for folder in directory.glob(f"{_PREFIX}*"):
        # Errors: it is locked, it is not ours, or the file system has no locks.
        with suppress(OSError):
            if not os.listdir(folder):
                folder.rmdir()
                continue
            with (folder / _LOCK).open("r+b") as locked:
                fcntl.flock(locked, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _delete(folder)


def _delete(workspace: Path) -> None:
    """Delete a temporary directory. Delete the lock file last.

    If this process is killed meanwhile, the lock file tells a later process to delete the rest.
    """
    with interrupt_later():
        for folder in (workspace / "new", workspace / "old", workspace):
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def temporary_folder(files: Mapping[str, str]) -> Iterator[Path]:
    """Context manager: give a temporary folder that holds ``files``, which maps names to texts.

    Raises `OSError` if a file cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix=f"{ROOT}-") as folder:
        _write(Path(folder), files)
        yield Path(folder)
