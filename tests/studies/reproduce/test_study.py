import json
import math
from functools import reduce

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from kneexo.analysis import (
    FrequencyResponse,
    PolynomialFit,
    Run,
    TrackingMetrics,
    TrackingResult,
    linearize_loop,
    simulate,
)
from kneexo.analysis.frequency_response import SinestreamSettings
from kneexo.command_line.output import to_json
from kneexo.parameters import RodPolynomialParameters, Scenario, SimulationParameters
from kneexo.parameters.paths import changed
from kneexo.studies.paper import EQ_27_DIFFERENCES, EQ_27_EXACT_STATES, FIG_12
from kneexo.studies.reproduce.figures import figures, motions
from kneexo.studies.reproduce.report import report
from kneexo.studies.reproduce.study import (
    ReproduceResult,
    growth_rate,
    reproduce_study,
    rod_error_mm,
    speed_demand,
)

METRICS = {
    "max_error_deg": 0.11,
    "rms_error_deg": 0.12,
    "max_error_overall_deg": 0.13,
    "rms_error_overall_deg": 0.14,
    "mean_command_change_rpm": 15.0,
    "saturated_share": 0.16,
    "peak_command_rpm": 1700.0,
    "peak_pressure_mpa": 0.18,
    "pressure_over_rating_share": 0.19,
    "peak_shaft_power_w": 20.0,
    "power_over_rating_share": 0.21,
    "shaft_energy_j": 22.0,
    "shaft_energy_delivered_j": 23.0,
    "hydraulic_energy_j": 24.0,
}
"""Numbers that tell each other apart; those of the n-th run are n + 1 times as large."""

TIME = np.array([0.0, 0.5, 1.0, 1.5])
ANGLES = np.linspace(0.0, 90.0, 91)
TRIALS = (
    {"plant.cylinder.mass_kg": 4.0, "encoder.phase_rad": 5e-3},
    {"plant.cylinder.mass_kg": 9.0, "encoder.phase_rad": 1e-2},
)
GAINS = np.array([[0.9, 0.8, 0.5], [1.0, 0.7, 0.6]])
PHASES = np.array([[-10.0, -20.0, -40.0], [-12.0, -24.0, -48.0]])


def tracked(scenario, factor):
    reference, angle = np.radians([40.0, 41.0, 42.0, 43.0]), np.radians([40.0, 40.0, 44.0, 40.0])
    return TrackingResult(
        scenario,
        Run(
            TIME,
            {"knee_reference_rad": factor * reference, "knee_angle_rad": factor * angle},
            scenario.simulation,
        ),
        TrackingMetrics(**{name: factor * value for name, value in METRICS.items()}),
    )


def response(bandwidth_hz):
    return FrequencyResponse(
        frequencies_hz=np.array([0.1, 0.2, 0.4]),
        response=GAINS * np.exp(1j * np.radians(PHASES)),
        bandwidth_hz=bandwidth_hz,
        phase_at_bandwidth_deg=-31.5,
        trials=TRIALS,
        scenario=Scenario(),
        settings=SinestreamSettings(),
    )


def oscillation(rate):
    time = np.arange(0.0, 3.0, 0.002)
    command = np.where(np.arange(time.size) % 2, 2.0, -1.0)  # 3 rad/s of change at each sample
    pressure = 5.0 * np.exp(rate * time) * np.sin(330.0 * time)
    columns = {"load_pressure_pa": pressure, "motor_speed_command_rad_s": command}
    return Run(time, columns, SimulationParameters())


FIG_9 = {
    "rod_reference_m": np.array([0.10, 0.11, 0.12, 0.13]),
    "rod_extension_m": np.array([0.05, 0.10, 0.1198, 0.12999]),
}
RATIOS = {"nominal": 0.2, "gear_3": 0.42, "half_amplitude": 0.3}


