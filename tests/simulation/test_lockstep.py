"""Calls of plain functions that share batches of requests."""

import math
import pickle
from functools import partial

import numpy as np
import pytest
from scipy.optimize import brentq

from kneexo.simulation.lockstep import ask, is_in_lockstep, map_in_lockstep, needs_runs

BATCHES = []


def doubled(requests):
    """Answer twice each value, the last request first, or an error for a negative value."""
    BATCHES.append(sorted(requests.values()))
    for index in reversed(requests):
        value = requests[index]
        yield index, ValueError(f"{value} is negative") if value < 0 else 2 * value


def doubled_in_order(requests):
    return reversed(list(doubled(requests)))


def negated(requests):
    BATCHES.append(sorted(requests.values()))
    return ((index, -value) for index, value in requests.items())


def double(value, server=doubled):
    return ask(server, value)


@needs_runs
def power(value, exponent, *, offset=0):
    for _ in range(exponent):
        value = double(value)
    return value + offset


def fail_after(count, value, server=doubled):
    for _ in range(count):
        double(value, server)
    raise RuntimeError(f"{value} failed")


def call(task):
    return task()


@pytest.fixture(autouse=True)
def _no_batches():
    BATCHES.clear()


def test_a_call_alone_asks_for_its_own_requests():
    assert power(3, 2, offset=1) == 13
    assert BATCHES == [[3], [6]]
    with pytest.raises(ValueError, match="-1 is negative"):
        double(-1)


def test_the_decorator_changes_nothing_but_a_mark():
    assert pickle.loads(pickle.dumps(power)) is power
    assert is_in_lockstep(partial(partial(power, 3), offset=1))
    assert not is_in_lockstep(partial(math.sqrt, 4.0))


def test_calls_share_batches():
    calls = [partial(power, n, exponent) for n, exponent in ((1, 3), (2, 1), (3, 0), (4, 2))]
    in_order_of_ending = list(map_in_lockstep(call, calls))
    assert in_order_of_ending == [(2, 3), (1, 4), (3, 16), (0, 8)]
    assert BATCHES == [[1, 2, 4], [2, 8], [4]]


def test_each_server_gets_its_own_requests():
    calls = [partial(double, n, server) for n in (1, 2) for server in (doubled, negated)]
    assert dict(map_in_lockstep(call, calls)) == {0: 2, 1: -1, 2: 4, 3: -2}
    assert BATCHES == [[1, 2], [1, 2]]


def test_calls_in_lockstep_inside_a_call_share_batches_of_their_own():
    def total(n):
        return double(n) + sum(result for _, result in map_in_lockstep(double, range(n)))

    assert dict(map_in_lockstep(total, [2, 3])) == {0: 6, 1: 12}
    assert sorted(BATCHES) == [[0, 1], [0, 1, 2], [2, 3]]


def test_a_call_may_catch_the_error_of_a_request():
    def magnitude(value):
        try:
            return double(value)
        except ValueError:
            return double(-value)

    assert dict(map_in_lockstep(magnitude, [1, -2, 3])) == {0: 2, 1: 4, 2: 6}


def test_calls_before_the_one_that_fails_run_to_their_end():
    results = []
    calls = [partial(power, 1, 3), partial(fail_after, 2, 2), partial(fail_after, 0, 3)]
    with pytest.raises(RuntimeError, match="2 failed"):
        results.extend(map_in_lockstep(call, [*calls, partial(power, 5, 9)]))
    assert results == [(0, 8)]
    assert max(map(max, BATCHES)) < 5  # the last call did not begin


@pytest.mark.parametrize("server", [doubled, doubled_in_order])
def test_of_several_errors_that_of_the_first_call_is_raised(server):
    calls = [partial(fail_after, *arguments, server) for arguments in ((1, 2), (1, 3), (0, 4))]
    with pytest.raises(RuntimeError, match="2 failed"):
        list(map_in_lockstep(call, [partial(double, 1, server), *calls]))


def test_calls_behind_one_that_fails_make_no_more_requests():
    calls = [partial(power, 1, 3), partial(fail_after, 1, 2), partial(power, 3, 9)]
    with pytest.raises(RuntimeError, match="2 failed"):
        list(map_in_lockstep(call, calls))
    assert BATCHES == [[1, 2, 3], [2], [4]]


def test_an_interrupt_is_raised_at_once():
    ended = []

    def work(value):
        try:
            double(value)
            if value == 3:
                raise KeyboardInterrupt
            double(value)
        finally:
            ended.append(value)

    with pytest.raises(KeyboardInterrupt):
        list(map_in_lockstep(work, [1, 2, 3]))
    assert BATCHES == [[1, 2, 3]]
    assert sorted(ended) == [1, 2, 3]  # the calls that wait are ended too


def test_calls_have_the_settings_of_numpy_of_their_caller():
    with np.errstate(over="raise"):
        ((_, settings),) = map_in_lockstep(lambda _: np.geterr(), [None])
    assert settings["over"] == "raise"


def test_a_root_finder_may_ask_for_runs():
    def root(end):
        return brentq(lambda x: double(x * x) - 4.0, 0.0, end, xtol=1e-9)

    expected, report = brentq(lambda x: 2.0 * (x * x) - 4.0, 0.0, 3.0, xtol=1e-9, full_output=True)
    assert dict(map_in_lockstep(root, [3.0, 3.0])) == {0: expected, 1: expected}
    assert len(BATCHES) == report.function_calls
    with pytest.raises(ValueError, match="is negative"):
        list(map_in_lockstep(lambda end: brentq(lambda x: double(-1.0 - x), 0.0, end), [3.0]))
