"""Calls of plain functions that wait for each other, so that their runs share batches.

A function asks for a run by a plain call, such as ``run = simulate(scenario)``. The compiled engine
is fastest with many runs at once. So `map_in_lockstep` calls a function for many items. Each call
stops where it asks for a run. When all calls have stopped, one batch has the runs of all calls, and
the calls go on with their own runs. A greenlet keeps the stack of a call while it waits. All calls
work in one thread, one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from greenlet import getcurrent, greenlet

Function = TypeVar("Function", bound=Callable[..., Any])
Item = TypeVar("Item")
Result = TypeVar("Result")

Server = Callable[[Mapping[int, Any]], Iterator[tuple[int, Any]]]
"""Type of a function that answers requests, such as for runs.

The argument is a dictionary from the index of each request to the request. The function yields
pairs of index and answer in any order. An answer that is an `Exception` is raised in the call that
made the request.
"""


def needs_runs(function: Function) -> Function:
    """Decorator of a function that simulates, so that a sweep runs its calls in lockstep.

    The decorator only marks the function. `kneexo.sweeps.parallel_map` maps a marked function, or a
    `functools.partial` of a marked function, by `map_in_lockstep`.
    """
    vars(function)["needs_runs"] = True
    return function


def is_in_lockstep(function: Callable[..., Any]) -> bool:
    """Return whether ``function``, or the function in a `functools.partial`, has `needs_runs`."""
    return hasattr(partial(function).func, "needs_runs")


def ask(server: Server, request: Any) -> Any:
    """Return the answer of ``server`` to a request, or raise the answer if it is an exception.

    Inside `map_in_lockstep` the server gets the requests of all calls together.
    """
    call = getcurrent()
    if isinstance(call, _Call):
        answer = call.parent.switch(_Question(server, request))
    else:
        ((_, answer),) = server({0: request})
    if isinstance(answer, Exception):
        raise answer
    return answer


@dataclass(frozen=True)
class _Question:
    """What a call waits for: the answer of ``server`` to ``request``."""

    server: Server
    request: Any


# A greenlet, not a coroutine: no caller on the way needs `async` and `await`, and SciPy's root
# finders, which cannot wait for a coroutine, call a function that asks for runs.
class _Call(greenlet):
    """A call in lockstep, which works until it needs an answer, such as a run.

    Then the call returns a ``_Question`` to its parent, and waits.
    """


def map_in_lockstep(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[tuple[int, Result]]:
    """Yield the index of each item and ``function(item)``, as soon as the call ends.

    The calls advance in rounds. Each round answers the requests of all calls together. When a call
    raises an `Exception`, the calls of later items stop, and the calls of earlier items run to
    their end. Then the exception is raised. If several calls raise exceptions, only the exception
    of the first item is raised.
    """
    calls: list[_Call] = []
    questions: dict[int, _Question] = {}
    error, failed = None, math.inf

    def advance(index: int, value: Any) -> Iterator[tuple[int, Result]]:
        nonlocal error, failed
        try:
            news = calls[index].switch(value)
        except Exception as raised:  # raised again below, when the calls of earlier items ended
            if index < failed:
                error, failed = raised, index
            return
        if calls[index].dead:
            yield index, news
        else:
            questions[index] = news

    try:
        for index, item in enumerate(items):
            calls.append(_Call(function))
            calls[index].gr_context = copy_context()  # such as the settings of numpy.errstate
            yield from advance(index, item)
            if error is not None:
                break
        while questions:
            asked, questions = questions, {}
            for server in dict.fromkeys(question.server for question in asked.values()):
                requests = {
                    index: question.request
                    for index, question in asked.items()
                    if question.server is server and index < failed
                }
                for index, answer in server(requests):
                    yield from advance(index, answer)
        if error is not None:
            raise error
    finally:
        for call in calls:
            call.throw()  # ends a call that still waits
