"""Requests and outcomes of commands, and the delivery that writes and prints an outcome."""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from diagramc import output_directory, write_files
from kneexo.common.progress import progress_bar
from kneexo.errors import (
    KneexoError,
    OutputError,
    PackageError,
    ScenarioError,
    WorkerError,
    shown,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.sweeps.checkpoint import Checkpoint

FILES = "files"
"""Description of the progress bar of writing a command's files."""


@dataclass(frozen=True)
class Outcome:
    """The results of a command, which a `Delivery` writes and prints."""

    text: str = ""
    """Text that is printed on stdout."""
    document: str | None = None
    """JSON text that ``--json`` prints instead of ``text``. If None, ``--json`` prints ``text``."""
    notices: Sequence[str] = ()
    """Lines that are printed on stderr, before the text."""
    advice: str = ""
    """A line that is printed on stderr after the text, unless JSON is printed."""
    files: Mapping[str, str | bytes | Callable[[Path], object]] = field(default_factory=dict)
    """Files for `Request.directory`: from file name to content, or to a function that writes it."""
    figures: Mapping[str, Figure] = field(default_factory=dict)
    """Figures by name. Each figure is written to `Request.directory` as PNG and as PDF."""
    page: str = ""
    """HTML text that is written to `Request.file`."""
    open_in_browser: bool = False
    """Whether the browser opens `Request.file` after the text is printed."""


@dataclass(frozen=True)
class Request:
    """A command with its arguments, and the files for its results."""

    run: Callable[..., Outcome]
    """Function that runs the command; gets ``checkpoint`` if `checkpoint_path` is set."""
    json: bool = False
    """Whether to print the results as JSON."""
    directory: Path | None = None
    """The directory for `Outcome.files` and `Outcome.figures`; None if the command has none."""
    file: Path | None = None
    """The file for `Outcome.page`; None if the command writes no page."""
    scenario: str | None = None
    """Path of the scenario file, or None without a file. Error messages begin with the path."""
    checkpoint_path: Path | None = None
    """File that holds finished pieces of a study until its results are written, or None."""
    restart: bool = False
    """Whether to delete the finished pieces of an earlier run before the command runs."""
    uses_drake: bool = True
    """Whether the command imports Drake."""
    progress: Callable[[], AbstractContextManager[None]] = nullcontext
    """Function that returns a context manager, which shows the progress of the whole command."""
    uses_workers: bool = False
    """Whether the command has ``--workers``, so that a message about memory suggests fewer."""


class Delivery:
    """Runs the command of one request, and writes and prints the outcome."""

    def __init__(self, request: Request) -> None:
        self.request = request
        self._checkpoint: Checkpoint | None = None
        self._unused_pieces = 0
        self._written = False

    def run(self) -> int:
        """Run the command, write its files, print its text; return the exit code."""
        request = self.request
        if request.directory is not None:
            place = f"--out {shown(request.directory)}"
            with output_directory(request.directory, place, self._note_written) as directory:
                try:
                    with request.progress():
                        outcome = self._outcome()
                        alone = request.progress is nullcontext
                        _write(outcome, directory, None if alone else FILES)
                except BaseException:  # KeyboardInterrupt too: another process may want the file
                    if self._checkpoint is not None:
                        self._checkpoint.close()
                    raise
        else:
            outcome = self._outcome()
            if (file := request.file) is not None:
                write_files(file.parent, {file.name: outcome.page}, f"--out {shown(file)}")
                self._note_written()
        return self._print(outcome)

    def interrupt_notice(self) -> str:
        """Return a phrase that says where an interrupted command left results or finished pieces.

        Without results and pieces the phrase is "nothing was written".
        """
        if self._written:
            return f"the results are in {shown(self.request.directory or self.request.file)}"
        return self.checkpoint_notice() or "nothing was written"

    def checkpoint_notice(self) -> str:
        """Return a phrase that says where finished pieces are, or an empty text without pieces."""
        path = self.request.checkpoint_path
        if path is None or not (path.exists() if self._checkpoint is None else self._checkpoint):
            return ""
        count = "" if self._checkpoint is None else f"{len(self._checkpoint)} "
        return (
            f"{count}finished pieces are kept in {shown(path)}; the same command goes on from them"
        )

    def _outcome(self) -> Outcome:
        if self.request.checkpoint_path is None:
            return self.request.run()
        from kneexo.sweeps.checkpoint import Checkpoint

        resume = not self.request.restart
        self._checkpoint = Checkpoint(self.request.checkpoint_path, resume=resume)
        return self.request.run(checkpoint=self._checkpoint)

    def _note_written(self) -> None:
        """Note that the results are written. Delete the checkpoint, unless it has unused pieces.

        An unused piece, such as a piece of other settings, was not read by this command.
        """
        self._written = True
        if self._checkpoint is not None:
            self._unused_pieces = self._checkpoint.remove()

    def _print(self, outcome: Outcome) -> int:
        """Print notices and text, and open the browser if requested.

        Returns the exit code: 2 if no browser can be opened, else 0.
        """
        for notice in outcome.notices:
            print(notice, file=sys.stderr)
        if self._unused_pieces:
            print(
                f"kneexo: {self._unused_pieces} finished pieces of other settings stay in "
                f"{shown(self.request.checkpoint_path)}; --restart deletes them",
                file=sys.stderr,
            )
        as_json = self.request.json and outcome.document is not None
        print(outcome.document if as_json else outcome.text, end="")
        if outcome.advice and not as_json:
            print(outcome.advice, file=sys.stderr)
        file = self.request.file
        if outcome.open_in_browser and file and not webbrowser.open(file.resolve().as_uri()):
            message = f"--open: no browser here; {shown(file)} is written, open it elsewhere"
            print(f"kneexo: {message}", file=sys.stderr)
            return 2
        return 0


def file_names(files: Iterable[str], figures: Iterable[str] = ()) -> list[str]:
    """Return the sorted file names of files and figures. A figure has a PDF and a PNG file."""
    return sorted([*files, *(f"{name}.{kind}" for name in figures for kind in ("pdf", "png"))])


def files_line(directory: Path, files: Iterable[str], figures: Iterable[str] = ()) -> str:
    """Return the line that names directory and files, with the number of figures."""
    names = sorted(files)
    if count := len(list(figures)):
        names.append(f"{count} figure{'s' if count > 1 else ''} (PDF, PNG)")
    return f"In {shown(directory)}: {', '.join(names)}\n"


@contextmanager
def named_in_errors(path: str | None) -> Iterator[None]:
    """Context manager: put ``path``, the scenario file, before the message of an error.

    The message stays as it is if it begins with an argument such as ``--set``, or if the scenario
    cannot be the cause, for example because an output cannot be written.
    """
    try:
        yield
    except KneexoError as error:
        elsewhere = isinstance(error, ScenarioError | OutputError | PackageError | WorkerError)
        named = shown(path) in str(error) or str(error).startswith("--")
        if path and not elsewhere and not named:
            error.args = (f"{shown(path)}: {error}",)
        raise


def _write(outcome: Outcome, directory: Path, description: str | None) -> None:
    """Write the files and figures of an outcome to ``directory``, and close the figures.

    ``description`` is that of a progress bar, or None for no bar.
    """
    for name, content in outcome.files.items():
        if callable(content):
            content(directory / name)
        else:
            data = content.encode() if isinstance(content, str) else content
            (directory / name).write_bytes(data)
    if outcome.figures:
        import matplotlib.pyplot as plt

        from kneexo.command_line.output import save_figure

        with progress_bar(len(outcome.figures), description) as bar:
            for name, figure in outcome.figures.items():
                save_figure(directory, name, figure)
                plt.close(figure)
                bar.update(1)
