"""Async functions that share batches of requests, such as simulation runs.

A function that needs runs is an ``async def`` that awaits a `Request` for each run. The decorator
`synchronous` turns it into a plain function for its callers. An async caller awaits the same
function by `awaitable`. `run_concurrently` advances many coroutines and serves their pending
requests in one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Generator, Iterable, Iterator, Mapping, Sequence
from functools import partial, wraps
from typing import Any, Generic, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Request(Generic[Answer]):
    """A request, such as for a run; ``await request`` returns its answer or raises an error."""

    def __await__(self) -> Generator[Any, Any, Answer]:
        return (yield self)


Server = Callable[[Mapping[int, Any]], Iterator[tuple[int, Any]]]
"""Type of a function that answers requests.

Its argument maps the index of each request to the request. It yields pairs of index and answer in
any order. If an answer is an `Exception`, it is raised in the coroutine that awaits the request.
"""


def run_concurrently(
    coroutines: Sequence[Coroutine[Any, Any, Result]], server: Server
) -> Iterator[tuple[int, Result]]:
    """Yield index and result of each coroutine as soon as the coroutine ends.

    The coroutines advance in rounds. Each round passes the pending requests of all coroutines to
    ``server``. When a coroutine raises an `Exception`, the coroutines behind it in the sequence
    stop, and the coroutines before it run to their end. Then the exception is raised. If several
    coroutines raise exceptions, only the exception of the first in the sequence is raised.
    """
    requests: dict[int, Any] = {}
    error, failed = None, len(coroutines)

    def advance(index: int, resume: Callable[[Any], Any], value: Any) -> Iterator[Any]:
        nonlocal error, failed
        try:
            requests[index] = resume(value)
        except StopIteration as end:
            yield index, end.value
        except Exception as raised:  # raised again below, when the coroutines before it ended
            if index < failed:
                error, failed = raised, index

    try:
        for index, coroutine in enumerate(coroutines):
            yield from advance(index, coroutine.send, None)
            if error is not None:
                break
        while requests:
            pending, requests = requests, {}
            for index, answer in server({n: pending[n] for n in pending if n < failed}):
                coroutine = coroutines[index]
                resume = coroutine.throw if isinstance(answer, Exception) else coroutine.send
                yield from advance(index, resume, answer)
        if error is not None:
            raise error
    finally:
        for coroutine in coroutines:
            coroutine.close()


def synchronous(
    server: Server,
) -> Callable[[Callable[Arguments, Coroutine[Any, Any, Result]]], Callable[Arguments, Result]]:
    """Return a decorator that turns an async function into a plain function.

    A call of the plain function runs the coroutine, and ``server`` answers its requests.
    """

    def decorate(
        function: Callable[Arguments, Coroutine[Any, Any, Result]],
    ) -> Callable[Arguments, Result]:
        @wraps(function)
        def plain(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
            ((_, result),) = run_concurrently([function(*arguments, **named)], server)
            return result

        vars(plain).update(async_function=function, server=server)
        return plain

    return decorate


async def awaitable(
    function: Callable[Arguments, Result], *arguments: Arguments.args, **named: Arguments.kwargs
) -> Result:
    """Call ``function`` from an async function by ``await awaitable(function, ...)``.

    Parameters
    ----------
    function
        Any function, which is called plainly. If it was made by `synchronous`, or is a
        `functools.partial` of such a function, the server of the outer coroutine answers its
        requests.
    arguments, named
        Arguments of the function.
    """
    call: Any = partial(function, *arguments, **named)
    if is_synchronous(function):
        return await call.func.async_function(*call.args, **call.keywords)
    return call()


def is_synchronous(function: Callable[..., Any]) -> bool:
    """Whether `synchronous` made ``function``, or the function in a `functools.partial`."""
    return hasattr(partial(function).func, "async_function")


def map_concurrently(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[tuple[int, Result]]:
    """Yield the index of each item and ``function(item)``, as soon as the call ends.

    Calls of a `synchronous` function share batches of requests.
    """
    server = getattr(partial(function).func, "server", None) or (lambda requests: iter(()))
    return run_concurrently([awaitable(function, item) for item in items], server)


class _UnknownValueError(Exception):
    """Raised in `search_async` for an argument whose value is unknown; contains the argument."""


async def search_async(
    search: Callable[[Callable[[float], float]], Result],
    function: Callable[[float], Coroutine[Any, Any, float]],
) -> Result:
    """Return ``search(f)`` for the function f whose value at x is ``await function(x)``.

    So a plain root finder can search an async function. When ``search`` asks for an unknown value
    of f, the value is computed and put into a table, and ``search`` starts again. Therefore
    ``search`` must be deterministic.
    """
    values: dict[float, float] = {}

    def tabulated(argument: float) -> float:
        if argument not in values:
            raise _UnknownValueError(argument)
        return values[argument]

    while True:
        try:
            return search(tabulated)
        except _UnknownValueError as unknown:
            argument = unknown.args[0]
        values[argument] = await function(argument)
