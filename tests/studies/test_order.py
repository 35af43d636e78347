"""Full against reduced order: speeds, modes, bandwidth and the switching force."""

import itertools
import math
from concurrent.futures import Executor

import numpy as np
import pytest

from kneexo.analysis.error_model import error_model
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.errors import ParameterError
from kneexo.parameters import UNCERTAIN_KNEE, KneeLoadParameters, RampReference, Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation.run import Run
from kneexo.studies import order as module
from kneexo.studies.order import (
    OrderSettings,
    OrderStudy,
    frequency_row,
    in_order,
    order_study,
    speed_row,
    switching_row,
    tracking_row,
)
from kneexo.studies.order_figures import figures
from kneexo.studies.order_report import report
from kneexo.sweeps.checkpoint import Checkpoint

# Lee et al. 2020, Tables 2 and 3: bore 20 mm, rod 10 mm, 0.8 cm³/rev behind a gear of 6:1.
AREA_1, AREA_2 = math.pi / 4.0 * 0.020**2, math.pi / 4.0 * (0.020**2 - 0.010**2)
MEAN_AREA = 0.5 * (AREA_1 + AREA_2)
LAG = 0.010
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
    own = changed(Scenario(), {"plant.full_order": {"coulomb_friction_n": 5.0}})
    assert in_order(own, "full").plant.full_order.coulomb_friction_n == 5.0
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
    found = speed_row(changed(UNCERTAIN_KNEE, TIGHT), SETTINGS, (order, force, flexing))
    assert found["saturated_share"] == 1.0
    assert found["rod_speed_mm_s"] == pytest.approx(1e3 * FLOW / area, rel=1e-3)
    assert found["rod_speed_mm_s"] == pytest.approx(printed, abs=0.1)


@pytest.mark.parametrize("posture", [10.0, 40.0, 70.0])
def test_modes_are_those_of_one_chamber_with_its_make_up_valve_or_of_both(posture):
    reduced = frequency_row(UNCERTAIN_KNEE, ("reduced", 60.0, posture))
    assert reduced["mode_hz"] == pytest.approx(447.0, abs=0.5)
    assert reduced["mode_damping"] == pytest.approx(0.0059, abs=1e-4)
    full = frequency_row(UNCERTAIN_KNEE, ("full", 60.0, posture))
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
    assert full["mode_hz"] == pytest.approx(abs(mode) / (2.0 * math.pi), rel=0.01)
    # What the pump's leakage adds is 0.006 in the reduced order.
    assert full["mode_damping"] == pytest.approx(-mode.real / abs(mode), abs=0.006)
    assert full["mode_damping"] > 6.0 * reduced["mode_damping"]


def test_margins_fall_with_the_rod_side_loaded_and_grow_with_the_cap_side():
    margins = {
        case: frequency_row(UNCERTAIN_KNEE, (*case, 40.0))["phase_margin_deg"]
        for case in (("reduced", 60.0), ("full", 60.0), ("full", -60.0))
    }
    low, middle, high = sorted(margins.values())
    assert margins["full", -60.0] == low
    assert margins["full", 60.0] == high
    assert (low, middle, high) == pytest.approx((51.1, 57.1, 61.5), abs=0.2)  # as measured


def test_rows_of_a_known_run_are_those_of_its_later_part(monkeypatch):
    time = np.arange(0.0, 2.0, 0.25)
    late, wave = time >= 0.5, np.where(np.arange(time.size) % 2, 1.0, -1.0)
    columns = {
        "rod_velocity_m_s": np.where(late, 0.03 + 0.002 * wave, 9.0),
        "rod_reference_velocity_m_s": np.where(late, 0.02, 5.0),
        "knee_angle_rad": np.radians(np.where(late, 20.0 + 0.3 * wave, 80.0)),
        "knee_reference_rad": np.radians(np.where(late, 20.1, 0.0)),
        "cap_pressure_pa": np.where(late, 1e6 + 2e5 * wave, 9e6),
        "rod_side_pressure_pa": np.where(late, 3e5, 0.0),
        "motor_speed_command_rad_s": np.where(late & (time < 1.0), 5000.0 * math.pi / 30.0, 1.0),
    }

    def known(scenario, **options):
        return Run(time, columns, scenario.simulation)

    monkeypatch.setattr(module, "simulate", known)
    found = switching_row(UNCERTAIN_KNEE, SETTINGS, (16.0, True))
    assert found == pytest.approx(
        {
            "force_n": 16.0,
            "direction": "in",
            "velocity_swing_mm_s": 4.0,
            "velocity_rms_mm_s": 2.0,
            "load_pressure_swing_mpa": 0.4,
            "max_error_deg": 0.4,
            "oscillates": False,  # not by the 10 mm/s that count
        }
    )
    found = speed_row(UNCERTAIN_KNEE, SETTINGS, ("full", 60.0, False))
    assert found == pytest.approx(
        {
            "order": "full",
            "force_n": 60.0,
            "direction": "out",
            "saturated_share": 2.0 / 6.0,
            "rod_speed_mm_s": 30.0,
        }
    )


