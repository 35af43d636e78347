"""Ctrl-C and SIGTERM wait for the end of a body."""

import os
import signal

import pytest

from diagramc import interrupt_later


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_for_the_end_of_the_body(number):
    def interrupted(*_):
        raise KeyboardInterrupt

    ended = []

    def body():
        with interrupt_later():
            signal.raise_signal(number)
            os.kill(os.getpid(), number)
            ended.append(True)

    former = signal.signal(number, interrupted)
    try:
        with pytest.raises(KeyboardInterrupt):
            body()
        assert signal.getsignal(number) is interrupted
    finally:
        signal.signal(number, former)
    assert ended