@pytest.fixture(scope="module")
def known():
    """A reproduction whose numbers all differ and are known by hand."""
    p, q = (np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * scale for scale in (1e-9, 1e-8))
    return ReproduceResult(
        fit=PolynomialFit(
            table=RodPolynomialParameters(),
            angle_deg=ANGLES,
            extension_mm=148.0 - ANGLES,
            p_mm_deg=p,
            q_deg_mm=q,
            p_error_mm=np.array([3.0, -4.0]),
            q_error_deg=np.array([0.6, -0.8]),
            table_p_error_mm=np.array([0.5, -1.2]),
            table_q_error_deg=np.array([8.0, -15.0]),
        ),
        fig9=Run(TIME, FIG_9, SimulationParameters()),
        fig12={name: tracked(case, n + 1) for n, (name, case) in enumerate(FIG_12.items())},
        fig13=response(0.22),
        scaling={name: response(hertz) for name, hertz in RATIOS.items()},
        eq27_exact={name: oscillation(n - 0.5) for n, name in enumerate(EQ_27_EXACT_STATES)},
        eq27_differences={
            name: tracked(case, 10 * (n + 1))
            for n, (name, case) in enumerate(EQ_27_DIFFERENCES.items())
        },
    )


def test_every_number_of_the_results_is_the_one_that_its_name_says(known, flat, check_rules):
    numbers = json.loads(to_json(known.results()))
    check_rules(numbers)
    peak_rpm, saturation_hz = speed_demand()
    growth = [case.pop("growth_rate_per_s") for case in numbers["eq27_exact_states"].values()]
    assert growth == pytest.approx([-0.5, 0.5], abs=0.02)
    for name, case in FIG_12.items():
        law = type(case.controller)(**numbers["fig12"][name].pop("controller"))
        assert law == case.controller
    g4 = numbers.pop("table1_g4")  # of the geometry itself, 204 points
    assert g4 == {
        "refit_p_sse_mm2": pytest.approx(0.174, abs=1e-3),
        "refit_q_sse_deg2": pytest.approx(1.253, abs=1e-3),
        "refit_p_rmse_mm": pytest.approx(0.0296, abs=1e-4),
        "refit_q_rmse_deg": pytest.approx(0.0796, abs=1e-4),
    }
    root = math.sqrt(2.0)
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


PAPER = {
    # where our number is: what Lee et al. 2020 print
    ("table1", "x_at_10deg_mm"): 139.05,
    ("table1", "x_at_70deg_mm"): 38.98,
    ("table1", "strokes_per_period_mm"): 200.14,
    ("table1", "linkage_max_mm"): None,
    ("table1", "refit_p_sse_mm2"): 0.1781,
    ("table1", "refit_q_sse_deg2"): 1.241,
    ("table1", "linkage_rmse_mm"): 0.03,
    ("table1", "refit_q_rmse_deg"): 0.0792,
    ("table1_g4", "refit_p_sse_mm2"): 0.1781,
    ("table1_g4", "refit_q_sse_deg2"): 1.241,
    ("table1_g4", "refit_p_rmse_mm"): 0.03,
    ("table1_g4", "refit_q_rmse_deg"): 0.0792,
    ("fig9", "error_after_1s_mm"): None,
    ("fig9", "final_error_mm"): 0.0,
    ("fig12", "smc", "max_error_deg"): 2.0,
    ("fig12", "pid", "max_error_deg"): 4.0,
    ("fig12", "pid_tuned", "max_error_deg"): None,
    ("fig12", "pid_feedforward", "max_error_deg"): None,
    ("fig13", "bandwidth_hz"): 0.21,
    ("fig13", "phase_at_bandwidth_deg"): None,
    ("scaling", "gear_3", "ratio"): None,
    ("scaling", "half_amplitude", "ratio"): None,
}


def test_the_report_has_each_number_of_the_paper_beside_ours(known, tables):
    numbers = known.results()
    comparison, *_ = tables(report(known))
    assert comparison[0][:5] == ["quantity", "unit", "paper", "kneexo", "difference"]
    for (path, paper), row in zip(PAPER.items(), comparison[1:], strict=True):
        ours = reduce(dict.__getitem__, path, numbers)
        unit, printed, shown, difference = row[1:5]
        suffix = {"mm": "_mm", "mm²": "_mm2", "deg": "_deg", "deg²": "_deg2", "Hz": "_hz"}
        assert path[-1].endswith(suffix.get(unit, "ratio")), row
        assert float(shown) == pytest.approx(ours, abs=0.51 * 10.0 ** -len(shown.split(".")[-1]))
        if paper is None:
            assert (printed, difference) == ("not printed", "")
        else:
            assert float(printed) == paper
            assert difference[0] in "+-"
            assert float(difference) == pytest.approx(ours - paper, rel=6e-3, abs=1e-12)


