"""The Rosenbrock method: its coefficients, and its elimination against NumPy."""

import numpy as np
import pytest

from diagramc.errors import CompilationError
from diagramc.rosenbrock import RODAS, Elimination

# --------------------------------------------------------------------------- coefficients


def lower(rows):
    """A lower triangular matrix of rows of different length."""
    matrix = np.zeros((len(rows), len(rows)))
    for number, row in enumerate(rows):
        matrix[number, : len(row)] = row
    return matrix


def untransformed():
    """The matrices alpha and gamma, and the weights of both methods (Hairer and Wanner, IV.7)."""
    stages = len(RODAS.weights)
    gamma = np.linalg.inv(np.eye(stages) / RODAS.gamma - lower(RODAS.rate_factors))
    alpha = lower(RODAS.state_factors) @ gamma
    weights = np.array(RODAS.weights) @ gamma
    return alpha, gamma, weights, weights - np.array(RODAS.error_weights) @ gamma


def order_conditions(alpha, beta, b):
    """Pairs of a sum of the coefficients and its value in a method of order 4, by order."""
    a = alpha.sum(axis=1)
    c = beta.sum(axis=1)
    return {
        1: [(b.sum(), 1.0)],
        2: [(b @ c, 1 / 2)],
        3: [(b @ a**2, 1 / 3), (b @ beta @ c, 1 / 6)],
        4: [
            (b @ a**3, 1 / 4),
            (b @ (a * (alpha @ c)), 1 / 8),
            (b @ beta @ a**2, 1 / 12),
            (b @ beta @ beta @ c, 1 / 24),
        ],
    }


def test_rodas_has_order_four_and_its_embedded_method_order_three():
    alpha, gamma, weights, embedded = untransformed()
    for order, conditions in order_conditions(alpha, alpha + gamma, weights).items():
        for value, expected in conditions:
            assert value == pytest.approx(expected, abs=1e-13), order
    errors = {
        order: max(abs(value - expected) for value, expected in conditions)
        for order, conditions in order_conditions(alpha, alpha + gamma, embedded).items()
    }
    assert max(errors[order] for order in (1, 2, 3)) < 1e-13
    assert errors[4] > 1e-3  # else there would be no error estimate


def test_rodas_is_consistent_and_damps_the_fastest_modes_at_once():
    alpha, gamma, weights, embedded = untransformed()
    np.testing.assert_allclose(alpha.sum(axis=1), RODAS.nodes, atol=1e-13)
    np.testing.assert_allclose(gamma.sum(axis=1), RODAS.time_factors, atol=1e-13)
    for b in (weights, embedded):  # R(inf) = 1 - b^T (alpha + gamma)^-1 1
        at_infinity = 1.0 - b @ np.linalg.solve(alpha + gamma, np.ones(len(b)))
        assert at_infinity == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------------------- elimination


def executed(operations, numbers, factors):
    """Execute operations of an elimination on ``numbers``, in place."""
    for target, factor, other in operations:
        if factor is None:
            numbers[target] = 1.0 / numbers[target]
        elif other is None:
            numbers[target] *= factors[factor]
        else:
            numbers[target] -= factors[factor] * numbers[other]


@pytest.mark.parametrize("density", [0.1, 0.3, 1.0])
def test_the_elimination_solves_systems_of_any_pattern(density):
    random = np.random.default_rng(7)
    size = 9
    jacobian = random.normal(size=(size, size)) * (random.random((size, size)) < density)
    matrix, b = 20.0 * np.eye(size) - jacobian, random.normal(size=size)
    expected = np.linalg.solve(matrix, b)
    elimination = Elimination([np.flatnonzero(row).tolist() for row in jacobian], 1)
    assert {(i, i) for i in range(size)} <= set(elimination.entries)
    a = np.zeros(elimination.size)
    a[: len(elimination.entries)] = [matrix[entry] for entry in elimination.entries]
    executed(elimination.factorization, a, a)
    executed(elimination.substitution, b, a)
    np.testing.assert_allclose(b, expected, rtol=1e-13)


def test_the_elimination_of_an_arrow_adds_no_element():
    """The first state depends on all others, and they on it: as first pivot it would fill all."""
    size = 6
    elimination = Elimination([range(size)] + [[0]] * (size - 1), 1)
    assert elimination.size == len(elimination.entries) == 3 * size - 2


def test_operations_of_a_full_elimination():
    """Of n = 3 states: n³/3 - n/3 products of the factors, and n² of each solution."""
    operations = Elimination([range(3)] * 3, 2).operations
    assert operations == {"/": 3, "*": 3 + 5 + 2 * 9, "+": 5 + 2 * 6}


def test_many_states_that_depend_on_each_other_are_refused():
    with pytest.raises(CompilationError, match=r"40 states that depend on each other take .*other"):
        Elimination([range(40)] * 40, 6)
