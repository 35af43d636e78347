"""Handle Ctrl-C and SIGTERM so that a command saves its work before it ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived. Code that handles Ctrl-C (`KeyboardInterrupt`) handles SIGTERM too."""


# SIGTERM as an exception, so that temporary directories and worker processes end as after Ctrl-C.
def _terminate(number: int, frame: Any) -> None:
    raise Terminated


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def sigterm_raises() -> Iterator[None]:
    """Context manager: SIGTERM raises `Terminated` in the body.

    The manager has no effect outside the main thread, or if the program already handles SIGTERM.
    """
    unhandled = _in_main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if unhandled:
        signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        if unhandled:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def interrupt_later() -> Iterator[None]:
    """Context manager: delay Ctrl-C and SIGTERM until the body has ended.

    Processes that the body starts never receive Ctrl-C. The code that starts processes must end
    these processes.
    """
    arrived: list[int] = []
    handlers: dict[int, Any] = {}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    if _in_main_thread():
        # The mask is not enough: other threads do not have it, and Python runs the handlers of the
        # signals that they receive in the main thread.
        for number in _SIGNALS:
            if signal.getsignal(number) is not None:
                handlers[number] = signal.signal(number, lambda n, _: arrived.append(n))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for signal_number, handler in handlers.items():
            signal.signal(signal_number, handler)
        if arrived:
            signal.raise_signal(arrived[0])
