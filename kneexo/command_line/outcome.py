"""The outcome of a command: what `kneexo.command_line.delivery` writes and prints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from kneexo.errors import shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Outcome:
    """The results of a command, as texts, files and figures."""

    text: str = ""
    """Text that is printed on stdout."""
    document: str | None = None
    """JSON text that ``--json`` prints instead of ``text``. If None, ``--json`` prints ``text``."""
    notices: Sequence[str] = ()
    """Lines that are printed on stderr, before the text."""
    files: Mapping[str, str | bytes | Callable[[Path], object]] = field(default_factory=dict)
    """Files for the directory: from file name to content, or to a function that writes the file."""
    figures: Mapping[str, Figure] = field(default_factory=dict)
    """Figures by name. Each figure is written to the directory as PNG and as PDF."""
    page: str = ""
    """HTML text that is the file of ``--out``, or an empty text if the command has no page."""


def file_names(files: Iterable[str], figures: Iterable[str] = ()) -> list[str]:
    """Return the sorted file names of files and figures. A figure has a PDF and a PNG file."""
    return sorted([*files, *(f"{name}.{kind}" for name in figures for kind in ("pdf", "png"))])


def files_line(directory: Path, files: Iterable[str], figures: Iterable[str] = ()) -> str:
    """Return the line that names directory and files, with the number of figures."""
    names = sorted(files)
    if count := len(list(figures)):
        names.append(f"{count} figure{'s' if count > 1 else ''} (PDF, PNG)")
    return f"In {shown(directory)}: {', '.join(names)}\n"
