"""Stability margins against python-control, closed forms and eigenvalues on the unit circle."""

import dataclasses
import math

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest
from linear_cases import SCENARIOS, SPRING, T, plant_parameters, raises_one_line, sampled_loop

from diagramc import loop_at
from kneexo.analysis.linear.loop_equilibrium import find_equilibrium
from kneexo.analysis.linear.margins import stability_margins
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.diagrams import make_closed_loop
from kneexo.errors import LinearizationError
from kneexo.parameters import PidParameters, Scenario, SlidingModeParameters
from kneexo.parameters.paths import changed


@pytest.mark.filterwarnings("ignore:stability_margins")
@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "difference"])
def test_margins_are_those_of_python_control_on_the_state_space(loops, margins, name):
    m = margins[name]
    gain, phase, *_ = control.stability_margins(loops[name].to_control())
    assert m.gain_margin == pytest.approx(gain, rel=1e-6)
    assert m.phase_margin_deg == pytest.approx(phase, rel=1e-6)


def scaled(loop, factor):
    """The loop transfer with its gain multiplied."""
    return dataclasses.replace(loop.loop, b=factor * loop.loop.b)


@pytest.fixture(scope="module")
def conditional():
    """A wide boundary layer: three crossings of |L| = 1, of which one has turned past −180°."""
    return linearize_loop(Scenario(controller=SlidingModeParameters(phi_m_s2=18.0)))


def test_a_conditionally_stable_loop_prints_both_phase_margins(conditional):
    m, text = conditional.margins(), str(conditional)
    lag = f"phase margin {m.phase_margin_deg:.4g} deg at {m.phase_margin_frequency_hz:.4g} Hz"
    lead = f"lead {m.phase_lead_margin_deg:.4g} deg at {m.phase_lead_margin_frequency_hz:.4g} Hz"
    assert f"{lag}, {lead}, delay margin" in text
    assert "lower" not in text


def test_a_loop_that_loses_stability_with_less_gain_prints_that_margin():
    # Three integrators with the feedback (s + 10/s)³ less s³: Routh asks for a gain above 1/9.
    drive, feedback = np.array([[0.0], [0.0], [1.0]]), -np.array([[1e3, 3e2, 30.0]])
    loop = sampled_loop(np.eye(3, k=1), drive, feedback, np.zeros((1, 1)))
    m = loop.margins()
    assert m.lower_gain_margin == pytest.approx(1.0 / 9.0, rel=0.05)  # T adds a short delay
    assert scaled(loop, 1.001 * m.lower_gain_margin).closed_is_stable()
    assert not scaled(loop, 0.999 * m.lower_gain_margin).closed_is_stable()
    assert f", lower {m.lower_gain_margin:.4g}\n" in str(loop)


@pytest.mark.parametrize("name", ["difference", "pid_tuned"])
def test_the_delay_margin_is_what_the_can_bus_may_take(margins, name):
    samples = margins[name].delay_margin_s / T
    assert 1.0 < samples < 10.0
    below, above = (
        linearize_loop(changed(SCENARIOS[name], {"bus.latency_samples": n}))
        for n in (math.floor(samples), math.ceil(samples))
    )
    assert below.stable
    assert not above.stable


@pytest.mark.parametrize("unit_rpm", [1.0, 0.001])
@pytest.mark.parametrize(("latency", "same"), [(0, "smc"), (1, "can_1"), (2, "can_2")])
def test_the_loop_of_a_drive_is_the_one_without_rounding(loops, margins, unit_rpm, latency, same):
    bus = {"kind": "cia402", "velocity_unit_rpm": unit_rpm, "latency_samples": latency}
    loop = linearize_loop(Scenario(bus=bus))
    np.testing.assert_array_equal(loop.monodromy, loops[same].monodromy)
    # A delay in the loop takes itself from the delay margin, and nothing from the crossover.
    m, immediate = loop.margins(), margins["smc"]
    assert m.delay_margin_s == pytest.approx(immediate.delay_margin_s - latency * T, rel=1e-6)
    assert m.delay_margin_frequency_hz == pytest.approx(
        immediate.delay_margin_frequency_hz, rel=1e-9
    )


def test_an_unstable_loop_says_so(unstable):
    assert not unstable.stable
    assert not unstable.margins().stable
    for bandwidth in (unstable.bandwidth_hz, unstable.complementary_sensitivity_bandwidth_hz):
        with raises_one_line(LinearizationError, "unstable .* it has no bandwidth"):
            bandwidth()
    largest = max(abs(unstable.eigenvalues))
    assert str(unstable) == (  # exact states hold the rod that Table 1 has at 40 deg
        f"knee at 40.01 deg, T = 0.002 s: unstable, largest eigenvalue {largest:.6g}; "
        f"it has no margins"
    )
    axes = unstable.plot()
    shown = [text.get_text() for ax in axes for text in ax.get_legend().get_texts()]
    assert shown == ["Nyquist, 250 Hz"] * 2
    plt.close(axes[0].figure)


