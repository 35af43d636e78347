"""Writing results: all of them or none."""

from __future__ import annotations

import fcntl
import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kneexo.errors import OutputError, shown
from kneexo.interruption import interrupt_later

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.analysis import Run

_PREFIX = ".kneexo-"
_LOCK = "kneexo.lock"


@contextmanager
def output_directory(
    path: str | os.PathLike[str], written: Callable[[], object] | None = None
) -> Iterator[Path]:
    """A temporary directory whose files move to ``path`` when the body ends without error.

    All files move, or none: an error puts back what was there before. ``path`` and its parents are
    made when missing, and removed again when the body fails. What killed processes left there is
    deleted. ``written`` is called as soon as the files are in ``path``.

    Raises `OutputError` before the body when ``path`` cannot be written, and when writing fails.
    """
    target = Path(path)
    made: list[Path] = []
    workspace, lock = None, None
    try:
        made = [folder for folder in (target, *target.parents) if not folder.exists()]
        with interrupt_later():
            target.mkdir(parents=True, exist_ok=True)
            _delete_leftovers(target)
            workspace, lock = _workspace(target)
        yield workspace / "new"
        with interrupt_later():
            _replace(target, workspace)
            if written is not None:
                written()
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise _output_error(target, error) from None
    finally:
        with interrupt_later():
            if workspace is not None and lock is not None:
                _delete(workspace)
                os.close(lock)
            _remove_empty(made)


def _workspace(target: Path) -> tuple[Path, int]:
    """A temporary directory in ``target``, and the descriptor of its lock, which dies with us.

    It holds the file `_LOCK`, ``new`` for results and ``old`` for the files that they replace.
    """
    while True:
        workspace = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=target))
        with suppress(FileNotFoundError, BlockingIOError):  # taken for a leftover: again
            lock = os.open(workspace / _LOCK, os.O_RDWR | os.O_CREAT)
            try:
                _lock(lock)
                (workspace / "old").mkdir()
                (workspace / "new").mkdir()
            except OSError:  # an open lock would keep the leftover
                os.close(lock)
                raise
            return workspace, lock


def _lock(file: int) -> None:
    """Lock an open file, also where the file system has no locks; `BlockingIOError`: is locked."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        pass


def _delete_leftovers(target: Path) -> None:
    """Delete the temporary directories of dead processes: nobody locks them."""
    for folder in target.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # at work, another's, or a file system without locks
            if not os.listdir(folder):
                folder.rmdir()
                continue
            lock = os.open(folder / _LOCK, os.O_RDWR)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _delete(folder)
            finally:
                os.close(lock)


def _delete(workspace: Path) -> None:
    """The lock goes last: what a kill leaves is still known as a leftover."""
    for folder in (workspace / "new", workspace / "old", workspace):
        shutil.rmtree(folder, ignore_errors=True)


def _replace(target: Path, workspace: Path) -> None:
    """Move the new files to ``target``; an error restores the old ones."""
    old = workspace / "old"
    files = sorted((workspace / "new").iterdir())
    for file in files:
        place = target / file.name
        if place.is_dir():
            raise OutputError(
                f"--out {shown(target)}: {file.name} is a directory there; move it away or "
                f"choose another directory"
            )
        if os.path.lexists(place):
            try:
                os.link(place, old / file.name, follow_symlinks=False)
            except OSError:  # a file system without hard links
                shutil.copy2(place, old / file.name, follow_symlinks=False)
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


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, or never made
            folder.rmdir()


def _output_error(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(
        f"--out {shown(path)}: cannot write there ({reason}); choose another directory"
    )


def plain(value: Any) -> Any:
    """``value`` with arrays as lists and numbers that are not finite as None, for JSON."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(value: Any) -> str:
    """JSON text of `plain` data."""
    return json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_csv(path: Path, run: Run) -> None:
    """Write all signals of a run; each column's name ends in its unit."""
    line = ",".join(["%.10g"] * len(run.columns)) + "\n"
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(run.columns) + "\n")
        file.writelines(line % row for row in zip(*run.columns.values(), strict=True))


def save_figure(directory: Path, name: str, figure: Figure) -> None:
    """Write a figure as PNG and PDF, without dates, so that equal figures are equal files."""
    figure.savefig(directory / f"{name}.png", dpi=150)
    figure.set_layout_engine(None)  # done: with an engine each file is drawn twice
    figure.savefig(directory / f"{name}.pdf", metadata={"CreationDate": None})
