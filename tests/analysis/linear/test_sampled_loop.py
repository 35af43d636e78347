"""Sampled loops against Drake's Simulator, python-control and closed forms."""

import dataclasses
import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from linear_cases import Matrices, T, delayed, distance, eq_27, frequency_response, raises_one_line
from pydrake.symbolic import Variable, exp
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import SymbolicVectorSystem

from kneexo.analysis.linear.plant_linearization import linearize_plant
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.diagrams import make_plant
from kneexo.errors import LinearizationError
from kneexo.parameters import PidParameters, Scenario
from kneexo.studies.size.error_model import error_model


def test_the_plant_of_a_loop_is_the_linearized_plant(loops):
    plant = linearize_plant()
    for name in ("smc", "pid", "can_2", "exact"):
        loop = Matrices(loops[name])
        assert np.abs(loop.a - plant.a).max() < 1e-9 * np.abs(plant.a).max()
        assert np.abs(loop.b - plant.b).max() < 1e-12 * np.abs(plant.b).max()


@pytest.mark.parametrize(
    "controller",
    [
        # With these the integral's update differs from the identity by rounding.
        PidParameters(
            proportional_per_s=11.3, moment_arm_m=0.0931, derivative=0.03, filter_s=0.013
        ),
        PidParameters(proportional_per_s=7.7, moment_arm_m=0.113, velocity_feedforward=0.9),
        PidParameters(proportional_per_s=3.1, moment_arm_m=0.077, anti_windup_s=0.37),
    ],
)
def test_an_unused_integral_is_no_state_of_the_loop(controller):
    loop = linearize_loop(Scenario(controller=controller))
    assert Matrices(loop).g_z.shape == (2, 2)
    assert loop.stable


def test_eigenvalues_are_sorted_and_become_poles(loops):
    loop = loops["can_2"]
    values = loop.eigenvalues
    assert np.all(np.diff(np.abs(values)) <= 1e-12)
    kept = values[np.abs(values) > 1e-9]
    assert np.exp(loop.poles() * T) == pytest.approx(kept, rel=1e-12)


def test_exact_states_lose_stability_between_1_0e4_and_1_3e4():
    def stable(slope):
        return linearize_loop(eq_27(slope)).stable

    low, high = 1.0e4, 1.3e4
    assert stable(low)
    assert not stable(high)
    for _ in range(25):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    assert high - low < 1e-3
    assert low == pytest.approx(BOUNDARY_PER_S, rel=1e-4)
    # There the hydraulic mode leaves the unit circle, seen folded below the Nyquist frequency.
    loop = linearize_loop(eq_27(low))
    critical = loop.eigenvalues[0]
    assert abs(critical) == pytest.approx(1.0, abs=1e-6)
    hydraulic = linearize_plant().poles[-1]
    folded = abs(np.angle(np.exp(hydraulic * T)))
    assert abs(np.angle(critical)) == pytest.approx(folded, abs=0.05)


BOUNDARY_PER_S = 11_781.5


def test_the_phase_in_a_bode_plot_starts_below_90_deg():
    # L = g T²/2 (z + 1)/(z − 1)² z⁻ⁿ turns by −180° − (n + ½) ωT: the first angle is +179.9°.
    loop = delayed(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 50.0, 2)
    magnitude, phase = loop.plot()
    f, values = (part[:-1] for part in phase.lines[0].get_data())  # L is zero at Nyquist
    omega = 2.0 * math.pi * f
    assert values == pytest.approx(-180.0 - 2.5 * np.degrees(omega * T), abs=1e-3)
    assert f.max() == pytest.approx(250.0, rel=0.01)
    gain = 50.0 * T**2 / 4.0 * np.cos(0.5 * omega * T) / np.sin(0.5 * omega * T) ** 2
    assert magnitude.lines[0].get_ydata()[:-1] == pytest.approx(20.0 * np.log10(gain), abs=1e-3)


