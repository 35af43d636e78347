"""Ctrl-C and SIGTERM: SIGTERM becomes an error, and both wait for the end of a body."""

import os
import signal
import threading

import pytest

from kneexo.common.interruption import Terminated, interrupt_later, sigterm_raises


@pytest.fixture
def handler_of():
    """Set the handler of a signal; the former one returns after the test."""
    former = {}

    def set_handler(number, handler):
        former.setdefault(number, signal.getsignal(number))
        signal.signal(number, handler)

    yield set_handler
    for number, handler in former.items():
        signal.signal(number, handler)


def test_sigterm_raises_within_the_body_alone(handler_of):
    handler_of(signal.SIGTERM, signal.SIG_DFL)
    with pytest.raises(Terminated), sigterm_raises():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_handler_of_the_program_stays_in_place(handler_of):
    arrived = []
    handler_of(signal.SIGTERM, lambda *_: arrived.append(True))
    with sigterm_raises():
        signal.raise_signal(signal.SIGTERM)
    assert arrived


def test_other_threads_leave_the_handlers_as_they_are():
    errors = []

    def body():
        try:
            with sigterm_raises(), interrupt_later():
                pass
        except BaseException as error:  # would be lost with the thread
            errors.append(error)

    thread = threading.Thread(target=body)
    thread.start()
    thread.join()
    assert errors == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_for_the_end_of_the_body(handler_of, number):
    def interrupted(*_):
        raise KeyboardInterrupt

    handler_of(number, interrupted)
    ended = []

    def body():
        with interrupt_later():
            signal.raise_signal(number)
            os.kill(os.getpid(), number)
            ended.append(True)

    with pytest.raises(KeyboardInterrupt):
        body()
    assert ended
    assert signal.getsignal(number) is interrupted
