"""Runs in which a Python function sets an open input at each sample."""

import math

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LinearSystem, Multiplexer, PassThrough, ZeroOrderHold

from diagramc import InputTable, State, compile_diagram, simulate_with_feedback
from diagramc.errors import SimulationError

T = 0.01


def plant():
    """dx/dt = −x + h, where the port ``h`` holds the open input ``u`` for a sample."""
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(T, 1))
    lag = builder.AddNamedSystem("lag", LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    builder.Connect(hold.get_output_port(), lag.get_input_port())
    through = builder.AddNamedSystem("through", PassThrough(1))
    builder.ExportInput(hold.get_input_port(), "u")
    builder.ConnectInput("u", through.get_input_port())
    builder.ExportOutput(lag.get_output_port(), "x")
    builder.ExportOutput(hold.get_output_port(), "h")
    builder.ExportOutput(through.get_output_port(), "direct")
    return builder.Build()


def run(feedback, **options):
    model = compile_diagram(plant(), inputs=("u",))
    arguments = {
        "feedback_input": "u",
        "feedback_outputs": ("x",),
        "sample_period_s": T,
        "outputs": ("x", "h"),
    }
    state = State(np.array([2.0]), np.zeros(1))
    return simulate_with_feedback(
        model, model.parameters(), state, 0.5, feedback, **(arguments | options)
    )


def test_a_held_feedback_against_the_closed_form() -> None:
    """With h = −k x at each sample, x_{n+1} = e^(−T) x_n − (1 − e^(−T)) k x_n exactly."""
    gain, times = 3.0, []

    def feedback(time_s, values):
        times.append(time_s)
        return -gain * values["x"]

    result = run(feedback)
    factor = math.exp(-T) - (1.0 - math.exp(-T)) * gain
    expected = 2.0 * factor ** np.arange(51)
    np.testing.assert_allclose(result["x"][:, 0], expected, rtol=1e-7)
    np.testing.assert_allclose(result.time_s, T * np.arange(51), rtol=1e-12)
    np.testing.assert_allclose(times, T * np.arange(50), rtol=1e-12)
    # A record sees the state before the update at its time.
    np.testing.assert_allclose(result["h"][1:, 0], -gain * expected[:-1], rtol=1e-7)
    assert result["h"][0, 0] == 0.0
    np.testing.assert_allclose(result.final.continuous, expected[-1:], rtol=1e-7)


def test_other_open_inputs_have_their_own_time() -> None:
    """With dx/dt = −x + t and x(0) = 2, x = 2 e^(−t) + t − 1 + e^(−t)."""
    builder = DiagramBuilder()
    lag = builder.AddNamedSystem("lag", LinearSystem([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    both = builder.AddNamedSystem("both", Multiplexer(2))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(T, 1))
    builder.Connect(hold.get_output_port(), both.get_input_port(0))
    builder.Connect(both.get_output_port(), lag.get_input_port())
    builder.ExportInput(both.get_input_port(1), "w")
    builder.ExportInput(hold.get_input_port(), "u")
    builder.ExportOutput(lag.get_output_port(), "x")
    model = compile_diagram(builder.Build(), inputs=("w", "u"))
    table = InputTable(coefficients=np.array([[[0.0, 1.0], [9.0, 9.0]]]))
    result = simulate_with_feedback(
        model,
        model.parameters(),
        State(np.array([2.0]), np.zeros(1)),
        0.5,
        lambda time_s, values: 0.0,
        feedback_input="u",
        feedback_outputs=("x",),
        sample_period_s=T,
        inputs=table,
    )
    t = result.time_s
    np.testing.assert_allclose(result["x"][:, 0], 3.0 * np.exp(-t) + t - 1.0, rtol=1e-7)


def test_values_in_the_table_are_ignored() -> None:
    table = InputTable(np.array([0.1]), np.full((2, 1, 2), 5.0))
    given, without = (run(lambda t, v: 1.0, inputs=inputs) for inputs in (table, None))
    np.testing.assert_array_equal(given["x"], without["x"])
    assert table.coefficients.min() == 5.0  # the caller's table stays


def test_a_feedback_that_is_not_finite_names_time_and_input() -> None:
    with pytest.raises(SimulationError, match=r"t = 0.03 s: u is not finite"):
        run(lambda time_s, values: math.nan if time_s > 0.025 else 0.0)


def test_a_port_that_depends_on_the_input_is_refused() -> None:
    with pytest.raises(ValueError, match="direct: depends on u at the same time"):
        run(lambda time_s, values: 0.0, feedback_outputs=("direct",))


def test_an_error_of_the_function_is_raised_unchanged() -> None:
    def faulty(time_s, values):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(faulty)