def test_a_bode_plot_leaves_out_the_margin_that_a_loop_has_not():
    # An integrator crosses |L| = 1; a lag with less gain than one does not. Both reach −180°.
    integrator = delayed(np.array([[0.0]]), np.array([[1.0 / T]]), 0.1, 0)
    small = delayed(np.array([[-500.0]]), np.array([[100.0]]), 0.5, 1)
    for loop, phase_margin, gain_margin in ((integrator, True, True), (small, False, True)):
        magnitude, phase = loop.plot()
        assert math.isfinite(loop.margins().phase_margin_deg) == phase_margin
        assert math.isfinite(loop.margins().gain_margin) == gain_margin
        shown = [line.get_label() for axis in (magnitude, phase) for line in axis.lines]
        assert any("crossover" in label for label in shown) == phase_margin
        assert any("phase margin" in label for label in shown) == phase_margin
        assert any("gain margin" in label for label in shown) == gain_margin


def test_can_delay_is_a_delay_of_the_loop(loops):
    f = np.array([0.3, 5.0, 90.0, 240.0])
    z = np.exp(2j * math.pi * f * T)
    for name, n in (("can_1", 1), ("can_2", 2)):
        expected = loops["smc"].loop_response(f) / z**n
        assert loops[name].loop_response(f) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ["smc", "pid_tuned", "difference"])
def test_sensitivities_are_those_of_the_closed_loop(loops, name):
    loop = loops[name]
    f = np.array([0.1, 1.0, 17.0, 130.0])
    s, t = loop.sensitivity(f), loop.complementary_sensitivity(f)
    assert s + t == pytest.approx(np.ones(4), abs=1e-12)
    assert loop.loop_response(f) == pytest.approx(frequency_response(loop, f), rel=1e-8)
    # det(zI − closed) = det(zI − open)(1 + L)
    z = np.exp(2j * math.pi * f * T)
    eye = np.eye(loop.monodromy.shape[0])
    ratio = [np.linalg.det(v * eye - loop.to_control().A) for v in z]
    ratio /= np.array([np.linalg.det(v * eye - loop.monodromy) for v in z])
    assert s == pytest.approx(ratio, rel=1e-6)


@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "can_2", "difference", "weight"])
def test_the_output_follows_a_slow_reference(loops, name):
    loop = loops[name]
    # P action alone lags by f/0.8 Hz; so does a slow rest under the weight, less than 1e-2.
    assert loop.output_response(1e-3)[0] == pytest.approx(1.0, abs=2e-2)
    f = np.array([0.05, 0.9, 30.0, 440.0])
    s = 2j * np.pi * f
    reference = np.array([np.ones_like(s), s, s**2, s**3])
    expected = np.einsum("fj,jf->f", loop.model.sine_response(f)[:, 0, :4], reference)
    assert loop.output_response(f) == pytest.approx(expected, rel=1e-9)


def test_the_output_may_be_another_port(loops):
    rod = linearize_loop(output="rod_extension")
    assert Matrices(rod).c == pytest.approx(np.array([[0.0, 1.0, 0.0, 0.0]]))
    f = np.array([0.5, 30.0])
    slope = 1.0 / Matrices(loops["smc"]).c[0, 1]
    assert rod.output_response(f) == pytest.approx(slope * loops["smc"].output_response(f))


@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "difference", "exact"])
def test_the_bandwidth_is_the_first_crossing(loops, name):
    loop = loops[name]
    bandwidth = loop.bandwidth_hz()
    threshold = math.sqrt(0.5) * abs(loop.output_response(0.01)[0])
    assert abs(loop.output_response(bandwidth)[0]) == pytest.approx(threshold, rel=1e-9)
    below = np.abs(loop.output_response(np.geomspace(1e-3, 0.9999 * bandwidth, 300)))
    assert below.min() > threshold


def test_the_bandwidth_does_not_depend_on_the_unit_of_the_output(loops):
    model = loops["smc"].model
    loud = dataclasses.replace(loops["smc"], model=dataclasses.replace(model, c=10.0 * model.c))
    assert loud.bandwidth_hz() == pytest.approx(loops["smc"].bandwidth_hz(), rel=1e-9)


@pytest.mark.parametrize("name", ["smc", "pid", "pid_tuned", "can_2", "difference"])
def test_the_bandwidth_of_the_complementary_sensitivity_is_that_of_python_control(loops, name):
    loop = loops[name]
    bandwidth = loop.complementary_sensitivity_bandwidth_hz()
    f = np.concatenate([[0.01], np.geomspace(0.02, bandwidth, 400)])
    opened = loop.to_control()(np.exp(2j * math.pi * f * T))
    gain = np.abs(opened / (1.0 + opened))
    assert gain[-1] == pytest.approx(gain[0] / math.sqrt(2.0), rel=1e-6)
    assert gain[:-1].min() > gain[0] / math.sqrt(2.0)


