"""The sliding condition: ds/dt against two oracles, the bounds on the error, and the verdicts."""

import math
from dataclasses import asdict

import numpy as np
import pytest
from sliding_cases import (
    AREA,
    AREA_TERM,
    BETA,
    GAIN,
    SHORT,
    SMALL,
    STIFFNESS,
)

from kneexo.analysis import simulate
from kneexo.command_line.output import to_json
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.studies.sliding.condition import (
    error_bounds,
    sliding_rates,
    sliding_signals,
)
from kneexo.studies.sliding.figures import figures
from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings
from kneexo.studies.sliding.study import (
    effective_masses_kg,
    needed_eta,
    sliding_study,
)
from kneexo.sweeps.checkpoint import Checkpoint

# ------------------------------------------------------------------------------ verdicts


def test_needed_eta_and_effective_masses_by_hand():
    needed = needed_eta(SLIDING_LAW)
    # 4094 rpm at the peak of 10…70 deg at 0.1 Hz is 33.1 mm/s.
    speed = 4094.0 / 60.0 * 0.8e-6 / 6.0 / AREA
    assert needed.speed == pytest.approx(STIFFNESS / 7.0 * speed / BETA, rel=1e-3)
    assert needed.stability == pytest.approx(STIFFNESS / 7.0 * 3.2 / (40.0 * BETA), rel=1e-9)
    low, high = effective_masses_kg(changed(SLIDING_LAW, {"plant.full_order": {}}))
    assert (low, high) == pytest.approx(
        (GAIN["controller.mass_min_kg"], GAIN["controller.mass_max_kg"]), rel=1e-4
    )
    assert effective_masses_kg(SLIDING_LAW) == (1.4, 1.8)


# --------------------------------------------------------------------------------- study


def small_cases():
    """Labels and scenarios of the study with `SMALL`."""
    masses = effective_masses_kg(changed(SHORT, {"plant.full_order": {}}))
    gain = dict(zip(("controller.mass_min_kg", "controller.mass_max_kg"), masses, strict=True))
    laws = {"paper": {}, "area": AREA_TERM, "area_gain": AREA_TERM | gain}
    start = {
        "initial_offset_m": -0.010,
        "controller.sample_time_s": 2e-5,
        "simulation.duration_s": 0.0135,
    }
    plants = [
        (f"reduced, {mass:g} kg", "paper", load, {"plant.cylinder.mass_kg": mass})
        for mass in (1.4, 1.8)
        for load in (60.0,)
    ]
    plants += [
        ("full", law, load, {"plant.full_order": {}} | values)
        for law, values in laws.items()
        for load in (60.0, -60.0)
    ]
    for part, times in (("motion", {}), ("start", start)):
        for plant, law, load, values in plants:
            forces = {"plant.load.disturbance_n": load, "controller.eta_m_s3": 1e3}
            yield (part, plant, law, load, 1e3), changed(SHORT, times | values | forces)
    exact = {
        "encoder": {"quantized": False},
        "estimator": {"kind": "exact"},
        "controller.eta_m_s3": 200.0,
    }
    loops = {
        "ideal motor": exact | {"plant.ideal_motor": True},
        "motor": exact,
        "motor, encoder, observer": {},
    }
    for order, full in (("reduced", None), ("full", {})):
        for load in (60.0, -60.0):
            for loop, values in loops.items():
                plant = {"plant.rod_map": "polynomial", "plant.full_order": full}
                plant["plant.load"] = {"kind": "knee", "segment_mass_kg": 0, "disturbance_n": load}
                motion = {"initial_offset_m": -0.009, "simulation.duration_s": 0.08}
                scenario = changed(Scenario(), plant | motion | values)
                eta = scenario.controller.eta_m_s3
                yield ("sampled", f"{order}, {loop}", "paper", load, eta), scenario


def thinned(rows, count):
    """The first half in a row, then evenly spread ones to the last."""
    if len(rows) <= count:
        return list(rows)
    half = count // 2
    return [*rows[:half], *(rows[int(k)] for k in np.linspace(half, len(rows) - 1, half))]


