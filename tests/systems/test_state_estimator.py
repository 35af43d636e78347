import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagramc.testing import check_leaf
from kneexo.errors import ParameterError
from kneexo.parameters import ObserverParameters
from kneexo.systems import BackwardDifference, TrackingObserver

T, T_F = 0.002, 0.020  # Lee et al. 2020, Table 3; default of the observer
Z = math.exp(-T / T_F)
GAINS = np.array([1.0 - Z**3, 1.5 * (1.0 - Z**2) * (1.0 - Z) / T, (1.0 - Z) ** 3 / T**2])
PREDICT = np.array([[1.0, T, 0.5 * T**2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
INPUTS = {"measured_position": [(0.0, 0.15)]}
OBSERVER_STATE = [(0.0, 0.15), (-0.1, 0.1), (-1.0, 1.0)]

both = pytest.mark.parametrize("kind", [TrackingObserver, BackwardDifference])


def run(system, positions):
    """Feed measured positions one period after the other; return the estimates (n, 3)."""
    context = system.CreateDefaultContext()
    estimates = []
    for index, y in enumerate(positions):
        system.GetInputPort("measured_position").FixValue(context, y)
        if index == 0:  # at rest there
            context.SetDiscreteState(0, [y, *[0.0] * (context.get_discrete_state(0).size() - 1)])
        estimates.append(system.GetOutputPort("estimated_state").Eval(context).copy())
        update = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0)
        context.SetDiscreteState(0, update.CopyToVector())
    return np.array(estimates)


# ----------------------------------------------------------------------------- conversion


def test_conversions_of_the_observer_agree_and_keep_arguments_and_changes():
    system = TrackingObserver(ObserverParameters(time_constant_s=0.03), 0.005)
    check_leaf(system, INPUTS | {"discrete_state": OBSERVER_STATE})


def test_conversions_of_the_differences_agree_and_keep_arguments():
    state = {"discrete_state": [(0.0, 0.15), (-0.1, 0.1)]}
    check_leaf(BackwardDifference(0.005), INPUTS | state)


# ------------------------------------------------------------------- numbers: the observer


def test_observer_meets_the_written_out_equations(leaf):
    probe = leaf.Probe(TrackingObserver(), INPUTS, OBSERVER_STATE)
    for z in probe.points(20):
        y, predicted = z[1], z[2:5]
        corrected = predicted + GAINS * (y - predicted[0])
        expected = np.concatenate([corrected, PREDICT @ corrected])
        # Rounding: the gain on a is 9e2 … 2e2 1/s².
        np.testing.assert_allclose(probe.results(z), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("time_constant", [0.008, 0.020, 0.1])
def test_observer_has_its_three_poles_at_exp_of_minus_t_over_t_f(time_constant):
    system = TrackingObserver(ObserverParameters(time_constant_s=time_constant))
    context = system.CreateDefaultContext()
    system.GetInputPort("measured_position").FixValue(context, 0.0)
    columns = []
    for unit in np.eye(3):  # the update is linear and has no constant part
        context.SetDiscreteState(0, unit)
        update = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0)
        columns.append(update.CopyToVector())
    characteristic_polynomial = np.poly(np.transpose(columns))
    # A triple root is ill-conditioned, its polynomial is not: rounding of gains up to 1e4.
    np.testing.assert_allclose(
        characteristic_polynomial, np.poly([math.exp(-T / time_constant)] * 3), atol=1e-10
    )


def test_observer_follows_constant_acceleration_without_error():
    times = T * np.arange(600)  # 60 time constants; the poles leave exp(-60)·60²
    a = 0.8
    estimates = run(TrackingObserver(), 0.02 + 0.01 * times + 0.5 * a * times**2)
    exact = [0.02 + 0.01 * times[-1] + 0.5 * a * times[-1] ** 2, 0.01 + a * times[-1], a]
    # Rounding of the position, 1e-16 m, times the gains of up to 2.4e2 1/s², a few times.
    np.testing.assert_allclose(estimates[-1], exact, rtol=1e-10)


# ---------------------------------------------------------------- numbers: the differences


def test_differences_of_random_positions_are_the_written_out_ones():
    y = np.random.default_rng(2).uniform(0.0, 0.15, 12)
    v = np.r_[0.0, np.diff(y) / T]
    a = np.r_[0.0, np.diff(v) / T]
    # Rounding of y over T²: 1e-17 m / 4e-6 s².
    np.testing.assert_allclose(
        run(BackwardDifference(), y), np.transpose([y, v, a]), rtol=1e-9, atol=1e-9
    )


# ------------------------------------------------------------------------- initialization


@both
def test_initialize_puts_the_estimator_at_rest_at_the_measured_position(kind):
    system = kind()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("measured_position").FixValue(context, 0.123)
    simulator.Initialize()
    assert list(system.GetOutputPort("estimated_state").Eval(context)) == [0.123, 0.0, 0.0]
    simulator.AdvanceTo(0.1)  # and it stays there
    assert list(system.GetOutputPort("estimated_state").Eval(context)) == [0.123, 0.0, 0.0]


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize("sample_time", [0.0, -0.002, math.nan])
@both
def test_sample_time_out_of_range_is_refused_in_one_line(kind, sample_time):
    with pytest.raises(ParameterError, match="sample_time_s"):
        kind(sample_time_s=sample_time)


@both
def test_nan_measurement_shows_in_every_estimate(kind):
    system = kind()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("measured_position").FixValue(context, math.nan)
    simulator.AdvanceTo(0.01)
    assert np.isnan(system.GetOutputPort("estimated_state").Eval(context)).all()
