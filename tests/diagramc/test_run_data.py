"""States and tables of open inputs."""

import numpy as np
import pytest

from diagramc import InputTable

BREAKS_S = (1.0, 3.0)
SEGMENTS = np.array([[[1.0, 2.0, 0.5]], [[-1.0, 0.0, 4.0]], [[7.0, -2.0, 1.0]]])
"""Coefficients in ascending order of each of three segments."""


@pytest.mark.parametrize(
    ("time_s", "segment", "start_s"),
    [(-0.5, 0, 0.0), (0.5, 0, 0.0), (1.0, 1, 1.0), (2.9, 1, 1.0), (3.0, 1, 1.0), (3.1, 2, 3.0)],
)
def test_a_value_is_the_polynomial_of_its_segment(time_s, segment, start_s):
    table = InputTable(np.array(BREAKS_S), SEGMENTS)
    expected = np.polyval(SEGMENTS[segment, 0, ::-1], time_s - start_s)
    assert table.value(time_s) == pytest.approx([expected], rel=1e-15)


def test_a_single_break_belongs_to_the_segment_after_it():
    table = InputTable(np.array([1.0]), np.array([[[5.0]], [[6.0]]]))
    assert (table.value(np.nextafter(1.0, 0.0)), table.value(1.0)) == (5.0, 6.0)


def test_a_table_without_arguments_is_a_single_zero():
    np.testing.assert_array_equal(InputTable().value(12.3), [0.0])


def test_a_table_copies_its_arrays_as_doubles_in_c_order():
    coefficients = np.asfortranarray(np.ones((2, 3, 2), dtype=int))
    table = InputTable(np.array([1]), coefficients)
    coefficients[:] = 9
    assert table.coefficients.flags.c_contiguous
    assert (table.breaks.dtype, table.coefficients.dtype) == (float, float)
    np.testing.assert_array_equal(table.value(0.0), np.ones(3))


@pytest.mark.parametrize("breaks", [[1.0, 1.0], [2.0, 1.0]])
def test_breaks_must_ascend(breaks):
    with pytest.raises(ValueError, match=r"^breaks: must ascend$"):
        InputTable(np.array(breaks), SEGMENTS)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_must_be_finite(value):
    with pytest.raises(ValueError, match=r"^breaks: must be finite$"):
        InputTable(np.array([value]), SEGMENTS[:2])
    with pytest.raises(ValueError, match=r"^coefficients: must be finite$"):
        InputTable(coefficients=np.array([[[value]]]))