def measured(scenario):
    """What `check_sliding` says of a run, sample by sample."""
    failures, run, duration = [], None, scenario.simulation.duration_s
    while run is None:
        try:
            shorter = changed(scenario, {"simulation.duration_s": duration})
            run = simulate(shorter, signals=sliding_signals(scenario))
        except SimulationError as error:
            failures, duration = [*failures, str(error)], 0.5 * duration
    law = scenario.controller
    phi, lambda_, eta = law.phi_m_s2, law.lambda_per_s, law.eta_m_s3 * (1.0 - 1e-6)
    count = run.time_s.size - (not law.continuous)
    # A command is logged before its update, so that of an interval is the next one.
    time, command = run.time_s[:count], run["motor_speed_command_rad_s"][-count:]
    e = (run["rod_extension_m"] - run["rod_reference_m"])[:count]
    e_rate = (run["rod_velocity_m_s"] - run["rod_reference_velocity_m_s"])[:count]
    s = run["sliding_variable_m_s2"]
    if scenario.estimator.kind != "exact":
        s = sliding_rates(scenario, run, range(count), command)[0]

    def reaching_rate(rows, commands):
        values, rates = sliding_rates(scenario, run, rows, commands)
        return np.sign(values) * rates

    outside = [k for k in range(count) if abs(s[k]) > phi]
    inside = [k for k in range(count) if abs(s[k]) <= phi]
    result = dict.fromkeys(
        (
            *("holding_share", "attracting_share", "worst_rate_m_s3", "held_share", "mean_share"),
            *("reaching_s", "left_share", "largest_s", "error_share", "rate_share"),
            *("acceleration_share", "bounded_share", "largest_error_mm"),
        ),
        math.nan,
    )
    result |= {"failure": failures[0] if failures else "", "duration_s": duration}
    result["outside_share"] = len(outside) / count
    result["promised_s"] = max(0.0, abs(s[0]) - phi) / law.eta_m_s3
    rated, rates, bound = thinned(outside, 20), [], np.full(count, math.nan)
    if outside:
        rates = reaching_rate(rated, command[rated])
        result["holding_share"] = np.mean([rate <= -eta for rate in rates])
        result["attracting_share"] = np.mean([rate < 0.0 for rate in rates])
        result["worst_rate_m_s3"] = max(rates)
        if not law.continuous:
            rated = [k for k in rated if k + 1 < count]
            late = reaching_rate([k + 1 for k in rated], command[rated])
            result["held_share"] = np.mean([rate <= -eta for rate in late])
            slopes = [math.copysign(1.0, s[k]) * (s[k + 1] - s[k]) / 0.002 for k in rated]
            result["mean_share"] = np.mean([slope <= -eta for slope in slopes])
    if inside:
        first = inside[0]
        later = [k for k in outside if k > first]
        result["reaching_s"] = time[first]
        result["left_share"] = len(later) / (count - first)
        result["largest_s"] = max(abs(s[k]) for k in range(first, count)) / phi
        before_leaving = range(first, later[0] if later else count)
        bound[before_leaving], _ = error_bounds(
            time[before_leaving], e[first], e_rate[first], lambda_per_s=lambda_, phi_m_s2=phi
        )
        result["bounded_share"] = np.mean(
            [abs(e[k]) <= 1.000001 * bound[k] for k in before_leaving]
        )
        settled = [k for k in range(count) if time[k] >= time[first] + 0.1 / lambda_]
        if settled:
            e_2 = s[settled] - 2.0 * lambda_ * e_rate[settled] - lambda_**2 * e[settled]
            error, rate, acceleration = (
                max(abs(values)) for values in (e[settled], e_rate[settled], e_2)
            )
            result["largest_error_mm"] = 1e3 * error
            result["error_share"] = error / (phi / lambda_**2)
            result["rate_share"] = rate / (2.0 * phi / lambda_)
            result["acceleration_share"] = acceleration / (4.0 * phi)
    shown, drawn = thinned(range(count), 600), thinned(outside, 20)
    return result | {
        "trace": {
            "time_s": time[shown],
            "s_m_s2": s[shown],
            "error_m": e[shown],
            "bound_m": bound[shown],
            "outside_time_s": time[drawn],
            "reaching_rate_m_s3": rates,
        }
    }