def test_the_other_tables_of_the_report_are_those_of_the_results(known, tables):
    _, quintics, controllers, exact, differences = tables(report(known))
    p, q = RodPolynomialParameters().p_mm_deg, RodPolynomialParameters().q_deg_mm
    for n, row in enumerate(quintics[1:]):
        assert (row[0], row[3]) == (f"p_{n + 1}", f"q_{n + 1}")
        shown = [float(row[column]) for column in (1, 2, 4, 5)]
        expected = [p[n], 1e-9 * (n + 1), q[n], 1e-8 * (n + 1)]
        assert shown == pytest.approx(expected, rel=6e-4)
    columns = ("max_error_deg", "rms_error_deg", "mean_command_change_rpm", "saturated_share")
    for n, (name, row) in enumerate(zip(FIG_12, controllers[1:], strict=True)):
        assert row[0] == name
        expected = [(n + 1) * METRICS[column] for column in (*columns, "peak_command_rpm")]
        assert [float(cell) for cell in row[1:]] == pytest.approx(expected, abs=5e-4)
    assert [float(row[1]) for row in exact[1:]] == pytest.approx([-0.5, 0.5], abs=0.025)
    assert [row[0] for row in exact[1:]] == list(EQ_27_EXACT_STATES)
    for name, factor, row in zip(EQ_27_DIFFERENCES, (10, 20), differences[1:], strict=True):
        assert row[0] == name
        expected = [factor * value for value in (0.11, 0.12, 15.0)]
        assert [float(cell) for cell in row[1:]] == pytest.approx(expected, abs=5e-3)


def test_the_words_about_the_speed_limit_have_its_numbers(known):
    text = report(known)
    peak_rpm, saturation_hz = speed_demand()
    for said in (f"{peak_rpm:.0f} rpm", f"{saturation_hz:.3f} Hz", "1700 rpm", "16.0 %"):
        assert said in text


def test_the_view_shows_the_runs_of_fig_12(known):
    shown = motions(known)
    assert list(shown) == [
        "Fig. 12, sliding-mode control",
        "Fig. 12, PID as in the paper (P, 5 1/s)",
    ]
    for (linkage, columns), name in zip(shown.values(), ("smc", "pid"), strict=True):
        tracked = known.fig12[name]
        assert linkage is tracked.scenario.plant.linkage
        assert columns["knee_angle_rad"] is tracked.run["knee_angle_rad"]
        assert columns["time_s"] is tracked.run.time_s


