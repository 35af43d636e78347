import dataclasses
import math

import numpy as np
import pytest
from bandwidth_cases import (
    AMPLITUDES,
    BANDWIDTHS,
    FOLLOWER,
    FREQUENCIES,
    GAINS,
    LINEAR_GAINS,
    LINEAR_PHASES,
    PHASES,
    table,
)

from kneexo.studies.bandwidth.figures import figures


@pytest.mark.slow
def test_every_figure_of_a_map_can_be_drawn(mapped):
    for figure in figures(mapped[0]).values():
        figure.canvas.draw()


def test_the_heat_maps_have_frequency_across_and_amplitude_up(by_hand, curves, check_heat_map):
    axes = figures(by_hand)["amplitude_map"].axes
    panels = (
        20.0 * np.log10(GAINS),
        PHASES,
        100.0 * by_hand.cells["speed_limited_share"],
        100.0 * by_hand.cells["acceleration_limited_share"],
    )
    labels = ("gain (dB)", "phase (deg)", "speed limit (%)", "acceleration limit (%)")
    for ax, values, label in zip(axes[:4], panels, labels, strict=True):
        shown = np.ma.filled(ax.collections[0].get_array(), np.nan)
        assert shown == pytest.approx(values)
        check_heat_map(ax, FREQUENCIES, AMPLITUDES, shown.reshape(2, 3).T)
        assert ax.get_title(loc="right").endswith(label)
    lines = curves(axes[0])
    for label, name in (
        ("−3 dB, measured", "measured_hz"),
        ("speed limit, closed form", "rate_limit_hz"),
        ("speed limit, follower through x(θ)", "follower_hz"),
        ("acceleration bound", "acceleration_bound_hz"),
        ("linear loop", "linear_loop_hz"),
    ):
        assert lines[label][0] == pytest.approx(BANDWIDTHS[name])
        assert lines[label][1] == pytest.approx(AMPLITUDES)
    reached = curves(axes[2])["the reference requires more speed than the limit"]
    assert reached[0] == pytest.approx(BANDWIDTHS["speed_limit_reached_hz"])
    for ax in axes[2:4]:
        assert ax.lines[0].get_xdata() == pytest.approx(BANDWIDTHS["measured_hz"])


def test_bode_plots_have_measured_linear_and_follower(by_hand, curves):
    gain, phase = figures(by_hand)["bode_by_amplitude"].axes
    share = 0.1 * table(0.1) / GAINS
    for ax, measured, errors, linear, follower in (
        (
            gain,
            20.0 * np.log10(GAINS),
            20.0 * np.log10(1.0 + share),
            20.0 * np.log10(LINEAR_GAINS),
            20.0 * np.log10(FOLLOWER),
        ),
        (
            phase,
            PHASES,
            np.degrees(np.arcsin(share)),
            LINEAR_PHASES,
            np.full((2, 3), math.degrees(0.2)),
        ),
    ):
        for i, bars in enumerate(ax.containers):
            assert bars.get_label() == f"{AMPLITUDES[i]:g}°"
            assert bars[0].get_xdata() == pytest.approx(FREQUENCIES)
            assert bars[0].get_ydata() == pytest.approx(measured[i])
            ends = np.array([segment[:, 1] for segment in bars[2][0].get_segments()])
            assert np.ptp(ends, axis=1) == pytest.approx(2.0 * errors[i])
        dotted = [
            line for line in ax.lines if line.get_linestyle() == ":" and len(line.get_xdata())
        ]
        for line, values in zip(dotted, follower, strict=True):
            assert line.get_ydata() == pytest.approx(values)
        assert curves(ax)["linear loop"][1] == pytest.approx(linear)
    level = [line.get_ydata()[0] for line in gain.lines if len(set(line.get_ydata())) == 1]
    assert level == pytest.approx([-10.0 * math.log10(2.0)])


def test_the_closed_form_is_drawn_over_the_demand_of_speed(by_hand, curves):
    _, ax = figures(by_hand)["rate_limited_sine"].axes
    lines = curves(ax)
    for i, amplitude in enumerate(AMPLITUDES):
        x, y = lines[f"{amplitude:g}°"]
        # −3 dB of the closed form lies at ρ = R/(aω) = 0.5554.
        assert x == pytest.approx(
            np.array(FREQUENCIES) / BANDWIDTHS["rate_limit_hz"][i] / 0.55539, rel=1e-4
        )
        assert y == pytest.approx(20.0 * np.log10(GAINS[i]))
    x, y = lines["closed form"]
    assert np.interp(1.0 / 0.55539, x, y) == pytest.approx(-10.0 * math.log10(2.0), abs=0.01)
    triangle = x > 1.9  # a triangle of speed R: 8/π² · π/2 · ρ
    assert y[triangle] == pytest.approx(20.0 * np.log10(4.0 / math.pi / x[triangle]), abs=1e-6)