def test_every_case_is_measured_in_its_own_run(small_study, flat):
    study, _ = small_study
    expected = list(small_cases())
    assert len(study.cases) == len(expected) == 8 + 8 + 12
    shares = {}
    for case, (labels, scenario) in zip(study.cases, expected, strict=True):
        assert (case.part, case.plant, case.law, case.load_n, case.eta_m_s3) == labels
        by_numpy = measured(scenario)
        assert flat(asdict(case.measured)) == pytest.approx(flat(by_numpy), nan_ok=True), labels
        for name, value in by_numpy.items():
            shares.setdefault(name, set()).add(value if name != "trace" else "")
    # Each share has a chance to be wrong, but for that of the bounds, which always hold.
    for name in (n for n in shares if n.endswith("_share") and n != "bounded_share"):
        assert any(0.0 < value < 1.0 for value in shares[name]), name


def test_a_study_is_taken_up_again(small_study):
    study, path = small_study
    assert len(Checkpoint(path, resume=True)) == len(study.cases)
    resumed = sliding_study(SHORT, SMALL, checkpoint=Checkpoint(path, resume=True))
    assert to_json(resumed.results()) == to_json(study.results())


def test_results_are_the_cases_without_their_traces(by_hand, flat, check_rules):
    numbers = by_hand.results()
    check_rules(numbers)
    low, high = GAIN["controller.mass_min_kg"], GAIN["controller.mass_max_kg"]
    assert numbers.pop("effective_mass_kg") == pytest.approx((low, high), rel=1e-4)
    from_1e4 = {"60 N": 1e4, "-60 N": 1e4}
    expected = {
        "needed_eta_m_s3": {"speed": 3.3e4, "stability": 8.1e4},
        "smallest_eta_m_s3": {
            "paper": {"60 N": 2e4, "-60 N": 2e4},
            "area": from_1e4,
            "area_gain": from_1e4,
        },
        "cases": [
            {"part": c.part, "plant": c.plant, "law": c.law, "load_n": c.load_n}
            | {"eta_m_s3": c.eta_m_s3}
            | {name: value for name, value in asdict(c.measured).items() if name != "trace"}
            for c in by_hand.cases
        ],
    }
    assert flat(numbers) == pytest.approx(flat(expected))


@pytest.mark.slow
def test_paper_s_k_suffices_from_the_closed_forms_on():
    settings = SlidingSettings(etas_m_s3=(3e4, 3.6e4, 7e4, 9e4))
    study = sliding_study(SLIDING_LAW, settings)
    # 33 100 m/s³ with P_1 loaded (the area term at the peak speed), 80 100 with P_2 (stability).
    assert study.smallest_eta("paper", 60.0) == 3.6e4
    assert study.smallest_eta("paper", -60.0) == 9e4
    assert 3e4 < study.needed.speed < 3.6e4 < 7e4 < study.needed.stability < 9e4
    for law in ("area", "area_gain"):
        assert study.smallest_eta(law, 60.0) == study.smallest_eta(law, -60.0) == 3e4
    for case in study.of("motion", plant="reduced, 1.8 kg"):
        assert case.stays
        assert case.measured.error_share < 0.05
    # At 2 ms no mean rate keeps the promise, and the layer is reached by speed alone.
    for case in study.of("sampled"):
        assert case.measured.mean_share == 0.0
        assert case.measured.reaching_s > 50.0 * case.measured.promised_s
    default = study.of("sampled", plant="full, motor, encoder, observer")
    assert all(case.stays for case in default)
    for figure in figures(study).values():
        figure.canvas.draw()


# ------------------------------------------------------------------------------ bad input


def test_study_needs_the_continuous_law_under_a_load():
    with pytest.raises(
        ParameterError, match=r"needs controller\.continuous = true and plant\.load"
    ):
        sliding_study(Scenario())
