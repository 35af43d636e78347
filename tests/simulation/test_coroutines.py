"""Async functions that share batches of requests."""

import inspect
import math
import pickle
from dataclasses import dataclass
from functools import partial

import pytest
from scipy.optimize import brentq

from kneexo.analysis import TrackingResult, track
from kneexo.simulation.coroutines import (
    Request,
    awaitable,
    is_synchronous,
    map_concurrently,
    run_concurrently,
    search_async,
    synchronous,
)

BATCHES = []


@dataclass(frozen=True)
class Doubling(Request[float]):
    value: float


def doubled(requests):
    """Answer twice each value, the last request first, or an error for a negative value."""
    BATCHES.append(sorted(request.value for request in requests.values()))
    for index in reversed(requests):
        value = requests[index].value
        yield index, ValueError(f"{value} is negative") if value < 0 else 2 * value


def doubled_in_order(requests):
    return reversed(list(doubled(requests)))


@synchronous(doubled)
async def double(value: float) -> float:
    """Return twice a value."""
    return await Doubling(value)


@synchronous(doubled)
async def power(value, exponent, *, offset=0):
    for _ in range(exponent):
        value = await awaitable(double, value)
    return value + offset


async def fail_after(count, value):
    for _ in range(count):
        await Doubling(value)
    raise RuntimeError(f"{value} failed")


@pytest.fixture(autouse=True)
def _no_batches():
    BATCHES.clear()


def test_a_call_of_a_synchronous_function_serves_its_own_requests():
    assert double(3) == 6
    assert power(3, 2, offset=1) == 13
    assert BATCHES == [[3], [3], [6]]
    with pytest.raises(ValueError, match="-1 is negative"):
        double(-1)


def test_a_synchronous_function_looks_like_a_plain_one():
    assert (double.__name__, double.__doc__) == ("double", "Return twice a value.")
    assert str(inspect.signature(double)) == "(value: float) -> float"
    assert not inspect.iscoroutinefunction(double)
    assert pickle.loads(pickle.dumps(double)) is double


def test_the_signature_of_track_returns_a_tracking_result():
    assert inspect.signature(track, eval_str=True).return_annotation is TrackingResult


def test_concurrent_calls_share_batches():
    calls = [awaitable(power, n, exponent) for n, exponent in ((1, 3), (2, 1), (3, 0), (4, 2))]
    in_order_of_ending = list(run_concurrently(calls, doubled))
    assert in_order_of_ending == [(2, 3), (1, 4), (3, 16), (0, 8)]
    assert BATCHES == [[1, 2, 4], [2, 8], [4]]


def test_an_async_function_may_catch_the_error_of_a_request():
    async def magnitude(value):
        try:
            return await Doubling(value)
        except ValueError:
            return await Doubling(-value)

    calls = [magnitude(n) for n in (1, -2, 3)]
    assert dict(run_concurrently(calls, doubled)) == {0: 2, 1: 4, 2: 6}


def test_calls_before_the_one_that_fails_run_to_their_end():
    results = []
    calls = [awaitable(power, 1, 3), fail_after(2, 2), fail_after(0, 3), awaitable(power, 5, 9)]
    with pytest.raises(RuntimeError, match="2 failed"):
        results.extend(run_concurrently(calls, doubled))
    assert results == [(0, 8)]
    assert max(map(max, BATCHES)) < 5  # the last call did not begin


@pytest.mark.parametrize("server", [doubled, doubled_in_order])
def test_of_several_errors_that_of_the_first_call_is_raised(server):
    calls = [awaitable(power, 1, 2), fail_after(1, 2), fail_after(1, 3), fail_after(0, 4)]
    with pytest.raises(RuntimeError, match="2 failed"):
        list(run_concurrently(calls, server))


def test_calls_behind_one_that_fails_make_no_more_requests():
    calls = [awaitable(power, 1, 3), fail_after(1, 2), awaitable(power, 3, 9)]
    with pytest.raises(RuntimeError, match="2 failed"):
        list(run_concurrently(calls, doubled))
    assert BATCHES == [[1, 2, 3], [2], [4]]


@pytest.mark.filterwarnings("error")  # a coroutine that is neither run nor closed warns
def test_calls_behind_one_that_fails_at_once_do_not_begin():
    begun = []

    async def noted(value):
        begun.append(value)
        await Doubling(value)

    with pytest.raises(RuntimeError, match="2 failed"):
        list(run_concurrently([noted(1), fail_after(0, 2), noted(3)], doubled))
    assert begun == [1]


def test_an_interrupt_is_raised_at_once():
    async def interrupted():
        await Doubling(1)
        raise KeyboardInterrupt

    calls = [awaitable(power, 1, 0), awaitable(power, 1, 5), interrupted()]
    with pytest.raises(KeyboardInterrupt):
        list(run_concurrently(calls, doubled))
    assert BATCHES == [[1, 1]]


def test_plain_functions_and_partials_can_be_awaited():
    calls = [awaitable(math.sqrt, 4.0), awaitable(partial(power, 3, offset=1), 1)]
    assert dict(run_concurrently(calls, doubled)) == {0: 2.0, 1: 7}


def test_plain_functions_and_partials_can_be_mapped():
    assert dict(map_concurrently(math.sqrt, [4.0, 9.0])) == {0: 2.0, 1: 3.0}
    assert dict(map_concurrently(partial(power, 3), [1, 0])) == {0: 6, 1: 3}


def test_a_partial_of_a_synchronous_function_is_synchronous():
    assert is_synchronous(partial(partial(power, 3), offset=1))
    assert not is_synchronous(partial(math.sqrt, 4.0))


def test_a_plain_root_finder_searches_an_async_function():
    async def excess(x):
        return await awaitable(double, x * x) - 4.0

    def search(function):
        return brentq(function, 0.0, 3.0, xtol=1e-9)

    calls = [search_async(search, excess) for _ in range(2)]
    root, report = brentq(lambda x: 2.0 * (x * x) - 4.0, 0.0, 3.0, xtol=1e-9, full_output=True)
    assert dict(run_concurrently(calls, doubled)) == {0: root, 1: root}
    assert len(BATCHES) == report.function_calls  # one request for each value


def test_an_error_of_a_value_ends_the_search():
    async def excess(x):
        return await awaitable(double, -1.0 - x)

    calls = [search_async(lambda f: brentq(f, 0.0, 3.0), excess)]
    with pytest.raises(ValueError, match="is negative"):
        list(run_concurrently(calls, doubled))
