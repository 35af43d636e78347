"""The frequency response over amplitude and frequency, its report and its pictures."""

import math
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis import bandwidth
from kneexo.analysis.bandwidth import (
    acceleration_bound_hz,
    follower_bandwidth_hz,
    follower_response,
    large_signal_bandwidth_hz,
    rod_amplitude_m,
    rod_limits,
    speed_limit_reached_hz,
)
from kneexo.analysis.sampled_loop import linearize_loop
from kneexo.analysis.sine_estimate import SineEstimate, SineEstimateSettings
from kneexo.command_line.output import to_json
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import RampReference, Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation.engines import simulate
from kneexo.studies.bandwidth import BandwidthResult, BandwidthSettings, bandwidth_study, study
from kneexo.studies.bandwidth.figures import figures
from kneexo.studies.bandwidth.report import report
from kneexo.sweeps.checkpoint import Checkpoint

QUICK = SineEstimateSettings(averaged_cycles=2, largest_cycles=3)
BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "validate_bandwidth.py"


def sine(amplitude_deg, **values):
    return changed(Scenario(), {"reference.amplitude_deg": amplitude_deg, **values})


# --------------------------------------------------------------------------- amplitude map


SMALL_MAP = BandwidthSettings(
    amplitudes_deg=(0.3, 3.0), frequencies_hz=(2.5, 5.0, 12.5), estimate=QUICK
)


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "checkpoint.jsonl"
    return bandwidth_study(Scenario(), SMALL_MAP, checkpoint=Checkpoint(path)), path


def test_the_map_shows_where_the_limits_take_over(mapped):
    result, _ = mapped
    assert result.response.shape == (2, 3)
    assert not result.failures
    assert [result.decided_by(i)[0] for i in range(2)] == ["linear loop", "speed limit"]
    # Bandwidths: the linear loop's 4.06 Hz; below the follower's 2.22 Hz, as acceleration counts.
    assert result.bandwidths["measured_hz"][0] == pytest.approx(4.06, rel=0.02)
    assert 0.88 <= result.bandwidths["measured_hz"][1] / result.bandwidths["follower_hz"][1] <= 1.0
    assert result.cells["speed_limited_share"][1, 0] > 0.2
    assert np.all(result.cells["speed_limited_share"][0] == 0.0)
    assert np.all(result.cells["acceleration_limited_share"][:, 2] > 0.5)
    assert result.linear_deviation(quantized=False) < 2e-3
    assert result.linear_deviation(quantized=False) < result.linear_deviation(quantized=True) < 0.03
    speed, acceleration = rod_limits(Scenario())
    omega = math.tau * result.frequencies_hz
    bound = 4 / math.pi * np.minimum(speed / omega, acceleration / omega**2)
    for gain, amplitude in zip(np.abs(result.response), (0.3, 3.0), strict=True):
        # The bound holds for any controller; 5 % for the curvature of x(θ) and the settling.
        assert np.all(gain <= 1.05 * bound / rod_amplitude_m(sine(amplitude)))


def projected(amplitude_deg, frequency_hz, *, quantized):
    """Response of the knee to a sine: a fit of sine and drift to the last 2 of 6 cycles."""
    values = {
        "reference.frequency_hz": frequency_hz,
        "reference.ramp_s": 0.6,
        "simulation.duration_s": 0.6 + 6.0 / frequency_hz,
        "encoder.quantized": quantized,
    }
    run = simulate(sine(amplitude_deg, **values), signals=("knee_reference", "knee_angle"))
    time = run.time_s[-round(2.0 / frequency_hz / 0.002) :]
    phase = 2.0 * math.pi * frequency_hz * time
    terms = np.stack([np.cos(phase), np.sin(phase), np.ones_like(time), time - time.mean()], axis=1)
    angle, reference = (
        np.linalg.lstsq(terms, run[f"knee_{name}_rad"][-time.size :])[0]
        for name in ("angle", "reference")
    )
    response = complex(*angle[:2]) / complex(*reference[:2])
    return response.conjugate(), math.degrees(angle[2])


