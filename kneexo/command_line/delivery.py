"""Runs a request, and writes and prints its outcome."""

from __future__ import annotations

import sys
import webbrowser
from contextlib import nullcontext
from pathlib import Path

from diagramc import interrupt_later, output_directory, write_files
from kneexo import system
from kneexo.command_line.outcome import Outcome
from kneexo.command_line.request import Request
from kneexo.common.progress import progress_bar, whole_bar
from kneexo.errors import PackageError, shown

FILES = "files"
"""Description of the progress bar of writing a command's files."""


def import_drake() -> None:
    """Import Drake. Raises `PackageError` if the system lacks a library of Drake's."""
    if line := system.lacking():  # Drake itself would print a page
        raise PackageError(line)
    with interrupt_later():  # an interrupt of its first import makes Drake print a page
        import pydrake  # noqa: F401  (imported here for that reason alone)


def deliver(request: Request) -> int:
    """Run the command of ``request``, write its files and print its text.

    Opens the browser if requested. Returns the exit code: 2 if no browser can be opened, else 0.
    """
    if request.uses_drake:
        import_drake()
    if (first := request.first(request)) is not None:
        text = _with_directory(first).text
        print(f"kneexo: first answer, {first.first_answer}:\n{text}", file=sys.stderr)
        request.restart, request.answered = False, first.first_answer
    outcome = _with_directory(request) if request.fills_directory else request.run(request)
    if outcome.page:
        file = request.out
        write_files(file.parent, {file.name: outcome.page}, f"--out {shown(file)}")
        request.written = True
    for notice in outcome.notices:
        print(notice, file=sys.stderr)
    if request.unused_pieces:
        print(
            f"kneexo: {request.unused_pieces} finished pieces of other settings stay in "
            f"{shown(request.checkpoint_path)}; --restart deletes them",
            file=sys.stderr,
        )
    as_json = request.json and outcome.document is not None
    print(outcome.document if as_json else outcome.text, end="")
    if request.browser and not webbrowser.open(request.out.resolve().as_uri()):
        message = f"--open: no browser here; {shown(request.out)} is written, open it elsewhere"
        print(f"kneexo: {message}", file=sys.stderr)
        return 2
    return 0


def interrupt_notice(request: Request) -> str:
    """Return a phrase that says where an interrupted command left results or finished pieces.

    Without results and pieces the phrase is "nothing was written".
    """
    if request.written:
        return f"the results are in {shown(request.out)}"
    if request.answered:
        answer = f"the first answer ({request.answered}) is in {shown(request.out)}"
        return f"{answer}; {pieces_notice(request)}"
    return pieces_notice(request) or "nothing was written"


def pieces_notice(request: Request) -> str:
    """Return a phrase that says where finished pieces are, or an empty text without pieces."""
    path, checkpoint = request.checkpoint_path, request.checkpoint
    if path is None or not (path.exists() if checkpoint is None else checkpoint):
        return ""
    count = "" if checkpoint is None else f"{len(checkpoint)} "
    return f"{count}finished pieces are kept in {shown(path)}; the same command goes on from them"


def _with_directory(request: Request) -> Outcome:
    """Run a command and write the files and figures of its outcome. Close the figures."""

    def note_written() -> None:
        """Delete the finished pieces, unless some are unused, such as pieces of other settings."""
        request.written = True
        if request.checkpoint is not None and not request.first_answer:
            request.unused_pieces = request.checkpoint.remove()

    place = f"--out {shown(request.out)}"
    with output_directory(request.out, place, note_written) as directory:
        try:
            with whole_bar(request.command, request.stages) if request.stages else nullcontext():
                outcome = request.run(request)
                _write(outcome, directory, FILES if request.stages else None)
        except BaseException:  # KeyboardInterrupt too: another process may want the file
            if request.checkpoint is not None:
                request.checkpoint.close()
            raise
    return outcome


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
