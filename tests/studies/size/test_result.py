from __future__ import annotations

import json
import math

import pytest
from size_cases import (
    ACCELERATION,
    AREA_MM2,
    FLOW,
    SETTINGS,
    SPEED_MM_S,
)

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.command_line.output import to_json
from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.studies.hardware import (
    DISPLACEMENT,
    scaled,
    tuned,
)

FLOW_L_MIN = 0.8e-3 * 5000.0 / 6.0


def demanded(frequency, factor):
    """What `demand` says, in the units of the results."""
    ratio = 6700.0 * factor / (5000.0 * math.pi / 30.0)
    start = math.asin(0.25)  # ∫ max(sin + ¼, 0) = ¼ (π + 2 asin ¼) + 2 cos asin ¼
    positive = (0.25 * (math.pi + 2.0 * start) + 2.0 * math.cos(start)) / (2.0 * math.pi)
    return {
        "frequency_hz": frequency,
        "peak_knee_rate_deg_s": 301.0 * factor,
        "peak_rod_speed_mm_s": 620.0 * factor,
        "flow_factor": ratio,
        "peak_rod_acceleration_m_s2": 6.3 * factor,
        "peak_motor_acceleration_rad_s2": 68000.0 * factor / ratio,
        "peak_flow_l_min": 9.96 * factor,
        "peak_rod_force_n": 64.0 * factor,
        "peak_pressure_mpa": 0.65 * factor,
        "peak_shaft_power_w": 69.0 * factor,
        "delivered_energy_j": 69.0 * factor * positive / 1.25 / frequency,
        "net_energy_j": 69.0 * factor * 0.2 / frequency,
    }


def test_the_demand_is_in_the_units_of_its_names(by_hand, flat):
    numbers = by_hand.results()
    expected = {
        "demand": [demanded(1.0, 1.0), demanded(0.8, 0.7)],
        "demand_with_segment_inertia": [demanded(1.0, 1.1), demanded(0.8, 0.9)],
        "demand_by_wearer_torque_n_m": {"0": demanded(1.0, 1.3), "10": demanded(1.0, 1.7)},
    }
    shown = {key: numbers[key] for key in expected}
    # The trapezoids of the sampled stride are good for 1e-3.
    assert flat(shown) == pytest.approx(flat(expected), rel=1e-3)


def test_limits_are_those_of_pump_gear_and_piston(by_hand):
    numbers = by_hand.results()["limits"]
    # Eq. 10 with Table 1: half of 139.05 − 38.92 mm, on G1 to 0.2 mm.
    amplitude = 0.5 * (139.05 - 38.92)
    assert numbers["rod_amplitude_mm"] == pytest.approx(amplitude, abs=0.2)
    assert numbers["rod_speed_limit_mm_s"] == pytest.approx(SPEED_MM_S, rel=1e-9)
    motor = 5000.0 * math.pi / 30.0
    limit = UNCERTAIN_KNEE.plant.pump.acceleration_limit_rad_s2
    assert numbers["rod_acceleration_limit_m_s2"] == pytest.approx(
        1e-3 * SPEED_MM_S * limit / motor, rel=1e-9
    )
    ratio = motor * SPEED_MM_S / numbers["rod_amplitude_mm"]
    one_percent = numbers["acceleration_limit_one_percent_rad_s2"]
    assert one_percent == pytest.approx(7.2666 * ratio, rel=1e-9)
    assert numbers["acceleration_limit_alone_rad_s2"] == pytest.approx(0.73 * ratio, rel=1e-9)


def test_a_design_tells_every_way_to_its_flow(by_hand):
    for numbers, design, share in zip(
        by_hand.results()["designs"], by_hand.designs, (1.0, 2.0), strict=True
    ):
        factor = FLOW * share
        expected = {
            "frequency_hz": design.frequency_hz,
            "flow_factor": factor,
            "rod_speed_limit_mm_s": SPEED_MM_S * factor,
            "rod_acceleration_limit_m_s2": 1e-3
            * SPEED_MM_S
            * factor
            * ACCELERATION
            * share
            * UNCERTAIN_KNEE.plant.pump.acceleration_limit_rad_s2
            / (5000.0 * math.pi / 30.0),
            "flow_at_speed_limit_l_min": FLOW_L_MIN * factor,
            "acceleration_limit_rad_s2": ACCELERATION * share * 1e4,
            "displacement_cm3_per_rev": 0.8 * factor,
            "or_gear_ratio": 6.0 / factor,
            "or_motor_speed_limit_rpm": 5000.0 * factor,
            # Without the gear, the piston that the paper's motor moves as fast: 6/flow of ours.
            "or_piston_area_without_gear_mm2": AREA_MM2 * 6.0 / factor,
            "rated_force_of_that_piston_n": AREA_MM2 * 6.0 / factor * 3.5,
        }
        assert {name: numbers[name] for name in expected} == pytest.approx(expected, rel=1e-9)
        assert numbers["flow_search"] == vars(design.flow)
        assert numbers["acceleration_search"] == vars(design.acceleration)
        # 20 mm √1.21, and a pump that fills this piston as fast
        assert numbers["piston_factor"] == pytest.approx(1.21, rel=1e-9)
        assert numbers["bore_mm"] == pytest.approx(22.0, rel=1e-9)
        assert numbers["rod_mm"] == pytest.approx(11.0, rel=1e-9)
        assert numbers["with_piston_cm3_per_rev"] == pytest.approx(0.8 * factor * 1.21, rel=1e-9)
        assert numbers["walking"] == design.walking
        assert numbers["carried"] == design.carried
        assert numbers["checked"] == design.checked
        assert numbers["halved_step"] == design.halved
        assert numbers["step_agreement"] == pytest.approx(
            {
                "max_error_deg": 0.02,
                "peak_pressure_mpa": 0.02,
                "peak_shaft_power_w": 0.05,
                "delivered_energy_j": 0.02,
            }
        )


