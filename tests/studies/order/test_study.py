"""Full against reduced order: speeds, modes, bandwidth and the switching force."""

import math
from concurrent.futures import Executor
from dataclasses import asdict

import numpy as np
import pytest
from order_cases import (
    BRIEF,
    FORCE,
    NAMES,
    POSTURE,
    rows,
)

from kneexo.analysis import simulate
from kneexo.analysis.bandwidth import large_signal_bandwidth_hz
from kneexo.analysis.error_model import error_model
from kneexo.analysis.plant_linearization import linearize_plant
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.tracking import track
from kneexo.errors import ParameterError
from kneexo.parameters import UNCERTAIN_KNEE, KneeLoadParameters, RampReference, Scenario
from kneexo.parameters.paths import changed
from kneexo.studies.order.figures import figures
from kneexo.studies.order.report import report
from kneexo.studies.order.rows import FrequencyRow, SpeedRow
from kneexo.studies.order.study import (
    OrderSettings,
    frequency_row,
    in_order,
    order_study,
    speed_row,
    switching_force_n,
    switching_row,
)
from kneexo.sweeps.checkpoint import Checkpoint

# Lee et al. 2020, Tables 2 and 3: bore 20 mm, rod 10 mm, 0.8 cm³/rev behind a gear of 6:1.
AREA_1, AREA_2 = math.pi / 4.0 * 0.020**2, math.pi / 4.0 * (0.020**2 - 0.010**2)
MEAN_AREA = 0.5 * (AREA_1 + AREA_2)
FLOW = 0.8e-6 * 5000.0 / 60.0 / 6.0
TABLE_1 = (1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0)
TIGHT = {"plant.pump.internal_leakage_m3_per_s_pa": 0.0}
SETTINGS = OrderSettings()


# --------------------------------------------------------------------------------- pieces


def test_in_order_changes_order_and_load_alone():
    full = in_order(UNCERTAIN_KNEE, "full", 60.0)
    assert full.plant.full_order is not None
    assert full.plant.load == KneeLoadParameters(disturbance_n=60.0)
    assert in_order(full, "reduced", -60.0) == UNCERTAIN_KNEE
    rough = changed(Scenario(), {"plant.full_order": {"coulomb_friction_n": 5.0}})
    assert in_order(rough, "full").plant.full_order.coulomb_friction_n == 5.0
    # Without a load there is none but the disturbance.
    assert in_order(Scenario(), "full", 7.0).plant.load == KneeLoadParameters(
        segment_mass_kg=0.0, disturbance_n=7.0
    )


@pytest.mark.parametrize("flexing", [True, False], ids=["in", "out"])
@pytest.mark.parametrize(
    ("order", "force", "area", "printed"),
    [
        ("full", 60.0, AREA_1, 35.4),
        ("full", -60.0, AREA_2, 47.2),
        ("reduced", 60.0, MEAN_AREA, 40.4),
    ],
)
def test_speed_at_the_limit_follows_the_loaded_chamber(order, force, area, printed, flexing):
    row = SpeedRow(**speed_row(changed(UNCERTAIN_KNEE, TIGHT), SETTINGS, (order, force, flexing)))
    assert row.saturated_share == 1.0
    assert row.rod_speed_mm_s == pytest.approx(1e3 * FLOW / area, rel=1e-3)
    assert row.rod_speed_mm_s == pytest.approx(printed, abs=0.1)


def linearized(scenario, case):
    return FrequencyRow(**frequency_row(scenario, case))


@pytest.mark.parametrize("posture", [10.0, 70.0])
def test_modes_are_those_of_one_chamber_with_its_make_up_valve_or_of_both(posture):
    reduced = linearized(UNCERTAIN_KNEE, ("reduced", 60.0, posture))
    assert reduced.mode_hz == pytest.approx(447.0, abs=0.5)
    assert reduced.mode_damping == pytest.approx(0.0059, abs=1e-4)
    full = linearized(UNCERTAIN_KNEE, ("full", 60.0, posture))
    x = 1e-3 * np.polyval(TABLE_1, posture)  # G1 follows it to 0.1 mm here
    stiffness = [
        1.72e9 * area**2 / volume
        for area, volume in (
            (AREA_1, 5e-6 + AREA_1 * x),
            (AREA_2, 5e-6 + AREA_2 * (0.150 - x)),
        )
    ]
    # The tied line relaxes through its valve, 2e-10 m³/(s·Pa).
    cubic = np.polymul([1.6, 0.05, stiffness[0]], [1.0, 2e-10 * stiffness[1] / AREA_2**2])
    cubic[2] += stiffness[1]
    roots = np.roots(cubic)
    mode = roots[np.argmax(roots.imag)]
    assert full.mode_hz == pytest.approx(abs(mode) / (2.0 * math.pi), rel=0.01)
    # What the pump's leakage adds is 0.006 in the reduced order.
    assert full.mode_damping == pytest.approx(-mode.real / abs(mode), abs=0.006)
    assert full.mode_damping > 6.0 * reduced.mode_damping