def test_every_row_of_the_map_is_that_of_its_own_run(mapped, tables, check_cells):
    result, _ = mapped
    for i, amplitude in enumerate((0.3, 3.0)):
        for j, frequency in enumerate((2.5, 5.0, 12.5)):
            response, mean_deg = projected(amplitude, frequency, quantized=True)
            # Other cycles: they differ by less than the uncertainty.
            allowed = 5.0 * result.cells["uncertainty"][i, j] + 0.01 * abs(response)
            assert result.response[i, j] == pytest.approx(response, abs=allowed)
            assert result.cells["mean_deg"][i, j] == pytest.approx(mean_deg, abs=2.0)
            if i == 0:
                response, _ = projected(amplitude, frequency, quantized=False)
                assert result.unquantized[j] == pytest.approx(response, rel=0.01)
    loop = linearize_loop(Scenario(), 40.0)
    assert result.linear == pytest.approx(loop.output_response(np.array([2.5, 5.0, 12.5])))
    expected = []
    for amplitude, name in ((0.3, "linear loop"), (3.0, "speed limit")):
        at = sine(amplitude)
        row = [large_signal_bandwidth_hz(at), loop.bandwidth_hz()]
        row.append(acceleration_bound_hz(rod_limits(at)[1], rod_amplitude_m(at)))
        row += [follower_bandwidth_hz(at), rod_limits(at)[0] / rod_amplitude_m(at)]
        row[-1] /= 2.0 * math.pi * 0.555390  # ρ = R/(aω) at −3 dB of the closed form
        expected.append([amplitude, *row, name, row[0] / row[1 if name == "linear loop" else 3]])
    (shown,) = tables(report(result))
    check_cells(shown, expected)
    reached = result.bandwidths["speed_limit_reached_hz"]
    assert reached == pytest.approx([speed_limit_reached_hz(sine(a)) for a in (0.3, 3.0)])
    follower = [[follower_response(sine(a), f) for f in (2.5, 5.0, 12.5)] for a in (0.3, 3.0)]
    assert result.follower == pytest.approx(np.array(follower))


def test_a_bus_that_rounds_is_a_quantizer_of_the_map():
    settings = changed(SMALL_MAP, {"amplitudes_deg": (0.3,)})
    free = {"encoder.quantized": False}
    bus = {"bus": {"kind": "cia402", "latency_samples": 0}}
    rounded, exact = (
        bandwidth_study(changed(Scenario(), values), settings) for values in (free | bus, free)
    )
    np.testing.assert_array_equal(rounded.unquantized, exact.response[0])
    assert np.all(rounded.response != exact.response)
    assert "% with them" in report(rounded)
    assert "% with them" not in report(exact)


def test_a_map_without_a_sine_to_compare_with_the_linear_loop_says_so(mapped):
    limited = replace(mapped[0], unlimited=np.zeros(3, dtype=bool))
    assert "nothing to compare with the linear loop" in report(limited)
    failed = mapped[0].response.copy()
    failed[0] = math.nan
    for result in (limited, replace(mapped[0], response=failed)):
        assert "nan" not in report(result)


def test_the_report_names_the_sine_whose_mean_wanders_most(by_hand):
    means = np.array([[40.0, 41.0, 41.5], [39.1, 32.4, 45.0]])  # about 40°
    text = report(replace(by_hand, cells=by_hand.cells | {"mean_deg": means}))
    assert "At 3 sines the mean" in text
    assert "(7.6°) at 30° and 0.2 Hz" in text


@pytest.mark.slow
def test_every_figure_of_a_map_can_be_drawn(mapped):
    for figure in figures(mapped[0]).values():
        figure.canvas.draw()


GAINS = np.array([[0.99, 0.8, 0.5], [0.95, 0.6, 0.2]])
PHASES = np.array([[-5.0, -20.0, -50.0], [-15.0, -70.0, -190.0]])
LINEAR_GAINS, LINEAR_PHASES = np.array([1.0, 0.91, 0.52]), np.array([-4.0, -19.0, -45.0])
FOLLOWER = np.array([[1.0, 1.0, 0.8], [0.97, 0.65, 0.25]])
BANDWIDTHS = {
    "measured_hz": [0.3, 0.16],
    "linear_loop_hz": [0.31, 0.31],
    "acceleration_bound_hz": [3.3, 0.5],
    "follower_hz": [6.7, 0.17],
    "rate_limit_hz": [6.9, 0.18],
    "speed_limit_reached_hz": [4.0, 0.12],
}
AMPLITUDES, FREQUENCIES = (1.0, 30.0), (0.1, 0.2, 0.4)


def table(start):
    return start + 0.01 * np.arange(6.0).reshape(2, 3)


