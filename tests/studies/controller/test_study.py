import math
from itertools import product

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from kneexo.command_line.output import to_json
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import (
    DifferenceParameters,
    Scenario,
    SimulationParameters,
    SineReference,
    SlidingModeParameters,
    StepReference,
)
from kneexo.parameters.paths import changed
from kneexo.simulation.engines import simulate
from kneexo.studies.controller import study as module
from kneexo.studies.controller.figures import figures
from kneexo.studies.controller.report import report
from kneexo.studies.controller.result import (
    MAP_METRICS,
    METRICS,
    ControllerResult,
    LimitCycleCase,
    ideal_settling_time_s,
)
from kneexo.studies.controller.settings import ControllerSettings
from kneexo.studies.controller.study import (
    LIMIT_CYCLE_VARIANTS,
    controller_study,
    experiments,
    settling_time_s,
)
from kneexo.studies.paper import IDEAL_SMC, PID_PAPER
from kneexo.sweeps.checkpoint import Checkpoint

GRID = ControllerSettings(
    lambdas_per_s=(10.0, 20.0, 40.0),
    phis_m_s2=(0.32, 1.0, 3.2, 10.0, 32.0),
    etas_m_s3=(2.8e4, 2.8e5),
    map_time_constants_s=(0.01, 0.02),
    map_slopes_per_s=(1e4, 1e5),
)
SHAPE = (3, 5, 2)


def made_up(failures=None, **values):
    """A study whose arrays are given by functions of λ, Φ and η; all loops stable and sound."""
    axes = (GRID.lambdas_per_s, GRID.phis_m_s2, GRID.etas_m_s3)
    given = dict.fromkeys(METRICS, lambda lambda_, phi, eta: 1.0)
    given["saturated_share"] = lambda lambda_, phi, eta: 0.0
    arrays = {
        name: np.array([function(*point) for point in product(*axes)]).reshape(SHAPE)
        for name, function in (given | values).items()
    }
    mapped = {name: np.ones((2, 2)) for name in MAP_METRICS}
    return ControllerResult(Scenario(), GRID, arrays, failures or {}, (), mapped)


# ------------------------------------------------------------------------ settling of a step


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_settling_time_of_a_decay_is_its_logarithm(rate):
    time = np.arange(0.0, 8.0, 0.002)
    settling_s = settling_time_s(time, np.exp(-rate * time), 0.05)
    assert settling_s == pytest.approx(math.log(20.0) / rate, abs=0.002)  # one sample


