"""SIGTERM becomes an error."""

import signal
import threading
from functools import partial

import pytest

from diagramc import interrupt_later
from kneexo.common.interruption import Terminated, sigterm_raises


@pytest.fixture
def handle_sigterm():
    """Set the handler of SIGTERM; the former one returns after the test."""
    former = signal.getsignal(signal.SIGTERM)
    yield partial(signal.signal, signal.SIGTERM)
    signal.signal(signal.SIGTERM, former)


def test_sigterm_raises_within_the_body_alone(handle_sigterm):
    handle_sigterm(signal.SIG_DFL)
    with pytest.raises(Terminated), sigterm_raises():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_handle_sigterm_the_program_stays_in_place(handle_sigterm):
    arrived = []
    handle_sigterm(lambda *_: arrived.append(True))
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
