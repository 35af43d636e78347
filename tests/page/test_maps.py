"""Formulas: each kind is found for a function that has it, and refused for one that has not."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from kneexo.errors import ParameterError
from kneexo.page.maps import fit_maps, map_value

RANGES = {"a": (0.5, 4.0), "b": (-1.0, 3.0), "c": (0.0, 2.0)}
VALUES = {"a": 1.0, "b": 0.0, "c": 0.25}


def fitted(function, **options):
    """The formula of a function of a, b, c, as JSON gives it, and the usable names."""
    maps, names = fit_maps(
        lambda v: np.array([function(v["a"], v["b"], v["c"]), 5.0]), RANGES, VALUES, **options
    )
    assert 1 not in maps  # a constant needs no formula
    return json.loads(json.dumps(maps.get(0))), names


def require_same(formula, function, exact=False):
    for a, b, c in np.random.default_rng(2).uniform(0.0, 1.0, (200, 3)):
        point = {"a": 0.5 + 3.5 * a, "b": -1.0 + 4.0 * b, "c": 2.0 * c}
        expected = function(**point)
        got = map_value(formula, point)
        assert got == expected if exact else got == pytest.approx(expected, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize(
    ("kind", "of", "function"),
    [
        ("affine", ["a", "c"], lambda a, b, c: 3.0 + 2.0 * a - 0.5 * c),
        ("power", ["a"], lambda a, b, c: 7.0 / a),
        ("power", ["a"], lambda a, b, c: math.sqrt(2.0 * a)),
        ("least", ["a"], lambda a, b, c: min(2.0, 1.5 * a)),
        ("chebyshev", ["b", "a", "c"], lambda a, b, c: a * c * math.sin(b) + c * b * b + a),
        ("chebyshev", ["a", "b"], lambda a, b, c: math.exp(0.3 * a) * (2.0 + b)),
    ],
)
def test_the_kind_of_a_function_is_found(kind, of, function):
    formula, names = fitted(function)
    assert (formula["kind"], formula["of"], names) == (kind, of, ("a", "b", "c"))
    require_same(formula, function)


def test_a_number_that_is_copied_has_no_rounding():
    formula, _ = fitted(lambda a, b, c: b)
    require_same(formula, lambda a, b, c: b, exact=True)


def test_a_limit_in_whole_units():
    def function(a, b, c):
        return 0.1 * math.floor(min(a, 2.34) / 0.1 * (1.0 + 1e-12))

    formula, _ = fitted(function, unit=0.1)
    assert (formula["kind"], formula["unit"]) == ("least", 0.1)
    require_same(formula, function)


def test_at_least():
    formula = {"kind": "affine", "of": ["a"], "offset": 0.0, "factors": [2.0], "at_least": 3.0}
    assert [map_value(formula, {"a": a}) for a in (1.0, 2.0)] == [3.0, 4.0]


def test_a_number_without_formula_is_not_usable_and_keeps_its_value():
    # |b − 0.3| has a corner, so b is left out at its value 0.
    formula, names = fitted(lambda a, b, c: a * abs(b - 0.3) + c)
    assert names == ("a", "c")
    require_same(formula, lambda a, b, c: 0.3 * a + c)


def test_a_number_whose_end_is_refused_is_not_usable():
    def function(a, b, c):
        if c > 1.9:
            raise ParameterError("c")
        return a + c

    formula, names = fitted(function)
    assert names == ("a", "b")
    require_same(formula, lambda a, b, c: a + 0.25)


def test_a_required_number_without_formula_is_an_error():
    with pytest.raises(ParameterError, match=r"^b: no formula represents the effect"):
        fitted(lambda a, b, c: abs(b - 0.3), required=("b",))


def test_a_joint_effect_that_no_pair_shows_is_an_error():
    # a and b act together only where c is large; the single effects do not show it.
    with pytest.raises(ParameterError):
        fitted(lambda a, b, c: a + (b if c > 1.99 else 0.0) * c, required=("a", "b", "c"))


@pytest.mark.slow
@settings(max_examples=30)
@given(st.lists(st.floats(-5.0, 5.0), min_size=8, max_size=8), st.floats(0.1, 2.0))
def test_any_function_that_is_linear_in_two_and_smooth_in_a_third(k, rate):
    def function(a, b, c):
        smooth = [math.cos(rate * b), b, b * b, 1.0]
        return sum((k[i] + k[i + 4] * (a if i % 2 else c)) * smooth[i] for i in range(4))

    formula, names = fitted(function)
    assert names == ("a", "b", "c")
    if formula is not None:
        require_same(formula, function)
