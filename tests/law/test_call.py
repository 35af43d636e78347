"""Calls of a law's function: what it gets, and what it may return."""

import math

import numpy as np
import pytest
from pydrake.symbolic import if_then_else

from kneexo.errors import ParameterError, SimulationError
from kneexo.law.call import call_law, require_finite_result
from kneexo.parameters import Law

VALUES = {
    "rod_extension": np.array([0.1]),
    "rod_reference": np.array([0.2, 0.0, 0.0, 0.0]),
    "state": np.array([0.5]),
    "time_s": np.array([3.0]),
}


def called(function):
    law = Law(function)
    return call_law(law, law.target, VALUES)


def test_a_function_gets_its_arguments_as_scalars_and_arrays() -> None:
    def law(rod_extension, rod_reference, state=(0.0,)):
        assert [np.ndim(value) for value in (rod_extension, rod_reference, state)] == [0, 1, 1]
        return rod_extension + rod_reference[0], [2.0 * state[0]]

    assert called(law) == [0.1 + 0.2, 1.0]


def with_state(result):
    return lambda rod_extension, state=(0.0,): result


NO_NUMBER = "must return the motor speed in rad/s, one number"
NO_PAIR = "must return (command, next_state), with 1 numbers in next_state"


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda rod_extension: None, f"returns None; {NO_NUMBER}"),
        (lambda rod_extension: "fast", NO_NUMBER),
        (lambda rod_extension: True, NO_NUMBER),
        (lambda rod_extension: [1.0, 2.0], NO_NUMBER),
        (lambda rod_extension: np.ma.masked, NO_NUMBER),
        (lambda rod_extension: np.timedelta64(3, "s"), NO_NUMBER),
        (with_state(1.0), NO_PAIR),
        (with_state((1.0,)), NO_PAIR),
        (with_state((1.0, [1.0, 2.0])), NO_PAIR),
        (with_state(([1.0, 2.0], [])), NO_PAIR),
        (with_state((1.0, ["x"])), NO_PAIR),
    ],
)
def test_a_wrong_result_is_one_line(function, message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        called(function)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_result_must_be_finite() -> None:
    with pytest.raises(SimulationError, match=r"^t = 2 s: law .* returns 1, nan as command and"):
        require_finite_result(Law(math.sin), 2.0, [1.0, math.nan])


def by_sign(rod_extension, rod_reference):
    return if_then_else(rod_reference[0] - rod_extension > 0, 500.0, -500.0)


@pytest.mark.parametrize(
    ("function", "command"),
    [
        (by_sign, 500.0),
        (lambda rod_extension: if_then_else(rod_extension > 1.0, 500.0, -500.0), -500.0),
        (lambda rod_extension: 5.0 if if_then_else(rod_extension > 0.2, 1.0, 0.0) else -5.0, -5.0),
    ],
)
def test_if_then_else_gives_numbers(function, command: float) -> None:
    assert called(function) == [command]
