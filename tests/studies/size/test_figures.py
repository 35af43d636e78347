from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from size_cases import (
    ACCELERATION,
    FLOW,
    SETTINGS,
    SPEED_MM_S,
    WAVE,
)

from kneexo.analysis.hardware import (
    ACCELERATION_LIMIT,
    DISPLACEMENT,
    HARDWARE,
    SPEED_LIMIT,
)
from kneexo.parameters import UNCERTAIN_KNEE
from kneexo.studies.plots import colour_map
from kneexo.studies.size.figures import figures, last_stride, motions
from kneexo.studies.size.report import report


@pytest.mark.slow
def test_every_figure_can_be_drawn(study):
    result, _ = study
    assert "nan" not in report(result)
    for figure in figures(result).values():
        figure.canvas.draw()


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
            assert y == pytest.approx([row[name] for row in sweep], nan_ok=True)
    bounds = curves(axes[0])
    for path, label in (
        (SPEED_LIMIT, "motor speed"),
        (DISPLACEMENT, "displacement"),
        (ACCELERATION_LIMIT, "acceleration"),
    ):
        (shown,) = (v for k, v in bounds.items() if k.startswith("bound") and label in k)
        expected = [row["expected_bandwidth_hz"] for row in sized.sweeps[path]]
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
            text = [t for p, t in written.items() if p == pytest.approx(at)]
            assert text == ([] if math.isnan(value) else [f"{value:.2g}"])
        # A light cell is good, a wide bandwidth as well as a small error.
        worse = "low" if ax is drawn["sizing_maps"].axes[0] else "high"
        assert ax.collections[0].get_cmap() == colour_map(worse)


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
        ratio = 7.2666 if "7.3" in label else 0.73
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


def test_pressures_of_the_stride_are_drawn_with_their_limits(sized, drawn):
    before, after = drawn["stride_pressure"].axes
    assert [ax.get_title() for ax in (before, after)] == [
        "hardware as it is",
        "sized, with its piston",
    ]
    for ax, relative in ((before, 1.0), (after, 1.21)):
        lines = {line.get_label(): line for line in ax.lines}
        assert list(lines) == [
            *("P_1, share 1", "P_2, share 1", "P_1, share 0.5", "P_2, share 0.5"),
            *("growing chamber", "relief valves open", "oil evaporates"),
        ]
        assert set(lines["relief valves open"].get_ydata()) == {3.5}
        assert lines["oil evaporates"].get_ydata() == pytest.approx([-0.1, -0.1])
        for share in (1.0, 0.5):
            held = max(lines[f"P_2, share {share:g}"].get_ydata()) - 4.0 / 15.0  # P_r A_1/A_2
            assert held == pytest.approx(share * 757 / 235.62 / relative, abs=0.006)
    growing = before.lines[4].get_ydata()
    assert (min(growing), max(growing)) == pytest.approx((-0.845, 0.2), abs=1e-3)
    assert before.get_xlim() == pytest.approx((0.0, 1.349))


def test_every_axis_has_its_own_label_and_title(drawn, check_caption):
    labels = {
        name: [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
        for name, figure in drawn.items()
    }
    factor, error = "factor on the value", "largest error (deg)"
    speed = ("rod speed limit R (mm/s)", "acceleration limit (rad/s²)")
    assert labels == {
        "sizing_sweeps": [
            *((factor, "−3 dB bandwidth (Hz)"), (factor, error), (factor, error), ("", ""))
        ],
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
        "stride_pressure": [
            *(("", "pressure (MPa)"), ("time in the stride (s)", "pressure (MPa)")),
        ],
    }
    *sweeps, key = drawn["sizing_sweeps"].axes
    left, right, *_ = drawn["sizing_maps"].axes
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
    legends = [
        key.get_legend(),
        *drawn["walking_tracking"].legends,
        *drawn["walking_demand"].legends,
    ]
    for legend, count in zip(legends, (10, 6, 3), strict=True):
        shown = {text.get_text() for text in legend.get_texts()}
        assert len(shown) == len(legend.get_texts()) == count
    for figure in drawn.values():
        check_caption(figure)
    assert [text.get_text() for text in drawn["walking_demand"].legends[0].get_texts()] == [
        *("needed, moving mass of Eq. 16", "needed, inertia of the shank", "closed loop")
    ]
    assert drawn["walking_tracking"].axes[0].get_xlim() == (0.0, 100.0)
    assert drawn["walking_demand"].axes[0].get_xlim() == (0.0, 100.0)


def test_the_view_shows_what_walks(sized):
    shown = motions(sized)
    assert list(shown) == ["hardware as it is", "sized hardware"]
    for (plant, columns), trace in zip(shown.values(), sized.traces.values(), strict=True):
        assert plant is sized.scenario.plant
        assert columns["time_s"][0] == 0.0
        np.testing.assert_allclose(np.diff(columns["time_s"]), np.diff(trace["time_s"]))
        assert columns["knee_angle_rad"] is trace["knee_angle_rad"]
    stopped = dataclasses.replace(sized, traces=sized.traces | {"nominal": {}})
    assert list(motions(stopped)) == ["sized hardware"]
