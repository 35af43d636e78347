"""Results, report and figures of a sizing made by hand, whose numbers are all known."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from kneexo.analysis.hardware import (
    ACCELERATION_LIMIT,
    DISPLACEMENT,
    HARDWARE,
    SPEED_LIMIT,
    scaled,
    tuned,
)
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.walking import WALKING_METRICS, WalkingDemand
from kneexo.command_line.output import to_json
from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.studies.size.figures import figures, last_stride, motions
from kneexo.studies.size.report import report
from kneexo.studies.size.result import Search, SizeResult, WalkingDesign
from kneexo.studies.size.settings import SizeSettings

# Lee et al. 2020, Tables 2 and 3: bore 20 mm, rod 10 mm, 0.8 cm³/rev behind a gear of 6:1.
AREA_MM2 = math.pi / 4.0 * (20.0**2 - 0.5 * 10.0**2)
FLOW_L_MIN = 0.8e-3 * 5000.0 / 6.0
SPEED_MM_S = 0.8e3 * 5000.0 / 60.0 / 6.0 / AREA_MM2

SETTINGS = SizeSettings(
    factors=(0.5, 1.0, 2.0),
    walking_factors=(0.5, 1.0, 1.25, 1.5),
    stride_frequencies_hz=(1.0, 0.8),
    lambda_per_s=(20.0, 80.0, 100.0),
    slope_per_s=(5e4, 7e4),
    observer_s=(0.02,),
    wearer_torques_n_m=(0.0, 10.0),
)
FLOW, ACCELERATION = 17.0, 2.0
"""Of the first design, as factors on the paper's hardware; the second has twice as much."""

CYCLE = np.linspace(0.0, 100.0, 101)
WAVE = np.sin(2.0 * np.pi * CYCLE / 100.0)  # its largest value is 1

AT_SINE = (
    "expected_bandwidth_hz",
    "bandwidth_hz",
    "small_signal_bandwidth_hz",
    "max_error_deg",
    "rms_error_deg",
    "mean_command_change_rpm",
)


def demand(frequency, factor, *, segment=False):
    """A stride whose peaks are ``factor`` times a number for each signal."""
    wave = factor * WAVE
    return WalkingDemand(
        frequency_hz=frequency,
        segment_inertia=segment,
        cycle_percent=CYCLE,
        knee_angle_deg=40.0 + 0.01 * WAVE,
        knee_rate_deg_s=301.0 * wave,
        rod_speed_m_s=0.62 * wave,
        rod_acceleration_m_s2=6.3 * wave,
        rod_force_n=64.0 * wave,
        load_pressure_pa=0.65e6 * wave,
        load_flow_m3_s=1.66e-4 * wave,
        motor_speed_rad_s=6700.0 * wave,
        motor_acceleration_rad_s2=68000.0 * wave,
        shaft_power_w=69.0 * factor * (WAVE + 0.25) / 1.25,
    )


def numbers(names, start, failure=""):
    """Numbers that no other row has."""
    values = {name: 0.017 * (start + n) for n, name in enumerate(names)}
    if "saturated_share" in values:
        values["saturated_share"] = start / 1000.0
    return values | {"failure": failure}


def failed(names):
    return dict.fromkeys(names, math.nan) | {"failure": "t = 1 s: left the range; too slow"}


def design(frequency, share, start):
    factors = {DISPLACEMENT: FLOW * share, ACCELERATION_LIMIT: ACCELERATION * share}
    halved = numbers(WALKING_METRICS, start + 40)
    checked = {k: v if isinstance(v, str) else v / 1.02 for k, v in halved.items()}
    checked["peak_shaft_power_w"] = halved["peak_shaft_power_w"] / 0.95
    reached = share == 1.0
    return WalkingDesign(
        frequency_hz=frequency,
        flow=Search(15.4 * share, 1.9, True, 1.0, 25.0),
        acceleration=Search(1.8e4 * share, 1.7 if reached else 2.6, reached, 1e3, 1e5),
        scenario=scaled(UNCERTAIN_KNEE, factors),
        walking=numbers(WALKING_METRICS, start),
        checked=checked,
        halved=halved,
    )


