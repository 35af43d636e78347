"""Sensitivities against closed forms and against exact derivatives by AutoDiff.

The exact derivatives were recorded once. AutoDiff carried them through the linearization, and
through the run by a third-order Runge-Kutta method with steps of 0.5 ms (0.05 ms in full order).
"""

import math

import numpy as np
import pytest

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.errors import LinearizationError, ParameterError, SimulationError
from kneexo.geometry.linkage import pose
from kneexo.parameters import UNCERTAIN_KNEE, Scenario
from kneexo.parameters.paths import changed, value_at
from kneexo.studies.robustness.sensitivity import (
    _sensitivities,
    differentiable,
    loop_sensitivities,
    tracking_sensitivities,
)

# ------------------------------------------------------------------------------- differences

LAG, TORQUE = "plant.pump.lag_s", "plant.load.knee_torque_n_m"


def derivatives(metric, paths=(LAG,)):
    """The derivatives of ``metric`` of a scenario, by the differences of this module."""
    found = _sensitivities(
        UNCERTAIN_KNEE, list(paths), lambda changed: [{"metric": metric(one)} for one in changed]
    )
    return found.gradients["metric"]


def test_differences_have_the_slope_of_a_curve_and_its_sign():
    def metric(scenario):
        lag, torque = value_at(scenario, LAG), value_at(scenario, TORQUE)
        return -math.exp(300.0 * lag) + 5.0 * math.sin(torque)

    # The torque is zero, so that its step comes from its range. A curvature of 9e4 is left.
    found = derivatives(metric, (LAG, TORQUE))
    assert found == pytest.approx([-300.0 * math.exp(3.0), 5.0], rel=1e-10)


@pytest.mark.parametrize(
    "of_lag",
    [
        lambda lag: float(lag > 0.01),
        lambda lag: math.sqrt(max(lag - 0.01, 0.0)),
        lambda lag: math.inf,
        lambda lag: math.nan if lag > 0.01 else 1.0,
    ],
    ids=["jump", "vertical slope", "infinite", "missing above"],
)
def test_a_metric_without_slope_has_no_derivative(of_lag):
    assert np.isnan(derivatives(lambda scenario: of_lag(value_at(scenario, LAG)))).all()


def test_the_controller_keeps_its_plant_and_nothing_is_rounded():
    seen = []
    derivatives(lambda scenario: seen.append(scenario) or 0.0)
    lags = [value_at(scenario, LAG) for scenario in seen]
    assert lags == pytest.approx([0.01, 0.010001, 0.009999, 0.010002, 0.009998], rel=1e-12)
    assert {value_at(scenario, "nominal.pump.lag_s") for scenario in seen} == {0.01}
    assert not any(scenario.quantized for scenario in seen)


# ----------------------------------------------------------------------------------- margins

BORE, OFFSET = "plant.cylinder.bore_m", "encoder.mounting_error_rad"
# Derivatives by AutoDiff with respect to bore, motor lag and mounting error.
MARGINS = {
    "paper": {
        "largest_eigenvalue": (-2.7365008, 0.62133345, 0.037968906),
        "phase_margin_deg": (4038.8129, -294.29106, -56.040776),
        "delay_margin_s": (37.529578, -0.90429553, -0.52076829),
        "gain_margin": (261.14674, -10.247758, -3.6233274),
        "disk_margin": (90.219125, -4.7277443, -1.2518063),
    },
    "leg": {
        "largest_eigenvalue": (-2.2806148, 0.39851113, 0.026938251),
        "phase_margin_deg": (4184.2266, -299.2428, -59.31477),
        "delay_margin_s": (32.979839, -0.9019465, -0.50221902),
        "gain_margin": (221.27086, -9.3416945, -3.2547366),
        "disk_margin": (84.5144, -4.5383313, -1.2264988),
    },
    "wearer": {
        "largest_eigenvalue": (-0.23069302, 0.019034238, 0.00098087975),
        "phase_margin_deg": (3553.1619, -1367.0011, -29.433645),
        "delay_margin_s": (3.3295183, -0.68638753, -0.015842616),
        "gain_margin": (3663.048, -518.22353, 29.340158),
        "disk_margin": (60.544958, -26.43456, -0.58432234),
    },
}


@pytest.mark.parametrize(
    "preset", ["paper", *(pytest.param(name, marks=pytest.mark.slow) for name in ("leg", "wearer"))]
)
def test_margins_have_the_derivatives_of_autodiff(preset):
    found = loop_sensitivities(Scenario.preset(preset), [BORE, LAG, OFFSET])
    assert list(found.metrics) == list(MARGINS[preset])
    for metric, expected in MARGINS[preset].items():
        # They agree to 4e-6.
        assert found.gradients[metric] == pytest.approx(expected, rel=1e-4), metric


def test_the_gain_margin_is_inverse_to_the_displacement_of_the_pump():
    # Without load and leakage the flow alone enters the loop, and the controller keeps its belief.
    path, scenario = "plant.pump.displacement_m3_per_rad", Scenario()
    found = loop_sensitivities(scenario, [path])
    expected = -found.metrics["gain_margin"] / value_at(scenario, path)
    assert found.of("gain_margin")[path] == pytest.approx(expected, rel=1e-5)
    loop = linearize_loop(scenario, knee_angle_deg=40.0)
    assert found.metrics["gain_margin"] == loop.margins().gain_margin
    assert found.metrics["largest_eigenvalue"] == abs(loop.eigenvalues[0])