def test_a_stride_has_its_pressures_in_stance_and_late_swing(by_hand):
    rows = {(row["hardware"], row["moment_share"]): row for row in by_hand.results()["stride"]}
    names = ("hardware as it is", "sized", "sized, with its piston")
    assert list(rows) == [(name, share) for name in names for share in (1.0, 0.5)]
    # 773 N at 20.8° on A_1 and −757 N at 2.0° on A_2, each with P_r on the other side.
    for key, cap, rod_side in (
        (("hardware as it is", 1.0), 2.61, 3.48),
        (("hardware as it is", 0.5), 1.38, 1.87),
        (("sized, with its piston", 1.0), 773 / 314.16 / 1.21 + 0.15, 757 / 235.62 / 1.21 + 4 / 15),
    ):
        row = rows[key]
        assert row["cap_pressure_mpa"] == pytest.approx(cap, abs=0.006)
        assert row["rod_side_pressure_mpa"] == pytest.approx(rod_side, abs=0.006)
        assert row["cap_angle_deg"] == pytest.approx(20.8, abs=0.05)
        assert row["rod_side_angle_deg"] == pytest.approx(2.0, abs=0.05)
    as_it_is, fast = rows["hardware as it is", 1.0], rows["sized", 1.0]
    assert as_it_is["lowest_pressure_mpa"] == pytest.approx(-0.845, abs=0.001)
    assert as_it_is["lowest_angle_deg"] == pytest.approx(35.5, abs=0.1)
    assert as_it_is["share_within_speed"] == pytest.approx(175 / 1350)
    assert len(as_it_is["warnings"]) == 1
    # 17 times the flow is 687 mm/s of the 701 mm/s; A_1 takes 14 % more than the mean area.
    lacking = 314.16e-6 * 0.701 - 17.0 * 5000.0 / 360.0 * 0.8e-6
    assert fast["lowest_pressure_mpa"] == pytest.approx(0.2 - 1e-6 * lacking / 2e-10, abs=0.01)
    assert fast["warnings"] == ()


def test_the_controller_is_asked_for_what_the_lag_takes(by_hand):
    numbers = by_hand.results()["controller"]
    beta = math.sqrt(1.8 / 1.4)
    stiffness = 4.0 * 1.72e9 * (1e-6 * AREA_MM2) ** 2 / (math.sqrt(1.4 * 1.8) * 41_233e-9)
    assert numbers["authority_m_s3"] == pytest.approx(beta * 2.8e5, rel=1e-9)
    assert numbers["slope_per_s"] == pytest.approx(beta * 2.8e5 / 3.2, rel=1e-9)
    assert numbers["authority_asked_m_s3"] == pytest.approx(stiffness * 0.011 * 6.3, rel=1e-4)
    # The stride is one small sine about 40°.
    ample = scaled(UNCERTAIN_KNEE, {DISPLACEMENT: SETTINGS.largest_flow_factor})
    for name, scenario in (
        ("linear_error_deg", ample),
        ("linear_error_tuned_deg", tuned(ample, by_hand.best_gains)),
    ):
        error = 0.01 * abs(
            linearize_loop(scenario, knee_angle_deg=40.0).output_response(1.0)[0] - 1.0
        )
        assert numbers[name] == pytest.approx(error, rel=2e-3)


def test_what_was_measured_is_in_the_results_as_it_is(by_hand, flat):
    def plain(data):
        return json.loads(to_json(data))

    numbers = plain(by_hand.results())
    for name in ("nominal", "gains", "best_gains", "steps", "design_at_reference", "variations"):
        assert flat(numbers[name]) == flat(plain(getattr(by_hand, name)))
    factors = [0.5, 1.0, 1.25, 1.5]
    bandwidth, walking = plain(by_hand.bandwidth_map_hz), plain(by_hand.walking_map_deg)
    assert numbers["bandwidth_map"] == {"factors": [0.5, 1.0, 2.0], "bandwidth_hz": bandwidth}
    assert numbers["walking_map"] == {"factors": factors, "max_error_deg": walking}
    assert numbers["walking_sweeps"] == {
        path: [{"factor": f} | walked for f, walked in zip(factors, plain(sweep), strict=True)]
        for path, sweep in by_hand.walking_sweeps.items()
    }
    # Tables 2 and 3: rpm, cm³/rev, 1, rad/s², ms, counts/rev.
    for (path, sweep), value in zip(
        numbers["sweeps"].items(), (5000.0, 0.8, 6.0, 1e4, 10.0, 4096.0), strict=True
    ):
        measured = plain(by_hand.sweeps[path])
        for factor, row, measured_row in zip((0.5, 1.0, 2.0), sweep, measured, strict=True):
            assert row.pop("factor") == factor
            assert row.pop("value") == pytest.approx(factor * value, rel=1e-9)
            assert row == measured_row
