"""Delays Ctrl-C and SIGTERM until a piece of work is complete."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def interrupt_later() -> Iterator[None]:
    """Context manager: delay Ctrl-C and SIGTERM until the body has ended.

    Processes that the body starts never receive Ctrl-C. The code that starts processes must end
    these processes.
    """
    arrived: list[int] = []
    handlers: dict[int, Any] = {}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    if threading.current_thread() is threading.main_thread():
        # The mask is not enough: other threads do not have it, and Python runs the handlers of the
        # signals that they receive in the main thread.
        for number in (signal.SIGINT, signal.SIGTERM):
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