def test_settling_counts_the_last_time_outside_the_band():
    time = np.arange(6.0)
    assert settling_time_s(time, np.array([9.0, 0.0, 0.0, -2.0, 0.5, 0.0]), 1.0) == 3.0
    assert settling_time_s(time, np.array([9.0, 0.0, 0.0, 0.0, 0.0, 1.1]), 1.0) == math.inf
    assert settling_time_s(time, np.array([9.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 1.0) == 0.0


def test_ideal_settling_time_solves_the_sliding_surface():
    lambda_ = 7.0
    surface = solve_ivp(
        lambda t, e: [e[1], -2.0 * lambda_ * e[1] - lambda_**2 * e[0]],
        (0.0, 2.0),
        [1.0, 0.0],
        rtol=1e-10,
        atol=1e-12,
        dense_output=True,
    )
    at = ideal_settling_time_s(lambda_, 0.1)
    assert surface.sol(at)[0] == pytest.approx(0.1, rel=1e-6)  # the solver's tolerance


# ------------------------------------------------------------------------------ the claims


def test_slope_is_beta_eta_over_phi():
    beta = math.sqrt(1.8 / 1.4)
    assert made_up().slope_per_s[2] == pytest.approx([beta * 2.8e4 / 3.2, beta * 2.8e5 / 3.2])


def test_the_centre_is_the_scenarios_own_controller():
    assert made_up().centre == (1, 2, 1)


def test_larger_lambda_settles_faster_in_every_case():
    claim = made_up(settling_s=lambda lambda_, phi, eta: 4.0 / lambda_).claims()[0]
    assert (claim.cases, claim.share, claim.verdict) == (20, 1.0, "true")
    assert (claim.sound_cases, claim.sound_share) == (20, 1.0)
    slower = made_up(settling_s=lambda lambda_, phi, eta: lambda_).claims()[0]
    assert (slower.share, slower.verdict) == (0.0, "false")


def test_a_step_that_never_settles_is_slower_and_two_of_them_decide_nothing():
    def settling(lambda_, phi, eta):
        return {10.0: math.inf, 20.0: 0.2, 40.0: math.inf}[lambda_] if phi < 1.0 else math.inf

    claim = made_up(settling_s=settling).claims()[0]
    # At Φ = 0.32 and both η: ∞ to 0.2 s holds, 0.2 s to ∞ does not.
    assert (claim.cases, claim.share, claim.verdict) == (4, 0.5, "true in part")
    undecided = made_up(settling_s=lambda lambda_, phi, eta: math.nan).claims()[0]
    assert (undecided.cases, undecided.verdict) == (0, "not decided")
    assert math.isnan(undecided.share)


def test_wrong_phi_chatters_when_the_command_changes_more_on_both_sides():
    calmest = {10.0: 0.32, 20.0: 1.0, 40.0: 3.2}

    def change(lambda_, phi, eta):
        return 10.0 * math.exp(abs(math.log(phi / calmest[lambda_])))

    claim = made_up(mean_command_change_rpm=change).claims()[1]
    # 6 lines of 5 Φ, neighbours by about √10: all but the calmest are wrong, and chatter.
    assert (claim.cases, claim.verdict) == (24, "true")
    assert "0.32, 1, 3.2 m/s² at λ = 10, 20, 40 1/s" in claim.finding
    # λβη/Φ at η = 2.8e5: 10/0.32, 20/1 and 40/3.2 times 3.175e5
    assert "λk/Φ there is 4e+06…9.9e+06 1/s²" in claim.finding


def test_phi_does_not_chatter_where_the_command_is_calm_throughout():
    claim = made_up().claims()[1]
    assert (claim.share, claim.verdict) == (0.0, "false")


def test_failed_runs_are_no_cases_of_chattering():
    def change(lambda_, phi, eta):
        return math.nan if phi > 1.0 else {0.32: 100.0, 1.0: 10.0}[phi]

    claim = made_up(mean_command_change_rpm=change).claims()[1]
    assert (claim.cases, claim.share) == (6, 1.0)
    assert "too large a Φ in – of 0" in claim.finding


def test_larger_eta_tracks_better_where_nothing_saturates():
    claim = made_up(max_error_deg=lambda lambda_, phi, eta: phi / eta).claims()[2]
    assert (claim.cases, claim.share, claim.verdict) == (15, 1.0, "true")


@pytest.mark.parametrize(
    ("unsound", "sound_cases"),
    [
        # Of 20 pairs of λ, 24 wrong Φ and 15 pairs of η: those without an unsound loop.
        (lambda lambda_, phi, eta: lambda_ == 10.0, (10, 16, 10)),
        (lambda lambda_, phi, eta: lambda_ == 40.0, (10, 16, 10)),
        (lambda lambda_, phi, eta: phi == 32.0, (16, 18, 12)),
        (lambda lambda_, phi, eta: eta == 2.8e4, (10, 12, 0)),
        (lambda lambda_, phi, eta: eta == 2.8e5, (10, 12, 0)),
    ],
)
def test_a_sound_case_lies_between_sound_loops(unsound, sound_cases):
    claims = made_up(
        settling_s=lambda lambda_, phi, eta: 4.0 / lambda_,
        mean_command_change_rpm=lambda lambda_, phi, eta: 10.0 * math.exp(abs(math.log(phi))),
        max_error_deg=lambda lambda_, phi, eta: phi / eta,
        disk_margin=lambda *point: 0.4999 if unsound(*point) else 0.5,
    ).claims()
    assert [claim.cases for claim in claims] == [20, 24, 15]
    assert tuple(claim.sound_cases for claim in claims) == sound_cases


def test_saturated_and_unstable_points_are_counted_apart():
    claim = made_up(
        max_error_deg=lambda lambda_, phi, eta: eta / phi,
        saturated_share=lambda lambda_, phi, eta: 0.5 if phi < 1.0 and eta > 1e5 else 0.0,
        stable=lambda lambda_, phi, eta: 0.0 if phi == 1.0 and eta > 1e5 else 1.0,
    ).claims()[2]
    assert (claim.cases, claim.share, claim.verdict) == (9, 0.0, "false")
    assert "the error falls in 0 % of 6 cases" in claim.finding


def test_what_counts_is_the_slope():
    claim = made_up(max_error_deg=lambda lambda_, phi, eta: 1e5 * phi / eta).claims()[2]
    # 1e5 Φ/η at the centre's Φ/η = 3.2/2.8e5, whatever η.
    assert "the same η give 1.14, 1.14°" in claim.finding


# -------------------------------------------------------------------------------- the runs

BASE = Scenario(
    reference=SineReference(amplitude_deg=1.0, frequency_hz=4.0),
    simulation=SimulationParameters(duration_s=0.5),
)
SMALL = ControllerSettings(
    lambdas_per_s=(20.0, 40.0),
    phis_m_s2=(1.0, 3.2),
    etas_m_s3=(2.8e5,),
    step_duration_s=0.4,
    large_step_deg=5.0,
    fast_duration_s=0.2,
    fast_frequency_hz=10.0,
    fast_amplitude_deg=0.2,
    hold_duration_s=0.1,
    limit_cycle_lambdas_per_s=(20.0,),
    map_time_constants_s=(0.01, 0.02),
    map_slopes_per_s=(1e4, 1e5),
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    checkpoint = Checkpoint(tmp_path_factory.mktemp("study") / "checkpoint.jsonl")
    return controller_study(BASE, SMALL, checkpoint=checkpoint), checkpoint


def settled(scenario, size_deg):
    """Last time at which a step about 40° is more than 0.2° off; inf when that is the end."""
    step = StepReference(start_deg=40 - size_deg / 2, end_deg=40 + size_deg / 2, time_s=0.0)
    values = {"reference": step, "simulation.duration_s": 0.4}
    run = simulate(changed(scenario, values), signals=("knee_angle",))
    away = np.abs(np.degrees(run["knee_angle_rad"]) - step.end_deg)
    last = run.time_s[away > 0.2].max()
    return math.inf if last == run.time_s[-1] else last


def with_slope(slope_per_s, observer_s):
    phi = math.sqrt(1.8 / 1.4) * 2.8e5 / slope_per_s
    values = {"controller.phi_m_s2": phi, "estimator.time_constant_s": observer_s}
    return changed(BASE, values)


def test_every_row_is_that_of_runs_and_margins_of_its_own_scenario(small, in_numbers, margins):
    study, _ = small
    fast = SineReference(mean_deg=40.0, amplitude_deg=0.2, frequency_hz=10.0)
    for i, j in product(range(2), range(2)):
        gains = {"controller.lambda_per_s": (20.0, 40.0)[i], "controller.phi_m_s2": (1.0, 3.2)[j]}
        scenario = changed(BASE, gains)
        faster = changed(scenario, {"reference": fast, "simulation.duration_s": 0.2})
        expected = in_numbers(scenario, 0.25) | margins(scenario, 40.0)
        expected |= {
            "fast_max_error_deg": in_numbers(faster, 0.1)["max_error_deg"],
            "settling_s": settled(scenario, 2.0),
            "large_settling_s": settled(scenario, 5.0),
        }
        row = {name: values[i, j, 0] for name, values in study.values.items()}
        expected = {name: expected[name] for name in METRICS}
        assert row == pytest.approx(expected, rel=1e-9, nan_ok=True)
    assert study.failures == {}


def test_the_band_of_settling_is_smaller_than_the_steps():
    with pytest.raises(ParameterError, match=r"settling_band_deg = 0\.2 deg: must be less than"):
        ControllerSettings(step_deg=0.2)


def test_every_loop_of_the_map_has_its_own_observer_and_slope(small, in_numbers, margins):
    study, _ = small
    for i, j in product(range(2), range(2)):
        scenario = with_slope((1e4, 1e5)[j], (0.01, 0.02)[i])
        expected = in_numbers(scenario, 0.25) | margins(scenario, 40.0)
        row = {name: values[i, j] for name, values in study.map_values.items()}
        assert row == pytest.approx({name: expected[name] for name in MAP_METRICS}, rel=1e-6)


def test_the_trap_has_its_variants(small, in_numbers, margins):
    cases = {case.variant: case for case in small[0].limit_cycle}
    variants = {
        "as built": {},
        "exact encoder": {"encoder.quantized": False},
        "unlimited acceleration": {"plant.pump.acceleration_limit_rad_s2": 1e7},
    }
    assert set(cases) == set(variants)
    for variant, values in variants.items():
        scenario = changed(with_slope(1e4, 0.008), values)
        expected = in_numbers(scenario, 0.25) | margins(scenario, 40.0)
        for name in ("max_error_deg", "mean_command_change_rpm", "stable", "disk_margin"):
            assert getattr(cases[variant], name) == pytest.approx(expected[name], rel=1e-6)
    # Linear loops know neither counts nor limits.
    assert len({case.disk_margin for case in cases.values()}) == 1
    assert cases["exact encoder"].time_s.shape == cases["exact encoder"].error_deg.shape == (251,)


def test_the_oscillation_at_rest_is_that_of_the_later_half_of_the_hold(small):
    law = SlidingModeParameters()
    own = changed(
        BASE,
        {
            "controller.lambda_per_s": 20.0,
            "controller.phi_m_s2": law.gain_ratio * law.eta_m_s3 / SMALL.limit_cycle_slope_per_s,
            "estimator.time_constant_s": SMALL.limit_cycle_time_constant_s,
        },
    )
    run = simulate(experiments(own, SMALL)["hold"], signals=("knee_angle",))
    angle = run["knee_angle_rad"][run.time_s >= 0.05 - 1e-9]  # the reference is constant
    built = next(case for case in small[0].limit_cycle if case.variant == "as built")
    assert built.oscillation_at_rest_deg == pytest.approx(np.degrees(np.ptp(angle)), rel=1e-9)


def test_a_finished_study_is_taken_from_its_checkpoint(small, monkeypatch):
    study, checkpoint = small

    def refuse(*arguments, **keywords):
        raise AssertionError("computed again")

    monkeypatch.setattr(module, "track", refuse)
    again = controller_study(
        BASE, SMALL, checkpoint=Checkpoint(checkpoint.path, resume=True), progress=True
    )
    assert to_json(again.results()) == to_json(study.results())
    assert report(again) == report(study)


@pytest.mark.slow
def test_every_figure_can_be_drawn(small):
    for figure in figures(small[0]).values():
        figure.canvas.draw()


# --------------------------------------------------------- results, report and figures by hand


def limit_cycle_case(number, lambda_, variant):
    return LimitCycleCase(
        lambda_per_s=lambda_,
        variant=variant,
        stable=number != 2,
        disk_margin=0.11 + 0.01 * number,
        max_error_deg=1.1 + number,
        mean_command_change_rpm=31.0 + number,
        oscillation_at_rest_deg=0.21 + 0.1 * number,
        time_s=np.array([0.0, 1.0, 2.0]),
        error_deg=np.array([0.1, 0.2, 0.3]) + number,
        failure="",
    )


@pytest.fixture(scope="module")
def by_hand():
    """A study in which no two numbers are equal."""
    grid = np.arange(30.0).reshape(SHAPE)
    values = {name: 0.05 + 0.001 * grid + 0.04 * n for n, name in enumerate(METRICS)}
    values["stable"] = np.where(grid % 7 == 3, 0.0, 1.0)
    values["settling_s"][0, 0, 0] = math.inf
    values["disk_margin"][2, 4, 0] = math.nan
    mapped = {
        name: 0.3 + 0.1 * n + np.array([[0.01, 0.02], [0.03, 0.04]])
        for n, name in enumerate(MAP_METRICS)
    }
    mapped["stable"] = np.array([[1.0, 1.0], [1.0, 0.0]])
    limit_cycle = [
        limit_cycle_case(n, lambda_, variant)
        for n, (lambda_, variant) in enumerate(
            product(GRID.limit_cycle_lambdas_per_s, LIMIT_CYCLE_VARIANTS)
        )
    ]
    failures = {(10.0, 0.32, 2.8e4): "left the range"}
    return ControllerResult(Scenario(), GRID, values, failures, tuple(limit_cycle), mapped)


def test_results_are_the_grid_the_trap_and_the_map(by_hand, flat, check_rules):
    numbers = by_hand.results()
    check_rules({name: numbers[name] for name in ("grid", "map", "limit_cycle", "claims")})
    beta = math.sqrt(1.8 / 1.4)
    expected = {
        "lambdas_per_s": GRID.lambdas_per_s,
        "phis_m_s2": GRID.phis_m_s2,
        "etas_m_s3": GRID.etas_m_s3,
        "slope_per_s": [[beta * eta / phi for eta in GRID.etas_m_s3] for phi in GRID.phis_m_s2],
        "grid": by_hand.values,
        "failures": [
            {"lambda_per_s": 10.0, "phi_m_s2": 0.32, "eta_m_s3": 2.8e4, "why": "left the range"}
        ],
        "limit_cycle": [
            {key: v for key, v in vars(case).items() if key not in ("time_s", "error_deg")}
            for case in by_hand.limit_cycle
        ],
        "map": {
            "time_constants_s": GRID.map_time_constants_s,
            "slopes_per_s": GRID.map_slopes_per_s,
            **by_hand.map_values,
        },
    }
    own = {name: value for name, value in numbers.items() if name != "claims"}
    assert flat(own) == pytest.approx(flat(expected), nan_ok=True)
    for claim, written in zip(by_hand.claims(), numbers["claims"], strict=True):
        assert written == vars(claim) | {"verdict": claim.verdict}


def test_every_cell_of_the_report_is_in_the_study(by_hand, tables, check_cells):
    claims, *lines, limit_cycle = tables(report(by_hand))
    for row, claim in zip(claims[1:], by_hand.claims(), strict=True):
        assert row[2] == str(claim.cases)
        assert row[5] == str(claim.sound_cases)
        assert row[4] == f"**{claim.verdict}**"
        for cell, share in ((row[3], claim.share), (row[6], claim.sound_share)):
            assert cell == ("–" if math.isnan(share) else f"{100 * share:.0f} %")
    assert claims[0][5] == "between loops of disk margin ≥ 0.5: cases"
    assert [row[0] for row in claims[1:]] == [f"“{claim.quote}”" for claim in by_hand.claims()]
    assert [row[1] for row in claims[1:]] == [claim.case for claim in by_hand.claims()]
    for table in lines:
        assert table[0][1:] == [
            *("k/Φ (1/s)", "max error (deg)", "command change (rpm/sample)", "saturated share"),
            "max error at 1 Hz (deg)",
            *(f"{size}° step, settling to ±0.2° (s)" for size in (2, 20)),
            *("disk margin", "phase margin (deg)"),
        ]
    # Along λ, Φ and η through the default: λ = 20, Φ = 3.2, η = 2.8e5.
    assert by_hand.centre == (1, 2, 1)
    columns = (
        "max_error_deg",
        "mean_command_change_rpm",
        "saturated_share",
        "fast_max_error_deg",
        "settling_s",
        "large_settling_s",
        "disk_margin",
        "phase_margin_deg",
    )
    beta = math.sqrt(1.8 / 1.4)
    axes = (GRID.lambdas_per_s, GRID.phis_m_s2, GRID.etas_m_s3)
    for axis, (shown, along) in enumerate(zip(lines, axes, strict=True)):
        rows = []
        for n, value in enumerate(along):
            at = tuple(n if i == axis else c for i, c in enumerate((1, 2, 1)))
            slope = beta * GRID.etas_m_s3[at[2]] / GRID.phis_m_s2[at[1]]
            rows.append([value, slope, *(float(by_hand.values[name][at]) for name in columns)])
        check_cells(shown, rows)
        assert shown[0][0] == ("λ (1/s)", "Φ (m/s²)", "η (m/s³)")[axis]
    per_sample = math.pi / 30.0 / 0.002  # rad/s² of 1 rpm in a sample
    check_cells(
        limit_cycle,
        [
            [
                case.lambda_per_s,
                case.variant,
                "stable" if case.stable else "unstable",
                case.disk_margin,
                case.max_error_deg,
                case.mean_command_change_rpm,
                case.mean_command_change_rpm * per_sample,
                case.oscillation_at_rest_deg,
            ]
            for case in by_hand.limit_cycle
        ],
    )


def test_the_words_have_the_largest_error_of_a_stable_loop(by_hand):
    text = report(by_hand)
    limit = Scenario().plant.pump.acceleration_limit_rad_s2
    demand = 31.0 * math.pi / 30.0 / 0.002 / limit
    for said in (
        "30 points; 1 of them have a run that failed",
        f"mean change is {demand:.2g} times",
        "## A limit cycle: T_f = 8 ms, k/Φ = 10000 1/s",
        "brings a step of 2° to within ±0.2° of its end sooner",
        "Φ at least 3 times larger or smaller",
        "more than 2 times as much per sample",
        "less than 1 % of its samples saturated",
        "errs by up to 0.33° (T_f = 20 ms, k/Φ = 1e+04 1/s)",
        "The step of 20° settles to the same ±0.2° in",
        "λ, at Φ (m/s²) = 3.2, η (m/s³) = 280000\n",
        "Φ, at λ (1/s) = 20, η (m/s³) = 280000\n",
        "η, at λ (1/s) = 20, Φ (m/s²) = 3.2\n",
    ):
        assert said in text


def test_the_maps_have_their_axes_where_the_labels_say(by_hand, check_heat_map):
    drawn = figures(by_hand)
    beta = math.sqrt(1.8 / 1.4)
    panels = (
        ("study_lambda_slope", "λ (1/s)", "k/Φ (1/s)"),
        ("study_phi_eta", "Φ (m/s²)", "η (m/s³)"),
    )
    names = {
        "study_lambda_slope": (
            *("max_error_deg", "mean_command_change_rpm", "settling_s", "disk_margin"),
        ),
        "study_phi_eta": (
            *("max_error_deg", "mean_command_change_rpm", "saturated_share", "disk_margin"),
        ),
    }
    rising = beta * 2.8e5 / np.array(GRID.phis_m_s2[::-1])
    for title, across, up in panels:
        axes = drawn[title].axes
        assert axes[2].get_xlabel() == across
        assert axes[0].get_ylabel() == up
        for ax, name in zip(axes[:4], names[title], strict=True):
            values = np.where(np.isinf(by_hand.values[name]), np.nan, by_hand.values[name])
            if title == "study_lambda_slope":  # at the default η; the smallest Φ is on top
                check_heat_map(ax, GRID.lambdas_per_s, rising, values[:, ::-1, 1])
                stable = by_hand.values["stable"][:, ::-1, 1]
                x, y, default = GRID.lambdas_per_s, rising, (20.0, rising[2])
            else:  # at the default λ
                check_heat_map(ax, GRID.phis_m_s2, GRID.etas_m_s3, values[1])
                stable = by_hand.values["stable"][1]
                x, y, default = GRID.phis_m_s2, GRID.etas_m_s3, (3.2, 2.8e5)
            crosses, star = ax.lines[:2]
            unstable = sorted((x[i], y[j]) for i, j in np.argwhere(stable == 0.0))
            marked = sorted(zip(*crosses.get_data(), strict=True))
            assert np.array(marked) == pytest.approx(np.array(unstable))
            assert np.ravel(star.get_data()) == pytest.approx(default)
            if title == "study_phi_eta":  # dashed: where k/Φ = βη/Φ is a power of ten
                low = ax.get_xlim()[0], ax.get_ylim()[0]
                for line, text, power in zip(ax.lines[2:], ax.texts, (4, 5, 6), strict=True):
                    phis, etas = (np.asarray(values) for values in line.get_data())
                    assert beta * etas / phis == pytest.approx([10.0**power] * 2)
                    at = text.get_position()
                    assert beta * at[1] / at[0] == pytest.approx(10.0**power)
                    # Beside the left or above the lower edge, whichever the line meets.
                    away = at[0] / low[0] / 1.1, at[1] / low[1] / 1.7
                    assert min(away) == pytest.approx(1.0)
                    assert text.get_text() == f"10$^{power}$"
    _, error, margin, *_ = drawn["study_limit_cycle"].axes
    for ax, name in ((error, "max_error_deg"), (margin, "disk_margin")):
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("T_f (ms)", "k/Φ (1/s)")
        check_heat_map(ax, [10.0, 20.0], GRID.map_slopes_per_s, by_hand.map_values[name])
        crosses, star, circle = ax.lines
        assert np.ravel(crosses.get_data()) == pytest.approx([20.0, 1e5])
        assert np.ravel(star.get_data()) == pytest.approx([20.0, beta * 2.8e5 / 3.2])
        at = [1e3 * GRID.limit_cycle_time_constant_s, GRID.limit_cycle_slope_per_s]
        assert np.ravel(circle.get_data()) == pytest.approx(at)


def test_the_lines_of_the_claims_are_those_of_the_grid(by_hand, curves):
    drawn = figures(by_hand)
    faster, chattering, adherent, collapse = drawn["study_claims"].axes
    values, beta = by_hand.values, math.sqrt(1.8 / 1.4)
    lines = curves(faster)
    for label, name in (
        (f"step of {GRID.step_deg:g}°", "settling_s"),
        (f"step of {GRID.large_step_deg:g}°", "large_settling_s"),
    ):
        assert lines[label][0] == pytest.approx(GRID.lambdas_per_s)
        assert lines[label][1] == pytest.approx(values[name][:, 2, 1])
    assert lines["s = 0 alone"][1] == pytest.approx(
        [ideal_settling_time_s(x, 0.2 / GRID.step_deg) for x in GRID.lambdas_per_s]
    )
    for ax, labels, x, of in (
        (
            chattering,
            GRID.lambdas_per_s,
            GRID.phis_m_s2,
            lambda n: values["mean_command_change_rpm"][n, :, 1],
        ),
        (adherent, GRID.phis_m_s2, GRID.etas_m_s3, lambda n: values["max_error_deg"][1, n]),
    ):
        for label, (xs, ys) in curves(ax).items():
            assert xs == pytest.approx(x)
            assert ys == pytest.approx(of(labels.index(float(label))))
    for n, eta in enumerate(GRID.etas_m_s3):
        xs, ys = curves(collapse)[f"{eta:g}"]
        assert xs == pytest.approx(beta * eta / np.array(GRID.phis_m_s2))
        assert ys == pytest.approx(values["max_error_deg"][1, :, n])
    spans = (  # with room for the legend above the highest value
        (faster, "λ (1/s)", "settling time to ±0.2° (s)"),
        (chattering, "Φ (m/s²)", "mean command change (rpm/sample)"),
        (adherent, "η (m/s³)", "max error (deg)"),
        (collapse, "k/Φ (1/s)", "max error (deg)"),
    )
    for ax, across, up in spans:
        assert (ax.get_xlabel(), ax.get_ylabel()) == (across, up)
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
        highest = max(np.max(y[np.isfinite(y)]) for _, y in curves(ax).values())
        assert ax.get_ylim()[1] > highest
    assert list(faster.get_yticks()) == [0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0]
    assert list(faster.get_xticks()) == [10.0, 40.0]
    assert [float(label) for label in curves(chattering)] == [10.0, 20.0, 40.0]
    assert [float(label) for label in curves(adherent)] == [0.32, 1.0, 3.2, 10.0, 32.0]
    limit_cycle = drawn["study_limit_cycle"].axes[0]
    assert (limit_cycle.get_xlabel(), limit_cycle.get_ylabel()) == (
        "time (s)",
        "tracking error (deg)",
    )
    assert limit_cycle.get_title().endswith("λ = 20 1/s")
    lines = curves(limit_cycle)
    shown = [c for c in by_hand.limit_cycle if c.lambda_per_s == GRID.limit_cycle_lambdas_per_s[0]]
    assert list(lines) == [case.variant for case in shown]
    for case in shown:
        assert lines[case.variant][1] == pytest.approx(case.error_deg)


# ------------------------------------------------------------------------------ a run that fails


def test_a_run_that_fails_leaves_nan_and_its_reason(monkeypatch):
    def fail(scenario, **keywords):
        raise SimulationError("t = 1 s: knee_angle left the range of motion")

    monkeypatch.setattr(module, "track", fail)
    one = SMALL.model_dump() | {"lambdas_per_s": (20.0,), "phis_m_s2": (3.2,)}
    study = controller_study(BASE, ControllerSettings(**one))
    assert study.failures == {
        (20.0, 3.2, 2.8e5): "t = 1 s: knee_angle left the range of motion",
    }
    assert math.isnan(study.values["settling_s"][0, 0, 0])
    assert study.values["max_error_deg"][0, 0, 0] > 0.0
    assert {case.failure for case in study.limit_cycle} == set(study.failures.values())
    assert all(math.isnan(case.max_error_deg) for case in study.limit_cycle)
    assert "1 of them have a run that failed" in report(study)
    for figure in figures(study).values():
        plt.close(figure)


# ------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        (Scenario(controller=PID_PAPER), "controller.kind = pid: must be a sampled smc"),
        (IDEAL_SMC, "controller.kind = smc: must be a sampled smc"),
        (Scenario(estimator=DifferenceParameters()), "estimator.kind = difference: must be"),
        (
            Scenario(reference=SineReference(mean_deg=85.0, amplitude_deg=1.0)),
            "end_deg = 95 deg is",
        ),
    ],
)
def test_a_scenario_that_cannot_be_studied_is_one_line(scenario, message):
    with pytest.raises(ParameterError, match=message) as caught:
        controller_study(scenario)
    assert "\n" not in str(caught.value)


def test_a_grid_must_increase():
    with pytest.raises(ParameterError, match=r"etas_m_s3: must increase"):
        ControllerSettings(etas_m_s3=(2.0, 1.0))
    with pytest.raises(ParameterError, match=r"lambdas_per_s"):
        ControllerSettings(lambdas_per_s=(-1.0, 1.0))


def test_experiments_lie_about_the_middle_of_the_reference():
    cases = experiments(Scenario(), ControllerSettings())
    assert cases["step"].reference.range_deg == (39.0, 41.0)
    assert cases["large_step"].reference.range_deg == (30.0, 50.0)
    assert cases["hold"].reference.range_deg == (68.0, 70.0)
    assert cases["fast"].reference.range_deg == (37.5, 42.5)


# ------------------------------------------------------------------- the paper's own task


@pytest.mark.slow
def test_the_trap_is_stable_and_errs_by_degrees():
    """Second program (docs/model.md, reference numbers): 3–5° at λ = 20, tens of them at λ = 10."""
    settings = ControllerSettings(
        lambdas_per_s=(20.0,),
        phis_m_s2=(3.2,),
        etas_m_s3=(2.8e5,),
        map_time_constants_s=(0.02,),
        map_slopes_per_s=(1e5,),
    )
    study = controller_study(settings=settings)
    cases = {(case.lambda_per_s, case.variant): case for case in study.limit_cycle}
    assert all(case.stable for case in cases.values())
    assert 3.0 < cases[20.0, "as built"].max_error_deg < 5.0
    assert cases[10.0, "as built"].max_error_deg > 10.0
    for lambda_ in (20.0, 10.0):
        # It takes the counts to set it off, and the limit to make it large.
        exact = cases[lambda_, "exact encoder"]
        unlimited = cases[lambda_, "unlimited acceleration"]
        assert exact.max_error_deg < unlimited.max_error_deg
        assert unlimited.max_error_deg < 0.5 * cases[lambda_, "as built"].max_error_deg
        assert exact.mean_command_change_rpm < 5.0
    # The default beside it, docs/validation.md: 0.047°.
    assert study.values["max_error_deg"][0, 0, 0] == pytest.approx(0.047, abs=0.001)
