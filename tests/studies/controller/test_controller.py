import math
from itertools import product

import numpy as np
import pytest
from controller_cases import (
    BASE,
    SMALL,
)

from kneexo.errors import SimulationError
from kneexo.parameters import (
    Scenario,
    SineReference,
    SlidingModeParameters,
    StepReference,
)
from kneexo.parameters.paths import changed
from kneexo.simulation.engines import simulate
from kneexo.studies.controller import controller
from kneexo.studies.controller.controller import (
    controller_study,
    experiments,
    settling_time_s,
)
from kneexo.studies.controller.figures import figures
from kneexo.studies.controller.report import report
from kneexo.studies.controller.result import (
    MAP_METRICS,
    METRICS,
)
from kneexo.studies.controller.settings import ControllerSettings

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


# -------------------------------------------------------------------------------- the runs


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
    assert len(cases["exact encoder"].time_s) == len(cases["exact encoder"].error_deg) == 251


def test_the_oscillation_at_rest_is_that_of_the_later_half_of_the_hold(small):
    law = SlidingModeParameters()
    scenario = changed(
        BASE,
        {
            "controller.lambda_per_s": 20.0,
            "controller.phi_m_s2": law.gain_ratio * law.eta_m_s3 / SMALL.limit_cycle_slope_per_s,
            "estimator.time_constant_s": SMALL.limit_cycle_time_constant_s,
        },
    )
    run = simulate(experiments(scenario, SMALL)["hold"], signals=("knee_angle",))
    angle = run["knee_angle_rad"][run.time_s >= 0.05 - 1e-9]  # the reference is constant
    built = next(case for case in small[0].limit_cycle if case.variant == "as built")
    assert built.oscillation_at_rest_deg == pytest.approx(np.degrees(np.ptp(angle)), rel=1e-9)


# ------------------------------------------------------------------------------ a run that fails


@pytest.mark.slow
def test_a_run_that_fails_leaves_nan_and_its_reason(monkeypatch):
    def fail(scenario, **keywords):
        raise SimulationError("t = 1 s: knee_angle left the range of motion")

    monkeypatch.setattr(controller, "track", fail)
    single_point = SMALL.model_dump() | {"lambdas_per_s": (20.0,), "phis_m_s2": (3.2,)}
    study = controller_study(BASE, ControllerSettings(**single_point))
    assert study.failures == {
        (20.0, 3.2, 2.8e5): "t = 1 s: knee_angle left the range of motion",
    }
    assert math.isnan(study.values["settling_s"][0, 0, 0])
    assert study.values["max_error_deg"][0, 0, 0] > 0.0
    assert {case.failure for case in study.limit_cycle} == set(study.failures.values())
    assert all(math.isnan(case.max_error_deg) for case in study.limit_cycle)
    assert " points have a run that failed" in report(study)
    figures(study)


# ------------------------------------------------------------------------------- bad input


def test_experiments_lie_about_the_middle_of_the_reference():
    cases = experiments(Scenario(), ControllerSettings())
    assert cases["step"].reference.range_deg == (39.0, 41.0)
    assert cases["large_step"].reference.range_deg == (30.0, 50.0)
    assert cases["hold"].reference.range_deg == (68.0, 70.0)
    assert cases["fast"].reference.range_deg == (37.5, 42.5)


# ------------------------------------------------------------------- the paper's own task


@pytest.mark.slow
def test_the_trap_is_stable_and_errs_by_degrees():
    """Second program: 3–5° at λ = 20, tens of degrees at λ = 10."""
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