@pytest.fixture(scope="module")
def sized():
    """A `SizeResult` that nothing was simulated for."""
    sweeps = {
        path: [numbers(AT_SINE, 100 + 30 * n + 7 * m) for m, _ in enumerate(SETTINGS.factors)]
        for n, path in enumerate(HARDWARE)
    }
    sweeps[DISPLACEMENT][0] = failed(AT_SINE) | {"expected_bandwidth_hz": 0.5}
    walking_sweeps = {
        path: [{"max_error_deg": error} for error in (9.0 + n, 1.0, 1.5, 3.0 - 0.4 * n)]
        for n, path in enumerate(HARDWARE)
    }
    gains = [
        {"lambda_per_s": lambda_, "slope_per_s": slope, "observer_s": observer}
        | {"max_error_deg": 1.0 + 10 * i + j, "disk_margin": 0.1 * i + 0.01 * j, "meets": j == 1}
        for observer in SETTINGS.observer_s
        for i, slope in enumerate(SETTINGS.slope_per_s)
        for j, lambda_ in enumerate(SETTINGS.lambda_per_s)
    ]
    time = 1.0 + np.arange(0.0, 2.0 + 1e-9, 0.02)
    trace = {
        "time_s": time,
        "knee_angle_rad": np.radians(30.0 + time),
        "knee_reference_rad": np.radians(30.0 + 3.0 * time),
        "motor_speed_rad_s": 100.0 * time,
        "load_pressure_pa": 2e6 * time,
        "shaft_power_w": 40.0 * time,
    }
    return SizeResult(
        scenario=UNCERTAIN_KNEE,
        settings=SETTINGS,
        nominal=numbers(AT_SINE, 1),
        sweeps=sweeps,
        bandwidth_map_hz=np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, np.nan, 0.9]]),
        demands=[demand(1.0, 1.0), demand(0.8, 0.7)],
        segment_demands=[demand(1.0, 1.1, segment=True), demand(0.8, 0.9, segment=True)],
        torque_demands={0.0: demand(1.0, 1.3), 10.0: demand(1.0, 1.7)},
        gains=gains,
        best_gains=gains[1] | {"phase_margin_deg": 44.0},
        steps={
            "as it is": [
                numbers(WALKING_METRICS, 400) | {"saturated_share": 0.87},
                numbers(WALKING_METRICS, 420),
            ],
            "ample": [failed(WALKING_METRICS), numbers(WALKING_METRICS, 440)],
        },
        designs=[design(1.0, 1.0, 500), design(0.8, 2.0, 600)],
        design_at_reference=numbers(AT_SINE, 51),
        variations={"reduced": numbers(WALKING_METRICS, 700), "full": failed(WALKING_METRICS)},
        walking_sweeps=walking_sweeps,
        walking_map_deg=1.0 + 0.1 * np.arange(16.0).reshape(4, 4),
        traces={"nominal": trace, "sized": {k: 1.0 * v for k, v in trace.items()}},
    )


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


def test_the_demand_is_in_the_units_of_its_names(sized, flat, check_rules):
    numbers = sized.results()
    check_rules(numbers)
    expected = {
        "demand": [demanded(1.0, 1.0), demanded(0.8, 0.7)],
        "demand_with_segment_inertia": [demanded(1.0, 1.1), demanded(0.8, 0.9)],
        "demand_by_wearer_torque_n_m": {"0": demanded(1.0, 1.3), "10": demanded(1.0, 1.7)},
    }
    shown = {key: numbers[key] for key in expected}
    # The trapezoids of the sampled stride are good for 1e-3.
    assert flat(shown) == pytest.approx(flat(expected), rel=1e-3)


def test_limits_are_those_of_pump_gear_and_piston(sized):
    numbers = sized.results()["limits"]
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
    assert numbers["acceleration_limit_one_percent_rad_s2"] == pytest.approx(7.27 * ratio, rel=1e-9)
    assert numbers["acceleration_limit_alone_rad_s2"] == pytest.approx(0.73 * ratio, rel=1e-9)


