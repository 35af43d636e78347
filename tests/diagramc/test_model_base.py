"""Checks, initialization and errors of a compiled model."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagramc import InputTable, State
from diagramc.errors import ParameterError, SimulationError, StiffnessError
from diagramc.native.arguments import OK, OUTPUT_NOT_FINITE, OUTSIDE, TOO_ROUGH


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_parameter_that_is_not_finite_is_refused(servo, value):
    model, parameters, state = servo
    bad = parameters.copy()
    bad[model.parameter_names.index("arm.mass_kg")] = value
    for call in (model.simulate, lambda *a: model.initialized(*a[:2])):
        with pytest.raises(ParameterError, match=rf"arm\.mass_kg = {value}: must be finite"):
            call(bad, state, 0.1)


@pytest.mark.parametrize("integrator", ["exact_hold", "rk4"])
def test_a_state_that_is_not_finite_ends_the_run(servo, integrator):
    model, parameters, state = servo
    bad = State(state.continuous * np.array([np.nan, 1.0, 1.0, 1.0]), state.discrete)
    with pytest.raises(SimulationError, match=r"arm\.x\[0\] is not finite"):
        model.simulate(parameters, bad, 0.1, integrator=integrator)


def test_a_run_that_fails_at_its_start_fails_with_any_records(servo):
    model, parameters, state = servo
    out = State(state.continuous + np.array([0.0, 1.0, 0.0, 0.0]), state.discrete)
    for options in ({}, {"record_times_s": [0.0, 0.05]}, {"record_times_s": []}):
        with pytest.raises(SimulationError, match=r"^t = 0 s: arm: position = 1 m$"):
            model.simulate(parameters, out, 0.1, **options)


def test_arrays_of_another_shape_are_refused(servo):
    model, parameters, state = servo
    short = State(state.continuous[1:], state.discrete)
    with pytest.raises(ValueError, match=r"state.continuous has the shape \(3,\): must be \(4,\)"):
        model.initialized(parameters, short)
    table = InputTable(np.array([1.0]))  # two segments, but coefficients for one
    with pytest.raises(ValueError, match=r"inputs\.coefficients has the shape"):
        model.initialized(parameters, state, table)
    for call in (model.constants, lambda rows: model.simulate(rows, state, 0.01)):
        with pytest.raises(ValueError, match="parameters has the shape"):
            call(parameters[1:])


def test_initialization_runs_no_periodic_update_and_copies(servo):
    model, parameters, _ = servo
    before = State(np.arange(4.0) / 100.0, np.array([7.0]))
    after = model.initialized(parameters, before)
    np.testing.assert_array_equal(after.continuous, np.arange(4.0) / 100.0)
    np.testing.assert_array_equal(after.discrete, [7.0])
    after.discrete[0] = after.continuous[0] = 9.0
    assert (before.discrete[0], before.continuous[0]) == (7.0, 0.0)


def test_each_outcome_has_its_error(servo):
    model, parameters, state = servo
    runner = stable_runner(2e-3)
    text = str(model.fault((OUTPUT_NOT_FINITE, 5, 0), runner, parameters, state))
    assert text.startswith(f"t = 0.01 s: {next(iter(model.outputs))} is not finite")
    bad = State(state.continuous, np.array([np.nan]))
    text = str(model.fault((OUTPUT_NOT_FINITE, 5, 0), runner, parameters, bad))
    assert text.startswith(f"t = 0.01 s: {model.discrete_names[0]} is not finite")
    error = model.fault((TOO_ROUGH, 0, 0), runner, parameters, state)
    assert isinstance(error, StiffnessError)
    assert str(error).endswith("use rk4")
    error = model.fault((TOO_ROUGH, 0, 1), runner, parameters, state)
    assert isinstance(error, StiffnessError)
    assert "a mode is faster than 1e+13 1/s" in str(error)
    assert model.fault((OK, 5, 0), runner, parameters, state) is None
    # The leaf itself has nothing against this state.
    error = model.fault((OUTSIDE, 1, 0), runner, parameters, state)
    assert str(error) == "t = 0.002 s: arm left its limits"


def stable_runner(tick_s):
    """A runner without unstable steps, whose ticks have equal lengths."""
    timing = SimpleNamespace(times=lambda tick: tick * tick_s)
    return SimpleNamespace(timing=timing, unstable_step=lambda lane: None)