def falling_and_rising(by_hand, decibels):
    """``by_hand`` with the same gains in dB for every amplitude and for the linear loop."""
    gains = 10.0 ** (np.array(decibels) / 20.0)
    return dataclasses.replace(by_hand, response=np.array([gains, [1.0] * 3]), linear=gains)


def test_a_gain_that_returns_above_3_db_is_marked_and_said(by_hand, curves):
    drawn = figures(falling_and_rising(by_hand, [0.0, -5.0, -1.0]))
    again = curves(drawn["amplitude_map"].axes[0])["gain above −3 dB again"]
    assert (*again[0], *again[1]) == (FREQUENCIES[2], AMPLITUDES[0])
    assert "rises above it again" in drawn["amplitude_map"].get_label()
    gain = drawn["bode_by_amplitude"].axes[0]
    (at,) = [line.get_xdata()[0] for line in gain.lines if line.get_marker() == "^"]
    # −3.0103 dB lies at 0.49742 of the way from −5 dB to −1 dB, over the logarithm.
    assert at == pytest.approx(FREQUENCIES[1] ** 0.50258 * FREQUENCIES[2] ** 0.49742, rel=1e-4)
    (text,) = gain.texts
    assert text.get_text() == f"△ linear gain rises above −3 dB again at {at:.3g} Hz"
    assert f" The linear gain rises above −3 dB again at {at:.3g} Hz." in (
        drawn["bode_by_amplitude"].get_label()
    )


def test_a_gain_that_does_not_return_is_not_marked(by_hand, curves):
    drawn = figures(falling_and_rising(by_hand, [0.0, -4.0, -5.0]))
    assert "gain above −3 dB again" not in curves(drawn["amplitude_map"].axes[0])
    assert list(drawn["bode_by_amplitude"].axes[0].texts) == []
    assert (
        "again" not in drawn["amplitude_map"].get_label() + drawn["bode_by_amplitude"].get_label()
    )


def test_every_axis_has_its_label_scale_limits_and_legend(by_hand, check_caption):
    drawn = figures(by_hand)
    across, up, gain = "frequency (Hz)", "amplitude (deg)", "gain (dB)"
    labels = {
        "amplitude_map": [("", up), ("", ""), (across, up), (across, "")],
        "bode_by_amplitude": [("", gain), (across, "phase (deg)")],
        "rate_limited_sine": [
            ("time (periods)", "position (amplitudes)"),
            ("speed demand aω/R = 1/ρ (1)", gain),
        ],
    }
    legends = {"amplitude_map": 7, "bode_by_amplitude": 5, "rate_limited_sine": 0}
    for name, expected in labels.items():
        axes = drawn[name].axes[: len(expected)]
        assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in axes] == expected
        check_caption(drawn[name])
        shown = [text for legend in drawn[name].legends for text in legend.get_texts()]
        assert len(shown) == legends[name]  # below the figure, over no data
        if shown:
            assert all(ax.get_legend() is None for ax in axes)
    sine, demand = drawn["rate_limited_sine"].axes
    for ax in (*drawn["amplitude_map"].axes[:4], *drawn["bode_by_amplitude"].axes, demand):
        assert ax.get_xscale() == "log"
    assert demand.get_ylim() == (-45.0, 5.0)
    assert drawn["bode_by_amplitude"].axes[0].get_ylim() == (-45.0, 7.0)
    # The last one and a half of four periods, the sine and three followers of it.
    for line in sine.lines:
        assert line.get_xdata()[[0, -1]] == pytest.approx([0.0, 1.5])
        assert np.abs(line.get_ydata()).max() <= 1.0 + 1e-9
    assert sine.lines[0].get_ydata() == pytest.approx(
        np.sin(2.0 * math.pi * (sine.lines[0].get_xdata() + 2.5)), abs=1e-9
    )
    for line, ratio in zip(sine.lines[1:], (0.8, 0.555390, 0.3), strict=True):
        assert line.get_label() == f"ρ = {ratio:.3g}"
        rate = np.abs(np.diff(line.get_ydata())).max() * 1000.0
        assert rate == pytest.approx(2.0 * math.pi * ratio, rel=1e-3)
    first = drawn["amplitude_map"].axes[0]
    norm = first.collections[0].norm
    assert (norm.vmin, norm.vmax) == (-20.0, 3.0)
    assert list(first.get_yticks()) == [1.0, 30.0]
    for ax in (first, drawn["bode_by_amplitude"].axes[0]):
        assert list(ax.get_xticks()) == [0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0]