def test_a_design_tells_every_way_to_its_flow(sized):
    for design, one, share in zip(
        sized.results()["designs"], sized.designs, (1.0, 2.0), strict=True
    ):
        factor = FLOW * share
        expected = {
            "frequency_hz": one.frequency_hz,
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
        assert {name: design[name] for name in expected} == pytest.approx(expected, rel=1e-9)
        assert design["flow_search"] == vars(one.flow)
        assert design["acceleration_search"] == vars(one.acceleration)
        assert design["walking"] == one.walking
        assert design["checked"] == one.checked
        assert design["halved_step"] == one.halved
        assert design["step_agreement"] == pytest.approx(
            {
                "max_error_deg": 0.02,
                "peak_pressure_mpa": 0.02,
                "peak_shaft_power_w": 0.05,
                "delivered_energy_j": 0.02,
            }
        )


def test_the_controller_is_asked_for_what_the_lag_takes(sized):
    numbers = sized.results()["controller"]
    beta = math.sqrt(1.8 / 1.4)
    stiffness = 4.0 * 1.72e9 * (1e-6 * AREA_MM2) ** 2 / (math.sqrt(1.4 * 1.8) * 41_233e-9)
    assert numbers["authority_m_s3"] == pytest.approx(beta * 2.8e5, rel=1e-9)
    assert numbers["slope_per_s"] == pytest.approx(beta * 2.8e5 / 3.2, rel=1e-9)
    assert numbers["authority_asked_m_s3"] == pytest.approx(stiffness * 0.011 * 6.3, rel=1e-4)
    # The stride is one small sine about 40°.
    ample = scaled(UNCERTAIN_KNEE, {DISPLACEMENT: SETTINGS.largest_flow_factor})
    for name, scenario in (
        ("linear_error_deg", ample),
        ("linear_error_tuned_deg", tuned(ample, sized.best_gains)),
    ):
        error = 0.01 * abs(linearize_loop(scenario, 40.0).output_response(1.0)[0] - 1.0)
        assert numbers[name] == pytest.approx(error, rel=2e-3)


def test_what_was_measured_is_in_the_results_as_it_is(sized, flat):
    numbers = json.loads(to_json(sized.results()))
    plain = json.loads(
        to_json(
            {
                "nominal": sized.nominal,
                "gains": sized.gains,
                "best_gains": sized.best_gains,
                "steps": sized.steps,
                "design_at_reference": sized.design_at_reference,
                "variations": sized.variations,
                "bandwidth_map": {
                    "factors": [0.5, 1.0, 2.0],
                    "bandwidth_hz": sized.bandwidth_map_hz,
                },
                "walking_map": {
                    "factors": [0.5, 1.0, 1.25, 1.5],
                    "max_error_deg": sized.walking_map_deg,
                },
                "walking_sweeps": {
                    path: [
                        {"factor": factor} | one
                        for factor, one in zip((0.5, 1.0, 1.25, 1.5), sweep, strict=True)
                    ]
                    for path, sweep in sized.walking_sweeps.items()
                },
            }
        )
    )
    assert flat({key: numbers[key] for key in plain}) == flat(plain)
    # Tables 2 and 3: rpm, cm³/rev, 1, rad/s², ms, counts/rev.
    for (path, sweep), value in zip(
        numbers["sweeps"].items(), (5000.0, 0.8, 6.0, 1e4, 10.0, 4096.0), strict=True
    ):
        measured = json.loads(to_json(sized.sweeps[path]))
        for factor, row, own in zip((0.5, 1.0, 2.0), sweep, measured, strict=True):
            assert row.pop("factor") == factor
            assert row.pop("value") == pytest.approx(factor * value, rel=1e-9)
            assert row == own


def test_every_cell_of_the_report_is_in_the_results(sized, tables, check_cells):
    numbers = sized.results()
    hardware, demands, torques, steps, designs, variations, kept = tables(report(sized))

    columns = (*AT_SINE[:1], "small_signal_bandwidth_hz", "bandwidth_hz", "max_error_deg")
    rows = [["hardware as it is", *(numbers["nominal"][name] for name in columns)]]
    for path, sweep in numbers["sweeps"].items():
        name, unit, _ = HARDWARE[path]
        for one in (sweep[0], sweep[2]):
            label = f"{name} {one['value']:.4g} {unit}".rstrip()
            rows.append([label, *(one[column] for column in columns)])
    check_cells(hardware, rows)
    assert hardware[0][1:] == [
        "bound (Hz)",
        "small signal (Hz)",
        "measured −3 dB (Hz)",
        "error (deg)",
    ]

    both = [*numbers["demand"], *numbers["demand_with_segment_inertia"]]
    assert demands[0][1:] == ["1 Hz, Eq. 16", "0.8 Hz, Eq. 16", "1 Hz, shank", "0.8 Hz, shank"]
    check_cells(
        demands,
        [
            [row[0], *(one[name] for one in both)]
            for row, name in zip(demands[1:], [*both[0]][1:], strict=True)
        ],
    )
    by_torque = numbers["demand_by_wearer_torque_n_m"]
    names = ("peak_rod_force_n", "peak_pressure_mpa", "peak_shaft_power_w", "delivered_energy_j")
    check_cells(torques, [[t, *(one[n] for n in names)] for t, one in by_torque.items()])

    names = ("max_error_deg", "rms_error_deg")
    lost = "fails: t = 1 s: left the range"
    first, second = sized.steps["as it is"]
    check_cells(
        steps,
        [
            ["as it is", *(one[name] for one in (first, second) for name in names)],
            ["ample", lost, "–", *(sized.steps["ample"][1][name] for name in names)],
        ],
    )

    one, other = numbers["designs"]
    searched = [d["acceleration_search"] for d in numbers["designs"]]
    values = {
        "smallest flow": [d["flow_search"]["value"] for d in numbers["designs"]],
        "smallest acceleration": [
            searched[0]["value"],
            "not reached in 1000 … 100000: best 2.6° (bound 2°) at 3.6e+04",
        ],
    }
    for name in (
        *("rod_speed_limit_mm_s", "acceleration_limit_rad_s2", "flow_at_speed_limit_l_min"),
        *("displacement_cm3_per_rev", "or_gear_ratio", "or_motor_speed_limit_rpm"),
        *("or_piston_area_without_gear_mm2", "rated_force_of_that_piston_n"),
    ):
        values[name] = [one[name], other[name]]
    for name in WALKING_METRICS:
        if name not in ("saturated_share", "net_energy_j"):
            halved = name in one["step_agreement"]
            kind = "halved_step" if halved else "walking"
            values[name] = [d[kind][name] for d in numbers["designs"]]
    values["change"] = [5.0, 5.0]
    check_cells(
        designs,
        [[row[0], *pair] for row, pair in zip(designs[1:], values.values(), strict=True)],
    )
    check_units(designs[1:], values)

    names = ("max_error_deg", "rms_error_deg", "peak_motor_speed_rpm", "peak_pressure_mpa")
    names += ("peak_shaft_power_w", "delivered_energy_j")
    reduced = sized.variations["reduced"]
    check_cells(
        variations,
        [["reduced", *(reduced[n] for n in names)], ["full", lost, *["–"] * 5]],
    )
    assert kept[1:] == [
        [HARDWARE[path][0], "1 … 1.25" if n < 3 else "1 … 1.5"] for n, path in enumerate(HARDWARE)
    ]


UNITS = {
    "_mm_s": "(mm/s)",
    "_rad_s2": "(rad/s²)",
    "_l_min": "(L/min)",
    "_cm3_per_rev": "(cm³/rev)",
    "_rpm": "(rpm)",
    "_mm2": "(mm²)",
    "_n": "(N)",
    "_deg": "(deg)",
    "_mpa": "(MPa)",
    "_w": "(W)",
    "_j": "(J)",
}


def check_units(rows, values):
    """The label of each row ends in the unit that the name of its number ends in."""
    for row, name in zip(rows, values, strict=True):
        units = [unit for suffix, unit in UNITS.items() if name.endswith(suffix)]
        assert not units or row[0].endswith(units[0]), (row[0], name)


def test_the_words_have_the_numbers_of_the_results(sized):
    numbers, text = sized.results(), report(sized)
    limits, own = numbers["limits"], numbers["controller"]
    for said in (
        f"= {limits['rod_speed_limit_mm_s']:.1f} mm/s",
        f"= {limits['rod_acceleration_limit_m_s2']:.3f} m/s²",
        f"a = ±{limits['rod_amplitude_mm']:.2f} mm",
        f"below {limits['acceleration_limit_one_percent_rad_s2']:.0f} rad/s² (1 %",
        f"below {limits['acceleration_limit_alone_rad_s2']:.0f} rad/s² it decides",
        "its speed limit 87 % of the time",
        "With 25 times the flow and 100000 rad/s² no limit",
        f"errs by {own['linear_error_deg']:.1f}° at 1 Hz",
        f"and by {own['linear_error_tuned_deg']:.2f}° with λ",
        "reference 10…70° moves it",
        "largest at 0.1 Hz after the first period",
        "at 1 Hz; the ratings are",
        "## The smallest hardware that walks within 2°",
        "Smallest flow with 100000 rad/s²; sized values are 1.1 times",
        "## Around the hardware sized for 1 Hz",
        # 0.017 times 51, 52, 53 and 54
        "It follows 10…70° at 0.1 Hz to 0.918°.",
        "3 dB for that sine: 0.884 Hz (bound of its limits 0.867 Hz, linear loop 0.901 Hz).",
        "of those tried in 0.5 … 1.5, that keep the error within 2°",
        f"= {own['authority_asked_m_s3']:.2g} m/s³; the controller has",
        f" {own['authority_m_s3']:.2g}, so η must grow",
        "λ 20 1/s → 80 1/s",
        f"k/Φ {own['slope_per_s']:.3g} 1/s → 5e+04 1/s",
        "T_f 20 ms:",
        "disk margin 0.01, phase margin 44°",
        " and ".join(f"{one['flow_factor']:.3g}" for one in numbers["demand"]) + " times the flow",
        "ratings are 3.5 MPa and 200 W",
    ):
        assert said in text
    assert "nan" not in text
    none = dataclasses.replace(sized, best_gains=sized.best_gains | {"meets": False})
    said = (
        "none of the 6 gains tried has a disk margin of 0.5 without chattering** (this one: 0.01)"
    )
    assert said in report(none)
    assert [line for line in text.splitlines() if line.startswith("- ")] == [
        f"- pump displacement {0.4:.4g} cm³/rev: t = 1 s: left the range; too slow"
    ]


# -------------------------------------------------------------------------------- figures


@pytest.fixture(scope="module")
def drawn(sized):
    return figures(sized)


def test_sweeps_show_every_row(sized, drawn, curves):
    axes = drawn["sizing_sweeps"].axes
    for ax, sweeps, factors, name in (
        (axes[0], sized.sweeps, SETTINGS.factors, "bandwidth_hz"),
        (axes[1], sized.sweeps, SETTINGS.factors, "max_error_deg"),
        (axes[2], sized.walking_sweeps, SETTINGS.walking_factors, "max_error_deg"),
    ):
        lines = curves(ax)
        for path, sweep in sweeps.items():
            x, y = lines[HARDWARE[path][0]]
            assert x == pytest.approx(factors)
            assert y == pytest.approx([one[name] for one in sweep], nan_ok=True)
    bounds = curves(axes[0])
    for path, label in (
        (SPEED_LIMIT, "motor speed"),
        (DISPLACEMENT, "displacement"),
        (ACCELERATION_LIMIT, "acceleration"),
    ):
        (shown,) = (v for k, v in bounds.items() if k.startswith("bound") and label in k)
        expected = [one["expected_bandwidth_hz"] for one in sized.sweeps[path]]
        assert shown[1] == pytest.approx(expected)


def test_maps_have_the_flow_across_and_the_acceleration_limit_up(sized, drawn, check_heat_map):
    limit = UNCERTAIN_KNEE.plant.pump.acceleration_limit_rad_s2
    for ax, values, factors, flow, acceleration in (
        (drawn["sizing_maps"].axes[0], sized.bandwidth_map_hz, SETTINGS.factors, 1.0, 1.0),
        (
            drawn["sizing_maps"].axes[1],
            sized.walking_map_deg,
            SETTINGS.walking_factors,
            FLOW,
            ACCELERATION,
        ),
    ):
        speed = SPEED_MM_S * flow * np.array(factors)
        check_heat_map(ax, speed, limit * acceleration * np.array(factors), values.T)
        limits = limit * acceleration * np.array(factors)
        for ticks, of in ((ax.get_xticklabels(), speed), (ax.get_yticklabels(), limits)):
            numbers = [float(tick.get_text()) for tick in ticks]
            assert all(min(abs(of / number - 1.0)) < 0.05 for number in numbers)
        # Rows of the map are limits, columns flows; so are the numbers written on it.
        written = {t.get_position(): t.get_text() for t in ax.texts}
        for (row, column), value in np.ndenumerate(values):
            at = (speed[column], limit * acceleration * factors[row])
            (text,) = (t for p, t in written.items() if p == pytest.approx(at))
            assert text == ("–" if math.isnan(value) else f"{value:.2g}")


def test_a_map_in_which_every_run_fails_has_its_axes_all_the_same(sized):
    none = dataclasses.replace(sized, bandwidth_map_hz=np.full((3, 3), math.nan))
    ax = figures(none)["sizing_maps"].axes[0]
    assert [text.get_text() for text in ax.texts] == ["every run fails"]
    assert ax.get_xlim() == pytest.approx((0.5 * SPEED_MM_S, 2.0 * SPEED_MM_S))
    assert ax.get_ylim() == pytest.approx((5e3, 2e4))
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")


def test_maps_show_the_limits_and_the_sized_hardware(sized, drawn, curves):
    left, right = (curves(ax) for ax in drawn["sizing_maps"].axes[:2])
    motor, amplitude = 5000.0 * math.pi / 30.0, sized.results()["limits"]["rod_amplitude_mm"]
    for label, (speed, limit) in left.items():
        ratio = 7.27 if "7.3" in label else 0.73
        assert limit == pytest.approx(ratio * motor * speed / amplitude, rel=1e-9)
    assert len(left) == 2
    (x,), (y,) = right["sized"]
    limit = UNCERTAIN_KNEE.plant.pump.acceleration_limit_rad_s2
    assert (x, y) == pytest.approx((SPEED_MM_S * FLOW, ACCELERATION * limit))
    speed, needed = right["speed and acceleration of the motion"]
    assert needed == pytest.approx(6.3 * motor / (1e-3 * speed))
    vertical = [
        line.get_xdata()[0]
        for line in drawn["sizing_maps"].axes[1].lines
        if line.get_label().startswith("_")
    ]
    assert vertical == pytest.approx([620.0])


def test_gains_lie_with_lambda_across_and_the_slope_up(drawn):
    (ax, *_) = drawn["walking_gains"].axes
    drawn_errors = np.asarray(ax.collections[0].get_array(), dtype=float).reshape(2, 3)
    np.testing.assert_array_equal(drawn_errors, [[1.0, 2.0, 3.0], [11.0, 12.0, 13.0]])
    colours = ax.collections[0].norm
    assert colours.vmin <= 1.0
    assert colours.vmax > 13.0  # above it also where all gains err alike
    assert [t.get_text() for t in ax.get_xticklabels()] == ["20", "80", "100"]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["50000", "70000"]
    written = {t.get_position(): (t.get_text(), t.get_weight()) for t in ax.texts}
    assert written[2.5, 1.5] == ("13.0°\n0.12", "normal")
    assert written[1.5, 0.5] == ("2.0°\n0.01", "bold")
    assert "T_f = 20 ms" in ax.get_title()


def test_tracking_shows_the_last_stride(sized, drawn, curves):
    angle, error, speed = drawn["walking_tracking"].axes
    cycle, trace = last_stride(sized.traces["sized"], 1.0)
    assert np.all(np.diff(cycle) >= 0.0)
    assert trace["time_s"].min() > 2.0
    lines = curves(angle)
    for label in ("hardware as it is", "sized hardware"):
        assert lines[label][0] == pytest.approx(cycle)
        assert lines[label][1] == pytest.approx(30.0 + trace["time_s"])
    assert lines["reference"][1] == pytest.approx(40.0 + 0.01 * WAVE)
    errors = [line for line in error.lines if np.size(line.get_xdata()) == cycle.size]
    assert errors[0].get_ydata() == pytest.approx(2.0 * trace["time_s"])
    speeds = [line for line in speed.lines if np.size(line.get_xdata()) == cycle.size]
    assert speeds[0].get_ydata() == pytest.approx(3000.0 / math.pi * trace["time_s"])
    flat = sorted(line.get_ydata()[0] for line in speed.lines if np.size(line.get_xdata()) == 2)
    assert flat == pytest.approx([-5000.0, 5000.0])
    flat = sorted(line.get_ydata()[0] for line in error.lines if np.size(line.get_xdata()) == 2)
    assert flat == pytest.approx([-2.0, 2.0])
    key = [text.get_text() for text in drawn["walking_tracking"].legends[0].get_texts()]
    assert [text for text in key if "±2°" in text or "±5000 rpm" in text] == key[-2:]
    assert "logarithmic beyond ±2" in error.get_ylabel()
    assert error.yaxis.get_transform().linthresh == 2.0
    ticks = zip(error.get_yticks(), error.get_yticklabels(), strict=True)
    assert all(float(t.get_text().replace("−", "-")) == at for at, t in ticks)


def test_demand_is_drawn_in_its_units(sized, drawn):
    speed, flow, pressure, power = drawn["walking_demand"].axes
    for ax, unit, peak in (
        (speed, "(mm/s)", 620.0),
        (flow, "(L/min)", 9.96),
        (pressure, "(MPa)", 0.65),
    ):
        assert ax.get_ylabel().endswith(unit)
        for line, factor in zip(ax.lines, (1.0, 1.1), strict=False):
            assert line.get_ydata() == pytest.approx(factor * peak * WAVE)
    assert power.lines[0].get_ydata() == pytest.approx(69.0 * (WAVE + 0.25) / 1.25)
    _, trace = last_stride(sized.traces["sized"], 1.0)
    litres = 0.8e-3 * FLOW / 6.0 * 60.0 / (2.0 * math.pi) * 100.0  # of 100 rad/s
    for ax, factor in ((flow, litres), (pressure, 2.0), (power, 40.0)):
        assert ax.lines[2].get_ydata() == pytest.approx(factor * trace["time_s"])
    reach = speed.patches[0].get_path().vertices[:, 1] if speed.patches else []
    bounds = speed.patches[0].get_extents().transformed(speed.transData.inverted())
    assert len(reach) > 0
    assert (bounds.y0, bounds.y1) == pytest.approx((-SPEED_MM_S, SPEED_MM_S))


def test_every_axis_has_its_own_label_and_title(drawn):
    labels = {
        name: [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
        for name, figure in drawn.items()
    }
    factor, error = "factor on the value", "largest error (deg)"
    speed = ("rod speed limit R (mm/s)", "acceleration limit (rad/s²)")
    assert labels == {
        "sizing_sweeps": [(factor, "−3 dB bandwidth (Hz)"), (factor, error), (factor, error)],
        "sizing_maps": [speed, speed, ("", ""), ("", "")],
        "walking_gains": [("λ (1/s)", "k/Φ (1/s)"), ("", "largest error in walking (deg)")],
        "walking_tracking": [
            ("", "knee flexion (deg)"),
            ("", "error (deg)\nlogarithmic beyond ±2"),
            ("gait cycle (%)", "motor speed (rpm)"),
        ],
        "walking_demand": [
            ("", "rod speed (mm/s)"),
            ("", "pump flow (L/min)"),
            ("gait cycle (%)", "load pressure (MPa)"),
            ("gait cycle (%)", "shaft power (W)"),
        ],
    }
    sweeps, (left, right, *_) = drawn["sizing_sweeps"].axes, drawn["sizing_maps"].axes
    assert [ax.get_title() for ax in sweeps] == [
        "(a) 10…70°, hardware as it is",
        "(b) 10…70° at 0.1 Hz, hardware as it is",
        "(c) walking at 1 Hz, sized hardware",
    ]
    assert all(ax.get_xscale() == ax.get_yscale() == "log" for ax in (*sweeps, left, right))
    assert left.get_title(loc="right") == "−3 dB bandwidth (Hz)"
    assert right.get_title(loc="right") == "largest error (deg)"
    assert left.get_title(loc="left") == "(a) controller as it is"
    assert right.get_title(loc="left") == "(b) walking at 1 Hz, sized controller"
    (bound,) = [line for line in sweeps[2].lines if "bound" in line.get_label()]
    assert bound.get_label() == "(c) bound of the paper, 2°"
    assert set(bound.get_ydata()) == {2.0}
    for name in ("sizing_sweeps", "walking_tracking", "walking_demand"):
        (legend,) = drawn[name].legends
        shown = [text.get_text() for text in legend.get_texts()]
        assert len(set(shown)) == len(shown) == {"sizing_sweeps": 10}.get(name, len(shown))
    assert [text.get_text() for text in drawn["walking_demand"].legends[0].get_texts()] == [
        *("needed, moving mass of Eq. 16", "needed, inertia of the shank", "closed loop")
    ]
    assert drawn["walking_tracking"].axes[0].get_xlim() == (0.0, 100.0)
    assert drawn["walking_demand"].axes[0].get_xlim() == (0.0, 100.0)


def test_the_view_shows_what_walks(sized):
    shown = motions(sized)
    assert list(shown) == ["hardware as it is", "sized hardware"]
    for (linkage, columns), trace in zip(shown.values(), sized.traces.values(), strict=True):
        assert linkage is sized.scenario.plant.linkage
        assert columns["time_s"][0] == 0.0
        np.testing.assert_allclose(np.diff(columns["time_s"]), np.diff(trace["time_s"]))
        assert columns["knee_angle_rad"] is trace["knee_angle_rad"]
    stopped = dataclasses.replace(sized, traces=sized.traces | {"nominal": {}})
    assert list(motions(stopped)) == ["sized hardware"]