def test_every_line_of_the_figures_is_that_of_its_run(known, curves):
    drawn = figures(known)
    assert [name[:5] for name in drawn] == ["fig05", "fig09", "fig12", "fig13", "eq27_"]
    left, right = drawn["fig05_polynomial_fit"].axes
    for ax, x, y, fit, table in (
        (left, ANGLES, 148.0 - ANGLES, known.fit.p_mm_deg, known.fit.table.p_mm_deg),
        (right, 148.0 - ANGLES, ANGLES, known.fit.q_deg_mm, known.fit.table.q_deg_mm),
    ):
        lines = curves(ax)
        np.testing.assert_array_equal(lines["linkage (Eq. 1–9)"], (x[::30], y[::30]))
        np.testing.assert_array_equal(lines["quintic fit"], (x, np.polyval(fit, x)))
        np.testing.assert_array_equal(lines["Table 1"], (x, np.polyval(table, x)))
    rod, error = drawn["fig09_ideal_smc"].axes
    lines = curves(rod)
    assert lines["reference"][1] == pytest.approx([100.0, 110.0, 120.0, 130.0])
    assert lines["rod extension"][1] == pytest.approx([50.0, 100.0, 119.8, 129.99])
    for ax, sign in ((error, 1.0), (error.child_axes[0], -1.0)):
        x, y = ax.lines[0].get_data()
        assert x == pytest.approx(TIME)
        assert y == pytest.approx(sign * np.array([-50.0, -10.0, -0.2, -0.01]))
    panels = np.reshape(drawn["fig12_tracking"].axes, (3, 2))
    for n, (angle, wrong) in enumerate(panels):
        lines = curves(angle)
        assert lines["knee angle"][1] == pytest.approx((n + 1) * np.array([40, 40, 44, 40.0]))
        assert lines["reference"][1] == pytest.approx((n + 1) * np.array([40, 41, 42, 43.0]))
        assert wrong.lines[0].get_ydata() == pytest.approx((n + 1) * np.array([0, 1, -2, 3.0]))
        assert f"max {(n + 1) * 0.11:.2f}°" in wrong.get_title()
        assert ("PID" in angle.get_title()) == (n > 0)
    assert all(panels[0, 0].get_shared_x_axes().joined(panels[0, 0], ax) for ax in panels.flat)
    assert [ax.get_xlabel() for ax in panels.flat] == [""] * 4 + ["time (s)"] * 2
    exact, counts = drawn["eq27_at_2ms"].axes
    assert (exact.get_ylim(), counts.get_ylim()) == ((1e-2, 1e4), (-24.0, 16.0))
    assert [ax.get_ylabel() for ax in (exact, counts)] == [
        *("|load pressure| (Pa)", "tracking error (deg)")
    ]
    for ax in (exact, counts):
        assert (ax.get_xlabel(), ax.get_legend().get_title().get_text()) == (
            "time (s)",
            "k/Φ (1/s)",
        )
    for name, run in known.eq27_exact.items():
        x, y = curves(exact)[name]
        assert x == pytest.approx(run.time_s)
        assert y == pytest.approx(np.abs(run["load_pressure_pa"]))
    for name, factor in zip(known.eq27_differences, (10, 20), strict=True):
        assert curves(counts)[name][1] == pytest.approx(factor * np.array([0, 1, -2, 3.0]))
    for figure in drawn.values():
        assert all(ax.get_ylabel() for ax in figure.axes)


def test_fig_13_has_trials_means_our_crossing_and_the_papers(known, curves):
    gain, phase = figures(known)["fig13_frequency_response"].axes
    decibels = 20.0 * np.log10(GAINS)
    for ax, each, mean in (
        (gain, decibels, 20.0 * np.log10([0.95, 0.75, 0.55])),
        (phase, PHASES, np.array([-11.0, -22.0, -44.0])),
    ):
        for line, values in zip(ax.lines, each, strict=False):
            assert line.get_ydata() == pytest.approx(values)
        lines = curves(ax)
        assert lines["mean"][0] == pytest.approx([0.1, 0.2, 0.4])
        assert lines["mean"][1] == pytest.approx(mean)
        fine, values = lines["PCHIP"]
        through = PchipInterpolator([0.1, 0.2, 0.4], 10.0 ** (mean / 20.0))(fine)
        if ax is gain:
            assert values == pytest.approx(20.0 * np.log10(through), abs=0.05)
        assert values[[0, -1]] == pytest.approx(mean[[0, -1]])
    vertical = {
        line.get_label(): line.get_xdata()[0]
        for line in gain.lines
        if len(set(line.get_xdata())) == 1
    }
    paper = [label for label in vertical if label.startswith("paper")]
    assert paper[0] in [text.get_text() for text in gain.get_legend().get_texts()]
    assert [vertical[label] for label in paper] == [0.21]
    assert "0.21 Hz" in paper[0]
    assert sorted(vertical.values()) == [0.21, 0.22]


def test_the_speed_limit_does_not_explain_the_error_at_a_tenth_of_a_hertz():
    peak, saturation = speed_demand()
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
    eigenvalues = linearize_loop(EQ_27_EXACT_STATES[name], 30.0).eigenvalues
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