@pytest.fixture(scope="module")
def by_hand():
    """A map that nothing was simulated for: its numbers tell each other apart."""
    return BandwidthResult(
        amplitudes_deg=np.array(AMPLITUDES),
        frequencies_hz=np.array(FREQUENCIES),
        response=GAINS * np.exp(1j * np.radians(PHASES)),
        cells={
            "uncertainty": 0.1 * table(0.1),
            "settled": np.array([[True, True, False], [True, False, True]]),
            "cycles": np.arange(6).reshape(2, 3),
            "mean_deg": table(40.0),
            "speed_limited_share": table(0.3),
            "acceleration_limited_share": table(0.6),
        },
        bandwidths={name: np.array(values) for name, values in BANDWIDTHS.items()},
        linear=LINEAR_GAINS * np.exp(1j * np.radians(LINEAR_PHASES)),
        linear_failure="",
        follower=FOLLOWER * np.exp(0.2j),
        unquantized=LINEAR_GAINS * np.exp(1j * np.radians(LINEAR_PHASES)) * [1.003, 0.905, 5.0],
        unlimited=np.array([True, True, False]),
        failures=("30 deg, 9 Hz: left the range",),
        scenario=Scenario(),
        settings=BandwidthSettings(
            amplitudes_deg=AMPLITUDES, frequencies_hz=FREQUENCIES, estimate=QUICK
        ),
    )


def test_results_of_a_map_are_those_of_its_cells(by_hand, flat, check_rules):
    numbers = by_hand.results()
    check_rules(numbers)
    deviation = max(  # of the two sines off the limits
        abs(g * np.exp(1j * math.radians(a - b)) / h - 1.0)
        for g, a, h, b in ((0.99, -5.0, 1.0, -4.0), (0.8, -20.0, 0.91, -19.0))
    )
    expected = {
        "frequencies_hz": FREQUENCIES,
        "linear_loop": {
            "gain": LINEAR_GAINS,
            "phase_deg": LINEAR_PHASES,
            "failure": "",
            "largest_deviation": deviation,
            "largest_deviation_without_quantizer": 0.095,
        },
        "amplitudes": [
            {
                "amplitude_deg": amplitude,
                "bandwidths": {name: values[i] for name, values in BANDWIDTHS.items()},
                "decided_by": ("linear loop", "speed limit")[i],
                "gain": GAINS[i],
                "phase_deg": PHASES[i],
                **{name: values[i] for name, values in by_hand.cells.items()},
            }
            for i, amplitude in enumerate(AMPLITUDES)
        ],
        "failures": ["30 deg, 9 Hz: left the range"],
    }
    assert flat(numbers) == pytest.approx(flat(expected))


def test_the_frame_has_a_row_for_each_cell(by_hand, monkeypatch):
    monkeypatch.setattr(study, "data_frame", lambda columns: columns)  # needs no pandas
    columns = by_hand.to_dataframe()
    assert columns["amplitude_deg"].tolist() == [1.0, 1.0, 1.0, 30.0, 30.0, 30.0]
    assert columns["frequency_hz"].tolist() == [0.1, 0.2, 0.4] * 2
    assert columns["gain"] == pytest.approx(GAINS.ravel())
    assert columns["phase_deg"] == pytest.approx(PHASES.ravel())
    for name, values in by_hand.cells.items():
        assert columns[name].tolist() == values.ravel().tolist()


def test_every_cell_of_the_report_is_in_the_map(by_hand, tables, check_cells):
    text = report(by_hand)
    (shown,) = tables(text)
    columns = (
        "measured_hz",
        "linear_loop_hz",
        "acceleration_bound_hz",
        "follower_hz",
        "rate_limit_hz",
    )
    lowest = (("linear loop", 0.31), ("speed limit", 0.17))
    check_cells(
        shown,
        [
            [a, *(BANDWIDTHS[c][i] for c in columns), name, BANDWIDTHS["measured_hz"][i] / hertz]
            for i, (a, (name, hertz)) in enumerate(zip(AMPLITUDES, lowest, strict=True))
        ],
    )
    speed, acceleration = rod_limits(Scenario())
    for said in (
        "about 40°, 6 sines",
        "2 sines had not settled after 3 cycles",
        f"at most {100.0 * 0.1 * 0.15 / 0.2:.2g} % of the gain",
        "the linear loop at 1°; the speed limit at 30°",
        f"at most {1e3 * speed:.3g} mm/s and {acceleration:.3g} m/s²",
        f"below {1e3 * speed**2 / acceleration:.2g} mm of rod",
        "by at most 9.5 % without quantizers, 12 % with them",
        "- 30 deg, 9 Hz: left the range",
    ):
        assert said in text


