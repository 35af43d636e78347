"""Sensitivities by AutoDiff against differences of the numbers that they belong to.

The differences know nothing of AutoDiff in the values: they run the whole analysis of changed
scenarios and extrapolate to a step of zero (Ridders). What they cannot tell to 1e-6 is no oracle.
"""

import math
from functools import reduce

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.sensitivity import (
    differentiable,
    loop_sensitivities,
    tracking_sensitivities,
)
from kneexo.errors import LinearizationError, ParameterError, SimulationError
from kneexo.parameters import UNCERTAIN_KNEE, UNCERTAINTY, Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import simulate_compiled
from kneexo.studies.paper import PID_TUNED

PATHS = tuple(path for path in UNCERTAINTY.values if differentiable(UNCERTAIN_KNEE, path))

# Every value matters here: leaking, damped, loaded, off its mounting.
LEAKY = changed(
    UNCERTAIN_KNEE,
    {
        "plant.pump.internal_leakage_m3_per_s_pa": 2e-12,
        "plant.cylinder.damping_n_s_per_m": 400.0,
        "plant.cylinder.bulk_modulus_pa": 1e9,
        "plant.load.knee_torque_n_m": 4.0,
        "encoder.mounting_error_rad": 1e-3,
    },
)
STEPS = {
    "plant.cylinder.mass_kg": 0.3,
    "plant.cylinder.bulk_modulus_pa": 2e8,
    "plant.pump.internal_leakage_m3_per_s_pa": 4e-13,
    "plant.cylinder.damping_n_s_per_m": 80.0,
    "plant.cylinder.bore_m": 2e-4,
    "plant.load.segment_mass_kg": 0.4,
    "plant.load.knee_torque_n_m": 0.5,
    "plant.pump.lag_s": 1e-3,
    "encoder.mounting_error_rad": 1e-3,
}
"""Where the extrapolation starts."""


def at(scenario, path, value):
    """The scenario with another value, whose controller keeps its beliefs."""
    return changed(scenario.model_copy(update={"nominal": scenario.believed_plant}), {path: value})


def ridders(function, step, rows=5):
    """Derivative at 0 of a function that returns arrays, and its error, by extrapolation."""
    steps = step / 1.6 ** np.arange(rows)
    table = np.array([(function(h) - function(-h)) / (2.0 * h) for h in steps])
    best, error = table[0], np.full_like(table[0], math.inf)
    factor = 1.6**2
    for _ in range(1, rows):
        finer = table[1:] + (table[1:] - table[:-1]) / (factor - 1.0)
        changes = np.maximum(abs(finer - table[1:]), abs(finer - table[:-1]))
        for value, change in zip(finer, changes, strict=True):
            best, error = np.where(change < error, value, best), np.minimum(change, error)
        table, factor = finer, factor * 1.6**2
    return best, error


def value_of(scenario, path):
    return reduce(getattr, path.split("."), scenario)


def test_the_oracle_is_one():
    slopes, error = ridders(lambda h: np.array([math.sin(1.0 + h), math.exp(3.0 * h)]), 0.3)
    assert slopes == pytest.approx([math.cos(1.0), 3.0], rel=1e-9)
    assert (error < 1e-6).all()


# ---------------------------------------------------------------------------------- margins

FULL_ORDER = {
    "plant.full_order": {"coulomb_friction_n": 40.0},
    "plant.load.knee_torque_n_m": -4.0,
}
LOOPS = {
    "smc": LEAKY,
    "can_2": changed(LEAKY, {"bus.latency_samples": 2}),
    "difference": changed(
        LEAKY, {"estimator": {"kind": "difference"}, "plant.cylinder.bulk_modulus_pa": 1.72e9}
    ),
    "pid": changed(LEAKY, {"controller": PID_TUNED.model_dump()}),
    "full_order": changed(LEAKY, FULL_ORDER),
}


def loop_metrics(scenario, names):
    loop = linearize_loop(scenario, knee_angle_deg=0.5 * sum(scenario.reference.range_deg))
    margins = loop.margins()
    return np.array([abs(loop.eigenvalues[0]), *(getattr(margins, name) for name in names[1:])])