def test_margins_fall_with_the_rod_side_loaded_and_grow_with_the_cap_side():
    margins = {
        case: linearized(UNCERTAIN_KNEE, (*case, 40.0)).phase_margin_deg
        for case in (("reduced", 60.0), ("full", 60.0), ("full", -60.0))
    }
    low, middle, high = sorted(margins.values())
    assert margins["full", -60.0] == low
    assert margins["full", 60.0] == high
    assert (low, middle, high) == pytest.approx((51.1, 57.1, 61.5), abs=0.2)  # as measured


def test_no_linear_loop_is_said_in_words():
    signum = changed(UNCERTAIN_KNEE, {"controller.switching": "signum"})
    row = linearized(signum, ("full", 60.0, 40.0))
    assert "there is no linear" in row.failure
    assert math.isnan(row.phase_margin_deg)
    assert row.mode_hz == pytest.approx(280.0, abs=1.0)  # the plant has its mode all the same


# ------------------------------------------------------------------------ one small comparison


FULL = dict(BRIEF.plant.full_order)


def plant_of(order, force, weight=True):
    """The changes that make an order under a force, with or without the weight of the segment."""
    load = {"kind": "knee", "disturbance_n": force} | ({} if weight else {"segment_mass_kg": 0.0})
    return {"plant.load": load, "plant.full_order": FULL if order == "full" else None}


def ramp(order, force, direction, rate_deg_s, duration_s, **values):
    """A ramp between 30 and 50 deg without the weight of the segment; ``in`` flexes the knee."""
    start, end = (30.0, 50.0) if direction == "in" else (50.0, 30.0)
    reference = {"kind": "ramp", "start_deg": start, "end_deg": end, "time_s": 0.0}
    changes = {"reference": reference | {"rate_deg_s": rate_deg_s}}
    changes["simulation.duration_s"] = duration_s
    return changed(BRIEF, plant_of(order, force, weight=False) | changes | values)


def tracked(order, force):
    result = track(changed(BRIEF, plant_of(order, force)), all_signals=True)
    run, late = result.run, result.run.time_s >= 0.5 - 1e-9
    error = np.degrees(run["knee_reference_rad"] - run["knee_angle_rad"])
    command = run["motor_speed_command_rad_s"][late]
    columns = {"load_pressure": "load_pressure_pa"}
    if order == "full":
        columns = {"cap": "cap_pressure_pa", "rod_side": "rod_side_pressure_pa"}
    pressures = {name: 1e-6 * run[column] for name, column in columns.items()}
    row = {
        "order": order,
        "disturbance_n": force,
        "max_error_deg": np.abs(error[late]).max(),
        "rms_error_deg": math.sqrt(np.mean(error[late] ** 2)),
        "mean_command_change_rpm": np.abs(np.diff(command)).mean() * 30.0 / math.pi,
        "saturated_share": np.mean(np.abs(command) > 5000.0 * math.pi / 30.0 * 0.99999),
        # 1600 samples, of which a figure shows 800.
        "trace": {
            "time_s": run.time_s[::2],
            "error_deg": error[::2],
            "pressures_mpa": {name: values[::2] for name, values in pressures.items()},
        },
    }
    row |= {f"{name}_min_mpa": values.min() for name, values in pressures.items()}
    row |= {f"{name}_max_mpa": values.max() for name, values in pressures.items()}
    if order == "full":
        flows = {
            name: run[f"cap_{name}_flow_m3_s"] + run[f"rod_side_{name}_flow_m3_s"]
            for name in ("relief", "makeup")
        }
        row["relief_share"] = np.mean(flows["relief"] > 0.0)
        row["peak_makeup_cm3_s"] = 1e6 * np.abs(flows["makeup"]).max()
    return row


