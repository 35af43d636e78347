"""The wearer's torque and help: designs, motions, weak legs, rows and margins."""

import math
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pytest
from wearer_cases import SMALL, WALKING, walking

from kneexo.analysis import measure_impedance
from kneexo.analysis.wearer.coupling import coupled_stability
from kneexo.parameters import WEARERS
from kneexo.parameters.paths import changed
from kneexo.simulation.engines import simulate
from kneexo.studies.wearer import wearer
from kneexo.studies.wearer.figures import figures
from kneexo.studies.wearer.wearer import (
    WEARER_KNEE,
    WearerSettings,
    designs,
    in_motion,
    margins,
    measured,
    modes,
    wearer_study,
    with_flow,
)

REDUCED = changed(WEARER_KNEE, {"plant.full_order": None})
QUICK = (2.0, math.nan)


# -------------------------------------------------------------------------------- scenarios


def test_a_larger_pump_keeps_the_gains_in_flow():
    larger = with_flow(WEARER_KNEE, 10.0, gain=3.0)
    before, after = WEARER_KNEE.plant, larger.plant
    assert after.pump.displacement_m3_per_rad == pytest.approx(
        10.0 * before.pump.displacement_m3_per_rad
    )
    assert after.pump.speed_limit_rad_s == before.pump.speed_limit_rad_s
    assert after.full_order == before.full_order

    def flow_gains(scenario):
        law, pump = scenario.controller, scenario.plant.pump
        return (
            law.proportional_rad_s_per_n * pump.displacement_m3_per_rad,
            law.integral_rad_s2_per_n * pump.displacement_m3_per_rad,
        )

    proportional, integral = flow_gains(WEARER_KNEE)
    assert flow_gains(larger) == pytest.approx((3.0 * proportional, 3.0 * integral))
    assert flow_gains(with_flow(WEARER_KNEE, 7.0)) == pytest.approx((proportional, integral))
    law = WEARER_KNEE.controller
    assert larger.controller.speed_feedforward == law.speed_feedforward
    assert with_flow(REDUCED, 2.0).plant.full_order is None


@pytest.mark.slow
def test_a_larger_pump_works_through_a_loaded_chamber_in_slow_motion():
    # Make-up valves enlarged with the pump would pass this motion: |Z| = 0.34 at 50 times the flow.
    slow = {"controller.mode": "zero_torque", "wearer.motion": "prescribed"}
    ample, sized = (
        measure_impedance(changed(with_flow(WEARER_KNEE, flow), slow), 1.0, 5.0, knee_angle_deg=45)
        for flow in (50.0, 16.3)
    )
    assert ample.speed_limited_share == sized.speed_limited_share == 0.0
    assert abs(ample.impedance) == pytest.approx(abs(sized.impedance), rel=1e-3)
    assert abs(ample.impedance) == pytest.approx(12.17, rel=1e-3)


@pytest.mark.slow
def test_the_lowest_pressure_of_a_row_is_that_of_its_late_cycles():
    case = in_motion(with_flow(WEARER_KNEE, 16.3), SMALL, QUICK)
    run = simulate(case)
    late = run.time_s > 0.5 - 1e-6
    cap, rod_side = (run[f"{side}_pressure_pa"] for side in ("cap", "rod_side"))
    row = measured(2, case)
    assert row["lowest_pressure_pa"] == min(cap[late].min(), rod_side[late].min())


def test_margins_are_the_least_of_all_legs_and_postures(monkeypatch):
    seen = []

    def survey(scenario, *, knee_angles_deg):
        seen.append((scenario, knee_angles_deg))
        margins = np.array([[0.7, 0.4], [0.9, 0.5]])
        return SimpleNamespace(disk_margin=margins, gain_margin=3.0 * margins)

    springs = SimpleNamespace(low_n_m_per_rad=1.0, high_n_m_per_rad=9.0, felt_n_m_per_rad=3.0)
    monkeypatch.setattr(wearer, "coupled_stability", survey)
    monkeypatch.setattr(wearer, "stiffness_interval", lambda _: springs)
    assert margins((45.0,), WEARER_KNEE) == vars(springs) | {
        "disk_margin": 0.4,
        "gain_margin": pytest.approx(1.2),
    }
    assert seen == [(REDUCED, (45.0,))]