def test_a_frequency_row_has_the_units_of_its_names():
    found = frequency_row(UNCERTAIN_KNEE, ("reduced", 60.0, 40.0))
    loop = linearize_loop(in_order(UNCERTAIN_KNEE, "reduced", 60.0), 40.0)
    margins = loop.margins()
    assert found["stable"] is True
    assert found["failure"] == ""
    assert found["delay_margin_ms"] == 1e3 * margins.delay_margin_s
    assert found["delay_margin_ms"] == pytest.approx(187.0, abs=2.0)  # docs/validation.md
    for name in ("phase_margin_deg", "gain_margin", "disk_margin"):
        assert found[name] == getattr(margins, name)
    assert found["bandwidth_hz"] == loop.bandwidth_hz()
    # 60 N on the rod, and the weight of 1.6 kg at 0.2 m over the moment arm at 40°, in N.
    arm = np.polyval(np.polyder(TABLE_1), 40.0) * 1e-3 * 180.0 / math.pi
    weight = 1.6 * 9.81 * 0.2 * math.sin(math.radians(40.0)) / arm
    assert found["rod_force_n"] == pytest.approx(60.0 + weight, rel=0.01)
    trace = found["trace"]
    assert trace["frequencies_hz"][0] == 1.0
    # Well below motor and oil a radian of the motor moves D_m/(gear Ā) in m.
    at_1_hz = abs(1.0 / (1.0 + 2j * math.pi * LAG)) * 0.8e-6 / (2.0 * math.pi) / 6.0 / MEAN_AREA
    assert trace["plant_gain_m"][0] == pytest.approx(at_1_hz, rel=0.01)


def test_no_linear_loop_is_said_in_words():
    signum = changed(UNCERTAIN_KNEE, {"controller.switching": "signum"})
    found = frequency_row(signum, ("full", 60.0, 40.0))
    assert "there is no linear" in found["failure"]
    assert math.isnan(found["phase_margin_deg"])
    assert found["mode_hz"] == pytest.approx(280.0, abs=1.0)  # the plant has its mode all the same


def test_tracking_row_has_the_pressures_of_its_order():
    brief = changed(UNCERTAIN_KNEE, {"simulation.duration_s": 1.0})
    full, reduced = (tracking_row(brief, (order, 60.0)) for order in ("full", "reduced"))
    assert set(full["trace"]["pressures_mpa"]) == {"cap", "rod_side"}
    assert set(reduced["trace"]["pressures_mpa"]) == {"load_pressure"}
    # 60 N and the weight's −8…−9 N at 10…16 deg, on P_1 against the reservoir's 0.2 MPa.
    for force, value in ((51.6, full["cap_max_mpa"]), (50.0, full["cap_min_mpa"])):
        expected = 1e-6 * (force + 0.2e6 * AREA_2) / AREA_1
        assert value == pytest.approx(expected, rel=0.03)
    assert full["rod_side_max_mpa"] == pytest.approx(0.2, abs=0.02)
    assert full["relief_share"] == 0.0
    assert reduced["load_pressure_max_mpa"] == pytest.approx(51.6e-6 / MEAN_AREA, rel=0.03)


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
    found = order_study(UNCERTAIN_KNEE, settings, checkpoint=Checkpoint(path))
    return found, path


def rows(part, **labels):
    return [row for row in part if all(row[k] == v for k, v in labels.items())]