def test_a_loop_with_hardly_any_gain_has_no_gain_margin():
    law = PidParameters(proportional_per_s=1e-300)  # products of two values of the loop are zero
    loop = linearize_loop(Scenario(controller=law, estimator={"kind": "exact"}))
    assert loop.margins().gain_margin > 1e100


def test_a_loop_below_gain_one_has_an_infinite_phase_margin_in_words():
    # A spring holds the rod, and the controller pushes it by a thousandth of what is needed.
    controller = PidParameters(proportional_per_s=0.001)
    loop = linearize_loop(Scenario(plant=plant_parameters(SPRING), controller=controller))
    assert "  phase margin infinite, delay margin infinite\n" in str(loop)
    assert "nan" not in str(loop)


@pytest.mark.parametrize("name", ["smc", "pid_tuned", "difference", "can_2"])
def test_the_loop_touches_the_disk_that_it_keeps_out(loops, margins, name):
    axes = loops[name].plot_nyquist()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("real part of L", "imaginary part of L")
    lines = {line.get_label(): line.get_data() for line in axes.lines}
    real, imaginary = lines["L, f > 0"]
    np.testing.assert_array_equal(lines["L, f < 0"], (real, -imaginary))
    assert np.hypot(*lines["|L| = 1"]) == pytest.approx(np.ones(361))
    assert np.ravel(lines["−1"]).tolist() == [-1.0, 0.0]
    # L has one value at each frequency, and 250 Hz makes it real.
    assert imaginary[-1] == pytest.approx(0.0, abs=1e-6)
    assert real[-1] == pytest.approx(loops[name].loop_response(250.0)[0].real, abs=1e-6)
    assert (axes.get_xlim(), axes.get_ylim()) == ((-3.5, 1.5), (-2.5, 2.5))
    shown = axes.patches[0].get_label()
    assert shown == f"disk margin {margins[name].disk_margin:.3g}"
    assert "The curve touches the disk" in axes.figure.get_label()
    circle = axes.patches[0].get_path().vertices @ [1.0, 1.0j]
    m = margins[name]
    # On the real axis the disk spans the gains that the loop stands.
    assert circle.real.min() == pytest.approx(-m.disk_gain_margin, rel=1e-9)
    assert circle.real.max() == pytest.approx(-1.0 / m.disk_gain_margin, rel=1e-9)
    centre = 0.5 * (circle.real.min() + circle.real.max())
    radius = 0.5 * np.ptp(circle.real)
    assert np.abs(circle - centre) == pytest.approx(np.full(circle.size, radius), rel=1e-9)
    at = loops[name].loop_response(m.disk_margin_frequency_hz)[0]
    assert abs(at - centre) == pytest.approx(radius, rel=1e-9)
    everywhere = loops[name].loop_response(np.geomspace(0.01, 250.0, 5000))
    assert np.abs(everywhere - centre).min() >= (1.0 - 1e-9) * radius
    plt.close(axes.figure)


def test_an_unstable_loop_has_no_disk(unstable):
    axes = unstable.plot_nyquist()
    assert not axes.patches
    assert axes.figure.get_label() == "Nyquist plot of the loop transfer L."
    plt.close(axes.figure)


def test_the_loop_of_the_diagram_has_the_same_margins(loops, margins):
    scenario = SCENARIOS["pid_tuned"]
    diagram = make_closed_loop(scenario.without_quantizers(), signals=(), external_reference=True)
    rest = find_equilibrium(scenario)
    state = rest.equations.state(rest.context)
    context = diagram.CreateDefaultContext()
    context.SetContinuousState(state.continuous)
    context.SetDiscreteState(state.discrete)
    diagram.GetInputPort("knee_reference").FixValue(context, [math.radians(40.0), 0.0, 0.0, 0.0])
    opened = loop_at(diagram, "controller:motor_speed_command", context)
    f = np.geomspace(0.1, 250.0, 20)
    expected = loops["pid_tuned"].loop_response(f)
    # Two poles near z = 1 multiply the rounding errors of the matrices by 1e5 at 0.1 Hz.
    np.testing.assert_allclose(opened.response(f), expected, rtol=1e-9)
    assert vars(stability_margins(opened)) == pytest.approx(vars(margins["pid_tuned"]), rel=1e-11)
