"""Margins of loops whose signal changes within the period, against loops with a transfer."""

import math

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain, LinearSystem, ZeroOrderHold

from diagramc import PeriodicLoop, linearize, loop_at, margins

T = 0.05
STABLE = ([[0.0, 1.0], [-4.0, -1.0]], [[0.0], [4.0]], [[1.0, 0.2]], [[0.0]])
UNSTABLE = ([[0.0, 1.0], [1.0, -1.0]], [[0.0], [4.0]], [[1.0, 0.3]], [[0.0]])
LAG = ([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def loop(gain, plant=STABLE, *, hold_s=T, others=()):
    """A plant with a gain in feedback, held for a time if required, and other loops around it.

    ``others`` are tuples (period, offset, gain) of a hold and its gain.
    """
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", LinearSystem(*plant))
    add = builder.AddNamedSystem("add", Adder(1 + len(others), 1))
    paths = [("law", hold_s, 0.0, gain), *((f"law{i}", *o) for i, o in enumerate(others))]
    for number, (name, period_s, offset_s, factor) in enumerate(paths):
        law = builder.AddNamedSystem(name, Gain(-factor, 1))
        port = plant.get_output_port()
        if period_s is not None:
            hold = ZeroOrderHold(period_s, 1, offset_sec=offset_s)
            hold = builder.AddNamedSystem(f"hold_{name}", hold)
            builder.Connect(port, hold.get_input_port())
            port = hold.get_output_port()
        builder.Connect(port, law.get_input_port())
        builder.Connect(law.get_output_port(), add.get_input_port(number))
    builder.Connect(add.get_output_port(), plant.get_input_port())
    builder.ExportOutput(plant.get_output_port(), "y")
    return builder.Build()


@pytest.mark.parametrize(
    ("plant", "hold_s", "gain", "port"),
    [
        (STABLE, T, 1.5, "law:y0"),
        pytest.param(UNSTABLE, T, 1.5, "hold_law:u", marks=pytest.mark.slow),
        (LAG, None, 0.8, "law:y0"),
    ],
)
def test_a_clock_without_influence_changes_no_margin(plant, hold_s, gain, port):
    # With the clock the common period is 3 T, in which the loop has several values.
    simple = margins(loop_at(loop(gain, plant, hold_s=hold_s), port))
    clocked = loop_at(loop(gain, plant, hold_s=hold_s, others=[(1.5 * T, 0.5 * T, 0.0)]), port)
    assert isinstance(clocked, PeriodicLoop)
    m = margins(clocked)
    assert m.stable
    assert simple.stable
    assert m.gain_margin == pytest.approx(simple.gain_margin, rel=1e-9)
    assert m.lower_gain_margin == pytest.approx(simple.lower_gain_margin, rel=1e-9)
    phase = min(simple.phase_margin_deg, simple.phase_lead_margin_deg)
    assert m.phase_margin_deg == m.phase_lead_margin_deg == pytest.approx(phase, rel=1e-9)
    assert m.disk_margin == pytest.approx(simple.disk_margin, rel=1e-6)
    assert math.isnan(m.delay_margin_s)


def test_the_gain_margin_of_a_multirate_loop_destabilizes_the_diagram():
    others = [(1.5 * T, 0.5 * T, 0.4)]
    m = margins(loop_at(loop(1.5, others=others), "law:y0"))
    assert m.stable
    model = linearize(loop(1.5 * m.gain_margin, others=others), inputs=[], outputs=["y"])
    values = model.eigenvalues
    assert np.abs(values).max() == pytest.approx(1.0, abs=1e-9)
    angle = 2.0 * math.pi * m.gain_margin_frequency_hz * model.period_s
    assert abs(np.angle(values[0])) == pytest.approx(angle, abs=1e-8)
    for factor, stable in ((0.999, True), (1.001, False)):
        closed = loop(1.5 * factor * m.gain_margin, others=others)
        assert linearize(closed, inputs=[], outputs=["y"]).stable is stable


@pytest.mark.slow
def test_a_multirate_loop_is_unstable_with_more_than_its_margin():
    m = margins(loop_at(loop(60.0, others=[(1.5 * T, 0.0, 0.4)]), "law:y0"))
    assert not m.stable
    assert 0.0 < m.lower_gain_margin < 1.0
    closed = loop(60.0 * m.lower_gain_margin, others=[(1.5 * T, 0.0, 0.4)])
    values = linearize(closed, inputs=[], outputs=["y"]).eigenvalues
    assert np.abs(values).max() == pytest.approx(1.0, abs=1e-9)


def test_a_loop_that_nothing_destabilizes():
    m = margins(loop_at(loop(0.5, LAG, hold_s=None, others=[(T, 0.0, 0.0)]), "law:y0"))
    assert (m.gain_margin, m.lower_gain_margin, m.phase_margin_deg) == (math.inf, 0.0, math.inf)
    assert math.isnan(m.gain_margin_frequency_hz)
    assert (m.disk_margin, m.disk_gain_margin) == (2.0, math.inf)


def test_a_gain_far_beyond_the_margin_overflows_in_silence():
    # L = −0.5/(s + 1): the pole is −1 + 0.5 k.
    m = margins(loop_at(loop(-0.5, LAG, hold_s=None, others=[(T, 0.0, 0.0)]), "law:y0"))
    assert (m.gain_margin, m.gain_margin_frequency_hz) == pytest.approx((2.0, 0.0), rel=1e-9)


FREE = [  # modes outside of the loop of LAG: a state that the loop drives but does not see
    ([[-1.0, 0.0], [1.0, 0.0]], [[1.0], [0.0]], [[1.0, 0.0]]),  # an angle
    (
        [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[1.0], [0.0], [0.0]],
        [[1.0, 0.0, 0.0]],
    ),
    ([[-1.0, 1.0], [0.0, 0.0]], [[1.0], [0.0]], [[1.0, 0.0]]),  # a constant disturbance
    ([[-1.0, 1.0], [0.0, 0.5]], [[1.0], [0.0]], [[1.0, 0.0]]),  # a growing disturbance
]


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("plant", FREE)
def test_a_mode_that_the_loop_does_not_move_changes_no_margin(plant):
    # LAG alone has the pole p = e^−T − k g (1 − e^−T), which is −1 at the gain margin.
    gain, decay = 4.0, math.exp(-T)
    free = loop_at(loop(gain, (*plant, [[0.0]]), others=[(1.5 * T, 0.0, 0.0)]), "law:y0")
    assert isinstance(free, PeriodicLoop)
    m = margins(free)
    assert not m.stable
    assert m.gain_margin == pytest.approx((1.0 + decay) / (gain * (1.0 - decay)), rel=1e-9)
    simple = margins(loop_at(loop(gain, LAG), "law:y0"))
    assert m.phase_margin_deg == pytest.approx(simple.phase_margin_deg, rel=1e-8)
    assert m.disk_margin == pytest.approx(simple.disk_margin, rel=1e-6)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rounding", [-1e-13, 0.0, 1e-13])
def test_a_periodic_loop_on_the_boundary_has_no_margin(rounding):
    # L = −1/(s + 1) has the closed pole 0.
    m = margins(loop_at(loop(-1.0 - rounding, LAG, hold_s=None, others=[(T, 0.0, 0.0)]), "law:y0"))
    assert not m.stable
    assert (m.gain_margin, m.lower_gain_margin) == (1.0, 1.0)
    assert (m.phase_margin_deg, m.phase_lead_margin_deg, m.disk_margin) == (0.0, 0.0, 0.0)
    assert m.gain_margin_frequency_hz == pytest.approx(0.0, abs=1e-9)