@pytest.mark.slow
def test_tracking_error_of_the_full_order_is_that_of_its_area(comparison):
    found, _ = comparison
    full = changed(Scenario(), {"plant.full_order": {}})
    # θ̇ of 30 deg at 0.1 Hz, times the lag of 28.6 ms, rms: 0.381 deg; leakage and encoder add.
    lag = abs(error_model(full, loaded_chamber="cap").error_m(1.0, 0.0))
    expected = 30.0 * 2.0 * math.pi * 0.1 * lag / math.sqrt(2.0)
    for row in rows(found.tracking, order="full"):
        assert row["rms_error_deg"] == pytest.approx(expected, rel=0.03)
    for row in rows(found.tracking, order="reduced"):
        assert row["rms_error_deg"] < 0.05


@pytest.mark.slow
def test_bandwidth_follows_the_loaded_chamber(comparison):
    found, _ = comparison
    by_case = {(r["order"], r["disturbance_n"]): r["bandwidth_hz"] for r in found.bandwidth}
    # Kinematic follower at Q/A_1, Q/Ā and Q/A_2: 0.196, 0.2247 and 0.262 Hz.
    assert by_case["full", 60.0] == pytest.approx(0.196, abs=0.003)
    assert by_case["full", -60.0] == pytest.approx(0.262, abs=0.003)
    assert by_case["full", 0.0] == pytest.approx(0.262, abs=0.003)  # the weight loads P_2
    for force in (0.0, 60.0, -60.0):
        assert by_case["reduced", force] == pytest.approx(0.2236, abs=0.002)


@pytest.mark.slow
def test_rod_oscillates_near_the_switching_force_in_retraction_alone(comparison):
    found, _ = comparison
    assert found.oscillating_n("in") == [16.0]
    assert found.oscillating_n("out") == []
    inside = rows(found.switching, direction="in", force_n=16.0)[0]
    outside = rows(found.switching, direction="in", force_n=6.0)[0]
    # Halving rk4's step changes the swing by less than 2 %.
    assert inside["velocity_swing_mm_s"] > 20.0 * outside["velocity_swing_mm_s"]
    assert inside["velocity_swing_mm_s"] == pytest.approx(99.0, rel=0.05)
    assert inside["max_error_deg"] < outside["max_error_deg"]


@pytest.mark.slow
def test_comparison_resumes_and_draws(comparison):
    found, path = comparison
    assert len(found.results()["speeds"]) == 8
    again = order_study(found.scenario, found.settings, checkpoint=Checkpoint(path, resume=True))
    assert report(again) == report(found)
    for figure in figures(found).values():
        figure.canvas.draw()


# ------------------------------------------------------- report and figures, by hand-made rows

NAMES = {
    "tracking": (
        *("max_error_deg", "rms_error_deg", "mean_command_change_rpm", "saturated_share"),
        *("load_pressure_min_mpa", "load_pressure_max_mpa", "cap_min_mpa", "cap_max_mpa"),
        *("rod_side_min_mpa", "rod_side_max_mpa"),
    ),
    "speeds": ("saturated_share", "rod_speed_mm_s"),
    "switching": (
        *("velocity_swing_mm_s", "velocity_rms_mm_s", "load_pressure_swing_mpa"),
        "max_error_deg",
    ),
    "frequency": (
        *("rod_force_n", "mode_hz", "mode_damping", "phase_margin_deg", "gain_margin"),
        *("delay_margin_ms", "disk_margin", "bandwidth_hz"),
    ),
    "bandwidth": ("bandwidth_hz",),
}
"""The numbers of a row in each part; no two of all rows are equal."""


