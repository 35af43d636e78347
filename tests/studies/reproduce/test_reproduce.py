import json
import math
from dataclasses import replace

import numpy as np
import pytest
from reproduce_cases import (
    METRICS,
)

from kneexo.analysis import (
    Run,
    fit_polynomials,
    linearize_loop,
    simulate,
)
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.command_line.output import to_json
from kneexo.parameters import G5, Scenario, SimulationParameters
from kneexo.parameters.paths import changed
from kneexo.studies.paper import EQ_27_DIFFERENCES, EQ_27_EXACT_STATES, FIG_12, PID_PAPER
from kneexo.studies.reproduce import reproduce
from kneexo.studies.reproduce.report import report
from kneexo.studies.reproduce.reproduce import (
    growth_rate,
    reproduce_study,
    rod_error_mm,
    speed_demand,
)


def test_every_number_of_the_results_is_the_one_that_its_name_says(by_hand, flat):
    numbers = json.loads(to_json(by_hand.results()))
    peak_rpm, saturation_hz = speed_demand().values()
    growth = [case.pop("growth_rate_per_s") for case in numbers["eq27_exact_states"].values()]
    assert growth == pytest.approx([-0.5, 0.5], abs=0.02)
    for name, case in FIG_12.items():
        law = type(case.controller)(**numbers["fig12"][name].pop("controller"))
        assert law == case.controller
    del numbers["comparison"]  # of these numbers; test_comparison.py
    g4 = numbers.pop("table1_g4")  # of the geometry itself, 204 points
    assert g4 == {
        "refit_p_sse_mm2": pytest.approx(0.174, abs=1e-3),
        "refit_q_sse_deg2": pytest.approx(1.253, abs=1e-3),
        "refit_p_rmse_mm": pytest.approx(0.0296, abs=1e-4),
        "refit_q_rmse_deg": pytest.approx(0.0796, abs=1e-4),
    }
    root = math.sqrt(91.0)  # of the number of angles
    # Eq. 10 with Table 1, term by term.
    x_10 = 148.0 - 6.195 - 3.192 + 0.4789 - 0.04164 + 0.001571
    x_70 = 148.0 - 43.365 - 156.408 + 164.2627 - 99.97764 + 26.403797
    expected = {
        "table1": {
            "x_at_10deg_mm": x_10,
            "x_at_70deg_mm": x_70,
            "linkage_rmse_mm": 1.3 / root,
            "linkage_max_mm": 1.2,
            "refit_p_mm_deg": [1e-9, 2e-9, 3e-9, 4e-9, 5e-9, 6e-9],
            "refit_p_rmse_mm": 5.0 / root,
            "refit_p_sse_mm2": 25.0,
            "refit_q_sse_deg2": 1.0,
            "strokes_per_period_mm": 2.0 * (x_10 - x_70),
            "refit_q_deg_mm": [1e-8, 2e-8, 3e-8, 4e-8, 5e-8, 6e-8],
            "refit_q_rmse_deg": 1.0 / root,
            "table_q_rmse_deg": 17.0 / root,
        },
        "fig9": {
            "initial_error_mm": 50.0,
            "error_after_1s_mm": 0.2,
            "final_error_mm": 0.01,
        },
        "fig12": {
            name: {key: (n + 1) * value for key, value in METRICS.items()}
            for n, name in enumerate(("smc", "pid", "pid_tuned", "pid_feedforward"))
        },
        # Errors of 0, 1, 2 and 3 deg at 0, 1, 2 and 3 s. A quarter period is 2.5 s.
        "fig12_start": {"first_quarter_period_deg": 2.0, "later_deg": 3.0},
        "fig13": {
            "frequencies_hz": [0.1, 0.2, 0.4],
            "gain": [0.95, 0.75, 0.55],
            "phase_deg": [-11.0, -22.0, -44.0],
            "bandwidth_hz": 0.22,
            "phase_at_bandwidth_deg": -31.5,
            "gain_spread": [0.1, 0.1, 0.1],
            "trials": [
                {
                    "values": {"plant.cylinder.mass_kg": mass, "encoder.phase_rad": phase},
                    "gain": gain,
                }
                for mass, phase, gain in (
                    (4.0, 5e-3, [0.9, 0.8, 0.5]),
                    (9.0, 1e-2, [1.0, 0.7, 0.6]),
                )
            ],
        },
        "scaling": {
            "nominal": {"bandwidth_hz": 0.2, "ratio": 1.0},
            "gear_3": {"bandwidth_hz": 0.42, "ratio": 2.1},
            "half_amplitude": {"bandwidth_hz": 0.3, "ratio": 1.5},
        },
        "speed_limit": {
            "peak_speed_demand_at_0.1hz_rpm": peak_rpm,
            "saturation_from_hz": saturation_hz,
        },
        "eq27_exact_states": {
            name: {"mean_command_change_rpm": 90.0 / math.pi} for name in EQ_27_EXACT_STATES
        },
        "eq27_differences": {
            name: {
                "max_error_deg": factor * 0.11,
                "rms_error_deg": factor * 0.12,
                "mean_command_change_rpm": factor * 15.0,
            }
            for name, factor in zip(EQ_27_DIFFERENCES, (10, 20), strict=True)
        },
    }
    assert flat(numbers) == pytest.approx(flat(expected), rel=1e-5)


