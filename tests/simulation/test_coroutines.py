"""Calls that ask for something: alone, together, with errors, and around a root finder."""

import math
import pickle
from functools import partial

import pytest
from scipy.optimize import brentq

from kneexo.simulation.coroutines import coroutine, drive, evaluated, is_coroutine, steps, together

ASKED = []


def doubled(requests):
    """Twice each request, the last first; negative ones are errors."""
    ASKED.append(sorted(requests.values()))
    for index in reversed(requests):
        value = requests[index]
        yield index, ValueError(f"{value} is negative") if value < 0 else 2 * value


@coroutine(doubled)
def double(value):
    """Twice a value."""
    return (yield value)


@coroutine(doubled)
def power(value, exponent, *, offset=0):
    for _ in range(exponent):
        value = yield from steps(double, value)
    return value + offset


@pytest.fixture(autouse=True)
def _nothing_asked():
    ASKED.clear()


def test_a_plain_call_drives_itself():
    assert double(3) == 6
    assert power(3, 2, offset=1) == 13
    assert ASKED == [[3], [3], [6]]
    assert (double.__name__, double.__doc__) == ("double", "Twice a value.")
    with pytest.raises(ValueError, match="-1 is negative"):
        double(-1)


def test_what_calls_ask_for_at_a_time_is_answered_together():
    calls = [steps(power, n, exponent) for n, exponent in ((1, 3), (2, 1), (3, 0), (4, 2))]
    assert list(drive(calls, doubled)) == [(2, 3), (1, 4), (3, 16), (0, 8)]  # as they end
    assert ASKED == [[1, 2, 4], [2, 8], [4]]


def test_a_coroutine_may_catch_what_fails():
    @coroutine(doubled)
    def forgiving(value):
        try:
            return (yield value)
        except ValueError:
            return (yield -value)

    assert dict(drive([steps(forgiving, n) for n in (1, -2, 3)], doubled)) == {0: 2, 1: 4, 2: 6}


def fail_after(count, value):
    for _ in range(count):
        yield value
    raise RuntimeError(f"{value} failed")


def test_the_first_call_that_fails_raises_when_those_before_it_have_ended():
    ended = []
    calls = [steps(power, 1, 3), fail_after(2, 2), fail_after(0, 3), steps(power, 5, 9)]
    with pytest.raises(RuntimeError, match="2 failed"):
        ended.extend(drive(calls, doubled))
    assert ended == [(0, 8)]
    assert max(map(max, ASKED)) < 5  # what stands behind an error is not begun


def in_order(requests):
    ASKED.append(sorted(requests.values()))
    yield from ((index, 2 * value) for index, value in requests.items())


@pytest.mark.parametrize("answers", [doubled, in_order])
def test_of_several_errors_the_first_calls_is_raised(answers):
    calls = [steps(power, 1, 2), fail_after(1, 2), fail_after(1, 3), fail_after(0, 4)]
    with pytest.raises(RuntimeError, match="2 failed"):
        list(drive(calls, answers))


def test_what_stands_behind_an_error_goes_no_further():
    with pytest.raises(RuntimeError, match="2 failed"):
        list(drive([steps(power, 1, 3), fail_after(1, 2), steps(power, 3, 9)], doubled))
    assert ASKED == [[1, 2, 3], [2], [4]]
    begun = []

    def noted(value):
        begun.append(value)
        yield value

    with pytest.raises(RuntimeError, match="2 failed"):
        list(drive([noted(1), fail_after(0, 2), noted(3)], doubled))
    assert begun == [1]


def test_an_interrupt_is_raised_at_once():
    def interrupted():
        yield 1
        raise KeyboardInterrupt

    ended = []
    with pytest.raises(KeyboardInterrupt):
        ended.extend(drive([steps(power, 1, 0), steps(power, 1, 5), interrupted()], doubled))
    assert ASKED == [[1, 1]]


def test_plain_functions_and_partials_take_part():
    calls = [steps(math.sqrt, 4.0), steps(partial(power, 3, offset=1), 1)]
    assert dict(drive(calls, doubled)) == {0: 2.0, 1: 7}
    assert dict(together(math.sqrt, [4.0, 9.0])) == {0: 2.0, 1: 3.0}
    assert dict(together(partial(power, 3), [1, 0])) == {0: 6, 1: 3}
    assert is_coroutine(partial(partial(power, 3), offset=1))
    assert not is_coroutine(partial(math.sqrt, 4.0))
    assert pickle.loads(pickle.dumps(double)) is double


def test_a_root_finder_searches_what_must_be_asked_for():
    def excess(x):
        return (yield from steps(double, x * x)) - 4.0

    def search(function):
        return brentq(function, 0.0, 3.0, xtol=1e-9)

    calls = [evaluated(search, excess) for _ in range(2)]
    expected = brentq(lambda x: 2.0 * (x * x) - 4.0, 0.0, 3.0, xtol=1e-9, full_output=True)
    assert dict(drive(calls, doubled)) == {0: expected[0], 1: expected[0]}
    assert len(ASKED) == expected[1].function_calls  # each value is asked for once


def test_an_error_of_a_value_ends_the_search():
    def excess(x):
        return (yield from steps(double, -1.0 - x))

    with pytest.raises(ValueError, match="is negative"):
        list(drive([evaluated(lambda f: brentq(f, 0.0, 3.0), excess)], doubled))
