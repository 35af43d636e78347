"""Linear models: eigenvalues, poles, responses against python-control, updates, short texts."""

import math

import control
import numpy as np
import pytest
from pydrake.examples import VanDerPolOscillator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, LinearSystem, ZeroOrderHold

from diagramc import LinearizationError, ParameterError, linearize

A = np.array([[-0.5, 2.0, 0.0], [-2.0, -0.5, 0.1], [0.0, 0.3, -4.0]])
B, C, D = np.array([[0.0], [1.0], [0.5]]), np.array([[1.0, 0.0, 2.0]]), np.array([[0.3]])
FREQUENCIES_HZ = np.array([0.0, 0.2, 1.1, 6.0])


def linear(**arguments):
    return linearize(LinearSystem(A, B, C, D), inputs=["u0"], outputs=["y0"], **arguments)


@pytest.fixture
def held():
    """A hold every 0.1 s, from 0.04 s on, before the plant."""
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1, offset_sec=0.04))
    plant = builder.AddNamedSystem("plant", LinearSystem(A, B, C, D))
    builder.Connect(hold.get_output_port(), plant.get_input_port())
    builder.ExportInput(hold.get_input_port(), "motor.speed")
    builder.ExportOutput(plant.get_output_port(), "y")
    return builder.Build()


def test_a_continuous_model():
    model, system = linear(), control.ss(A, B, C, D)
    assert model.period_s is None
    assert model.ticks == ()
    assert (np.diff(model.eigenvalues.real) <= 0.0).all()
    assert sorted(model.poles(), key=str) == sorted(model.eigenvalues, key=str)
    assert np.sort_complex(model.poles()) == pytest.approx(np.sort_complex(system.poles()))
    assert np.sort_complex(model.zeros()) == pytest.approx(np.sort_complex(system.zeros()))
    response = model.frequency_response(FREQUENCIES_HZ)
    assert response.shape == (4, 1, 1)
    assert response[:, 0, 0] == pytest.approx(system(2j * np.pi * FREQUENCIES_HZ), rel=1e-12)
    assert model.stable


def test_a_period_discretizes_exactly():
    model, system = linear(period_s=0.2), control.ss(A, B, C, D).sample(0.2)
    for name in "abcd":
        expected = getattr(system, name.upper())
        np.testing.assert_allclose(getattr(model, name), expected, rtol=1e-12, atol=1e-13)
    # The eigenvalues e^{λT} of a discretized model have the poles λ.
    assert np.sort_complex(model.poles()) == pytest.approx(np.sort_complex(linear().poles()))
    z = np.exp(2j * np.pi * 0.2 * FREQUENCIES_HZ)
    assert model.frequency_response(FREQUENCIES_HZ)[:, 0, 0] == pytest.approx(system(z), rel=1e-10)
    assert (np.diff(np.abs(model.eigenvalues)) <= 0.0).all()


def test_an_offset_delays_the_input_within_the_period(held):
    model = linearize(held, inputs=["motor.speed"], outputs=["y"])
    before, after = control.ss(A, B, C, D).sample(0.04), control.ss(A, B, C, D).sample(0.06)
    np.testing.assert_allclose(model.a[:3, :3], after.A @ before.A, rtol=1e-12)
    np.testing.assert_allclose(model.a[:3, 3:], after.A @ before.B, rtol=1e-12)
    np.testing.assert_allclose(model.b, np.vstack([after.B, [[1.0]]]), rtol=1e-12)
    assert [tick.time_s for tick in model.ticks] == [0.0, 0.04]
    assert sum(tick.duration_s for tick in model.ticks) == pytest.approx(0.1, rel=1e-15)
    assert model.poles().size == 3  # none for the hold, whose eigenvalue is 0


def test_outputs_after_the_updates_see_the_new_value():
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1))
    gain = builder.AddNamedSystem("gain", Gain(3.0, 1))
    builder.Connect(hold.get_output_port(), gain.get_input_port())
    builder.ExportInput(hold.get_input_port(), "u")
    builder.ExportOutput(gain.get_output_port(), "y")
    model = linearize(builder.Build(), inputs=["u"], outputs=["y"])
    assert (model.c[0, 0], model.d[0, 0]) == (3.0, 0.0)
    later = model.after_updates()
    assert (later.c[0, 0], later.d[0, 0]) == (0.0, 3.0)
    assert later.a is model.a


def test_a_prescribed_motion_takes_the_force_of_its_equation():
    """The force u of a sine, by hand: m dv/dt = −k x − b v + z + u, dz/dt = −z/τ + v."""
    mass, spring, damper, lag = 2.0, 30.0, 0.7, 0.4
    a = [[0, 1, 0], [-spring / mass, -damper / mass, 1 / mass], [0, 1, -1 / lag]]
    system = LinearSystem(a, [[0], [1 / mass], [0]], [[0, 0, 1]], [[0]])
    s = 2j * np.pi * FREQUENCIES_HZ[1:]
    z = 1.0 / (s + 1.0 / lag)  # for v = 1
    force = mass * s + spring / s + damper - z
    for period_s in (None, 0.05):
        model = linearize(system, inputs=["u0"], outputs=["y0"], period_s=period_s)
        moved = model.prescribed(model.state_names[:2])
        assert moved.state_names == model.state_names[2:]
        assert moved.input_names == ("u0", *model.state_names[:2])
        assert moved.output_names == ("y0", *(f"rate of {x}" for x in model.state_names[:2]))
        pole = -1.0 / lag if period_s is None else np.exp(-period_s / lag)
        assert moved.eigenvalues == pytest.approx([pole], rel=1e-12)
        response = moved.sine_response(FREQUENCIES_HZ[1:])
        assert response[:, 0, 2] == pytest.approx(z, rel=1e-10)
        rate = response[:, 2, 1] / s + response[:, 2, 2]  # of v, from x and v
        assert (s - rate) / response[:, 2, 0] == pytest.approx(force, rel=1e-10)
        # The rate of x is v, and it does not depend on anything else.
        assert response[:, 1] == pytest.approx(np.tile([0.0, 0.0, 1.0], (3, 1)), abs=1e-14)