@pytest.mark.parametrize(
    "name", [n if n == "smc" else pytest.param(n, marks=pytest.mark.slow) for n in LOOPS]
)
def test_margins_and_largest_eigenvalue_against_differences(name):
    scenario = LOOPS[name]
    sensitivities = loop_sensitivities(scenario, list(STEPS))
    names = list(sensitivities.metrics)
    assert names[0] == "largest_eigenvalue"
    assert {"gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin"} == set(names[1:])
    assert [*sensitivities.metrics.values()] == pytest.approx(
        loop_metrics(scenario, names), rel=1e-12
    )
    checked = 0
    for path, step in STEPS.items():
        start = value_of(scenario, path)
        expected, error = ridders(
            lambda h, p=path, x=start: loop_metrics(at(scenario, p, x + h), names), step
        )
        ours = np.array([sensitivities.of(figure)[path] for figure in names])
        known = error < 1e-6 * np.abs(expected)
        checked += np.count_nonzero(known)
        assert ours[known] == pytest.approx(expected[known], rel=1e-5), path
        # Elsewhere the influence is too small for differences: within what they know.
        assert (np.abs(ours - expected)[~known] <= 10.0 * error[~known] + 1e-12).all(), path
    assert checked >= 0.75 * len(STEPS) * len(names)


def test_the_acceleration_limit_has_no_influence_on_a_loop_at_rest():
    path = "plant.pump.acceleration_limit_rad_s2"
    sensitivities = loop_sensitivities(UNCERTAIN_KNEE, [path])
    assert all(sensitivities.of(metric) == {path: 0.0} for metric in sensitivities.metrics)


def test_an_unstable_loop_has_the_gradient_of_its_eigenvalue_alone():
    # Without quantizer and estimator k/Φ = 1.3e4 1/s is beyond the boundary of stability.
    unstable = Scenario(estimator={"kind": "exact"}, controller={"phi_m_s2": 24.4})
    path = "plant.pump.lag_s"
    sensitivities = loop_sensitivities(unstable, [path])
    assert list(sensitivities.metrics) == ["largest_eigenvalue"]
    assert sensitivities.metrics["largest_eigenvalue"] > 1.0
    slope = approx_fprime(
        [0.01],
        lambda x: abs(linearize_loop(at(unstable, path, float(x[0]))).eigenvalues[0]),
        1e-7,
    )
    assert sensitivities.of("largest_eigenvalue")[path] == pytest.approx(slope[0], rel=1e-4)


def test_the_posture_is_the_middle_of_the_reference():
    path, motions = "plant.pump.lag_s", ((40.0, 30.0), (40.0, 10.0), (60.0, 10.0))
    gradients = [
        loop_sensitivities(
            changed(LEAKY, {"reference.mean_deg": mean, "reference.amplitude_deg": amplitude}),
            [path],
        ).of("disk_margin")
        for mean, amplitude in motions
    ]
    assert gradients[0] == gradients[1] != gradients[2]


# --------------------------------------------------------------------------------- tracking

SHORT = {
    "reference": {
        "kind": "sine",
        "mean_deg": 40.0,
        "amplitude_deg": 2.0,
        "frequency_hz": 1.0,
        "ramp_s": 0.1,
    },
    "simulation": {"duration_s": 0.1, "integrator": "runge_kutta3", "step_s": 5e-4},
}


def rms_error_deg(scenario):
    unquantized = changed(scenario, {"encoder.quantized": False})
    run = simulate_compiled(
        unquantized,
        signals=("knee_reference", "knee_angle"),
        integrator="runge_kutta3",
        step_s=scenario.simulation.step_s,
    )
    error = np.degrees(run["knee_reference_rad"] - run["knee_angle_rad"])
    period = 1.0 / scenario.reference.frequency_hz
    settled = run.time_s >= period - 1e-9
    return math.sqrt(np.mean(error[settled if settled.sum() > 1 else slice(None)] ** 2))


def assert_tracking(scenario, steps, rows, **options):
    sensitivities = tracking_sensitivities(scenario, list(steps), **options)
    assert sensitivities.metrics["rms_error_deg"] == pytest.approx(
        rms_error_deg(scenario), rel=1e-9
    )
    for path, step in steps.items():
        start = value_of(scenario, path)
        expected, error = ridders(
            lambda h, p=path, x=start: np.array([rms_error_deg(at(scenario, p, x + h))]), step, rows
        )
        assert error[0] < 5e-6 * abs(expected[0]), path
        assert sensitivities.of("rms_error_deg")[path] == pytest.approx(expected[0], rel=1e-5), path