def sped(order, direction):
    run = simulate(ramp(order, FORCE, direction, 60.0, 1.0))
    late = run.time_s >= 0.5
    limited = np.abs(run["motor_speed_command_rad_s"]) > 5000.0 * math.pi / 30.0 * 0.99999
    return {
        "order": order,
        "force_n": FORCE,
        "direction": direction,
        "saturated_share": np.mean(limited[late]),
        "rod_speed_mm_s": 1e3 * np.abs(run["rod_velocity_m_s"][late]).mean(),
    }


def switched(direction):
    # 20 deg at 15 deg/s, but for a twentieth.
    runge_kutta = {"simulation.integrator": "rk4", "simulation.step_s": 2e-5}
    run = simulate(ramp("full", 16.0, direction, 15.0, 0.95 * 20.0 / 15.0, **runge_kutta))
    late = run.time_s >= 0.5
    velocity = (run["rod_velocity_m_s"] - run["rod_reference_velocity_m_s"])[late]
    error = np.degrees(run["knee_angle_rad"] - run["knee_reference_rad"])[late]
    across = (run["cap_pressure_pa"] - run["rod_side_pressure_pa"])[late]
    swing = velocity.max() - velocity.min()
    return {
        "force_n": 16.0,
        "direction": direction,
        "velocity_swing_mm_s": 1e3 * swing,
        "velocity_rms_mm_s": 1e3 * velocity.std(),
        "load_pressure_swing_mpa": 1e-6 * (across.max() - across.min()),
        "max_error_deg": np.abs(error).max(),
        "oscillates": bool(swing > 0.010),
    }


def linear(order, force):
    scenario = changed(BRIEF, plant_of(order, force))
    plant = linearize_plant(scenario.plant, knee_angle_deg=POSTURE, outputs=("rod_velocity",))
    loop = linearize_loop(scenario, knee_angle_deg=POSTURE)
    margins, mode = loop.margins(), plant.poles[np.argmax(plant.poles.imag)]
    hertz = np.geomspace(1.0, 1000.0, 400)
    return {
        "order": order,
        "disturbance_n": force,
        "posture_deg": POSTURE,
        "mode_hz": abs(mode) / (2.0 * math.pi),
        "mode_damping": -mode.real / abs(mode),
        "rod_force_n": plant.operating_point.rod_force_n,
        "phase_margin_deg": margins.phase_margin_deg,
        "gain_margin": margins.gain_margin,
        "delay_margin_ms": 1e3 * margins.delay_margin_s,
        "disk_margin": margins.disk_margin,
        "bandwidth_hz": loop.bandwidth_hz(),
        "complementary_sensitivity_bandwidth_hz": loop.complementary_sensitivity_bandwidth_hz(),
        "stable": True,
        "failure": "",
        "trace": {"frequencies_hz": hertz, "plant_gain_m": np.abs(plant.response(hertz))},
    }


def test_every_row_is_that_of_its_own_run(small, flat):
    cases = [(order, force) for force in (0.0, FORCE) for order in ("reduced", "full")]
    expected = {
        "tracking": [tracked(*case) for case in cases],
        "speeds": [sped(order, d) for order in ("reduced", "full") for d in ("in", "out")],
        "switching": [switched("in"), switched("out")],
        "frequency": [linear(*case) for case in cases],
        "bandwidth": [
            {"order": order, "disturbance_n": force, "failure": ""}
            | {"bandwidth_hz": large_signal_bandwidth_hz(changed(BRIEF, plant_of(order, force)))}
            for order, force in cases
        ],
    }
    for part, rows_by_hand in expected.items():
        # A number that the order does not have is None.
        rows_of_runs = [
            {name: value for name, value in asdict(row).items() if value is not None}
            for row in getattr(small, part)
        ]
        assert flat(rows_of_runs) == pytest.approx(flat(rows_by_hand), nan_ok=True), part
    # Each number has a chance to be wrong.
    assert [row["oscillates"] for row in expected["switching"]] == [True, False]
    assert all(0.1 < row["saturated_share"] < 0.9 for row in expected["tracking"])
    assert any(0.1 < row["saturated_share"] < 0.9 for row in expected["speeds"])
    assert 0.1 < expected["tracking"][-1]["relief_share"] < 0.9


def test_the_switching_force_is_that_of_the_scenarios_own_reservoir():
    assert switching_force_n(BRIEF) == pytest.approx(0.25e6 * (AREA_1 - AREA_2))
    assert switching_force_n(UNCERTAIN_KNEE) == pytest.approx(0.2e6 * (AREA_1 - AREA_2))