@pytest.mark.slow
def test_margins_do_not_depend_on_the_flow():
    row = margins((45.0,), WEARER_KNEE)
    loops = coupled_stability(REDUCED, knee_angles_deg=[45.0])
    assert row["disk_margin"] == np.min(loops.disk_margin) > 0.5
    assert margins((45.0,), with_flow(WEARER_KNEE, 16.0)) == pytest.approx(row, rel=1e-4)


def test_a_loop_that_does_not_rest_has_no_margins():
    # The load cell demands a force, and the slow motor cannot feed the leakage under this force.
    held = changed(
        WEARER_KNEE, {"controller.command_limit_rad_s": 1e-3, "load_cell.offset_n": 500.0}
    )
    assert margins((45.0,), held) == {}


@pytest.mark.slow
def test_an_unstable_loop_has_no_disk_margin():
    wild = changed(WEARER_KNEE, {"controller.proportional_rad_s_per_n": 400.0})
    assert math.isnan(margins((45.0,), wild)["disk_margin"])


def test_the_designs_differ_in_flow_and_gains():
    assisting = changed(WEARER_KNEE, {"controller.mode": "impedance", "wearer.motion": "passive"})
    settings = WearerSettings(flow_factor=5.0, sized_flow_factor=7.0, unlimited_flow_factor=9.0)
    by_name = designs(assisting, settings)
    for design in by_name.values():
        assert (design.controller.mode, design.wearer.motion) == ("zero_torque", "prescribed")
    flows = {
        name: design.plant.pump.displacement_m3_per_rad
        / WEARER_KNEE.plant.pump.displacement_m3_per_rad
        for name, design in by_name.items()
    }
    expected = {"paper's pump": 1.0, "larger pump": 5.0, "sized pump": 7.0}
    expected |= {"motor without limits": 9.0}
    higher = {f"{name}, higher gains": flow for name, flow in expected.items()}
    shank = by_name["sized pump, inertia of the shank"]
    assert flows.pop("sized pump, inertia of the shank") == pytest.approx(7.0)
    assert shank.plant.load.inertia_kg_m2 == pytest.approx(1.6 * 0.2**2)
    assert shank.load_cell.filter_s == 0.005
    half = 0.5 * WEARER_KNEE.controller.proportional_rad_s_per_n
    assert shank.controller.proportional_rad_s_per_n == pytest.approx(half / 7.0)
    assert flows == pytest.approx({"motor held": 1.0} | expected | higher)
    assert by_name["motor held"].controller.command_limit_rad_s == 1e-3
    for name, flow in expected.items():
        gain = by_name[name].controller.proportional_rad_s_per_n * flow
        law = by_name[f"{name}, higher gains"].controller
        assert gain == pytest.approx(WEARER_KNEE.controller.proportional_rad_s_per_n)
        assert law.proportional_rad_s_per_n * flow == pytest.approx(4.0 * gain)


def test_walking_and_rising_replace_reference_and_duration():
    walk = in_motion(WEARER_KNEE, SMALL, WALKING)
    assert (walk.duration_s, walk.wearer) == (2.0, WEARER_KNEE.wearer)
    assert walk.plant.load.segment_mass_kg == WEARER_KNEE.plant.load.segment_mass_kg
    rise = in_motion(WEARER_KNEE, SMALL, (math.nan, 0.8))
    assert rise.duration_s == pytest.approx(2 * 3 * 0.8)
    assert rise.reference.range_deg == (5.0, 85.0)
    assert rise.plant.load.segment_mass_kg == 0.0


