"""Invariant zeros of systems whose zeros are known, and of random ones by their definition."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from diagramc.linear.zeros import invariant_zeros


def companion(poles, zeros):
    """State space of Π(s − zero)/Π(s − pole), with fewer zeros than poles."""
    denominator, numerator = (np.atleast_1d(np.real(np.poly(r))) for r in (poles, zeros))
    n = denominator.size - 1
    a = np.eye(n, k=1)
    a[-1] = -denominator[:0:-1]
    c = np.zeros((1, n))
    c[0, : numerator.size] = numerator[::-1]
    return a, np.eye(n)[:, -1:], c, np.zeros((1, 1))


@pytest.mark.parametrize("zeros", [[], [-3.0], [2.0, -0.5], [-1.0 + 4.0j, -1.0 - 4.0j, 7.0]])
def test_zeros_of_a_transfer_function(zeros):
    result = invariant_zeros(*companion([-1.0, -2.0, -2.5, -4.0, -0.1], zeros))
    assert np.sort_complex(result) == pytest.approx(np.sort_complex(np.array(zeros)), rel=1e-9)


def test_zeros_do_not_depend_on_the_units_of_the_states():
    a, b, c, d = companion([-1.0, -2.0, -300.0], [-50.0])
    unit = np.diag([1e-6, 1.0, 1e7])
    inverse = np.linalg.inv(unit)
    result = invariant_zeros(unit @ a @ inverse, unit @ b, c @ inverse, d)
    assert result == pytest.approx([-50.0], rel=1e-9)


@pytest.mark.parametrize(("of_input", "of_output"), [(1e-14, 1.0), (1.0, 1e-14), (1e9, 1e-12)])
def test_zeros_do_not_depend_on_the_units_of_inputs_and_outputs(of_input, of_output):
    a, b, c, d = companion([-1.0, -2.0, -3.0], [-5.0])
    result = invariant_zeros(a, of_input * b, of_output * c, of_input * of_output * d)
    assert result == pytest.approx([-5.0], rel=1e-9)


def test_feedthrough_gives_as_many_zeros_as_states():
    a, b, c = np.diag([-1.0, -2.0]), np.array([[1.0], [1.0]]), np.array([[1.0, 1.0]])
    # 1 + 1/(s + 1) + 1/(s + 2) = (s² + 5 s + 5)/…
    result = invariant_zeros(a, b, c, np.eye(1))
    assert np.sort(result.real) == pytest.approx([-2.5 - 1.25**0.5, -2.5 + 1.25**0.5], rel=1e-12)


def test_two_channels_have_the_zeros_of_both():
    first, second = companion([-1.0, -2.0], [-3.0]), companion([-4.0, -5.0, -6.0], [1.0, -7.0])
    system = [block_diag(upper, lower) for upper, lower in zip(first, second, strict=True)]
    mix = np.array([[1.0, 0.4], [-0.3, 1.0]])
    result = invariant_zeros(system[0], system[1] @ mix, mix @ system[2], system[3])
    assert np.sort_complex(result) == pytest.approx([-7.0, -3.0, 1.0], rel=1e-9)


def test_a_state_that_no_input_moves_and_no_output_shows_is_a_zero():
    a, b, c, d = companion([-1.0, -2.0], [])
    hidden = [block_diag(a, [[-9.0]]), np.vstack([b, [[0.0]]]), np.hstack([c, [[0.0]]]), d]
    assert invariant_zeros(*hidden) == pytest.approx([-9.0], rel=1e-12)


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 2), (3, 2)])
def test_a_random_system_that_is_not_square_has_no_zeros(inputs, outputs):
    rng = np.random.default_rng(1)
    shapes = ((4, 4), (4, inputs), (outputs, 4), (outputs, inputs))
    assert invariant_zeros(*(rng.normal(size=shape) for shape in shapes)).size == 0


def test_at_a_zero_the_system_matrix_loses_rank():
    rng = np.random.default_rng(2)
    a, b, c = rng.normal(size=(5, 5)), rng.normal(size=(5, 2)), rng.normal(size=(2, 5))
    result = invariant_zeros(a, b, c, np.zeros((2, 2)))
    assert result.size == 3
    for zero in result:
        matrix = np.block([[a - zero * np.eye(5), b], [c, np.zeros((2, 2))]])
        assert np.linalg.svd(matrix, compute_uv=False)[-1] < 1e-10


def test_a_gain_has_no_zeros():
    assert (
        invariant_zeros(np.empty((0, 0)), np.empty((0, 1)), np.empty((1, 0)), np.eye(1)).size == 0
    )
