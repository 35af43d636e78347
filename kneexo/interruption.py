"""Ctrl-C and SIGTERM: both end a command in order."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived; everything that handles Ctrl-C handles it as well."""


def _terminate(number: int, frame: Any) -> None:
    raise Terminated


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def sigterm_raises() -> Iterator[None]:
    """SIGTERM raises `Terminated` in the body, unless the caller of Python handles it."""
    replaced = _in_main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if replaced:
        signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        if replaced:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def interrupt_later() -> Iterator[None]:
    """Hold Ctrl-C and SIGTERM back until the body has ended.

    Processes that start meanwhile do not get Ctrl-C at all: this process ends them.
    """
    arrived: list[int] = []
    handlers: dict[int, Any] = {}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    if _in_main_thread():  # a mask does not bind the other threads, which hand the signal on
        for number in _SIGNALS:
            if signal.getsignal(number) is not None:
                handlers[number] = signal.signal(number, lambda n, _: arrived.append(n))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for held, handler in handlers.items():
            signal.signal(held, handler)
        if arrived:
            signal.raise_signal(arrived[0])
