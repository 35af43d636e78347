"""Writes all files of a result or none. A regular file of the same name is replaced.

New files are written to a temporary directory ``.kneexo-…`` in the target directory and moved at
the end. A process holds a lock in its temporary directory. A temporary directory without a lock was
left by a killed process, and a later process deletes it.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from kneexo.common.files.locking import lock
from kneexo.common.interruption import interrupt_later
from kneexo.errors import OutputError, shown

_PREFIX = ".kneexo-"
_LOCK = "kneexo.lock"


def write_file(path: Path, content: bytes, others: Mapping[str, bytes] = {}) -> None:
    """Write ``content`` to a file, and replace an earlier file. Create missing directories.

    ``others`` maps the names of files beside the file to their contents. Raises `OutputError` if a
    file cannot be written. After an error earlier files are unchanged, and no new directory is
    left.
    """
    with _replacement(path.parent, f"--out {shown(path)}", "") as directory:
        for name, data in {path.name: content, **others}.items():
            (directory / name).write_bytes(data)


def create_files(texts: Mapping[Path, str]) -> None:
    """Write texts to new files of one directory: all or none. Create missing directories.

    Raises `OutputError` if a file exists or cannot be written. Files that exist stay as they are.
    """
    for path in texts:
        if os.path.lexists(path):
            raise OutputError(f"{shown(path)} exists already; choose another name")
    with _replacement(path.parent, shown(path.parent), "") as directory:
        for path, text in texts.items():
            (directory / path.name).write_text(text, encoding="utf-8")


@contextmanager
def output_directory(
    path: str | os.PathLike[str], when_written: Callable[[], object] | None = None
) -> Iterator[Path]:
    """Context manager: give a temporary directory, whose files move to ``path`` after the body.

    If the body fails or a file cannot be moved, no file moves and ``path`` is as before. Missing
    directories are created, and removed again after a failure. ``when_written`` is called when the
    files are in ``path``, before Ctrl-C or SIGTERM can interrupt.

    Raises `OutputError` before the body if ``path`` cannot be written, and after the body if the
    files cannot be written. An `OSError` of the body becomes an `OutputError`.
    """
    target = Path(path)
    remedy = "; choose another directory"
    with _replacement(target, f"--out {shown(target)}", remedy, when_written) as directory:
        yield directory


@contextmanager
def _replacement(
    target: Path,
    option: str,
    remedy: str,
    when_written: Callable[[], object] | None = None,
) -> Iterator[Path]:
    """Context manager: give a temporary directory, whose files move to ``target`` after the body.

    `output_directory` describes what happens after a failure, and ``when_written``. Messages begin
    with ``option`` and end with ``remedy``.
    """
    created: list[Path] = []
    workspace, lock_file = None, None
    try:
        created = [folder for folder in (target, *target.parents) if not folder.exists()]
        with interrupt_later():
            target.mkdir(parents=True, exist_ok=True)
            _delete_leftovers(target)
            workspace, lock_file = _workspace(target)
        yield workspace / "new"
        with interrupt_later():
            _replace(target, workspace)
            if when_written is not None:
                when_written()
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        reason = error.strerror or str(error)
        raise OutputError(f"{option}: cannot write there ({reason}){remedy}") from None
    finally:
        with interrupt_later():
            if workspace is not None and lock_file is not None:
                _delete(workspace)
                os.close(lock_file)
            for folder in created:
                with suppress(OSError):  # not empty, or never created
                    folder.rmdir()


def _workspace(target: Path) -> tuple[Path, int]:
    """Create a temporary directory in ``target``; return its path and its locked file descriptor.

    The directory holds the file `_LOCK`, ``new`` for results and ``old`` for the files that the
    results replace.
    """
    while True:
        # In the target directory, because files can be moved in one step only within a file system.
        workspace = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=target))
        # Before it is locked, another process may delete it as a leftover; then the loop repeats.
        with suppress(FileNotFoundError, BlockingIOError):
            lock_file = os.open(workspace / _LOCK, os.O_RDWR | os.O_CREAT)
            try:
                lock(lock_file)
                (workspace / "old").mkdir()
                (workspace / "new").mkdir()
            except OSError:  # nobody could delete the directory while it is locked
                os.close(lock_file)
                raise
            return workspace, lock_file


def _delete_leftovers(target: Path) -> None:
    """Delete the temporary directories in ``target`` that no process locks."""
    for folder in target.glob(f"{_PREFIX}*"):
        # Errors: it is locked, it is not ours, or the file system has no locks.
        with suppress(OSError):
            if not os.listdir(folder):
                folder.rmdir()
                continue
            lock_file = os.open(folder / _LOCK, os.O_RDWR)
            try:
                fcntl.flock(lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _delete(folder)
            finally:
                os.close(lock_file)


def _delete(workspace: Path) -> None:
    """Delete a temporary directory. Delete the lock file last.

    If this process is killed meanwhile, the lock file tells a later process to delete the rest.
    """
    for folder in (workspace / "new", workspace / "old", workspace):
        shutil.rmtree(folder, ignore_errors=True)


def _replace(target: Path, workspace: Path) -> None:
    """Move the new files to ``target``. If a new file cannot be moved, restore the old files."""
    old = workspace / "old"
    files = sorted((workspace / "new").iterdir())
    for file in files:
        destination = target / file.name
        if destination.exists() and not destination.is_file():
            raise OutputError(
                f"--out {shown(target)}: {file.name} is no regular file there; move it away or "
                f"choose another directory"
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
