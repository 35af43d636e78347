import math
from itertools import product

import numpy as np
import pytest
from controller_cases import (
    GRID,
    SHAPE,
)
from scipy.integrate import solve_ivp

from kneexo.parameters import (
    Scenario,
)
from kneexo.studies.controller.result import (
    MAP_METRICS,
    METRICS,
    ControllerResult,
    ideal_settling_time_s,
)


def made_up(failures=None, **values):
    """A study whose arrays are given by functions of λ, Φ and η; all loops stable and sound."""
    axes = (GRID.lambdas_per_s, GRID.phis_m_s2, GRID.etas_m_s3)
    defaults = dict.fromkeys(METRICS, lambda lambda_, phi, eta: 1.0)
    defaults["saturated_share"] = lambda lambda_, phi, eta: 0.0
    arrays = {
        name: np.array([function(*point) for point in product(*axes)]).reshape(SHAPE)
        for name, function in (defaults | values).items()
    }
    mapped = {name: np.ones((2, 2)) for name in MAP_METRICS}
    return ControllerResult(Scenario(), GRID, arrays, failures or {}, (), mapped)


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


def test_results_are_the_grid_the_trap_and_the_map(by_hand, flat):
    numbers = by_hand.results()
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
    without_claims = {name: value for name, value in numbers.items() if name != "claims"}
    assert flat(without_claims) == pytest.approx(flat(expected), nan_ok=True)
    for claim, written in zip(by_hand.claims(), numbers["claims"], strict=True):
        assert written == vars(claim) | {"verdict": claim.verdict}
