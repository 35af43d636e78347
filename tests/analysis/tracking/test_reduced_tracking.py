"""Metrics without a log against the metrics of the log."""

import dataclasses
import math

import numpy as np
import pytest

from kneexo.analysis.signals import period_s
from kneexo.analysis.tracking.reduced_tracking import track_basic_metrics, track_metrics
from kneexo.analysis.tracking.reductions import TRACKING_METRICS
from kneexo.analysis.tracking.tracking import track
from kneexo.errors import ParameterError
from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SineReference,
)
from kneexo.simulation import simulate

BRISK = Scenario(
    plant=PlantParameters(
        pump=BldcPumpParameters(rated_power_w=0.3),
        cylinder=CylinderParameters(pressure_rating_pa=7.3e4),
        load=KneeLoadParameters(),
    ),
    reference=SineReference(mean_deg=40.0, amplitude_deg=5.0, frequency_hz=2.0),
    simulation=SimulationParameters(duration_s=1.0),
)


each_engine = pytest.mark.parametrize(
    "change", [{}, pytest.param({"simulation.integrator": "radau3"}, marks=pytest.mark.slow)]
)


@each_engine
def test_metrics_without_a_log_are_those_of_the_log(change):
    # The ratings are exceeded in a part of the samples, and power flows in both directions.
    scenario = BRISK.changed({"simulation.duration_s": 1.1, **change})
    expected = dataclasses.asdict(track(scenario).metrics)
    assert dataclasses.asdict(track_metrics(scenario)) == pytest.approx(expected, rel=1e-11)
    for share in ("pressure_over_rating_share", "power_over_rating_share"):
        assert 0.0 < expected[share] < 1.0
    energy, delivered = expected["shaft_energy_j"], expected["shaft_energy_delivered_j"]
    assert delivered > 1.01 * energy


@pytest.mark.parametrize(
    "integrator", ["exact_hold", pytest.param("radau3", marks=pytest.mark.slow)]
)
def test_a_wearer_adds_the_torque_after_the_first_period(integrator):
    worn = {"wearer": "leg", "controller": "torque", "simulation.integrator": integrator}
    scenario = BRISK.changed(worn)
    run = simulate(scenario)
    torque = run["interaction_torque_n_m"][run.time_s >= period_s(BRISK) - 1e-9]
    metrics = track_basic_metrics(scenario)
    assert metrics["peak_torque_n_m"] == np.abs(torque).max()
    assert metrics["rms_torque_n_m"] == pytest.approx(math.sqrt(np.mean(torque**2)), rel=1e-12)
    whole = math.sqrt(np.mean(run["interaction_torque_n_m"] ** 2))
    assert metrics["rms_torque_n_m"] != pytest.approx(whole, rel=0.01)
    short = scenario.changed({"simulation.duration_s": 0.7})
    torque = simulate(short)["interaction_torque_n_m"]
    assert track_basic_metrics(short)["peak_torque_n_m"] == np.abs(torque).max()


@pytest.mark.parametrize("periods", [0.5, 1.0, 1.2])
def test_basic_metrics_of_a_run_of_less_than_two_periods_are_those_of_the_whole_run(periods):
    short = BRISK.changed({"simulation.duration_s": periods * period_s(BRISK)})
    metrics = track(short).metrics
    expected = {name: getattr(metrics, name) for name in TRACKING_METRICS}
    assert track_basic_metrics(short) == pytest.approx(expected)
    assert expected["max_error_deg"] == metrics.max_error_overall_deg


def test_basic_metrics_of_one_sample_are_refused():
    with pytest.raises(ParameterError, match=r"^1 samples are too few for metrics"):
        track_basic_metrics(BRISK.changed({"simulation.duration_s": 0.001}))
