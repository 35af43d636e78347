"""The time limit of each test."""

import time

import pytest


@pytest.mark.timeout(0.2)
def test_a_test_that_does_not_end_fails():
    with pytest.raises(pytest.fail.Exception, match="Timeout"):
        time.sleep(60.0)


def test_a_fast_test_has_the_limit_of_the_settings(request):
    assert float(request.config.getini("timeout")) == 300.0
    assert request.node.get_closest_marker("timeout") is None


@pytest.mark.slow
def test_a_slow_test_has_a_quarter_of_an_hour(request):
    assert request.node.get_closest_marker("timeout").args == (900,)