def test_the_acceleration_limit_has_no_influence_on_a_loop_at_rest():
    path = "plant.pump.acceleration_limit_rad_s2"
    sensitivities = loop_sensitivities(Scenario(), [path])
    assert all(sensitivities.of(metric) == {path: 0.0} for metric in sensitivities.metrics)


def test_an_unstable_loop_has_the_gradient_of_its_eigenvalue_alone():
    # Without quantizer and estimator k/Φ = 1.3e4 1/s is beyond the boundary of stability.
    unstable = Scenario(estimator={"kind": "exact"}, controller={"phi_m_s2": 24.4})
    sensitivities = loop_sensitivities(unstable, [LAG])
    assert list(sensitivities.metrics) == ["largest_eigenvalue"]
    assert sensitivities.metrics["largest_eigenvalue"] > 1.0
    assert math.isfinite(sensitivities.of("largest_eigenvalue")[LAG])


def test_the_posture_is_the_middle_of_the_reference():
    motions = ((40.0, 30.0), (40.0, 10.0), (60.0, 10.0))
    gradients = [
        loop_sensitivities(
            changed(Scenario(), {"reference.mean_deg": mean, "reference.amplitude_deg": amplitude}),
            [LAG],
        ).of("disk_margin")
        for mean, amplitude in motions
    ]
    assert gradients[0] == gradients[1] != gradients[2]


# ---------------------------------------------------------------------------------- tracking

# Derivatives of the rms error by AutoDiff through a run, with respect to the same values.
RMS_ERROR = {
    "paper": (20.0, (4.0289587, 1.8250084, -15.837196)),
    "bench": (20.0, (2.3908048, 1.7751315, 1.7165805)),
    "leg": (2.0, (-253.98555, -1.4376649, -32.077688)),
}


@pytest.mark.parametrize(
    "preset", ["paper", *(pytest.param(name, marks=pytest.mark.slow) for name in ("bench", "leg"))]
)
def test_the_tracking_error_has_the_derivatives_of_autodiff(preset):
    duration_s, (by_bore, by_lag, by_offset) = RMS_ERROR[preset]
    found = tracking_sensitivities(
        Scenario.preset(preset), [BORE, LAG, OFFSET], duration_s=duration_s
    ).of("rms_error_deg")
    # The integrators differ. The bore changes the swing of the oil too: they agree to 4.3e-4.
    assert found[BORE] == pytest.approx(by_bore, rel=4e-3)
    # They agree to 6e-6.
    assert found[LAG] == pytest.approx(by_lag, rel=6e-5)
    assert found[OFFSET] == pytest.approx(by_offset, rel=6e-5)


def held(mounting_error_rad, **reference):
    """A knee that is held at 40 deg for 2.2 s, with an encoder that is off its mounting."""
    sine = {"kind": "sine", "mean_deg": 40.0, "amplitude_deg": 0.0, "frequency_hz": 1.0}
    values = {"reference": sine | reference, OFFSET: mounting_error_rad}
    return changed(Scenario(), values | {"simulation.duration_s": 2.2})


def test_a_held_knee_is_off_by_the_slope_of_the_encoder():
    scenario = held(1e-3)
    found = tracking_sensitivities(scenario, [OFFSET])
    rest_rad = math.radians(40.0 - found.metrics["rms_error_deg"])
    slope = pose(scenario.plant.linkage, rest_rad).encoder_sensitivity
    # After 1 s the pressure still flows through the leakage: 1e-4 is left.
    assert found.of("rms_error_deg")[OFFSET] == pytest.approx(math.degrees(abs(slope)), rel=1e-3)


def test_the_first_period_counts_only_if_the_run_is_shorter_than_two():
    short, long, settled = (
        tracking_sensitivities(held(1e-3), [OFFSET], duration_s=s) for s in (0.5, 1.9, 2.0)
    )
    # The knee starts without error and needs 0.2 s to settle.
    assert short.metrics["rms_error_deg"] < 0.97 * settled.metrics["rms_error_deg"]
    assert long.metrics["rms_error_deg"] < 0.997 * settled.metrics["rms_error_deg"]


def test_a_limit_that_is_not_reached_has_no_influence():
    path = "plant.pump.acceleration_limit_rad_s2"
    assert tracking_sensitivities(held(0.0), [path]).of("rms_error_deg") == {path: 0.0}


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
        with pytest.raises(ParameterError, match=rf"\A{path}: has no derivative[^\n]*\Z"):
            function(UNCERTAIN_KNEE, [path])


def test_no_values_are_refused():
    for function in (loop_sensitivities, tracking_sensitivities):
        with pytest.raises(ParameterError, match=r"\Apaths: there are none[^\n]*\Z"):
            function(UNCERTAIN_KNEE, [])


OVERLOADED = changed(
    UNCERTAIN_KNEE, {TORQUE: 400.0, "plant.pump.internal_leakage_m3_per_s_pa": 2e-12}
)


def test_a_run_that_leaves_its_range_says_so():
    with pytest.raises(SimulationError, match=r"\A[^\n]*\Z"):
        tracking_sensitivities(OVERLOADED, [LAG])


def test_a_loop_that_does_not_rest_says_so():
    with pytest.raises(LinearizationError, match=r"\A[^\n]*does not rest[^\n]*\Z"):
        loop_sensitivities(OVERLOADED, [LAG])