# ------------------------------------------------------------------------ the comparison


def test_an_executor_is_used():
    class AskedError(Exception):
        pass

    class Pool(Executor):
        def submit(self, function, /, *arguments, **named):
            raise AskedError

    with pytest.raises(AskedError):
        order_study(UNCERTAIN_KNEE, executor=Pool())


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    settings = OrderSettings(postures_deg=(40.0,), switching_forces_n=(6.0, 16.0, 30.0))
    path = tmp_path_factory.mktemp("orders") / "checkpoint"
    result = order_study(UNCERTAIN_KNEE, settings, checkpoint=Checkpoint(path))
    return result, path


@pytest.mark.slow
def test_tracking_error_of_the_full_order_is_that_of_its_area(comparison):
    result, _ = comparison
    full = changed(Scenario(), {"plant.full_order": {}})
    # θ̇ of 30 deg at 0.1 Hz, times the lag of 28.6 ms, rms: 0.381 deg; leakage and encoder add.
    lag = abs(error_model(full, loaded_chamber="cap").error_m(1.0, 0.0))
    expected = 30.0 * 2.0 * math.pi * 0.1 * lag / math.sqrt(2.0)
    for row in rows(result.tracking, order="full"):
        assert row.rms_error_deg == pytest.approx(expected, rel=0.03)
    for row in rows(result.tracking, order="reduced"):
        assert row.rms_error_deg < 0.05


@pytest.mark.slow
def test_bandwidth_follows_the_loaded_chamber(comparison):
    result, _ = comparison
    by_case = {(r.order, r.disturbance_n): r.bandwidth_hz for r in result.bandwidth}
    # Kinematic follower at Q/A_1, Q/Ā and Q/A_2: 0.196, 0.2247 and 0.262 Hz.
    assert by_case["full", 60.0] == pytest.approx(0.196, abs=0.003)
    assert by_case["full", -60.0] == pytest.approx(0.262, abs=0.003)
    assert by_case["full", 0.0] == pytest.approx(0.262, abs=0.003)  # the weight loads P_2
    for force in (0.0, 60.0, -60.0):
        assert by_case["reduced", force] == pytest.approx(0.2236, abs=0.002)


@pytest.mark.slow
def test_rod_oscillates_near_the_switching_force_in_retraction_alone(comparison):
    result, _ = comparison
    assert result.oscillating_n("in") == [16.0]
    assert result.oscillating_n("out") == []
    inside = rows(result.switching, direction="in", force_n=16.0)[0]
    outside = rows(result.switching, direction="in", force_n=6.0)[0]
    # Halving rk4's step changes the swing by less than 2 %.
    assert inside.velocity_swing_mm_s > 20.0 * outside.velocity_swing_mm_s
    assert inside.velocity_swing_mm_s == pytest.approx(99.0, rel=0.05)
    assert inside.max_error_deg < outside.max_error_deg


@pytest.mark.slow
def test_comparison_resumes_and_draws(comparison):
    result, path = comparison
    assert len(result.results()["speeds"]) == 8
    again = order_study(result.scenario, result.settings, checkpoint=Checkpoint(path, resume=True))
    assert again.results() == result.results()
    assert report(again) == report(result)
    for figure in figures(result).values():
        figure.canvas.draw()


# ------------------------------------------------------- report and figures, by hand-made rows


def test_results_are_the_rows_without_their_traces_and_what_their_order_lacks(
    by_hand, flat, check_rules
):
    numbers = by_hand.results()
    check_rules(numbers)
    expected = {
        part: [
            {
                name: value
                for name, value in vars(row).items()
                if name != "trace" and not (part == "tracking" and value is None)
            }
            for row in getattr(by_hand, part)
        ]
        for part in NAMES
    }
    assert flat(numbers) == pytest.approx(flat(expected), nan_ok=True)


# ------------------------------------------------------------------------------ bad input


def test_a_ramp_too_short_to_measure_is_refused():
    narrow = changed(UNCERTAIN_KNEE, {"reference.amplitude_deg": 0.1})
    with pytest.raises(ParameterError, match=r"\Aswitching_rate_deg_s = .* must take > 0\.5 s\Z"):
        switching_row(narrow, SETTINGS, (15.0, True))


def test_reference_must_be_a_sine():
    with pytest.raises(ParameterError, match="needs a sine that moves"):
        order_study(Scenario(reference=RampReference()))
