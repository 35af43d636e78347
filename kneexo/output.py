"""Writing results: all of them or none."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kneexo.errors import OutputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.analysis import Run


@contextmanager
def output_directory(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary directory whose files move to ``path`` when the body ends without error.

    ``path`` and its parents are made when missing, and removed again when the body fails. Raises
    `OutputError` before the body when ``path`` cannot be written, and when writing fails.
    """
    target = Path(path)
    made = [folder for folder in (target, *target.parents) if not folder.exists()]
    try:
        target.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".kneexo-", dir=target))
    except OSError as error:
        raise _output_error(target, error) from None
    try:
        yield temporary
        for file in sorted(temporary.iterdir()):
            os.replace(file, target / file.name)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise _output_error(target, error) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for folder in made:
            if not any(folder.iterdir()):
                folder.rmdir()


def _output_error(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"--out {path}: cannot write there ({reason}); choose another directory")


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
    names = ("time_s", *run.data)
    table = np.column_stack([run.time_s, *run.data.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.10g")


def save_figure(directory: Path, name: str, figure: Figure) -> None:
    """Write a figure as PNG and PDF, without dates, so that equal figures are equal files."""
    figure.savefig(directory / f"{name}.png", dpi=150)
    figure.set_layout_engine(None)  # done: with an engine each file is drawn twice
    figure.savefig(directory / f"{name}.pdf", metadata={"CreationDate": None})
