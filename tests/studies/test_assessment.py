"""One scenario in numbers: what is measured, and how failures are told."""

import math
from types import SimpleNamespace

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.tracking.tracking import track
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import compiled
from kneexo.simulation.compiled import scenario_diagram
from kneexo.studies import assessment
from kneexo.studies.assessment import MARGIN_METRICS, TRACKING_METRICS, assess

# Through Drake: short runs need no compiled model.
SHORT = changed(
    Scenario(),
    {
        "reference": {"kind": "sine", "mean_deg": 50.0, "amplitude_deg": 2.0, "frequency_hz": 4.0},
        "simulation": {"duration_s": 0.4, "integrator": "radau3", "step_s": 0.002},
    },
)


def test_metrics_are_those_of_their_analyses():
    assessment = assess(SHORT)
    metrics = track(SHORT).metrics
    margins = linearize_loop(SHORT, knee_angle_deg=50.0).margins()
    assert assessment == {
        **{name: getattr(metrics, name) for name in TRACKING_METRICS},
        **{name: getattr(margins, name) for name in MARGIN_METRICS},
        "stable": True,
        "tracking_failure": "",
        "margins_failure": "",
    }


def test_only_what_is_asked_for():
    assert set(assess(SHORT, margins=False)) == {*TRACKING_METRICS, "tracking_failure"}
    linear = assess(SHORT, tracking=False)
    assert set(linear) == {*MARGIN_METRICS, "stable", "margins_failure"}


def test_the_bandwidth_is_that_of_the_references_own_sine(monkeypatch):
    asked = []

    def bandwidth(scenario, loop):
        asked.append((scenario, loop))
        return 3.5

    monkeypatch.setattr(assessment, "large_signal_bandwidth_hz", bandwidth)
    numbers = assess(SHORT, tracking=False, margins=False, bandwidth=True)
    assert numbers == {"bandwidth_hz": 3.5, "bandwidth_failure": ""}
    assert asked == [(SHORT, None)]
    linear = SimpleNamespace(stable=False)
    monkeypatch.setattr(assessment, "linearize_loop", lambda *_, **__: linear)
    assess(SHORT, tracking=False, bandwidth=True)
    assert asked[1] == (SHORT, linear)


def test_a_gain_that_does_not_fall_is_reported(monkeypatch):
    monkeypatch.setattr(assessment, "large_signal_bandwidth_hz", lambda s, loop: math.nan)
    numbers = assess(SHORT, tracking=False, margins=False, bandwidth=True)
    assert numbers["bandwidth_failure"] == "no bandwidth: the gain does not cross 1/√2"


PUSHED = changed(
    SHORT,
    {
        "reference": {"kind": "step", "start_deg": 0.0, "end_deg": 0.0},
        "plant.load": {"kind": "knee", "knee_torque_n_m": -450.0},
        "plant.pump.internal_leakage_m3_per_s_pa": 1e-10,
    },
)


def test_failures_are_reported_in_one_line():
    assessment = assess(PUSHED, bandwidth=True)
    assert all(
        math.isnan(assessment[n]) for n in (*TRACKING_METRICS, *MARGIN_METRICS, "bandwidth_hz")
    )
    assert assessment["stable"] is None
    assert "left the range of motion" in assessment["tracking_failure"]
    assert "does not rest" in assessment["margins_failure"]
    assert "a sine" in assessment["bandwidth_failure"]
    assert not any("\n" in text for text in assessment.values() if isinstance(text, str))


def test_runs_that_fail_build_one_diagram_for_all(monkeypatch):
    built = []

    def counted(scenario):
        built.append(scenario)
        return scenario_diagram(scenario)

    monkeypatch.setattr(compiled, "scenario_diagram", counted)
    narrow = {"plant.knee.flexion_max_deg": 70.0, "simulation.duration_s": 6.0}
    for error in (-0.1, -0.11, -0.12):
        blind = changed(Scenario(), narrow | {"encoder.mounting_error_rad": error})
        text = assess(blind, margins=False)["tracking_failure"]
        assert "left the range of motion" in text
    assert len(built) <= 1  # Python 3.11 frees none of them


def test_an_unstable_loop_has_no_margins():
    exact = changed(SHORT, {"estimator": {"kind": "exact"}, "controller.phi_m_s2": 24.0})
    assessment = assess(exact, tracking=False)
    assert assessment["stable"] is False
    assert assessment["margins_failure"] == ""
    assert all(math.isnan(assessment[name]) for name in MARGIN_METRICS)
