"""Input tables against Drake's TrajectorySource."""

import numpy as np
import pytest
from pydrake.polynomial import Polynomial
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough, TrajectorySource
from pydrake.trajectories import BezierCurve, PiecewisePolynomial

from diagramc import InputTable, compile_diagram
from diagramc.trajectories import input_table, stack_tables

TIMES_S = np.arange(33.0) / 16.0  # exact in binary, as the breaks are


def cubic():
    return PiecewisePolynomial.CubicShapePreserving(
        [0.25, 0.5, 1.0, 1.5], np.array([[0.0, 1.0, 0.5, 2.0], [1.0, -1.0, 3.0, 3.0]])
    )


def mixed_degrees():
    """Two rows, the first of degree 0, the second of degree 2."""
    segments = [
        np.array([[Polynomial(1.0)], [Polynomial([0.0, 2.0, slope])]]) for slope in (1.0, -3.0)
    ]
    trajectory = PiecewisePolynomial(segments, [0.0, 0.75, 1.25])
    assert trajectory.getSegmentPolynomialDegree(0, 0) == 0
    return trajectory


CASES = {
    "value": (cubic, 0, True),
    "derivatives": (cubic, 2, True),
    "derivatives beyond the limits": (cubic, 2, False),
    "degrees": (mixed_degrees, 1, True),
    "steps": (
        lambda: PiecewisePolynomial.ZeroOrderHold([0.5, 1.0, 1.5], np.array([[1.0, 2.0, 3.0]])),
        0,
        True,
    ),
    "constant": (lambda: PiecewisePolynomial(np.array([[2.0], [3.0]])), 1, True),
}


def values(table):
    """What a compiled model gets from a table at `TIMES_S`."""
    size = table.coefficients.shape[1]
    builder = DiagramBuilder()
    block = builder.AddSystem(PassThrough(size))
    builder.ExportInput(block.get_input_port(), "in")
    builder.ExportOutput(block.get_output_port(), "out")
    model = compile_diagram(builder.Build(), inputs=["in"])
    run = model.simulate(
        model.parameters(), model.state(), 2.0, record_period_s=1 / 16, inputs=table
    )
    np.testing.assert_array_equal(run.time_s, TIMES_S)
    return run["out"]


def drake_values(trajectory, derivatives, zero):
    source = TrajectorySource(trajectory, derivatives, zero)
    context = source.CreateDefaultContext()
    rows = []
    for time in TIMES_S:
        context.SetTime(time)
        rows.append(source.get_output_port().Eval(context).copy())
    return np.array(rows)


@pytest.mark.parametrize("case", CASES)
def test_table_is_the_trajectory_source_of_drake(case):
    make, derivatives, zero = CASES[case]
    table = input_table(make(), derivatives, zero_derivatives_beyond_limits=zero)
    expected = drake_values(make(), derivatives, zero)
    np.testing.assert_allclose(values(table), expected, rtol=0, atol=1e-13)


def test_stacked_tables_keep_their_values():
    # The second ends, with a slope that is not zero, within the first.
    cases = [(cubic, 1, True), (mixed_degrees, 1, True), CASES["constant"]]
    stacked = stack_tables(
        *(input_table(make(), n, zero_derivatives_beyond_limits=zero) for make, n, zero in cases)
    )
    expected = np.hstack([drake_values(make(), n, zero) for make, n, zero in cases])
    np.testing.assert_allclose(values(stacked), expected, rtol=0, atol=1e-13)


def test_a_segment_before_all_breaks_has_powers_of_time():
    line = InputTable(coefficients=np.array([[[0.0, 1.0]]]))
    step = InputTable(np.array([1.0]), np.array([[[0.0]], [[5.0]]]))
    stacked = stack_tables(line, step)
    # From the break on both are in powers of t - 1.
    np.testing.assert_array_equal(stacked.coefficients[1], [[1.0, 1.0], [5.0, 0.0]])


def test_constants_stack_without_breaks():
    first, second = (InputTable(coefficients=np.full((1, 1, 1), value)) for value in (1.0, 2.0))
    stacked = stack_tables(first, second)
    assert stacked.breaks.size == 0
    np.testing.assert_array_equal(stacked.coefficients, [[[1.0], [2.0]]])


@pytest.mark.parametrize(
    ("trajectory", "derivatives", "words"),
    [
        (BezierCurve(0.0, 1.0, np.zeros((1, 3))), 0, "is a BezierCurve; must be a Piecewise"),
        (PiecewisePolynomial(np.zeros((1, 2))), 0, "has 2 columns; must have 1"),
        (PiecewisePolynomial(np.zeros((1, 1))), -1, "derivatives = -1: must be >= 0"),
    ],
)
def test_what_makes_no_table_is_refused(trajectory, derivatives, words):
    with pytest.raises(ValueError, match=words):
        input_table(trajectory, derivatives)
