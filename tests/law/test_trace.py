"""Equations of a law's function: when there are none, and what calls with numbers find out."""

import math
from collections import deque
from fractions import Fraction
from threading import Lock

import numpy as np
import pydrake.math as drake_math
import pytest
from pydrake.symbolic import Expression, if_then_else

from kneexo.errors import ParameterError
from kneexo.law.call import call_law
from kneexo.law.trace import HIDES_STATE, replay, trace
from kneexo.parameters import Law


def reason(function) -> str:
    law = Law(function)
    return trace(law, len(law.arguments.initial_state)).why_not_compiled


def deep(rod_extension):
    """As a tree the equations have 2⁴⁰ leaves."""
    x = rod_extension
    for _ in range(40):
        x = x * x + x
    return x


def sine(rod_extension):
    try:
        return math.sin(rod_extension)
    except TypeError:
        return np.sin(rod_extension)


def relay(rod_extension, rod_reference):
    return if_then_else(rod_reference[0] - rod_extension > 0, 500.0, -500.0)


@pytest.mark.parametrize(
    "function",
    [
        lambda rod_extension, rod_reference, gain=1e3: gain * (rod_reference[0] - rod_extension),
        lambda rod_extension, time_s, state=(1.0,), gain=10.0: (
            state[0] + 0.1 * time_s,
            [state[0] + gain * rod_extension],
        ),
        lambda knee_angle: np.sin(np.array([knee_angle])),
        lambda time_s: drake_math.sqrt(10.0 - time_s),  # fails above 10 s
        deep,
        sine,
        relay,
    ],
)
def test_what_traces_is_compiled(function) -> None:
    assert reason(function) == ""


def sly(rod_extension):
    return 2.0 * rod_extension if isinstance(rod_extension, Expression) else rod_extension


def matched(rod_extension):
    match rod_extension > 0.1385:
        case True:
            return 2.0
    return 1.0


def converted(rod_extension):
    try:
        return 2.0 if float(rod_extension) > 0.1385 else 1.0
    except TypeError:
        return 1.0


def equal_to_true(rod_extension):
    return 2.0 if (rod_extension > 0.1385) == True else 1.0  # noqa: E712


def looks_up(rod_extension, state=(0.0,)):
    """The symbolic call takes the first row; calls with small states do so too."""
    try:
        row = int(state[0])
    except TypeError:
        row = 0
    return (1.0, 2.0, 3.0, 4.0, 5.0)[row % 5], [state[0] + 1.0]


class Integrator:
    def __init__(self):
        self.integral = 0.0

    def __call__(self, rod_extension):
        self.integral += max(rod_extension, 0.0)
        return self.integral


class Late:
    """A law that changes after more calls than the comparison makes."""

    def __init__(self):
        self.calls = 0

    def __call__(self, rod_extension):
        self.calls += 1
        return (1.0 if self.calls < 10_000 else 2.0) * rod_extension


BRANCHES = "branches on a value (line "
NEEDS_NUMBERS = "needs plain numbers (line "


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (lambda rod_extension: max(rod_extension, 0.0), BRANCHES),
        (lambda rod_extension: 1.0 if rod_extension else 2.0, BRANCHES),
        (lambda rod_extension, knee_angle: rod_extension and knee_angle, BRANCHES),
        (lambda rod_extension: rod_extension or 1.0, BRANCHES),
        (lambda rod_extension: float(not rod_extension), BRANCHES),
        (lambda rod_extension: float(any([rod_extension])), BRANCHES),
        (lambda rod_extension: 5.0 if if_then_else(rod_extension > 0.2, 1, 0) else -5.0, BRANCHES),
        (lambda rod_extension, state=(0.0,): ({0.0: 1.0}.get(state[0], 2.0), [0.0]), NEEDS_NUMBERS),
        (equal_to_true, BRANCHES),
        (lambda rod_extension: math.sin(rod_extension), NEEDS_NUMBERS),
        (lambda rod_extension: 1 / 0, "raises ZeroDivisionError"),
        (sly, "differ from calls with numbers"),
        (matched, "differ from calls"),
        (converted, "differ from calls"),
        (looks_up, "differ from calls"),
        (Integrator(), HIDES_STATE),
        (Late(), HIDES_STATE),
    ],
)
def test_what_does_not_trace_says_why(function, why: str) -> None:
    assert why in reason(function)


# ------------------------------------------------------------------------ samples of a run


def replayed(function, *columns):
    """Trace a law, replay samples of a made-up run, and return why it is then not compiled."""
    law = Law(function)
    trace(law, len(columns) - 1).replayed = False
    replay(law, np.column_stack(columns), len(columns) - 1)
    return trace(law, len(columns) - 1).why_not_compiled


def rarely(rod_extension):
    is_number = not isinstance(rod_extension, Expression)
    return 7.0 if is_number and 0.1 < rod_extension < 0.1 + 1e-6 else 1e3 * rod_extension