@pytest.fixture(scope="module")
def by_hand():
    counter = itertools.count(1)

    def row(part, **labels):
        values = {name: round(0.00617 * next(counter), 5) for name in NAMES[part]}
        if labels.get("order") == "full":
            gone = [name for name in values if name.startswith("load_pressure")]
        else:
            gone = [name for name in values if name.startswith(("cap", "rod_side"))]
        return labels | {k: v for k, v in values.items() if k not in gone}

    loads, postures = (0.0, 60.0), (10.0, 40.0, 70.0)
    both = [(order, load) for load in loads for order in ("reduced", "full")]
    tracking = [row("tracking", order=o, disturbance_n=f) for o, f in both]
    for n, one in enumerate(tracking):
        names = ("load_pressure",) if one["order"] == "reduced" else ("cap", "rod_side")
        one["trace"] = {
            "time_s": [0.0, 1.0, 2.0],
            "error_deg": [0.1 + n, 0.2 + n, 0.3 + n],
            "pressures_mpa": {name: [n + 0.5, n + 0.6, len(name)] for name in names},
        }
    frequency = [
        row("frequency", order=o, disturbance_n=f, posture_deg=p, stable=True, failure="")
        for o, f in both
        for p in postures
    ]
    for n, one in enumerate(frequency):
        one["trace"] = {"frequencies_hz": [1.0, 10.0], "plant_gain_m": [1e-3 * (n + 1), 2e-5 * n]}
    lost = dict.fromkeys(NAMES["frequency"][3:], math.nan)
    frequency[0] |= {"bandwidth_hz": math.nan}
    frequency[1] |= lost | {"stable": False}
    frequency[2] |= lost | {"stable": None, "failure": "no rest"}
    return OrderStudy(
        tracking=tuple(tracking),
        speeds=tuple(
            row("speeds", order=o, force_n=60.0, direction=d)
            for o in ("reduced", "full")
            for d in ("in", "out")
        ),
        switching=tuple(
            row("switching", force_n=f, direction=d, oscillates=d == "in" and f == 16.0)
            for d in ("in", "out")
            for f in (6.0, 16.0)
        ),
        frequency=tuple(frequency),
        bandwidth=tuple(row("bandwidth", order=o, disturbance_n=f, failure="") for o, f in both),
        scenario=UNCERTAIN_KNEE,
        settings=OrderSettings(disturbances_n=loads, postures_deg=postures),
    )


def test_results_are_the_rows_without_their_traces(by_hand, flat, check_rules):
    numbers = by_hand.results()
    check_rules(numbers)
    expected = {
        part: [{k: v for k, v in row.items() if k != "trace"} for row in getattr(by_hand, part)]
        for part in NAMES
    }
    assert flat(numbers) == pytest.approx(flat(expected), nan_ok=True)


def test_every_cell_of_the_report_is_in_the_results(by_hand, tables, check_cells):
    tracking, speeds, bandwidth, frequency, switching = tables(report(by_hand))
    # A range is shown as low…high, to a thousandth of a MPa.
    names = ("load_pressure", "cap", "rod_side")
    for row, own in zip(tracking[1:], by_hand.tracking, strict=True):
        for n, name in enumerate(names):
            ends = [own.get(f"{name}_{end}_mpa") for end in ("min", "max")]
            expected = "" if ends[0] is None else f"{ends[0]:.3f}…{ends[1]:.3f}"
            assert row[5 + n] == expected
    assert tracking[0][5:] == ["P_L (MPa)", "P_1 (MPa)", "P_2 (MPa)"]
    columns = ("disturbance_n", "rms_error_deg", "max_error_deg", "mean_command_change_rpm")
    check_cells(
        [row[:5] for row in tracking],
        [[r["order"], *(r[name] for name in columns)] for r in by_hand.tracking],
    )
    check_cells(
        speeds,
        [
            [r["order"], "60", r["direction"], r["rod_speed_mm_s"], 100.0 * r["saturated_share"]]
            for r in by_hand.speeds
        ],
    )
    check_cells(
        bandwidth,
        [[r["order"], r["disturbance_n"], r["bandwidth_hz"]] for r in by_hand.bandwidth],
    )
    last = {0: "none below Nyquist", 1: "unstable", 2: "no rest"}
    check_cells(
        frequency,
        [
            [
                r["order"],
                *(r[name] for name in ("disturbance_n", "posture_deg", *NAMES["frequency"][:-1])),
                last.get(n, r["bandwidth_hz"]),
            ]
            for n, r in enumerate(by_hand.frequency)
        ],
    )
    columns = ("velocity_swing_mm_s", "load_pressure_swing_mpa", "max_error_deg")
    check_cells(
        switching,
        [[r["force_n"], r["direction"], *(r[n] for n in columns)] for r in by_hand.switching],
    )