def test_only_continuous_states_can_be_prescribed(held):
    model = linearize(held, inputs=["motor.speed"], outputs=["y"])
    names = model.state_names
    moved = model.prescribed(names[1:2])
    assert moved.a.shape == (3, 3)
    for wrong in ("hold.x[9]", names[-1]):
        with pytest.raises(ParameterError, match=r"\Astates: .* is no continuous state; .*hold"):
            model.prescribed([wrong])
    with pytest.raises(ParameterError, match=r"\Astates = .*: names a state twice\Z"):
        model.prescribed([names[0], names[0]])


def test_python_control_has_the_names(held):
    system = linearize(held, inputs=["motor.speed"], outputs=["y", "hold:y"]).to_control()
    assert system.input_labels == ["motor_speed"]
    assert system.output_labels == ["y", "hold:y"]
    assert system.state_labels == ["plant.x[0]", "plant.x[1]", "plant.x[2]", "hold.0[0]"]
    assert system.dt == 0.1
    assert linear().to_control().dt == 0


def test_stability_is_that_of_the_eigenvalues():
    for pole, stable in ((-0.1, True), (0.0, False), (0.1, False)):
        plant = LinearSystem([[pole]], [[1.0]], [[1.0]], [[0.0]])
        for period_s in (None, 0.5):
            model = linearize(plant, inputs=["u0"], outputs=["y0"], period_s=period_s)
            assert model.stable is stable
    gain = linearize(Gain(2.0, 1), inputs=["u0"], outputs=["y0"])
    assert gain.stable
    assert gain.frequency_response([1.0])[0, 0, 0] == 2.0


def test_texts_are_one_short_line(held):
    model = linearize(held, inputs=["motor.speed"], outputs=["y"])
    expected = "LinearModel(period_s=0.1, 4 states, inputs: motor.speed, outputs: y)"
    assert repr(model) == expected
    assert repr(linear()) == "LinearModel(continuous, 3 states, inputs: u0, outputs: y0)"
    assert repr(model.ticks[1]) == "TickModel(time_s=0.04, duration_s=0.06)"
    point = repr(model.operating_point)
    assert point == "OperatingPoint(time_s=0, 4 states, 1 inputs, 1 outputs)"


def test_what_a_model_lacks_is_one_line():
    model = linear()
    with pytest.raises(LinearizationError, match=r"\Aa continuous model has no updates\Z"):
        model.after_updates()
    autonomous = linearize(VanDerPolOscillator(), inputs=[], outputs=["y0"])
    assert autonomous.frequency_response([1.0]).shape == (1, 1, 0)
    for response in (model.frequency_response, linear(period_s=0.1).sine_response):
        with pytest.raises(
            LinearizationError, match=r"\Afrequency = nan Hz: must be finite, and at "
        ):
            response([1.0, math.nan])
    integrator = LinearSystem([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    for period_s in (None, 0.5):
        pole = linearize(integrator, inputs=["u0"], outputs=["y0"], period_s=period_s)
        for response in (pole.frequency_response, pole.sine_response):
            with pytest.raises(LinearizationError, match=r"\Afrequency = 0 Hz: is a pole [^\n]*\Z"):
                response([1.0, 0.0, 0.3])


@pytest.mark.parametrize("period_s", [None, 0.01])
@pytest.mark.parametrize("pole", [-1e-14, 0.0, 1e-14])
def test_rounding_does_not_decide_whether_a_free_mode_is_stable(pole, period_s):
    plant = LinearSystem([[-10.0, 0.0], [1.0, pole]], np.eye(2, 1), np.eye(2), np.zeros((2, 1)))
    model = linearize(plant, inputs=["u0"], outputs=["y0"], period_s=period_s)
    assert not model.stable


def test_a_slow_mode_is_stable():
    plant = LinearSystem(np.diag([-1e4, -1e-6]), np.eye(2, 1), np.eye(2), np.zeros((2, 1)))
    assert linearize(plant, inputs=["u0"], outputs=["y0"]).stable


def test_a_frequency_beyond_the_accuracy_of_its_phase_is_refused():
    model = linear(period_s=0.1)
    for response in (model.frequency_response, model.sine_response):
        assert np.isfinite(response([0.9e10])).all()
        for frequency in (1.1e10, 1e300):
            with pytest.raises(LinearizationError, match=r"must be finite, and at most 1e\+10 Hz"):
                response([1.0, frequency])
        with pytest.raises(ParameterError, match="frequencies_hz = 'a': must be numbers in Hz"):
            response("a")
    assert np.isfinite(linear().frequency_response([1e300])).all()
    with pytest.raises(LinearizationError, match=r"must be finite, and at most 1e\+300 Hz"):
        linear().frequency_response([1e308])
