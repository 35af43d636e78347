"""Responses to a continuous sine: closed forms, and simulated sinestreams of small amplitude."""

import math

import control
import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Gain, LinearSystem, ZeroOrderHold
from pydrake.trajectories import PiecewisePolynomial

from diagramc import compile_diagram, input_table, linearize

AMPLITUDE = 1e-4
SAMPLES_PER_S = 64 * 256
CASES = (
    ("mixed", 14, 32),
    ("continuous", 0, 8),
    ("sampled", 2, 32),
    ("mixed", 18, 32),
    ("multirate", 3, 32),
    ("multirate", 5, 32),
)
"""Kind and seed of random diagrams, and the periods of the window. All loops are stable."""


def sampled_loop(period_s, gain):
    """A plant 3/(s² + 0.8 s + 4) with a hold behind the gain of its error."""
    builder = DiagramBuilder()
    matrices = [[0.0, 1.0], [-4.0, -0.8]], [[0.0], [3.0]], [[1.0, 0.0]], [[0.0]]
    plant = builder.AddNamedSystem("plant", LinearSystem(*matrices))
    back = builder.AddNamedSystem("back", Gain(-1.0, 1))
    error = builder.AddNamedSystem("error", Adder(2, 1))
    law = builder.AddNamedSystem("law", Gain(gain, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(period_s, 1))
    builder.ExportInput(error.get_input_port(0), "r")
    builder.Connect(plant.get_output_port(), back.get_input_port())
    builder.Connect(back.get_output_port(), error.get_input_port(1))
    builder.Connect(error.get_output_port(), law.get_input_port())
    builder.Connect(law.get_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), plant.get_input_port())
    builder.ExportOutput(plant.get_output_port(), "y")
    return builder.Build(), control.ss(*matrices)


def test_a_sampled_loop_between_samples_in_closed_form():
    period_s, gain = 0.2, 1.7
    diagram, plant = sampled_loop(period_s, gain)
    model = linearize(diagram, inputs=["r"], outputs=["y", "hold:y"])
    frequencies = np.array([0.1, 0.7, 1.9, 3.3, 7.1])  # Nyquist is at 2.5 Hz
    s = 2j * np.pi * frequencies
    # The error is sampled: e = r − G_d(z) K e. The hold makes (1 − e^{−sT})/(sT) of its samples.
    discrete = control.sample_system(plant, period_s)
    samples = gain / (1.0 + gain * np.array([discrete(z) for z in np.exp(s * period_s)]))
    held = samples * (1.0 - np.exp(-s * period_s)) / (s * period_s)
    expected = np.array([[plant(value) * h, h] for value, h in zip(s, held, strict=True)])
    response = model.sine_response(frequencies)
    assert response.shape == (5, 2, 1)
    np.testing.assert_allclose(response[:, :, 0], expected, rtol=1e-10)


def test_of_a_continuous_model_both_responses_are_the_same():
    _, plant = sampled_loop(0.1, 1.0)
    system = LinearSystem(plant.A, plant.B, plant.C, plant.D)
    model = linearize(system, inputs=["u0"], outputs=["y0"])
    frequencies = np.array([0.0, 0.3, 2.0])
    expected = [plant(2j * math.pi * f) for f in frequencies]
    for response in (model.sine_response, model.frequency_response):
        np.testing.assert_allclose(response(frequencies)[:, 0, 0], expected, rtol=1e-12)


def sinestream(random, context, model, periods):
    """Component of each output at the frequency, per amplitude of the first input.

    The last window of ``periods`` periods of the model has a whole number of periods of the sine.
    """
    compiled = compile_diagram(random.diagram, inputs=random.inputs)
    window = periods * (model.period_s or 0.25)
    frequency_hz = 3.0 / window
    slowest = model.eigenvalues[0]
    decay = -slowest.real * window if model.period_s is None else -periods * math.log(abs(slowest))
    end = window * (math.ceil(math.log(1e6) / decay) + 1)
    times = np.linspace(0.0, end, round(end / window) * 3 * 200 + 1)
    angle = 2.0 * np.pi * frequency_hz * times
    nominal = [random.diagram.GetInputPort(name).Eval(context)[0] for name in random.inputs]
    values = np.tile(np.array(nominal)[:, None], times.size)
    rates = np.zeros_like(values)
    values[0] += AMPLITUDE * np.sin(angle)
    rates[0] = 2.0 * np.pi * frequency_hz * AMPLITUDE * np.cos(angle)
    run = compiled.simulate(
        compiled.parameters(context),
        compiled.state(context),
        end,
        outputs=random.outputs,
        record_period_s=1.0 / SAMPLES_PER_S,
        integrator="rk4",
        inputs=input_table(PiecewisePolynomial.CubicHermite(times, values, rates)),
    )
    count = round(window * SAMPLES_PER_S)
    turn = np.exp(-2j * np.pi * frequency_hz * run.time_s[-count:])
    signals = np.array([run[name][-count:, 0] for name in random.outputs])
    return frequency_hz, 2j / AMPLITUDE * (signals * turn).mean(axis=1)


def assert_equals_sinestream(random, periods):
    """Magnitude to 0.1 %, phase to 0.1°.

    The records are the values before the updates, so the phase of a held output lags by half of a
    record period, 0.03° at 3 Hz.
    """
    context = random.at_rest()
    model = linearize(random.diagram, context, inputs=random.inputs, outputs=random.outputs)
    assert model.stable
    frequency_hz, measured = sinestream(random, context, model, periods)
    response = model.sine_response(frequency_hz)[0, :, 0]
    reached = np.abs(response) > 1e-6
    assert reached.sum() > 1
    ratio = measured[reached] / response[reached]
    np.testing.assert_allclose(np.abs(ratio), 1.0, atol=1e-3)
    np.testing.assert_allclose(np.degrees(np.angle(ratio)), 0.0, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed", "periods"), CASES)
def test_a_simulated_sinestream_has_the_response(random_diagram, kind, seed, periods):
    assert_equals_sinestream(random_diagram(seed, kind), periods)
