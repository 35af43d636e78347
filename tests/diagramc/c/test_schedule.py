"""Ticks of a model in C, and Runge-Kutta steps within a tick."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LinearSystem, ZeroOrderHold

from diagramc import read_diagram, source_of
from diagramc.c.schedule import Schedule
from diagramc.errors import CompilationError


def exported(diagram, **options):
    return source_of(read_diagram(diagram, inputs=["u0"]), "model", **options)


def oscillator():
    """A continuous plant of two states with an input."""
    return LinearSystem(
        A=[[0.0, 1.0], [-400.0, -4.0]], B=[[0.0], [400.0]], C=[[1.0, 0.0]], D=[[0.0]]
    )


def test_sample_times_without_a_clock_wrap_after_a_cycle(built):
    builder = DiagramBuilder()
    for name, period, offset in (("a", 0.004, 0.0), ("b", 0.006, 0.010)):
        hold = builder.AddNamedSystem(name, ZeroOrderHold(period, 1, offset_sec=offset))
        builder.ExportInput(hold.get_input_port(), f"u_{name}")
        builder.ExportOutput(hold.get_output_port(), name)
    diagram = builder.Build()
    source = source_of(read_diagram(diagram, inputs=["u_a", "u_b"]), "model")
    assert not source.plan.needs_time
    inputs = np.arange(1.0, 41.0)[:, None] * [1.0, 10.0]
    outputs = built(source).replay(inputs)
    k = np.arange(40)  # ticks of 2 ms
    np.testing.assert_array_equal(outputs[:, 0], inputs[k // 2 * 2, 0])
    last = np.where(k < 5, -1, (k - 5) // 3 * 3 + 5)
    np.testing.assert_array_equal(outputs[:, 1], np.where(last < 0, 0.0, inputs[last, 1]))


def test_steps_fit_their_counter():
    options = {"tick_s": 1.0}
    assert exported(oscillator(), step_s=1.0 / 65_535, **options).plan.schedule.steps == 65_535
    with pytest.raises(CompilationError, match=r"step_s = 1e-07 s: makes 10000000 steps .* 65535"):
        exported(oscillator(), step_s=1e-7, **options)


def test_steps_divide_a_tick_and_are_at_most_as_long_as_allowed():
    schedule = Schedule(0.01, (1,), (0,), 0.003)
    assert (schedule.steps, schedule.step_s) == (4, 0.0025)
    assert Schedule(0.01, (1,), (0,), 0.0025).steps == 4  # not 5 by rounding
    assert Schedule(0.01, (1,), (0,), 1.0).steps == 1


def test_a_cycle_lasts_the_common_multiple_of_the_periods():
    assert Schedule(0.01, (4, 6), (0, 5), 1.0).cycle == (5, 17)
    assert Schedule(0.01, (4, 6), (0, 5), 1.0).counts_ticks
    assert not Schedule(0.01, (1, 1), (0, 0), 1.0).counts_ticks
    assert Schedule(0.01, (1,), (2,), 1.0).counts_ticks
