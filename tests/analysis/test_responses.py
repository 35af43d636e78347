"""Linear model, Bode response and step of a scenario, by their short names."""

import math

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis import linearize_loop, responses, track
from kneexo.analysis.responses import bode, linearize, step
from kneexo.errors import LinearizationError, ParameterError
from kneexo.parameters import PidParameters, Scenario, SlidingModeParameters, StepReference

LOW = Scenario().changed({"reference": {"mean_deg": 25.0, "amplitude_deg": 5.0}})
UNSTABLE = Scenario(controller=SlidingModeParameters(lambda_per_s=400.0))


@pytest.fixture(scope="module")
def response():
    return bode(Scenario(), [0.1, 1.0, 10.0])


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "my.yaml"
    path.write_text("reference: {mean_deg: 25, amplitude_deg: 5}\n", encoding="utf-8")
    return path


def test_a_loop_is_linearized_in_the_middle_of_its_reference(file):
    middle = linearize(LOW)
    assert middle.knee_angle_rad == pytest.approx(np.radians(25.0), abs=1e-3)
    np.testing.assert_array_equal(linearize(str(file)).eigenvalues, middle.eigenvalues)
    there = linearize(LOW, knee_angle_deg=60.0)
    assert there.knee_angle_rad == pytest.approx(np.radians(60.0), abs=1e-3)


def test_the_feedback_alone_is_that_of_python_control(response):
    loop = response.loop.to_control()
    closed = control.ss(loop.A - loop.B @ loop.C, loop.B, loop.C, loop.D, loop.dt)
    expected = closed(np.exp(2j * np.pi * response.frequencies_hz * response.loop.sample_time_s))
    np.testing.assert_allclose(response.complementary_sensitivity, expected, rtol=1e-6)


def test_the_response_is_the_feedback_alone_without_feedforward(response):
    pid = bode(Scenario(controller=PidParameters()), [0.1, 1.0, 3.0])
    # They differ by the images of the sampled knee angle, 250 Hz away.
    np.testing.assert_allclose(pid.response, pid.complementary_sensitivity, rtol=1e-3)
    feedforward = np.abs(response.response - response.complementary_sensitivity)
    assert np.all(feedforward > [0.05, 0.5, 0.5])


def test_gain_phase_and_frame(response):
    np.testing.assert_allclose(
        response.gain * np.exp(1j * np.radians(response.phase_deg)), response.response
    )
    assert response.bandwidth_hz == linearize_loop().bandwidth_hz()
    frame = response.to_dataframe()
    assert list(frame.index) == [0.1, 1.0, 10.0]
    np.testing.assert_array_equal(frame["gain"], response.gain)
    turn = np.exp(1j * np.radians(frame["complementary_sensitivity_phase_deg"]))
    feedback = frame["complementary_sensitivity_gain"] * turn
    np.testing.assert_allclose(feedback, response.complementary_sensitivity)


def test_the_text_has_the_loop_and_the_largest_gain(response):
    assert np.argmax(response.gain) == 1
    last = f"  largest gain {response.gain[1]:.4g} at 1 Hz"
    assert str(response) == f"{linearize_loop()}\n{last}"


def test_the_plot_shows_both_responses_and_the_bandwidth(file):
    response = bode(file)
    assert response.frequencies_hz[[0, -1]] == pytest.approx([0.02, 250.0])
    magnitude, phase = response.plot()
    whole, feedback, threshold, bandwidth = magnitude.lines
    np.testing.assert_array_equal(whole.get_xdata(), response.frequencies_hz)
    assert threshold.get_ydata()[0] == pytest.approx(-3.0, abs=0.02)
    np.testing.assert_allclose(10.0 ** (whole.get_ydata() / 20.0), response.gain)
    np.testing.assert_allclose(
        10.0 ** (feedback.get_ydata() / 20.0), np.abs(response.complementary_sensitivity)
    )
    assert bandwidth.get_xdata()[0] == response.bandwidth_hz
    np.testing.assert_array_equal(phase.lines[0].get_ydata(), response.phase_deg)
    _, axes = plt.subplots(2)
    assert response.plot(axes) is axes


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: bode(UNSTABLE), "is unstable .* it has no frequency response; reduce the gain"),
        (lambda: bode(frequencies_hz=[1.0, 0.0]), "^frequency = 0 Hz: must be > 0$"),
    ],
)
def test_a_response_that_does_not_exist_is_refused(call, message):
    with pytest.raises(LinearizationError, match=message):
        call()


def test_a_step_is_a_run_with_a_step_as_reference(file):
    result = step(file, size_deg=-2.0, duration_s=0.5)
    reference = StepReference(start_deg=25.0, end_deg=23.0, time_s=0.1)
    expected = track(LOW.changed({"reference": reference, "simulation.duration_s": 0.5}))
    assert result.scenario == expected.scenario
    assert result.metrics == expected.metrics
    angle_deg = np.degrees(result.run["knee_angle_rad"])
    before = result.run.time_s < 0.1
    np.testing.assert_allclose(angle_deg[before], 25.0, atol=0.02)
    assert angle_deg[-1] == pytest.approx(23.0, abs=0.1)
    crossing_s = result.run.time_s[np.argmax(angle_deg < 25.0 - 0.9 * 2.0)] - 0.1
    assert 0.5 * crossing_s < result.step.rise_time_s < crossing_s


def test_a_step_starts_at_rest_where_it_is_asked_to():
    away = Scenario().changed({"initial_offset_m": 0.01})
    result = step(away, size_deg=3.0, start_deg=50.0, duration_s=0.2)
    assert np.degrees(result.run["knee_angle_rad"][0]) == pytest.approx(50.0, abs=0.02)
    assert np.degrees(result.run["knee_reference_rad"][-1]) == pytest.approx(53.0)


def integrating(rod_extension, rod_reference, state, gain=5e4):
    """A law whose integral starts at its initial state."""
    error = rod_reference[0] - rod_extension
    return gain * error + state[0], [state[0] + 20.0 * error]


def test_a_law_takes_the_place_of_the_scenarios(monkeypatch):
    law = {"law": integrating, "initial_state": [2.0]}
    expected = Scenario().with_law(integrating, initial_state=[2.0])
    eigenvalues = linearize(expected).eigenvalues
    np.testing.assert_array_equal(linearize(**law).eigenvalues, eigenvalues)
    response = bode(frequencies_hz=[1.0], **law)
    np.testing.assert_array_equal(response.response, bode(expected, [1.0]).response)
    assert response.response != bode(frequencies_hz=[1.0]).response
    monkeypatch.setattr(responses, "track", lambda scenario: scenario)  # nothing to compile
    assert step(**law).controller == expected.controller


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size_deg": 60.0}, r"^start_deg \+ size_deg = 100 deg is out of range: must be >= 0 and"),
        ({"size_deg": math.nan}, r"^start_deg \+ size_deg = nan deg is out of range"),
        ({"size_deg": -5.0, "start_deg": 90.5}, "^start_deg = 90.5 deg is out of range"),
        ({"size_deg": 0.0}, "^size_deg = 0 deg: must not be 0$"),
        ({"duration_s": 0.1}, "^duration_s = 0.1 s: must be > 0.1 s, the time of the step$"),
        ({"duration_s": 1e6}, "simulation.duration_s = 1e.06 s is out of range"),
    ],
)
def test_a_step_that_is_none_or_leaves_the_range_is_refused(arguments, message):
    with pytest.raises(ParameterError, match=message):
        step(**arguments)