def test_a_weak_leg_yields_and_lacks_a_part_of_its_moment():
    heavy = walking("heavy")
    leg = heavy.wearer
    assert (leg.motion, leg.effort) == ("active", 0.8)
    assert leg.leg_mass_kg == pytest.approx(0.061 * 110.0)
    stance = WEARERS["stance"]
    for name in ("stiffness_n_m_per_rad", "loss_modulus_n_m_per_rad", "damping_n_m_s_per_rad"):
        assert getattr(leg, name) == pytest.approx(getattr(stance, name) * 110.0 / 75.0)
    # The extension moment of early stance: 65 N·m for 75 kg.
    assert min(leg.moment.moments_n_m) == pytest.approx(-65.2 * 110.0 / 75.0, rel=0.01)
    shift = np.subtract(heavy.reference.angles_deg, walking().reference.angles_deg)
    assert shift == pytest.approx(5.0)
    rise = in_motion(WEARER_KNEE, SMALL, (math.nan, 0.8), "light")
    assert (rise.wearer.effort, rise.wearer.moment) == (1.0, None)
    assert rise.wearer.stiffness_n_m_per_rad == pytest.approx(286.0 * 50.0 / 75.0)


def test_the_modes_are_those_of_the_controller():
    by_name = modes(WearerSettings(band_deg=3.0, shares=(0.3,)), assisting=True)
    laws = {name: changed(walking("light"), values).controller for name, values in by_name.items()}
    assert {name: law.mode for name, law in laws.items()} == {
        "zero torque": "zero_torque",
        "assist 0.3": "assist",
        "virtual spring": "impedance",
        "spring outside band": "assist_as_needed",
    }
    assert laws["assist 0.3"].assistance == 0.3
    assert laws["virtual spring"].stiffness_n_m_per_rad == 200.0
    assert laws["spring outside band"].band_rad == pytest.approx(math.radians(3.0))
    assert laws["assist 0.3"].torque_limit_n_m == 60.0
    assert "assist 0.3" not in modes(SMALL, assisting=False)


# ------------------------------------------------------------------------------------- rows


def test_the_numbers_of_a_row_are_those_of_its_run():
    case = changed(
        in_motion(with_flow(REDUCED, 10.0), SMALL, QUICK, "average"),
        {"controller.mode": "assist", "controller.torque_limit_n_m": 60.0},
    )
    signals = ("interaction_torque", "wearer_motion", "knee_angle", "knee_reference")
    run = simulate(case, signals=(*signals, "motor_speed_command", "biological_moment"))
    late = run.time_s > 0.5 - 1e-6  # after the first of two strides of 0.5 s
    time, torque = run.time_s[late], run["interaction_torque_n_m"][late]
    moment, rate = run["biological_moment_n_m"][late], run["wearer_rate_rad_s"][late]
    path, leg = run["knee_reference_rad"][late], run["wearer_angle_rad"][late]

    def mean(values):
        return np.trapezoid(values, time) / 0.5

    row = measured(2, case)
    trace = row.pop("trace")
    assert row.pop("failure") == ""
    assert row == pytest.approx(
        {
            "rms_torque_n_m": math.sqrt(mean(torque**2)),
            "mean_torque_n_m": mean(np.abs(torque)),
            "peak_torque_n_m": np.max(np.abs(torque)),
            "assistance_ratio": -mean(torque * moment) / mean(moment**2),
            "power_from_wearer_w": mean(np.maximum(torque * rate, 0.0)),
            "power_to_wearer_w": mean(np.maximum(-torque * rate, 0.0)),
            "deviation_deg": math.degrees(np.max(np.abs(leg - path))),
            "saturated_share": np.mean(
                np.abs(run["motor_speed_command_rad_s"][late]) > 523.598  # 5000 rpm
            ),
            "lowest_pressure_pa": math.nan,
        },
        rel=1e-9,
        nan_ok=True,
    )
    assert row["deviation_deg"] > 0.1
    assert 0.05 < row["saturated_share"] < 0.95
    # The trace is the second stride: 601 samples from one least flexion to the next.
    assert trace["time_s"] == pytest.approx(np.linspace(0.0, 0.5, 601).tolist())
    at = 0.5 + np.array(trace["time_s"])
    for name, values in (
        ("leg_deg", np.degrees(run["wearer_angle_rad"])),
        ("knee_deg", np.degrees(run["knee_angle_rad"])),
        ("torque_n_m", run["interaction_torque_n_m"]),
    ):
        assert trace[name] == pytest.approx(np.interp(at, run.time_s, values).tolist())