def test_the_feedforward_is_no_part_of_the_complementary_sensitivity(loops):
    smc = loops["smc"]
    angle_alone = [1.0, 0.0, 0.0, 0.0, 1.0]
    (tick,) = smc.model.ticks
    tick = dataclasses.replace(tick, jump_input=tick.jump_input * angle_alone)
    model = dataclasses.replace(smc.model, b=smc.model.b * angle_alone, ticks=(tick,))
    without = dataclasses.replace(smc, model=model)
    feedback = smc.complementary_sensitivity_bandwidth_hz()
    assert without.bandwidth_hz() < 0.6 * smc.bandwidth_hz()
    assert without.complementary_sensitivity_bandwidth_hz() == feedback


def test_a_loop_prints_its_margins_and_plots(loops):
    loop = loops["smc"]
    m, text = loop.margins(), str(loop)
    feedback = loop.complementary_sensitivity_bandwidth_hz()
    f_gain, f_phase, f_disk = (
        getattr(m, f"{name}_margin_frequency_hz") for name in ("gain", "phase", "disk")
    )
    assert text.splitlines() == [
        f"knee at 40 deg, T = 0.002 s: stable, largest eigenvalue {max(abs(loop.eigenvalues)):.6g}",
        f"  gain margin {m.gain_margin:.4g} at {f_gain:.4g} Hz",
        f"  phase margin {m.phase_margin_deg:.4g} deg at {f_phase:.4g} Hz, "
        f"delay margin {1e3 * m.delay_margin_s:.4g} ms",
        f"  disk margin {m.disk_margin:.4g} at {f_disk:.4g} Hz: "
        f"gain {m.disk_gain_margin:.4g}, phase {m.disk_phase_margin_deg:.4g} deg",
        f"  small-signal bandwidth {loop.bandwidth_hz():.4g} Hz, with feedforward",
        f"  complementary sensitivity bandwidth {feedback:.4g} Hz, feedback alone",
    ]
    magnitude, phase = loop.plot()
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in (magnitude, phase)]
    assert labels == [("", "loop magnitude (dB)"), ("frequency (Hz)", "phase (deg)")]
    lines = {line.get_label(): line.get_data() for ax in (phase, magnitude) for line in ax.lines}
    assert set(lines["Nyquist, 250 Hz"][0]) == {250.0}
    f, zero = lines[f"crossover {m.phase_margin_frequency_hz:.3g} Hz"]
    assert (*f, *zero) == pytest.approx((m.phase_margin_frequency_hz, 0.0))
    f, ends = lines[f"phase margin {m.phase_margin_deg:.3g}°"]
    assert f == pytest.approx([m.phase_margin_frequency_hz] * 2)
    assert ends == pytest.approx([-180.0, m.phase_margin_deg - 180.0], abs=0.01)
    assert {-180.0, -90.0} <= set(phase.get_yticks())
    for ax, level in ((magnitude, 0.0), (phase, -180.0)):
        assert [line for line in ax.lines if set(line.get_ydata()) == {level}]
    line = magnitude.lines[0]
    at_1_hz = np.interp(0.0, np.log10(line.get_xdata()), line.get_ydata())
    assert at_1_hz == pytest.approx(20.0 * math.log10(abs(loop.loop_response(1.0)[0])), abs=0.01)
    (margin,) = (line for line in magnitude.lines if line.get_label().startswith("gain margin"))
    f, ends = margin.get_data()
    assert f == pytest.approx([m.gain_margin_frequency_hz] * 2)
    assert 10.0 ** (-ends / 20.0) == pytest.approx([m.gain_margin, 1.0])
    assert f"({-ends[0]:.3g} dB)" in margin.get_label()


def test_the_phase_of_a_bode_plot_is_unwrapped_also_through_a_resonance(loops):
    loop = loops["exact"]  # its 447 Hz mode, folded to 53 Hz, turns the phase within 2 Hz
    _, phase = loop.plot()
    f, values = phase.lines[0].get_data()
    assert np.abs(np.diff(values)).max() < 30.0
    assert -270.0 <= values[0] < 90.0
    mode = np.abs(np.angle(loop.eigenvalues)) / (2.0 * math.pi * T)
    (mode,) = mode[np.abs(mode - 53.0) < 3.0][:1]
    turned = np.degrees(np.angle(loop.loop_response(f))) - values
    assert turned == pytest.approx(360.0 * np.round(turned / 360.0), abs=1e-6)
    plt.close(phase.figure)


