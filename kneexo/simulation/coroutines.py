"""Functions that ask for runs, one call alone or many calls together.

A function that needs runs is written as a generator: it yields what it asks for and is sent the
answer, or has an error thrown in. `coroutine` makes it a plain function for its callers. `drive`
takes many such calls and answers all that they ask for at a time together.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from functools import partial, wraps
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Item = TypeVar("Item")
Result = TypeVar("Result")

Steps = Generator[Any, Any, Result]
"""A call under way: yields requests, is sent answers, returns its result."""

Answers = Callable[[Mapping[int, Any]], Iterator[tuple[int, Any]]]
"""Turns requests by call into answers by call, in any order; an exception is thrown in."""


def drive(calls: Sequence[Steps[Result]], answers: Answers) -> Iterator[tuple[int, Result]]:
    """Indices and results of calls that go on together, each as soon as it ends.

    The first call that fails raises its error when those before it have ended; those behind it
    need not.
    """
    requests: dict[int, Any] = {}
    error, failed = None, len(calls)

    def advance(index: int, step: Callable[..., Any], *given: Any) -> Iterator[tuple[int, Result]]:
        nonlocal error, failed
        try:
            requests[index] = step(*given)
        except StopIteration as end:
            yield index, end.value
        except Exception as raised:  # whatever a call raises is raised for it, in its turn
            if index < failed:
                error, failed = raised, index

    for index, call in enumerate(calls):
        yield from advance(index, next, call)
        if error is not None:
            break
    while requests:
        asked, requests = requests, {}
        for index, answer in answers({n: asked[n] for n in asked if n < failed}):
            resume = calls[index].throw if isinstance(answer, Exception) else calls[index].send
            yield from advance(index, resume, answer)
    if error is not None:
        raise error


def coroutine(
    answers: Answers,
) -> Callable[[Callable[Arguments, Steps[Result]]], Callable[Arguments, Result]]:
    """Decorator: a generator function as a plain function, whose own requests ``answers`` meets."""

    def decorate(function: Callable[Arguments, Steps[Result]]) -> Callable[Arguments, Result]:
        @wraps(function)
        def alone(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
            ((_, result),) = drive([function(*arguments, **named)], answers)
            return result

        vars(alone).update(steps=function, answers=answers)
        return alone

    return decorate


def steps(
    function: Callable[Arguments, Result], *arguments: Arguments.args, **named: Arguments.kwargs
) -> Steps[Result]:
    """A call of ``function`` for ``yield from`` and `drive`; what is no coroutine asks nothing."""
    call: Any = partial(function, *arguments, **named)
    if not hasattr(call.func, "steps"):
        return call()
    return (yield from call.func.steps(*call.args, **call.keywords))


def is_coroutine(function: Callable[..., Any]) -> bool:
    """Whether calls of ``function`` gain from going on together."""
    return hasattr(partial(function).func, "steps")


def together(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[tuple[int, Result]]:
    """`drive` for ``function`` of each item."""
    answers = getattr(partial(function).func, "answers", None) or (lambda requests: iter(()))
    return drive([steps(function, item) for item in items], answers)


class _UnknownValueError(Exception):
    """A value that is not evaluated yet; carries its argument."""


def evaluated(
    search: Callable[[Callable[[float], float]], Result],
    evaluate: Callable[[float], Steps[float]],
) -> Steps[Result]:
    """``search(function)``, where ``evaluate`` gives the values of ``function`` as a coroutine.

    The search, which must be deterministic, begins again after each new value; it finds those that
    are known without a wait. So a plain root finder can look for what takes runs.
    """
    values: dict[float, float] = {}

    def function(argument: float) -> float:
        if argument not in values:
            raise _UnknownValueError(argument)
        return values[argument]

    while True:
        try:
            return search(function)
        except _UnknownValueError as unknown:
            argument = unknown.args[0]
        values[argument] = yield from evaluate(argument)