@pytest.mark.slow
def test_a_run_that_fails_has_its_reason_in_its_row():
    # The moment of stance straightens a soft leg, whose muscles give twice of it.
    soft = {"wearer.stiffness_n_m_per_rad": 2.0, "wearer.loss_modulus_n_m_per_rad": 0.5}
    case = in_motion(with_flow(REDUCED, 10.0), SMALL, WALKING, "average")
    case = changed(case, {"controller.mode": "assist", "wearer.effort": 2.0, **soft})
    row = measured(2, case)
    assert list(row) == ["failure"]
    assert "left the range of motion" in row["failure"]


def test_results_are_the_rows_without_their_traces(by_hand, flat):
    numbers = by_hand.results()
    expected = {
        part: [
            {name: value for name, value in asdict(row).items() if name != "trace"}
            for row in getattr(by_hand, part)
        ]
        for part in ("transparency", "help", "margins")
    }
    assert flat(numbers) == pytest.approx(flat(expected), nan_ok=True)


def test_the_rows_are_those_of_their_cases(monkeypatch):
    seen = []

    def count(cycles, scenario):
        seen.append(scenario)
        return {"rms_torque_n_m": float(len(seen)), "mean_torque_n_m": float(cycles)}

    monkeypatch.setattr(wearer, "measured", count)
    loops = []
    monkeypatch.setattr(wearer, "margins", lambda postures, loop: loops.append(loop) or {})
    settings = changed(SMALL, {"cadences_hz": (0.5, 1.0)})
    result = wearer_study(WEARER_KNEE, settings)
    by_name = designs(WEARER_KNEE, settings)
    names = ["paper's pump", "paper's pump, higher gains", "sized pump, inertia of the shank"]
    assert loops == [by_name[name] for name in names]
    assert [row.design for row in result.margins] == names
    rows = (*result.transparency, *result.help)
    assert len({row.rms_torque_n_m for row in rows}) == len(seen) == 10 * 3 + 2 * (3 * 4 + 3)
    assert [r.design for r in result.transparency] == [name for name in by_name for _ in range(3)]
    for row in rows:
        case = seen[round(row.rms_torque_n_m) - 1]
        motion = row.cadence_hz, row.rise_time_s
        leg = "" if row in result.transparency else row.wearer
        law = modes(settings, assisting=True)[row.mode]
        assert case == changed(in_motion(by_name[row.design], settings, motion, leg), law)
        assert row.mean_torque_n_m == 2.0
    assert {row.wearer for row in result.transparency} == {"any"}
    assert {r.wearer for r in result.help if r.cadence_hz == 1.0} == {"light", "average", "heavy"}
    assert {r.wearer for r in result.help if r.rise_time_s == 0.8} == {"average"}


@pytest.mark.slow
def test_the_study_draws(small):
    for figure in figures(small[0]).values():
        figure.canvas.draw()


@pytest.mark.slow
def test_the_torque_in_walking_is_that_of_oil_and_control():
    def rms(name, **changes):
        case = in_motion(designs(changed(WEARER_KNEE, changes), SMALL)[name], SMALL, HALF)
        return measured(2, case)["rms_torque_n_m"]

    assert rms("motor held") == pytest.approx(70.5, rel=0.02)
    assert rms("paper's pump") == pytest.approx(60.6, rel=0.02)
    assert rms("motor without limits") < 0.4 * rms("paper's pump")
    assert rms("sized pump, higher gains") < 0.1 * rms("paper's pump")


HALF = (0.5, math.nan)


# -------------------------------------------------------------------------------- bad input