def test_a_resonance_with_little_damping_is_a_circle_not_a_polygon():
    # x'' + 2 ζ ω x' + ω² x = ω² u with ω = 2π · 20 Hz and ζ = 2e-4: L turns by half a circle of
    # the diameter g/(2 ζ) within 0.02 Hz.
    w, zeta, gain = 2.0 * math.pi * 20.0, 2e-4, 1e-4
    a, b = np.array([[0.0, 1.0], [-(w**2), -2.0 * zeta * w]]), np.array([[0.0], [w**2]])
    loop = delayed(a, b, gain, 0)
    response = loop.loop_response(loop.frequency_grid())
    diameter = gain / (2.0 * zeta)
    assert np.abs(response).max() == pytest.approx(diameter, rel=0.05)
    # A chord of a circle drawn with 30 corners is a tenth of its diameter.
    assert np.abs(np.diff(response)).max() < 0.1 * diameter


@pytest.mark.slow
def test_a_loop_without_gain_has_plots_too():
    loop = linearize_loop(Scenario(controller=PidParameters(proportional_per_s=0.0)))
    for axes in (*loop.plot(), loop.plot_nyquist(), loop.plot_poles()):
        axes.figure.canvas.draw()
        plt.close(axes.figure)


def test_the_pole_plot_tells_unstable_eigenvalues(loops, unstable):
    for loop in (loops["smc"], unstable):
        axes = loop.plot_poles()
        marks = [line for line in axes.lines if line.get_label() in ("stable", "unstable")]
        drawn = np.concatenate([line.get_xdata() + 1j * line.get_ydata() for line in marks])
        assert distance(drawn, loop.eigenvalues) == 0.0
        outside = [line for line in marks if line.get_label() == "unstable"]
        assert bool(outside) is not loop.stable
        plt.close(axes.figure)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("real part of z", "imaginary part of z")
    # A line of damping ζ: z = e^{(−ζ + j√(1 − ζ²))ωT}.
    line = axes.lines[2]
    z = np.log(line.get_xdata()[1:] + 1j * line.get_ydata()[1:])
    assert -z.real / np.abs(z) == pytest.approx(np.full(z.size, 0.1), rel=1e-9)


def overflowing(diagram):
    """A diagram with the ports of another one, and an output ``overflow`` that is infinite."""
    builder, x, rest = DiagramBuilder(), Variable("x"), Variable("rest")
    inner = builder.AddNamedSystem("inner", diagram)
    for index in range(diagram.num_input_ports()):
        port = inner.get_input_port(index)
        builder.ExportInput(port, port.get_name())
    for index in range(diagram.num_output_ports()):
        port = inner.get_output_port(index)
        builder.ExportOutput(port, port.get_name())
    symbolic = SymbolicVectorSystem(  # without a state Drake refuses it in a continuous diagram
        state=[rest], input=[x], dynamics=[-rest], output=[exp(1e6 * x)]
    )
    system = builder.AddNamedSystem("overflow", symbolic)
    builder.Connect(inner.GetOutputPort("knee_angle"), system.get_input_port())
    builder.ExportOutput(system.get_output_port(), "overflow")
    return builder.Build()


def test_a_derivative_that_is_not_finite_is_no_linearization():
    plant = overflowing(make_plant())
    message = "overflow is not finite at this operating point: there is no linear model"
    with raises_one_line(LinearizationError, message):
        linearize_plant(plant, outputs=("knee_angle", "overflow"))


@pytest.mark.parametrize("frequency", [math.nan, math.inf, -math.inf])
def test_frequencies_must_be_finite(frequency):
    plant, loop = linearize_plant(), linearize_loop()
    for response in (plant.response, loop.loop_response, loop.output_response, loop.sensitivity):
        with raises_one_line(LinearizationError, f"frequency = {frequency:g} Hz: must be finite"):
            response([1.0, frequency])
    with raises_one_line(LinearizationError, f"frequency = {frequency:g} Hz: must be finite"):
        error_model().response(frequency)