def test_the_heat_maps_have_frequency_across_and_amplitude_up(by_hand, curves, check_heat_map):
    axes = figures(by_hand)["amplitude_map"].axes
    panels = (
        20.0 * np.log10(GAINS),
        PHASES,
        by_hand.cells["speed_limited_share"],
        by_hand.cells["acceleration_limited_share"],
    )
    labels = ("gain (dB)", "phase (deg)", "speed limit", "acceleration limit")
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
    reached = curves(axes[2])["the reference asks for more speed"]
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


def test_every_axis_has_its_label_scale_limits_and_legend(by_hand):
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
    legends = {
        "amplitude_map": [6, None, 2, 1],
        "bode_by_amplitude": [5, None],
        "rate_limited_sine": [4, 4],
    }
    for name, expected in labels.items():
        axes = drawn[name].axes[: len(expected)]
        assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in axes] == expected
        for ax, count in zip(axes, legends[name], strict=True):
            legend = ax.get_legend()
            assert (None if legend is None else len(legend.get_texts())) == count, name
    sine, demand = drawn["rate_limited_sine"].axes
    for ax in (*drawn["amplitude_map"].axes[:4], *drawn["bode_by_amplitude"].axes, demand):
        assert ax.get_xscale() == "log"
    for ax in (demand, drawn["bode_by_amplitude"].axes[0]):
        assert ax.get_ylim() == (-45.0, 5.0)
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


def test_an_interrupted_map_goes_on_with_identical_results(mapped):
    result, path = mapped
    lines = path.read_bytes().splitlines(keepends=True)
    assert len(lines) == 1 + 6 + 3 + 2  # header, cells, without quantizer, bandwidths
    path.write_bytes(b"".join(lines[:10]))
    again = bandwidth_study(Scenario(), SMALL_MAP, checkpoint=Checkpoint(path, resume=True))
    assert to_json(again.results()) == to_json(result.results())


def test_a_run_that_fails_leaves_its_cell_empty(monkeypatch):
    def estimate(scenario, settings):
        if scenario.reference.frequency_hz == 0.2 and scenario.reference.amplitude_deg == 30.0:
            raise SimulationError("t = 0.1 s: left the range")
        response = 1.0 / (1.0 + 1j * scenario.reference.frequency_hz)
        if scenario.reference.frequency_hz == 0.4:
            response = 0j  # a sine between two counts of the encoder
        return SineEstimate(0.2, 1.0, response, 1e-3, True, 2, 3, 40.0, 0.0, 0.0)

    for module in (bandwidth, study):
        monkeypatch.setattr(module, "estimate_sine", estimate)
    chosen = BandwidthSettings(amplitudes_deg=(1.0, 30.0), frequencies_hz=(0.1, 0.2, 0.4))
    result = bandwidth_study(Scenario(), chosen)
    assert np.argwhere(np.isnan(result.response)).tolist() == [[1, 1]]
    assert result.failures == ("30 deg, 0.2 Hz: t = 0.1 s: left the range",)
    # The phase is unwrapped across the gap.
    assert result.phase_deg[1, [0, 2]] == pytest.approx([-math.degrees(math.atan(0.1)), 0.0])
    assert result.gain_db[1, 2] < -200.0
    assert "- 30 deg, 0.2 Hz: t = 0.1 s: left the range" in report(result)
    for figure in figures(result).values():
        plt.close(figure)


@pytest.mark.parametrize(
    ("scenario", "values", "told"),
    [
        (Scenario(), {"frequencies_hz": (1.0, 2.0, 51.0)}, "51 Hz is too high: must be <= 50 Hz"),
        (Scenario(), {"amplitudes_deg": (1.0, 45.0)}, "leaves the range of motion"),
        (
            Scenario(),
            {"amplitudes_deg": (1.0, 50.0)},
            r"amplitudes_deg\.1 = 50 deg is out of range",
        ),
        (Scenario(reference=RampReference()), {}, "reference = ramp"),
    ],
)
def test_a_map_that_means_nothing_is_refused_before_any_run(monkeypatch, scenario, values, told):
    monkeypatch.setattr(study, "estimate_sine", None)
    with pytest.raises(ParameterError, match=told):
        bandwidth_study(scenario, BandwidthSettings(**values))


@pytest.mark.parametrize("name", ["amplitudes_deg", "frequencies_hz"])
@pytest.mark.parametrize("values", [(1.0, 3.0, 2.0), (1.0, 1.0, 2.0), (0.0, 1.0, 2.0)])
def test_amplitudes_and_frequencies_are_positive_and_increase(name, values):
    with pytest.raises(
        ParameterError,
        match=rf"{name}: must increase|{name}\.0 = 0 \w+ is out of range",
    ):
        BandwidthSettings(**{name: values})
