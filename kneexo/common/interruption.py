"""Handles SIGTERM like Ctrl-C, so that a command saves its work before it ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived. Code that handles Ctrl-C (`KeyboardInterrupt`) handles SIGTERM too."""


# SIGTERM as an exception, so that temporary directories and worker processes end as after Ctrl-C.
def _terminate(number: int, frame: Any) -> None:
    raise Terminated


@contextmanager
def sigterm_raises() -> Iterator[None]:
    """Context manager: SIGTERM raises `Terminated` in the body.

    The manager has no effect outside the main thread, or if the program already handles SIGTERM.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    unhandled = in_main_thread and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if unhandled:
        signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        if unhandled:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
