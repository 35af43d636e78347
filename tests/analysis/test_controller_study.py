import json
import math
from itertools import product

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from kneexo.analysis import controller_study as module
from kneexo.analysis.assessment import assess
from kneexo.analysis.checkpoint import Checkpoint
from kneexo.analysis.controller_study import (
    FIGURES,
    MAP_FIGURES,
    ControllerStudy,
    controller_study,
    experiments,
    ideal_settling_time_s,
    settling_time_s,
)
from kneexo.analysis.simulation import simulate
from kneexo.errors import ParameterError, SimulationError
from kneexo.output import to_json
from kneexo.parameters import (
    IDEAL_SMC,
    PID_PAPER,
    ControllerStudyParameters,
    DifferenceParameters,
    Scenario,
    SimulationParameters,
    SineReference,
    SlidingModeParameters,
)
from kneexo.scenario import changed

GRID = ControllerStudyParameters(
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
    given = dict.fromkeys(FIGURES, lambda lambda_, phi, eta: 1.0)
    given["saturated_share"] = lambda lambda_, phi, eta: 0.0
    arrays = {
        name: np.array([function(*point) for point in product(*axes)]).reshape(SHAPE)
        for name, function in (given | values).items()
    }
    mapped = {name: np.ones((2, 2)) for name in MAP_FIGURES}
    return ControllerStudy(Scenario(), GRID, arrays, failures or {}, (), mapped)


# ------------------------------------------------------------------------ settling of a step


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_settling_time_of_a_decay_is_its_logarithm(rate):
    time = np.arange(0.0, 8.0, 0.002)
    found = settling_time_s(time, np.exp(-rate * time), 0.05)
    assert found == pytest.approx(math.log(20.0) / rate, abs=0.002)  # one sample


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
    simulation=SimulationParameters(duration_s=0.5, integrator="radau3"),  # nothing to compile
)
SMALL = ControllerStudyParameters(
    lambdas_per_s=(20.0, 40.0),
    phis_m_s2=(1.0, 3.2),
    etas_m_s3=(2.8e5,),
    step_duration_s=0.1,
    large_step_deg=5.0,
    fast_duration_s=0.2,
    fast_frequency_hz=10.0,
    fast_amplitude_deg=0.2,
    hold_duration_s=0.1,
    trap_lambdas_per_s=(20.0,),
    map_time_constants_s=(0.01, 0.02),
    map_slopes_per_s=(1e4, 1e5),
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    checkpoint = Checkpoint(tmp_path_factory.mktemp("study") / "checkpoint.jsonl")
    return controller_study(BASE, SMALL, checkpoint=checkpoint), checkpoint


def test_every_point_is_the_assessment_of_its_own_scenario(small):
    study, _ = small
    own = changed(BASE, {"controller.lambda_per_s": 40.0, "controller.phi_m_s2": 1.0})
    expected = assess(own)
    for name in ("max_error_deg", "mean_command_change_rpm", "disk_margin", "phase_margin_deg"):
        assert study.values[name][1, 0, 0] == expected[name]
    assert study.values["stable"][1, 0, 0] == 1.0
    assert study.failures == {}


def test_the_map_has_its_own_observer_and_slope(small):
    study, _ = small
    law = SlidingModeParameters()
    phi = law.gain_ratio * law.eta_m_s3 / 1e4
    expected = assess(changed(BASE, {"controller.phi_m_s2": phi}))
    assert study.map_values["max_error_deg"][1, 0] == pytest.approx(expected["max_error_deg"])
    assert study.map_values["disk_margin"][1, 0] == pytest.approx(expected["disk_margin"])


def test_the_trap_has_its_variants(small):
    cases = {case.variant: case for case in small[0].trap}
    assert set(cases) == {"as built", "exact encoder", "unlimited acceleration"}
    # Linear loops know neither counts nor limits.
    assert len({case.disk_margin for case in cases.values()}) == 1
    exact, built = cases["exact encoder"], cases["as built"]
    assert exact.mean_command_change_rpm < 0.5 * built.mean_command_change_rpm
    assert exact.time_s.shape == exact.error_deg.shape == (251,)


def test_the_oscillation_at_rest_is_that_of_the_later_half_of_the_hold(small):
    law = SlidingModeParameters()
    own = changed(
        BASE,
        {
            "controller.lambda_per_s": 20.0,
            "controller.phi_m_s2": law.gain_ratio * law.eta_m_s3 / SMALL.trap_slope_per_s,
            "estimator.time_constant_s": SMALL.trap_time_constant_s,
        },
    )
    run = simulate(experiments(own, SMALL)["hold"], signals=("knee_angle",))
    angle = run["knee_angle_rad"][run.time_s >= 0.05 - 1e-9]  # the reference is constant
    built = next(case for case in small[0].trap if case.variant == "as built")
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
    assert again.report() == study.report()


def test_results_are_plain_and_the_report_has_the_verdicts(small):
    study, _ = small
    found = json.loads(to_json(study.results()))
    assert np.shape(found["grid"]["max_error_deg"]) == (2, 2, 1)
    assert [claim["verdict"] for claim in found["claims"]] == [c.verdict for c in study.claims()]
    report = study.report()
    for claim in study.claims():
        assert claim.quote in report
        assert f"**{claim.verdict}**" in report


def test_figures_have_labels_with_units(small):
    figures = small[0].figures()
    assert set(figures) == {"study_lambda_slope", "study_phi_eta", "study_claims", "study_trap"}
    for figure in figures.values():
        figure.canvas.draw()
        labels = [ax.get_xlabel() + ax.get_ylabel() for ax in figure.axes]
        assert any("(1/s)" in label or "(m/s²)" in label for label in labels)
        plt.close(figure)


def test_a_run_that_fails_leaves_nan_and_its_reason(monkeypatch):
    def fail(scenario, **keywords):
        raise SimulationError("t = 1 s: knee_angle left the range of motion")

    monkeypatch.setattr(module, "track", fail)
    one = SMALL.model_dump() | {"lambdas_per_s": (20.0,), "phis_m_s2": (3.2,)}
    study = controller_study(BASE, ControllerStudyParameters(**one))
    assert study.failures == {
        (20.0, 3.2, 2.8e5): "t = 1 s: knee_angle left the range of motion",
    }
    assert math.isnan(study.values["settling_s"][0, 0, 0])
    assert study.values["max_error_deg"][0, 0, 0] > 0.0
    assert {case.failure for case in study.trap} == set(study.failures.values())
    assert all(math.isnan(case.max_error_deg) for case in study.trap)
    assert "1 of them have a run that failed" in study.report()
    for figure in study.figures().values():
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
        ControllerStudyParameters(etas_m_s3=(2.0, 1.0))
    with pytest.raises(ParameterError, match=r"lambdas_per_s"):
        ControllerStudyParameters(lambdas_per_s=(-1.0, 1.0))


def test_experiments_lie_about_the_middle_of_the_reference():
    cases = experiments(Scenario(), ControllerStudyParameters())
    assert cases["step"].reference.range_deg == (39.0, 41.0)
    assert cases["large_step"].reference.range_deg == (30.0, 50.0)
    assert cases["hold"].reference.range_deg == (68.0, 70.0)
    assert cases["fast"].reference.range_deg == (37.5, 42.5)


# ------------------------------------------------------------------- the paper's own task


@pytest.mark.slow
def test_the_trap_is_stable_and_errs_by_degrees():
    """Second program (docs/model.md, reference numbers): 3–5° at λ = 20, tens of them at λ = 10."""
    settings = ControllerStudyParameters(
        lambdas_per_s=(20.0,),
        phis_m_s2=(3.2,),
        etas_m_s3=(2.8e5,),
        map_time_constants_s=(0.02,),
        map_slopes_per_s=(1e5,),
    )
    study = controller_study(settings=settings)
    cases = {(case.lambda_per_s, case.variant): case for case in study.trap}
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
