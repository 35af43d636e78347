"""Metrics of the interaction: closed forms of sines, and a run against sums of its own columns."""

import math

import numpy as np
import pytest

from kneexo.analysis import interaction_metrics, simulate
from kneexo.analysis.tracking.interaction import torque_error
from kneexo.errors import ResultError
from kneexo.parameters import Scenario, SimulationParameters
from kneexo.simulation import Run

TIME = np.linspace(0.0, 5.0, 5001)
OMEGA = math.pi  # period 2 s


def run_of(time=TIME, **columns):
    return Run(time, columns, SimulationParameters())


def sines(phase=0.7, torque_n_m=10.0, rate_rad_s=3.0, bias_n_m=0.0, time=TIME, **columns):
    """Torque and rate of one frequency; the torque leads by ``phase``."""
    return run_of(
        time,
        interaction_torque_n_m=bias_n_m + torque_n_m * np.sin(OMEGA * time + phase),
        wearer_rate_rad_s=rate_rad_s * np.sin(OMEGA * time),
        **columns,
    )


# The trapezoidal rule with 2000 steps a period is exact for sines, and off by 1e-5 at kinks.
EXACT, KINKS = {"rel": 1e-9}, {"rel": 1e-4}


def test_torque_and_powers_of_sines_are_those_of_integrals_by_hand():
    metrics = interaction_metrics(sines(), period_s=2.0)
    assert (metrics.start_s, metrics.end_s) == pytest.approx((2.0, 4.0))
    assert metrics.rms_torque_n_m == pytest.approx(10.0 / math.sqrt(2.0), **EXACT)
    assert metrics.mean_torque_n_m == pytest.approx(20.0 / math.pi, **KINKS)
    assert metrics.peak_torque_n_m == pytest.approx(10.0, **KINKS)
    # 10 sin(ωt + φ) · 3 sin ωt = 15 (cos φ − cos(2ωt + φ)): its positive part has the mean
    # 15 (sin φ + (π − φ) cos φ)/π, its negative part 15 (sin φ − φ cos φ)/π.
    phi = 0.7
    taken = 15.0 * (math.sin(phi) + (math.pi - phi) * math.cos(phi)) / math.pi
    given = 15.0 * (math.sin(phi) - phi * math.cos(phi)) / math.pi
    assert metrics.power_from_wearer_w == pytest.approx(taken, **KINKS)
    assert metrics.power_to_wearer_w == pytest.approx(given, **KINKS)
    assert math.isnan(metrics.assistance_ratio)


@pytest.mark.parametrize(("phase", "ratio"), [(math.pi, 0.25), (0.0, -0.25), (math.pi / 2, 0.0)])
def test_the_assistance_ratio_is_the_share_of_the_moment_that_the_exoskeleton_gives(phase, ratio):
    moment = 40.0 * np.sin(OMEGA * TIME)
    metrics = interaction_metrics(sines(phase, biological_moment_n_m=moment), period_s=2.0)
    assert metrics.assistance_ratio == pytest.approx(ratio, abs=1e-9)
    without = sines(phase, biological_moment_n_m=0.0 * TIME)
    assert math.isnan(interaction_metrics(without, period_s=2.0).assistance_ratio)


def test_the_initial_transient_and_a_part_of_a_period_do_not_count():
    torque = np.where((TIME < 1.999) | (TIME > 4.001), 99.0, -2.0)
    torque[TIME.searchsorted(2.5)] = -7.0
    run = run_of(interaction_torque_n_m=torque, wearer_rate_rad_s=np.ones_like(TIME))
    metrics = interaction_metrics(run, period_s=2.0)
    assert (metrics.peak_torque_n_m, metrics.peak_time_s) == (7.0, pytest.approx(2.5))
    # one sample of 1 ms in 2 s
    assert metrics.mean_torque_n_m == pytest.approx(2.0 + 5.0 * 0.001 / 2.0)
    assert metrics.power_to_wearer_w == pytest.approx(metrics.mean_torque_n_m)
    assert metrics.power_from_wearer_w == 0.0
    for whole in (interaction_metrics(run), interaction_metrics(run, period_s=2.6)):
        assert (whole.start_s, whole.end_s, whole.peak_torque_n_m) == (0.0, 5.0, 99.0)
    assert interaction_metrics(run, period_s=2.5).end_s == 5.0
    between = interaction_metrics(run, period_s=5.0008 / 2)  # its end lies between two samples
    assert (between.start_s, between.end_s) == pytest.approx((2.501, 5.0))
    assert interaction_metrics(run, period_s=5.0012 / 2).start_s == 0.0


def test_a_run_without_wearer_or_samples_is_refused():
    with pytest.raises(ResultError, match="interaction_torque_n_m"):
        interaction_metrics(run_of(knee_angle_rad=TIME))
    with pytest.raises(ResultError, match="1 samples; must have at least 2"):
        interaction_metrics(sines(time=TIME[:1]))


def test_the_torque_error_has_the_sign_of_the_desired_torque():
    # A rod that pushes extends the knee: −r F = −0.1 · 50 = −5 N·m.
    run = run_of(desired_torque_n_m=TIME, moment_arm_m=0.1 + 0 * TIME, rod_force_n=50.0 + 0 * TIME)
    assert torque_error(run) == pytest.approx(TIME + 5.0)


def test_a_run_agrees_with_its_own_power_and_force():
    scenario = Scenario.model_validate(
        {
            "plant": {"load": {"kind": "knee", "segment_mass_kg": 0.0}},
            "wearer": {
                "kind": "leg",
                "moment": {"times_s": (0.0, 2.0), "moments_n_m": (-20.0, 20.0)},
            },
            "controller": {"kind": "torque", "mode": "assist"},
            "reference": {"kind": "sine", "amplitude_deg": 5.0, "frequency_hz": 0.1},
            "simulation": {"duration_s": 2.0},
        }
    )
    run = simulate(scenario)
    metrics = interaction_metrics(run)
    power = run["power_of_wearer_w"]
    net = np.trapezoid(power, run.time_s) / 2.0
    assert metrics.power_from_wearer_w - metrics.power_to_wearer_w == pytest.approx(net, rel=1e-9)
    assert metrics.power_from_wearer_w + metrics.power_to_wearer_w == pytest.approx(
        np.trapezoid(np.abs(power), run.time_s) / 2.0, rel=1e-9
    )
    # The mass of 1.6 kg at the rod, without weight, needs less than 1e-3 N·m.
    actuator = -run["moment_arm_m"] * run["rod_force_n"]
    moment = run["biological_moment_n_m"]
    work, square = (np.trapezoid(y * moment, run.time_s) for y in (actuator, moment))
    assert metrics.assistance_ratio == pytest.approx(work / square, abs=1e-4)
    # the default assistance; the leak of the integral leaves an error of some per cent
    assert metrics.assistance_ratio == pytest.approx(0.2, abs=0.04)
    assert torque_error(run) == pytest.approx(run["desired_torque_n_m"] - actuator, abs=1e-9)
