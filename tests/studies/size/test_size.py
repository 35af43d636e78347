"""Sizing: the search, the choice of gains, and a whole small study."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from size_cases import (
    SMALL,
)

from kneexo.analysis.frequency.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.walking.stride import smallest_piston_factor
from kneexo.analysis.walking.walking import walking_demand, walking_metrics
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import UNCERTAIN_KNEE, Scenario
from kneexo.parameters.paths import changed
from kneexo.studies.hardware import (
    ACCELERATION_LIMIT,
    DISPLACEMENT,
    HARDWARE,
    SPEED_LIMIT,
    expected_bandwidth_hz,
    scaled,
    sliding_mode,
    tuned,
    with_piston,
)
from kneexo.studies.size import size
from kneexo.studies.size.figures import figures
from kneexo.studies.size.report import report
from kneexo.studies.size.size import size_study, smallest

# ---------------------------------------------------------------------------------- search


@given(threshold=st.floats(1.0, 99.0), bound=st.floats(0.1, 10.0), tolerance=st.floats(1e-3, 0.3))
def test_the_smallest_value_is_found_to_the_tolerance(threshold, bound, tolerance):
    def error(value):  # nan well below, as runs that fail
        return math.nan if value < 0.5 * threshold else bound * threshold / value

    search = smallest(error, 0.9, 100.0, bound_deg=bound, tolerance=tolerance)
    assert search.reached
    assert threshold * (1.0 - 1e-12) <= search.value <= threshold * (1.0 + tolerance)
    assert search.max_error_deg == error(search.value) <= bound


def test_a_search_that_is_met_at_once_says_the_low_end():
    search = smallest(lambda value: 1.0, 3.0, 7.0, bound_deg=2.0, tolerance=0.01)
    assert (search.value, search.reached) == (3.0, True)


def test_a_search_that_ends_beyond_its_range_tells_the_best_value():
    search = smallest(
        lambda value: math.nan if value > 20.0 else 3.0 + abs(value - 10.0),
        *(1.0, 100.0),
        bound_deg=2.0,
        tolerance=0.01,
    )
    assert not search.reached
    assert search.value == pytest.approx(10.0)  # one of nine, by equal ratios
    assert search.max_error_deg == pytest.approx(3.0)
    every = smallest(lambda value: math.nan, 1.0, 9.0, bound_deg=2.0, tolerance=0.01)
    assert not every.reached
    assert math.isnan(every.max_error_deg)


# ------------------------------------------------------------------------------- bad input


# ------------------------------------------------------------------------------ whole study


@pytest.fixture
def by_formula(monkeypatch):
    """At f Hz with λ = 80 1/s, 10 f times the flow and 2e4 f rad/s² leave an error of 2°."""
    displacement = UNCERTAIN_KNEE.plant.pump.displacement_m3_per_rad

    def error(scenario, frequency_hz):
        pump = scenario.plant.pump
        short = max(
            10.0 * displacement / pump.displacement_m3_per_rad, 2e4 / pump.acceleration_limit_rad_s2
        )
        return 2.0 * frequency_hz * short * 80.0 / scenario.controller.lambda_per_s

    def walking(scenario, frequency_hz, cycles):
        numbers = {"max_error_deg": error(scenario, frequency_hz), "failure": ""}
        pump = scenario.plant.pump
        numbers["displacement"] = pump.displacement_m3_per_rad
        return numbers | {"mean_command_change_rpm": 0.0}

    def judge(scenario, **_):
        return {"disk_margin": 0.6, "bandwidth_hz": np.nan}

    monkeypatch.setattr(size, "walking_metrics", walking)
    monkeypatch.setattr(size, "walk", lambda scenario, f, cycles: {"error": error(scenario, f)})
    monkeypatch.setattr(size, "assess", judge)


@pytest.mark.slow
@pytest.mark.usefixtures("by_formula")
def test_every_row_of_the_sweeps_is_that_of_its_own_hardware(in_numbers):
    base = changed(
        Scenario(),
        {
            "reference": {"kind": "sine", "amplitude_deg": 2.0, "frequency_hz": 4.0},
            "simulation.duration_s": 0.5,
        },
    )
    few = {"factors": (2.0,), "walking_factors": (1.0,), "lambda_per_s": (80.0,)}
    result = size_study(base, changed(SMALL, few))
    rows = {path: row for path, (row,) in result.sweeps.items()}
    assert list(rows) == list(HARDWARE)
    for path, row in (("", result.nominal), *rows.items()):
        hardware = scaled(base, {path: 2.0}) if path else base
        expected = in_numbers(hardware, 0.25) | {
            "expected_bandwidth_hz": expected_bandwidth_hz(hardware),
            "bandwidth_hz": large_signal_bandwidth_hz(hardware),
            "small_signal_bandwidth_hz": linearize_loop(
                hardware, knee_angle_deg=40.0
            ).bandwidth_hz(),
        }
        names = set(row) - {"failure"}
        assert len(names) == 6
        assert row["failure"] == ""
        assert {n: row[n] for n in names} == pytest.approx({n: expected[n] for n in names})


@pytest.mark.slow
@pytest.mark.usefixtures("by_formula")
def test_a_knee_that_walks_by_formula_gets_the_hardware_of_the_formula(monkeypatch):
    def fail(*_, **__):
        raise SimulationError("not asked for here")

    for name in ("large_signal_bandwidth_hz", "linearize_loop", "track"):
        monkeypatch.setattr(size, name, fail)
    settings = changed(SMALL, {"stride_frequencies_hz": (0.5, 1.0), "search_tolerance": 1e-3})
    result = size_study(settings=settings)

    lost = ["bandwidth_hz", "small_signal_bandwidth_hz", "max_error_deg", "rms_error_deg"]
    for row in (result.nominal, result.design_at_reference, *result.sweeps[DISPLACEMENT]):
        assert all(math.isnan(row[name]) for name in (*lost, "mean_command_change_rpm"))
        assert row["failure"] == "; ".join(["not asked for here"] * 3)
    # Ample: 25 times the flow and 1e5 rad/s²; the hardest stride is that of 1 Hz.
    assert result.best_gains["lambda_per_s"] == 80.0
    assert result.best_gains["max_error_deg"] == pytest.approx(2.0 * 10.0 / 25.0)
    assert [entry["meets"] for entry in result.gains] == [True, True]
    for frequency, design in zip((0.5, 1.0), result.designs, strict=True):
        assert design.flow.value == pytest.approx(10.0 * frequency, rel=1e-3)
        assert design.acceleration.value == pytest.approx(2e4 * frequency, rel=1e-3)
        assert design.walking["max_error_deg"] == pytest.approx(2.0 / 1.1, rel=1e-3)
        # The paper's piston carries the moment with 0.6 % to spare; 10 % are required.
        assert design.carrying == with_piston(design.scenario, 1.1 * smallest_piston_factor())
        ratio = design.carried["displacement"] / design.walking["displacement"]
        assert ratio == pytest.approx(1.1 * 0.99356, rel=1e-4)
    half = size_study(settings=changed(settings, {"moment_share": 0.5})).designs[0]
    assert half.carrying == half.scenario
    # 1.6 kg, 0.20 m from the knee
    shank = changed(UNCERTAIN_KNEE, {"plant.load.inertia_kg_m2": 0.064})
    demands = [(result.segment_demands[1], {}, 1.0)]
    demands += [(result.torque_demands[10.0], {"plant.load.knee_torque_n_m": 10.0}, 0.5)]
    for demand, torque, frequency in demands:
        expected = walking_demand(changed(shank, torque), frequency).rod_force_n
        assert demand.rod_force_n == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert "reduced order, inertia of the shank 0.064 kg·m² in place of the mass" in (
        result.variations
    )
    # What follows is about 0.5 Hz.
    for entry in result.variations.values():
        assert entry["max_error_deg"] == pytest.approx(2.0 / 1.1, rel=1e-3)
    factors = np.array(settings.walking_factors)
    worst = 2.0 / 1.1 / np.minimum(*np.meshgrid(factors, factors))
    assert result.walking_map_deg == pytest.approx(worst, rel=1e-3)
    assert result.traces["nominal"]["error"] == pytest.approx(0.5 * 2.0 * 10.0 * 4.0)
    assert result.traces["sized"]["error"] == pytest.approx(2.0 / 1.1, rel=1e-3)


@pytest.mark.slow(gate=0)
def test_the_sized_hardware_is_the_smallest(small):
    result, _ = small
    (design,) = result.designs
    assert design.flow.reached
    assert design.acceleration.reached
    assert design.walking["max_error_deg"] <= SMALL.error_bound_deg
    # Kinematics: 15.9 times the flow, and 7094 rad/s² at just that; 2° let the peak be cut.
    needed = result.results()["demand"][0]
    assert 0.85 < design.flow.value / needed["flow_factor"] < 1.05
    at_sized = needed["peak_motor_acceleration_rad_s2"] * needed["flow_factor"]
    assert 0.8 < design.acceleration.value / (at_sized / (1.1 * design.flow.value)) < 1.1

    def error(flow, limit):
        factors = {DISPLACEMENT: flow, ACCELERATION_LIMIT: limit / 1e4}
        walks = tuned(scaled(UNCERTAIN_KNEE, factors), result.best_gains)
        return walking_metrics(walks)["max_error_deg"]

    # A little less of either is not enough: an error beyond the bound, or no walking at all.
    assert not error(0.97 * design.flow.value, 1e5) <= SMALL.error_bound_deg
    sized_flow = 1.1 * design.flow.value
    assert not error(sized_flow, 0.97 * design.acceleration.value) <= SMALL.error_bound_deg
    assert error(sized_flow, design.acceleration.value) == design.acceleration.max_error_deg


@pytest.mark.slow
def test_what_the_controller_needs(small):
    result, _ = small
    steps = [ones[0] for ones in result.steps.values()]
    assert steps[0]["max_error_deg"] > 40.0
    assert "left the range of motion" in steps[1]["failure"]
    assert "left the range of motion" in steps[2]["failure"]
    assert steps[3]["max_error_deg"] < 2.0
    assert result.best_gains["lambda_per_s"] == 80.0
    assert result.best_gains["meets"]
    needs = result.results()["controller"]
    assert needs["authority_asked_m_s3"] > needs["authority_m_s3"]
    law = sliding_mode(result.designs[0].scenario)
    asked_for = needs["authority_asked_m_s3"]
    assert law.gain_ratio * law.eta_m_s3 > asked_for


@pytest.mark.slow
def test_bandwidth_goes_with_flow_and_never_beyond_its_bound(small):
    result, _ = small
    for path in (SPEED_LIMIT, DISPLACEMENT):
        half, base, double = (entry["bandwidth_hz"] for entry in result.sweeps[path])
        # f ∝ R; the observer and the acceleration limit take 2 % at twice the flow.
        assert half / base == pytest.approx(0.5, rel=0.01)
        assert double / base == pytest.approx(2.0, rel=0.03)
    for path in HARDWARE:
        for factor, entry in zip(SMALL.factors, result.sweeps[path], strict=True):
            bound = expected_bandwidth_hz(scaled(UNCERTAIN_KNEE, {path: factor}))
            assert entry["expected_bandwidth_hz"] == bound
            # The bound is that of a sine in x; the knee's is 3 % lower.
            assert 0.93 * bound < entry["bandwidth_hz"] <= bound
    errors = [entry["max_error_deg"] for entry in result.sweeps["encoder.counts_per_revolution"]]
    assert errors[0] > errors[1] > errors[2]
    lag = [entry["max_error_deg"] for entry in result.sweeps["plant.pump.lag_s"]]
    assert lag[0] < lag[1] < lag[2]


@pytest.mark.slow
def test_pressure_and_power_agree_at_half_the_step(small):
    result, _ = small
    agreement = result.results()["designs"][0]["step_agreement"]
    assert set(agreement) == {
        *("max_error_deg", "peak_pressure_mpa", "peak_shaft_power_w", "delivered_energy_j")
    }
    assert max(agreement.values()) < 0.01
    checked = result.designs[0].halved
    peaks = result.demands[0].peaks()
    # A loop near its limits: what it must catch up with comes on top of the motion's own.
    assert checked["peak_pressure_mpa"] == pytest.approx(
        1e-6 * peaks["peak_load_pressure_pa"], rel=0.3
    )
    assert checked["delivered_energy_j"] == pytest.approx(peaks["delivered_energy_j"], rel=0.05)
    assert checked["peak_shaft_power_w"] < 200.0
    assert checked["peak_pressure_mpa"] < 3.5


@pytest.mark.slow
def test_a_bound_out_of_reach_is_said_plainly():
    settings = SMALL.model_copy(
        update={
            "error_bound_deg": 0.2,
            "factors": (1.0,),
            "walking_factors": (1.0,),
            "disk_margin_min": 1.9,
            "seal_friction_n": 0.0,
        }
    )
    result = size_study(settings=settings)
    assert not result.designs[0].flow.reached
    assert result.designs[0].flow.max_error_deg > 0.2
    text = report(result)
    assert "not reached in 1 … 25: best 1." in text
    assert "none of the 2 gains tried has a disk margin of 1.9" in text
    figures(result)


@pytest.mark.slow
def test_gains_that_never_walk_are_refused():
    settings = SMALL.model_copy(update={"lambda_per_s": (20.0,), "factors": (1.0,)})
    with pytest.raises(ParameterError, match=r"none of 1 gains lets the knee walk; widen lambda"):
        size_study(settings=settings)