def test_the_speed_limit_does_not_explain_the_error_at_a_tenth_of_a_hertz():
    peak, saturation = speed_demand().values()
    # By hand: 30° at 0.1 Hz, moment arm of Table 1, 274.889 mm², 0.8 cm³/rev, gear 6.
    p = np.array([1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0])
    phase = np.linspace(0.0, 2.0 * np.pi, 4001)
    slope = np.polyval(np.polyder(p), 40.0 - 30.0 * np.cos(phase))  # mm/deg
    speed = np.abs(slope * 30.0 * 0.2 * np.pi * np.sin(phase)).max()  # mm/s
    assert peak == pytest.approx(speed * 274.889 / 800.0 * 6.0 * 60.0, rel=1e-5)
    assert peak == pytest.approx(4094.0, abs=1.0)
    assert saturation == pytest.approx(0.1221, abs=1e-4)


def test_growth_rate_of_a_growing_oscillation():
    time = np.arange(0.0, 3.0, 0.002)
    run = Run(
        time,
        {"load_pressure_pa": np.exp(1.2 * time) * np.sin(330.0 * time)},
        SimulationParameters(),
    )
    assert growth_rate(run) == pytest.approx(1.2, abs=0.02)


def test_all_figures_run_with_the_linkage_of_the_scenario(monkeypatch):
    groups = {
        figure: replace(group, run=lambda case: case) for figure, group in reproduce._GROUPS.items()
    }
    monkeypatch.setattr(reproduce, "_GROUPS", groups)
    monkeypatch.setattr(reproduce, "sinestream", lambda scenario, *_, **__: scenario)
    result = reproduce_study(Scenario(plant={"linkage": "G5"}))
    groups = (result.fig12, result.scaling, result.eq27_exact, result.eq27_differences)
    ran = [result.fig9, result.fig13, *(case for group in groups for case in group.values())]
    assert {case.plant.linkage for case in ran} == {G5}
    assert result.fit.p_mm_deg == pytest.approx(fit_polynomials(G5).p_mm_deg)
    assert result.fig12["pid"].controller == PID_PAPER


# ----------------------------------------------------------------------------- real runs


@pytest.fixture(scope="module")
def real():
    """The whole study, with three frequencies and one trial."""
    settings = SinestreamSettings(frequencies_hz=(0.2, 0.22, 0.24), trials=1)
    return reproduce_study(settings=settings)


def projected(scenario, frequency_hz):
    """Gain and phase in deg of the knee over the last 3 of 4 periods, by sums over samples."""
    values = {"reference.frequency_hz": frequency_hz, "simulation.duration_s": 4.0 / frequency_hz}
    run = simulate(changed(scenario, values), signals=("knee_reference", "knee_angle"))
    late = (run.time_s >= 1.0 / frequency_hz) & (run.time_s < 4.0 / frequency_hz - 1e-9)
    wave = np.exp(-2j * math.pi * frequency_hz * run.time_s[late])
    angle, reference = (run[f"knee_{name}_rad"][late] for name in ("angle", "reference"))
    mean = reference.mean()
    ratio = np.sum(wave * (angle - mean)) / np.sum(wave * (reference - mean))
    return abs(ratio), math.degrees(np.angle(ratio))


