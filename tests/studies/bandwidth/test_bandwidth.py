"""The frequency response over amplitude and frequency, its report and its pictures."""

import math

import numpy as np
import pytest
from bandwidth_cases import (
    AMPLITUDES,
    BANDWIDTHS,
    FREQUENCIES,
    GAINS,
    LINEAR_GAINS,
    LINEAR_PHASES,
    PHASES,
    SMALL_MAP,
)

from kneexo.analysis.frequency import bandwidth as measured
from kneexo.analysis.frequency.bandwidth import (
    acceleration_bound_hz,
    follower_bandwidth_hz,
    follower_response,
    large_signal_bandwidth_hz,
    rod_amplitude_m,
    rod_limits,
    speed_limit_reached_hz,
)
from kneexo.analysis.frequency.sine_estimate import SineEstimate
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.errors import SimulationError
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation.engines import simulate
from kneexo.studies.bandwidth import BandwidthSettings, bandwidth, bandwidth_study
from kneexo.studies.bandwidth.figures import figures
from kneexo.studies.bandwidth.report import report


def sine(amplitude_deg, **values):
    return changed(Scenario(), {"reference.amplitude_deg": amplitude_deg, **values})


# --------------------------------------------------------------------------- amplitude map


def test_the_map_shows_where_the_limits_take_over(small):
    result, _ = small
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


def test_every_row_of_the_map_is_that_of_its_own_run(small, tables, check_cells):
    result, _ = small
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
    loop = linearize_loop(Scenario(), knee_angle_deg=40.0)
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


@pytest.mark.slow
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


def test_results_of_a_map_are_those_of_its_cells(by_hand, flat):
    numbers = by_hand.results()
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
    monkeypatch.setattr(bandwidth, "data_frame", lambda columns: columns)  # needs no pandas
    columns = by_hand.to_dataframe()
    assert columns["amplitude_deg"].tolist() == [1.0, 1.0, 1.0, 30.0, 30.0, 30.0]
    assert columns["frequency_hz"].tolist() == [0.1, 0.2, 0.4] * 2
    assert columns["gain"] == pytest.approx(GAINS.ravel())
    assert columns["phase_deg"] == pytest.approx(PHASES.ravel())
    for name, values in by_hand.cells.items():
        assert columns[name].tolist() == values.ravel().tolist()


@pytest.mark.slow
def test_a_run_that_fails_leaves_its_cell_empty(monkeypatch):
    def estimate(scenario, settings):
        if scenario.reference.frequency_hz == 0.2 and scenario.reference.amplitude_deg == 30.0:
            raise SimulationError("t = 0.1 s: left the range")
        response = 1.0 / (1.0 + 1j * scenario.reference.frequency_hz)
        if scenario.reference.frequency_hz == 0.4:
            response = 0j  # a sine between two counts of the encoder
        return SineEstimate(0.2, 1.0, response, 1e-3, True, 2, 3, 40.0, 0.0, 0.0)

    for module in (measured, bandwidth):
        monkeypatch.setattr(module, "estimate_sine", estimate)
    chosen = BandwidthSettings(amplitudes_deg=(1.0, 30.0), frequencies_hz=(0.1, 0.2, 0.4))
    result = bandwidth_study(Scenario(), chosen)
    assert np.argwhere(np.isnan(result.response)).tolist() == [[1, 1]]
    assert result.failures == ("30 deg, 0.2 Hz: t = 0.1 s: left the range",)
    # The phase is unwrapped across the gap.
    assert result.phase_deg[1, [0, 2]] == pytest.approx([-math.degrees(math.atan(0.1)), 0.0])
    assert result.gain_db[1, 2] < -200.0
    assert "- 30 deg, 0.2 Hz: t = 0.1 s: left the range" in report(result)
    figures(result)
