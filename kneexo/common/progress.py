"""The width of a line, and progress bars with the remaining time, for terminals and notebooks.

A command shows one bar for its whole work, `whole_bar`, which the bars of its parts advance.
"""

from __future__ import annotations

import builtins
import importlib.util
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

_REFRESHES_PER_S = 2.0  # each costs some milliseconds, which the runs lack
_SPEED_OVER_S = 1e6  # the time left follows from the mean speed since the begin


COLUMNS = 100
"""Largest number of characters of a line, also in a file or pipe."""


def line_width() -> int:
    """Return the number of characters of a line: that of the terminal, at most `COLUMNS`."""
    return min(shutil.get_terminal_size((COLUMNS, 24)).columns, COLUMNS)


@dataclass(frozen=True)
class Stage:
    """A part of a command. The bar of the whole command gives each part its typical duration."""

    name: str
    """Description of the progress bar of the stage."""
    duration_s: float
    """Typical duration in s on two cores."""
    repeats: bool = False
    """True if an unknown number of bars with this name follow each other."""


@dataclass
class Bar:
    """A progress bar for an amount of work."""

    total: float
    """The whole amount of work."""
    move: Callable[[float], None]
    """Shows the share of the work that is finished."""
    n: float = 0.0
    """The amount of work that is finished."""

    def update(self, amount: float) -> None:
        """Advance the bar by an amount of work."""
        self.n += amount
        self.move(min(self.n / self.total, 1.0) if self.total else 1.0)


@contextmanager
def progress_bar(total: float, description: str | None) -> Iterator[Bar]:
    """Context manager: show a bar that ends at ``total``. Its method ``update`` advances the bar.

    Within the body of `whole_bar` the method advances the bar of the whole command. The bar shows
    nothing if ``description`` is None, or if stderr is no terminal. In a notebook the bar requires
    ipywidgets (``pip install ipywidgets``) and otherwise shows nothing.
    """
    if _whole is None or description is None:
        with _shown(description) as move:
            yield Bar(total, move)
        return
    start, end = _whole.stage(description)
    whole = _whole
    whole.advance_to(start)
    yield Bar(total, lambda share: whole.advance_to(start + share * (end - start)))
    whole.advance_to(end)


@contextmanager
def whole_bar(description: str, stages: Sequence[Stage]) -> Iterator[None]:
    """Context manager: show one bar for the whole work of its body, if stderr is a terminal.

    Each `progress_bar` of the body whose description is the name of a stage advances the bar by
    the share of this stage. Between two advances the bar still shows the elapsed time. Lines on
    stderr appear above the bar. The bar disappears at the end.
    """
    global _whole
    with _shown(description, transient=True) as move:
        _whole = _Whole(stages, move)
        try:
            yield
        finally:
            _whole = None


@contextmanager
def _shown(
    description: str | None, *, transient: bool = False
) -> Iterator[Callable[[float], None]]:
    """Context manager: show a bar, and return the function that moves it to a share from 0 to 1."""
    notebook = _in_notebook() and importlib.util.find_spec("ipywidgets") is not None
    if description is None or not (sys.stderr.isatty() or notebook):
        yield lambda share: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

    with Progress(
        *("{task.description}: {task.percentage:3.0f}%", BarColumn()),
        *(TimeElapsedColumn(), TimeRemainingColumn(), "left"),
        console=Console(stderr=True),
        refresh_per_second=_REFRESHES_PER_S,
        speed_estimate_period=_SPEED_OVER_S,
        transient=transient,
        redirect_stdout=False,
    ) as progress:
        task = progress.add_task(description, total=1.0)
        yield lambda share: progress.update(task, completed=share)
        progress.refresh()  # in a notebook, rich does not show the end


class _Whole:
    """The bar of a whole command, and the stage that it has reached."""

    def __init__(self, stages: Sequence[Stage], move: Callable[[float], None]) -> None:
        self._move, self._reached = move, 0.0
        self._total_s = sum(stage.duration_s for stage in stages)
        self._left: dict[str, tuple[float, float, bool]] = {}
        end = 0.0
        for stage in stages:
            start, end = end, end + stage.duration_s
            self._left[stage.name] = (start, end, stage.repeats)

    def stage(self, name: str) -> tuple[float, float]:
        """Return begin and end of the next bar of a stage, in s of typical duration.

        Begin and end are the present position if there is no such stage.
        """
        if name not in self._left:
            return self._reached, self._reached
        start, last, repeats = self._left[name]
        # Nobody knows how many bars follow, so each takes half of what is left of the stage.
        end = 0.5 * (start + last) if repeats else last
        self._left[name] = (end, last, repeats)
        return start, end

    def advance_to(self, position_s: float) -> None:
        """Move the bar forward to a position in s of typical duration."""
        if position_s > self._reached:
            self._reached = position_s
            self._move(position_s / self._total_s)


_whole: _Whole | None = None


def _in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this code.

    IPython adds the function ``get_ipython`` to the builtins.
    """
    shell = getattr(builtins, "get_ipython", None)
    return shell is not None and "IPKernelApp" in shell().config