def test_tracking_error_against_differences():
    # Bore enters by the mean area, the torque by the pressure at the start too.
    steps = {
        "plant.cylinder.bore_m": 2e-6,
        "plant.pump.lag_s": 2e-5,
        "plant.load.knee_torque_n_m": 0.01,
        "encoder.mounting_error_rad": 1e-6,
    }
    assert_tracking(changed(UNCERTAIN_KNEE, SHORT), steps, 2)


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["smc", "pid"])
def test_tracking_error_against_differences_in_all_values(controller):
    law = {"controller": PID_TUNED.model_dump()} if controller == "pid" else {}
    scenario = changed(LEAKY, SHORT | law | {"simulation.duration_s": 1.0})
    # Within a larger step the motor enters or leaves its limits at other samples: a kink.
    steps = {path: 1e-3 * step for path, step in STEPS.items()}
    assert_tracking(scenario, steps, 2)


@pytest.mark.slow
def test_tracking_error_of_the_full_order_against_differences():
    short = SHORT | {"simulation.step_s": 5e-5, "simulation.duration_s": 0.2}
    scenario = changed(UNCERTAIN_KNEE, short | FULL_ORDER)
    assert_tracking(scenario, {"plant.cylinder.bore_m": 2e-7, "plant.pump.lag_s": 2e-6}, 2)


def test_after_the_first_period_the_start_does_not_count():
    # 20 Hz: a period of 50 ms within 0.1 s.
    reference = {"reference.frequency_hz": 20.0, "reference.amplitude_deg": 0.05}
    scenario = changed(UNCERTAIN_KNEE, SHORT | reference | {"simulation.duration_s": 0.1})
    assert_tracking(scenario, {"plant.pump.lag_s": 2e-5}, 2)
    whole = tracking_sensitivities(scenario, ["plant.pump.lag_s"], duration_s=0.05)
    # One sample follows the period: too few, so that all count.
    period = rms_error_deg(changed(scenario, {"simulation.duration_s": 0.05}))
    assert whole.metrics["rms_error_deg"] == pytest.approx(period, rel=1e-9)
    later = tracking_sensitivities(scenario, ["plant.pump.lag_s"])
    assert period != pytest.approx(later.metrics["rms_error_deg"], rel=0.01)


def test_a_limit_that_is_not_reached_has_no_influence():
    small = {"reference.amplitude_deg": 0.05, "simulation.duration_s": 0.05}
    scenario = changed(UNCERTAIN_KNEE, SHORT | small)
    path = "plant.pump.acceleration_limit_rad_s2"
    assert tracking_sensitivities(scenario, [path]).of("rms_error_deg") == {path: 0.0}


# ---------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    "path",
    [
        "plant.linkage",
        "plant.linkage.a_2_m",
        "plant.load.kind",
        "plant.full_order.dead_volume_m3",
        "bus.latency_samples",
        "controller.phi_m_s2",
        "plant.pump.no_such_value",
        "",
    ],
)
def test_a_value_without_derivative_is_refused(path):
    assert not differentiable(UNCERTAIN_KNEE, path)
    for function in (loop_sensitivities, tracking_sensitivities):
        with pytest.raises(ParameterError, match=rf"\A{path}: has no derivative [^\n]*\Z"):
            function(UNCERTAIN_KNEE, [path])


def test_no_values_are_refused():
    for function in (loop_sensitivities, tracking_sensitivities):
        with pytest.raises(ParameterError, match=r"\Apaths: there are none[^\n]*\Z"):
            function(UNCERTAIN_KNEE, [])


def test_a_run_that_diverges_says_so():
    # RK3 is not stable at 1 ms on the 447 Hz mode of the oil.
    scenario = changed(UNCERTAIN_KNEE, SHORT)
    with pytest.raises(SimulationError, match=r"\A[^\n]*reduce step_s = 0.001 s\Z"):
        tracking_sensitivities(scenario, ["plant.pump.lag_s"], step_s=1e-3)


def test_a_loop_that_does_not_rest_says_so():
    pushed = changed(LEAKY, {"plant.load.knee_torque_n_m": 400.0})
    with pytest.raises(LinearizationError, match=r"\A[^\n]*does not rest[^\n]*\Z"):
        loop_sensitivities(pushed, ["plant.pump.lag_s"])