def test_the_findings_have_the_extremes_of_each_order(by_hand):
    text = report(by_hand)
    for part, name, form in (
        ("tracking", "rms_error_deg", ".3f"),
        ("speeds", "rod_speed_mm_s", ".1f"),
        ("bandwidth", "bandwidth_hz", ".3f"),
        ("frequency", "mode_damping", ".2g"),
        ("frequency", "phase_margin_deg", ".1f"),
        ("frequency", "disk_margin", ".2f"),
    ):
        said = []
        for order in ("reduced", "full"):
            values = [r[name] for r in getattr(by_hand, part) if r["order"] == order]
            ends = sorted({f"{f(values):{form}}" for f in (np.nanmin, np.nanmax)}, key=float)
            said.append(f"{order} {'…'.join(ends)}")
        assert ", ".join(said) in text
    assert "the paper measured 0.21 Hz" in text
    assert by_hand.oscillating_n("in") == [16.0]
    assert by_hand.oscillating_n("out") == []
    assert "oscillates at 16…16 N when it retracts" in text
    assert "oscillates at none of the forces when it extends" in text


def test_every_line_of_the_figures_is_that_of_its_row(by_hand, curves):
    drawn = figures(by_hand)
    assert set(drawn) == {"order_tracking", "order_switching", "order_frequency"}
    panels = np.reshape(drawn["order_tracking"].axes, (2, 2))
    pressures = {"P_L, reduced": "load_pressure", "P_1, full": "cap", "P_2, full": "rod_side"}
    for (error, pressure), load in zip(panels, (0.0, 60.0), strict=True):
        assert f" {load:g} N" in error.get_title()
        lines, shown = curves(error), curves(pressure)
        for r in rows(by_hand.tracking, disturbance_n=load):
            assert lines[r["order"]][1] == pytest.approx(r["trace"]["error_deg"])
            for name, values in r["trace"]["pressures_mpa"].items():
                (label,) = (k for k, v in pressures.items() if v == name)
                assert shown[label][1] == pytest.approx(values)
    (ax,) = drawn["order_switching"].axes
    lines = curves(ax)
    for label, direction in (("retracting", "in"), ("extending", "out")):
        own = rows(by_hand.switching, direction=direction)
        assert lines[label][0] == pytest.approx([6.0, 16.0])
        assert lines[label][1] == pytest.approx([r["velocity_swing_mm_s"] for r in own])
    (label,) = (label for label in lines if label.startswith("P_r"))
    assert lines[label][0] == pytest.approx(0.2e6 * (AREA_1 - AREA_2))
    assert label.endswith("= 15.7 N")
    (ax,) = drawn["order_frequency"].axes
    lines = curves(ax)
    assert "(mm/rad)" in ax.get_ylabel()
    assert "40 deg" in ax.get_title()
    for r in rows(by_hand.frequency, posture_deg=40.0):
        hertz, gain = lines[f"{r['order']}, {r['disturbance_n']:g} N"]
        assert hertz == pytest.approx(r["trace"]["frequencies_hz"])
        assert gain == pytest.approx([1e3 * value for value in r["trace"]["plant_gain_m"]])
    assert lines["Nyquist, 250 Hz"][0] == pytest.approx(250.0)
    for figure in drawn.values():
        assert all(ax.get_ylabel() for ax in figure.axes)


def test_a_comparison_without_forces_has_dashes_in_its_report():
    settings = OrderSettings(disturbances_n=(0.0,), switching_forces_n=(0.0,))
    empty = OrderStudy((), (), (), (), (), UNCERTAIN_KNEE, settings)
    assert "Rod speed at the limit in mm/s: reduced –, full –." in report(empty)


# ------------------------------------------------------------------------------ bad input


def test_a_ramp_too_short_to_measure_is_refused():
    narrow = changed(UNCERTAIN_KNEE, {"reference.amplitude_deg": 0.1})
    with pytest.raises(ParameterError, match=r"\Aswitching_rate_deg_s = .* must take > 0\.5 s\Z"):
        switching_row(narrow, SETTINGS, (15.0, True))


def test_reference_must_be_a_sine():
    with pytest.raises(ParameterError, match="needs a sine that moves"):
        order_study(Scenario(reference=RampReference()))