def test_every_row_is_that_of_its_own_run(real, in_numbers, tables):
    results = real.results()
    for name, case in FIG_12.items():
        row = results["fig12"][name]
        expected = in_numbers(case, 10.0)
        assert {key: row[key] for key in expected} == pytest.approx(expected, rel=1e-9)
    for name, case in EQ_27_DIFFERENCES.items():
        expected = in_numbers(case, 10.0)
        row = results["eq27_differences"][name]
        assert row == pytest.approx({key: expected[key] for key in row}, rel=1e-9)
    scenario = Scenario()
    (values,) = real.fig13.trials
    trial = changed(scenario, {"nominal": scenario.believed_plant} | values)
    responses = [projected(trial, f) for f in (0.2, 0.22, 0.24)]
    # 0.22 and 0.24 Hz: a period is no whole number of samples.
    assert results["fig13"]["gain"] == pytest.approx([g for g, _ in responses], rel=5e-3)
    assert results["fig13"]["phase_deg"] == pytest.approx([p for _, p in responses], abs=0.5)

    def crossing(gains, frequencies):
        return np.interp(-math.sqrt(0.5), -np.array(gains), frequencies)

    expected = crossing([gain for gain, _ in responses], (0.2, 0.22, 0.24))
    assert results["fig13"]["bandwidth_hz"] == pytest.approx(expected, rel=0.01)
    scaling, grid = results["scaling"], (0.4, 0.42, 0.44, 0.46, 0.48)
    for name, values in (
        ("gear_3", {"plant.pump.gear_ratio": 3.0}),
        ("half_amplitude", {"reference.amplitude_deg": 15.0}),
    ):
        scenario = changed(Scenario(), values)
        expected = crossing([projected(scenario, f)[0] for f in grid], grid)
        assert scaling[name]["bandwidth_hz"] == pytest.approx(expected, rel=0.01)
        ratio = expected / scaling["nominal"]["bandwidth_hz"]
        assert scaling[name]["ratio"] == pytest.approx(ratio, rel=0.01)
    shown = {row[0]: row for row in tables(report(real))[0]}
    row = shown["largest error with SMC (Fig. 12, “less than 2°”)"]
    error = results["fig12"]["smc"]["max_error_deg"]
    assert row[1:5] == ["deg", "2", f"{error:.3f}", f"{error - 2.0:+.3g}"]


def test_fig_9_starts_89_mm_off_and_closes_as_the_sliding_surface_says(real):
    run = real.fig9
    error = rod_error_mm(run)
    assert error[0] == pytest.approx(-89.0, abs=1e-6)
    # (1 + λt) e^{−λt} at λ = 10 1/s.
    expected = -89.0 * 11.0 * math.exp(-10.0)
    assert np.interp(1.0, run.time_s, error) == pytest.approx(expected, abs=2e-4)
    assert real.results()["fig9"]["error_after_1s_mm"] == pytest.approx(-expected, abs=2e-4)


@pytest.mark.parametrize("name", list(EQ_27_EXACT_STATES))
def test_the_oscillation_at_2_ms_grows_as_the_eigenvalues_say(real, name):
    eigenvalues = linearize_loop(EQ_27_EXACT_STATES[name], knee_angle_deg=30.0).eigenvalues
    # The mode of the oil, 447 Hz, appears at 500 − 447 = 53 Hz.
    hertz = np.abs(np.angle(eigenvalues)) / (2.0 * np.pi * 0.002)
    mode = eigenvalues[np.argmin(np.abs(hertz - 53.0))]
    row = real.results()["eq27_exact_states"][name]
    # The fit's blocks of 0.15 s hold eight periods.
    assert row["growth_rate_per_s"] == pytest.approx(np.log(abs(mode)) / 0.002, abs=0.02)
    assert (row["growth_rate_per_s"] > 0.0) == (name == "13000")


def test_differences_of_the_encoder_make_degrees_of_error(real):
    for case in real.eq27_differences.values():
        assert 5.0 < case.metrics.max_error_deg < 26.0


def test_the_tuned_pids_stay_within_the_chattering_of_the_sliding_mode(real):
    smc = real.fig12["smc"].metrics
    assert smc.max_error_deg <= 0.30
    for name in ("pid_tuned", "pid_feedforward"):
        pid = real.fig12[name].metrics
        assert pid.mean_command_change_rpm <= smc.mean_command_change_rpm
        assert pid.max_error_deg < 0.1


def test_each_number_that_does_not_hold_has_its_reason(real, check_screen):
    check_screen(report(real))
    comparison = {row["quantity"]: row for row in real.results()["comparison"]}
    failing = {name for name, row in comparison.items() if row["judgement"] == "does not hold"}
    assert failing == {
        *("x at 70° (Section 5)", "rod travel in one period (Section 5)"),
        *("SSE of x(θ_p) (Fig. 5a)", "SSE of θ_p(x) (Fig. 5b)", "RMSE of θ_p(x) (Fig. 5b)"),
        *("SSE of x(θ_p), G4", "SSE of θ_p(x), G4", "RMSE of θ_p(x), G4"),
        *("peak motor speed at 0.1 Hz (Section 5: at its limit)", "−3 dB bandwidth (Fig. 13)"),
    }
    assert all(comparison[name]["because"] for name in failing)
    bound = comparison["largest error with SMC (Fig. 12, “less than 2°”)"]
    assert (bound["judgement"], bound["kneexo"] < 2.0) == ("holds", True)
