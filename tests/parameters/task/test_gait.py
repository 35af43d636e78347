"""The measured gait: the data, its licence, and the reference made of it."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from kneexo.parameters import gait_reference
from kneexo.parameters.task.gait import (
    GAIT_STRIDE_S,
    MOMENT_STRIDE_S,
    gait_knee_flexion,
    gait_knee_moment,
    gait_moment_cycle,
    gait_start_percent,
)
from kneexo.systems.knee_reference import make_knee_reference, reference_range_deg


def evaluate(reference, times):
    """θ_d and three derivatives, (n, 4), in deg and s."""
    system = make_knee_reference(reference)
    context = system.CreateDefaultContext()

    def at(time):
        context.SetTime(time)
        return system.get_output_port().Eval(context)

    return np.degrees([at(time) for time in times])


def test_the_data_name_their_source_and_licence():
    text = files("kneexo").joinpath("data", "gait_knee_flexion.csv").read_text(encoding="utf-8")
    head = text.splitlines()[:2]
    assert all(line.startswith("#") for line in head)
    for credit in ("NONAN GaitPrint", "Wiles et al.", "CC BY 4.0", f"{GAIT_STRIDE_S:.3f} s"):
        assert credit in "".join(head)


def test_the_moment_names_its_source_and_has_its_licence():
    data = files("kneexo").joinpath("data")
    head = data.joinpath("knee_angle_moment_walk.csv").read_text(encoding="utf-8").splitlines()[:3]
    assert all(line.startswith("#") for line in head)
    for credit in ("opensim-core", "id_walk.sto", "0435b081", "Apache-2.0", "flexion positive"):
        assert credit in "".join(head)
    licence = data.joinpath("knee_angle_moment_walk.LICENSE.txt").read_text(encoding="utf-8")
    assert "Apache License" in licence
    assert "9. Accepting Warranty or Additional Liability." in licence


def test_the_moment_is_as_printed_in_its_file():
    time, flexion, moment = gait_knee_moment()
    assert time == pytest.approx(0.45 + 0.001 * np.arange(1350), abs=1e-9)
    assert (flexion[0], moment[0]) == (21.6655, -64.2495)
    assert (flexion[-1], moment[-1]) == (9.2031, -7.3544)
    assert (flexion.max(), moment.min(), moment.max()) == (72.2343, -65.2298, 34.0237)


def test_the_data_span_one_cycle():
    percent, mean, deviation = gait_knee_flexion()
    assert np.array_equal(percent, np.arange(101.0))
    assert mean.shape == deviation.shape == (101,)
    assert (deviation > 0.0).all()
    # As printed in the file: heel contact, the swing's peak, mid-stance.
    assert (mean[0], mean[71], mean[41]) == (4.157, 59.159, 2.332)
    assert gait_start_percent() == 41.0


@pytest.mark.parametrize("frequency_hz", [1.0, 1.0 / GAIT_STRIDE_S])
def test_rates_are_the_differences_of_the_data(frequency_hz):
    percent, mean, _ = gait_knee_flexion()
    step = 0.01 / frequency_hz
    times = (percent + 100.0 - gait_start_percent()) * step
    rate, acceleration = evaluate(gait_reference(frequency_hz, 3), times)[:, 1:3].T
    # What a cubic spline with continuous acceleration obeys at every knot; the line that closes
    # the cycle adds its slope. Rounding: 1e-16 · 60° / h² = 1e-10 of the peak.
    slope = (mean[-1] - mean[0]) * frequency_hz
    differences = (mean[2:] - mean[:-2]) / (2.0 * step) - slope
    mixed = (rate[:-2] + 4.0 * rate[1:-1] + rate[2:]) / 6.0
    assert mixed == pytest.approx(differences, abs=1e-8 * np.abs(differences).max())
    second = (mean[2:] - 2.0 * mean[1:-1] + mean[:-2]) / step**2
    mixed = (acceleration[:-2] + 4.0 * acceleration[1:-1] + acceleration[2:]) / 6.0
    assert mixed == pytest.approx(second, abs=1e-8 * np.abs(second).max())


def test_the_peak_rate_is_that_of_the_measured_stride():
    times = np.linspace(0.0, GAIT_STRIDE_S, 2001)
    rate = evaluate(gait_reference(1.0 / GAIT_STRIDE_S, 2), times)[:, 1]
    assert np.abs(rate).max() == pytest.approx(446.0, abs=2.0)  # from the data: 3.97°/1 %


def test_it_is_periodic_closed_and_smooth():
    reference = gait_reference(1.0, 4)
    times = np.linspace(1.0, 2.0, 500)
    first, second = evaluate(reference, times), evaluate(reference, times + 1.0)
    # The ends of the spline reach in with a factor of 0.27 a sample: nothing after 100 of them.
    assert np.abs(first - second)[:, :3].max() <= 1e-9 * np.abs(first).max()
    assert reference.angles_deg[0] == reference.angles_deg[-1]
    percent, mean, _ = gait_knee_flexion()
    stride = np.array(reference.angles_deg[59:160])  # heel contact to heel contact
    # A straight line closes the cycle: nothing at its start, all of the gap at its end.
    assert np.allclose(
        mean - stride,
        (mean[-1] - mean[0]) * percent / 100.0 * (percent < 100.0)
        + (mean[-1] - mean[0]) * (percent == 100.0),
        atol=1e-12,
    )
    assert np.abs(mean - stride).max() < 0.033
    # Continuous acceleration: no jump within a microsecond at the samples.
    beside = evaluate(reference, [1.5 - 1e-7, 1.5 + 1e-7])
    assert np.abs(np.diff(beside[:, :3], axis=0)).max() < 0.05


def test_it_stays_inside_the_range_of_motion_between_samples_too():
    low, high = reference_range_deg(gait_reference(1.0, 3))
    assert 2.31 < low < 2.332  # the spline passes the lowest sample by 0.014°
    assert 59.1 < high < 59.17


def test_it_starts_and_ends_at_rest():
    reference = gait_reference(1.0, 3)
    start, end = evaluate(reference, [0.0, 3.0])
    assert reference.times_s[0] == 0.0
    assert reference.times_s[-1] == pytest.approx(3.0)
    # Least flexion: less than 0.5 % of the peak rate of 398 deg/s.
    assert max(abs(start[1]), abs(end[1])) < 2.0


@given(frequency=st.floats(0.05, 10.0), cycles=st.integers(1, 5))
def test_only_time_scales_with_the_frequency(frequency, cycles):
    reference, base = gait_reference(frequency, cycles), gait_reference(1.0, cycles)
    assert reference.angles_deg == base.angles_deg
    assert np.allclose(np.multiply(reference.times_s, frequency), base.times_s, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["gait_knee_flexion.csv", "knee_angle_moment_walk.csv", "knee_angle_moment_walk.LICENSE.txt"],
)
def test_a_built_wheel_ships_the_data(wheel, name):
    data = f"kneexo/data/{name}"
    assert (wheel / data).read_bytes() == (Path(__file__).parents[3] / data).read_bytes()


def test_the_moment_over_the_gait_cycle_is_the_last_stride_of_its_file():
    _, flexion, moment = gait_knee_moment()
    cycle = gait_moment_cycle()
    assert cycle.shape == (101,)
    assert cycle[0] == cycle[-1]
    # The stride by hand: 1147 samples of 1 ms before the last one, linearly between two samples.
    position = 202.0 + 11.47 * np.arange(100)
    lower = position.astype(int)
    part = position - lower
    stride = (1.0 - part) * moment[lower] + part * moment[lower + 1]
    closed = stride - 0.01 * np.arange(100) * (moment[1349] - moment[202])
    angle = (1.0 - part) * flexion[lower] + part * flexion[lower + 1]
    # Circular correlation by the Fourier transform.
    mean = gait_knee_flexion()[1][:-1]
    correlation = np.fft.ifft(np.fft.fft(mean) * np.conj(np.fft.fft(angle))).real
    shift = int(np.argmax(correlation))
    assert cycle[:-1] == pytest.approx(closed[(np.arange(100) - shift) % 100], abs=1e-9)
    # Both knees flex most at the same time, to two percent of the stride.
    assert abs((np.argmax(angle) + shift) % 100 - np.argmax(mean)) <= 2
    assert int(np.argmin(cycle)) in range(12, 20)  # extension moment of early stance
    assert np.abs(closed - stride).max() < 1.2


def test_the_strides_of_the_moment_file_repeat_after_their_duration():
    _, flexion, moment = gait_knee_moment()

    def mismatch(samples):
        return sum(
            np.mean((values[samples:] - values[:-samples]) ** 2) / np.var(values)
            for values in (flexion, moment)
        )

    best = min(range(1050, 1250), key=mismatch)
    assert best == pytest.approx(1e3 * MOMENT_STRIDE_S, abs=2.0)
