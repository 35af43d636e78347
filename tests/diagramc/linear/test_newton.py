"""Newton's method on functions whose zeros are known in closed form."""

import math

import numpy as np
import pytest

from diagramc.linear.newton import NEWTON_STEPS, newton


def square_root_of_two(point):
    return point**2 - 2.0, np.diag(2.0 * point)


def test_a_search_ends_at_the_zero():
    point = newton(square_root_of_two, np.array([1.0]))
    assert point == pytest.approx([math.sqrt(2.0)], rel=1e-15)


def test_a_variable_without_influence_keeps_its_value():
    def first_only(point):
        return point[:1] ** 2 - 2.0, np.array([[2.0 * point[0], 0.0]])

    point = newton(first_only, np.array([1.0, 7.0]))
    assert point == pytest.approx([math.sqrt(2.0), 7.0], rel=1e-15)


def test_the_tolerance_suits_large_variables():
    calls = []

    def rounded(point):
        """A linear function whose rounding error keeps the steps at 1e-9."""
        calls.append(point)
        error = 1e-9 * (-1.0) ** len(calls) if len(calls) > 1 else 0.0
        return point - 1e6 + error, np.eye(1)

    newton(rounded, np.array([0.0]))
    assert len(calls) == 2


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("place", [0, 1])
def test_a_value_or_derivative_that_is_not_finite_ends_the_search(bad, place):
    def function(point):
        answer = [point, np.eye(1)]
        answer[place] = answer[place] * bad
        return answer

    assert newton(function, np.array([1.0])) == 1.0


def test_a_search_without_zero_ends_too():
    calls = []

    def function(point):
        calls.append(point)
        return point**2 + 1.0, np.diag(2.0 * point)

    assert np.isfinite(newton(function, np.array([0.5]))).all()
    assert len(calls) == NEWTON_STEPS


@pytest.mark.parametrize(("noise", "ends"), [(1e-11, True), (1e-7, False)])
def test_a_search_ends_when_rounding_no_longer_reduces_the_residual(noise, ends):
    calls = []

    def rounded(x):
        calls.append(x)
        return x - 1.0 + noise * (-1.0) ** len(calls), np.eye(1)

    assert newton(rounded, np.array([3.0])) == pytest.approx([1.0], abs=2.0 * noise)
    assert (len(calls) <= 4) is ends