def bounded(rod_extension):
    is_number = not isinstance(rod_extension, Expression)
    return 1e3 * (min(rod_extension, 0.2) if is_number else rod_extension)


def raising(rod_extension):
    if not isinstance(rod_extension, Expression) and rod_extension > 0.1:
        raise ValueError
    return rod_extension


SOME = np.linspace(0.05, 0.08, 1000)
TWO_PERCENT, EXTREME = SOME.copy(), np.full(1000, 0.1)
TWO_PERCENT[500:520] = 0.1 + 5e-7
EXTREME[707] = 0.3


@pytest.mark.parametrize(
    ("function", "right", "wrong"),
    [(rarely, SOME, TWO_PERCENT), (bounded, SOME, EXTREME), (raising, SOME, EXTREME)],
)
def test_samples_of_a_run_show_what_no_point_of_comparison_shows(function, right, wrong) -> None:
    assert replayed(function, right) == ""
    assert "differ from calls" in replayed(function, wrong)


class LateCounter:
    def __init__(self):
        self.calls = 0

    def __call__(self, rod_extension):
        self.calls += not isinstance(rod_extension, Expression) and rod_extension > 0.2
        return (1.0 if self.calls < 30 else 2.0) * rod_extension


def test_hidden_state_that_samples_show() -> None:
    x = np.full(200, 0.3)
    assert replayed(LateCounter(), x) == HIDES_STATE
    counter = LateCounter()
    with pytest.raises(ParameterError, match="hides state"):
        replayed(lambda rod_extension: counter(rod_extension), x)


# --------------------------------------------------------------------------- hidden state


class Counting:
    """A law with a state that hides, which compares a NumPy scalar as pydrake 1.58 does not."""

    def __init__(self):
        self.calls = 0

    def __call__(self, rod_extension, rod_reference):
        self.calls += 1
        return relay(rod_extension, rod_reference) * self.calls


def test_an_object_with_if_then_else_counts_each_sample_once() -> None:
    law = Law(Counting())
    assert trace(law, 0).why_not_compiled == HIDES_STATE
    function = law.copy_of_target()
    arguments = {"rod_extension": np.array([0.1]), "rod_reference": np.array([0.2, 0.0, 0.0, 0.0])}
    commands = [call_law(law, function, arguments) for _ in range(3)]
    assert commands == [[500.0], [1000.0], [1500.0]]


def test_a_function_that_hides_state_is_refused_each_time() -> None:
    calls, hits, last, random = [], [], deque([0.0] * 99), np.random.default_rng()

    def remembers(rod_extension):
        calls.append(rod_extension)
        return 0.0

    def above(rod_extension):
        if rod_extension > 0.12:
            hits.append(rod_extension)
        return 1.0 if len(hits) < 10_000 else 2.0

    def late(rod_extension):
        last.append(rod_extension)
        return last.popleft()

    for function in (remembers, above, above, late, lambda rod_extension: random.normal()):
        with pytest.raises(ParameterError, match=r"hides state: .* must take the argument state"):
            reason(function)


def test_an_object_that_cannot_be_copied_is_one_line() -> None:
    class Locked:
        def __init__(self):
            self.lock = Lock()

        def __call__(self, rod_extension):
            return rod_extension

    with pytest.raises(
        ParameterError, match=r"Locked: the object cannot be copied for a run: Type"
    ):
        reason(Locked())


# ------------------------------------------------------------------------ what is remembered


def test_equal_equations_have_one_key_and_others_another() -> None:
    def key(function):
        law = Law(function)
        return trace(law, len(law.arguments.initial_state)).key

    def scaled(factor):
        return lambda rod_extension, gain=1.0: gain * factor * rod_extension

    twice = key(scaled(2.0))
    assert key(scaled(Fraction(2))) == twice
    assert twice == key(lambda rod_extension, gain=5.0: gain * rod_extension * 2)
    for other in (Fraction(2, 3), 2.0000000000000004):
        assert key(scaled(other)) not in ("", twice)
    assert key(lambda rod_extension: math.sin(rod_extension)) == ""
    assert key(lambda rod_extension, k=1.0: k) != key(lambda rod_extension, c=1.0: c)
    assert key(lambda rod_extension, state=(0.0,): (state[0], state)) != key(
        lambda rod_extension, time_s, state=(0.0,): (time_s, [time_s])
    )


def test_a_law_is_traced_anew_when_its_values_change() -> None:
    gains = {"k": 1.0}
    law = Law(lambda rod_extension: gains["k"] * rod_extension)
    before = trace(law, 0)
    assert trace(law, 0) is before
    assert trace(Law(law.target), 0) is before
    gains["k"] = 2.0
    assert trace(law, 0).key != before.key
    gains["k"] = 1.0
    assert trace(law, 0).key == before.key
