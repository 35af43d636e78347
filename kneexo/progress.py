"""Progress bars with the remaining time, for terminals and notebooks.

A command shows one bar for its whole work, `whole_bar`, which the bars of its parts advance.
"""

from __future__ import annotations

import builtins
import importlib.util
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from typing import Any

_FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}, {remaining} left"
_REFRESH_S = 1.0
"""Time in s after which a bar of a whole command shows the elapsed time again."""


@dataclass(frozen=True)
class Stage:
    """A part of a command, whose typical duration is its share of the bar of the whole command."""

    name: str
    """Description of the progress bar of the stage."""
    duration_s: float
    """Typical duration in s on two cores."""
    repeats: bool = False
    """True if an unknown number of bars with this name follow each other."""


def progress_bar(total: float, description: str | None) -> Any:
    """Return a bar that ends at ``total``; its method ``update(amount)`` advances it.

    Within the body of `whole_bar` it advances the bar of the whole command. Otherwise it is a bar
    of tqdm. The bar shows nothing if ``description`` is None, or if stderr is no terminal. In a
    notebook the bar requires ipywidgets (``pip install ipywidgets``) and otherwise shows nothing.
    """
    if _whole is not None and description is not None:
        return _whole.part(total, description)
    from tqdm import tqdm

    settings: dict[str, Any] = {
        "total": total,
        "desc": description,
        "mininterval": 0.5,
        "bar_format": _FORMAT,
    }
    if description is not None and _in_notebook() and importlib.util.find_spec("ipywidgets"):
        from tqdm.notebook import tqdm as notebook_bar

        return notebook_bar(**settings)
    return tqdm(**settings, disable=True if description is None else None)


@contextmanager
def whole_bar(description: str, stages: Sequence[Stage]) -> Iterator[None]:
    """Context manager: show one bar for the whole work of its body, if stderr is a terminal.

    Each `progress_bar` of the body whose description is the name of a stage advances the bar by
    the share of this stage. Meanwhile the elapsed time goes on. Lines on stderr appear above the
    bar. The bar disappears at the end.
    """
    global _whole
    from tqdm import tqdm
    from tqdm.contrib import DummyTqdmFile

    bar = tqdm(
        total=sum(stage.duration_s for stage in stages),
        desc=description,
        mininterval=0.1,
        smoothing=0.0,  # the time left follows from the mean speed
        bar_format=_FORMAT,
        leave=False,
        disable=None,
    )
    if bar.disable or _whole is not None:
        bar.close()
        yield
        return
    lines_above: Any = DummyTqdmFile(sys.stderr)
    ended = threading.Event()

    def tick() -> None:
        while not ended.wait(_REFRESH_S):
            bar.refresh()

    ticker = threading.Thread(target=tick, daemon=True)
    ticker.start()
    _whole = _Whole(bar, stages)
    try:
        with redirect_stderr(lines_above):
            yield
    finally:
        _whole = None
        ended.set()
        ticker.join()
        bar.close()


class _Whole:
    """The bar of a whole command, and the stage that it has reached."""

    def __init__(self, bar: Any, stages: Sequence[Stage]) -> None:
        self._bar = bar
        self._ends_s: dict[str, float] = {}
        self._left: dict[str, tuple[float, Stage]] = {}
        end = 0.0
        for stage in stages:
            self._left[stage.name] = (end, stage)
            end += stage.duration_s
            self._ends_s[stage.name] = end

    def part(self, total: float, name: str) -> _Part:
        """Return a bar that advances the whole by the share of stage ``name``, or by nothing."""
        if name not in self._left:
            return _Part(self, total, self._bar.n, self._bar.n)
        start, stage = self._left[name]
        end = self._ends_s[name]
        if stage.repeats:
            end = 0.5 * (start + end)
        self._left[name] = (end, stage)
        return _Part(self, total, start, end)

    def advance_to(self, position_s: float) -> None:
        """Move the bar forward to a position in s of typical duration."""
        if position_s > self._bar.n:
            self._bar.update(position_s - self._bar.n)


class _Part:
    """A bar for a part of a command. It moves the bar of the whole from ``start`` to ``end``."""

    def __init__(self, whole: _Whole, total: float, start: float, end: float) -> None:
        self.n = 0.0
        """The amount of work that is finished."""
        self._whole = whole
        self._total = total
        self._start, self._end = start, end

    def __enter__(self) -> _Part:
        self._whole.advance_to(self._start)
        return self

    def __exit__(self, *_: object) -> None:
        self._whole.advance_to(self._end)

    def update(self, amount: float) -> None:
        """Advance the bar by an amount of work."""
        self.n += amount
        share = min(self.n / self._total, 1.0) if self._total else 1.0
        self._whole.advance_to(self._start + share * (self._end - self._start))


_whole: _Whole | None = None


def _in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this code.

    IPython adds the function ``get_ipython`` to the builtins.
    """
    shell = getattr(builtins, "get_ipython", None)
    return shell is not None and "IPKernelApp" in shell().config
