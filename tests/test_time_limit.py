"""The limits of each test, in wall time and in processor time."""

import signal
import time

import pytest


@pytest.mark.timeout(2, func_only=True)
def test_a_test_that_waits_for_ever_fails():
    with pytest.raises(pytest.fail.Exception, match="Timeout"):
        time.sleep(60.0)


def test_a_test_that_works_for_ever_fails():
    def work():
        signal.setitimer(signal.ITIMER_PROF, 0.01)
        while True:
            pass

    with pytest.raises(pytest.fail.Exception, match="s of processor time"):
        work()


def test_a_fast_test_has_a_minute_of_the_processor():
    assert 50.0 < signal.getitimer(signal.ITIMER_PROF)[0] <= 61.0


@pytest.mark.slow
def test_a_slow_test_has_a_quarter_of_an_hour_of_the_processor():
    assert 890.0 < signal.getitimer(signal.ITIMER_PROF)[0] <= 901.0
