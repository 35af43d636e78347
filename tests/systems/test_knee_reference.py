import math

import numpy as np
import pytest

from diagramc.testing import check_leaf
from kneexo.errors import ParameterError
from kneexo.parameters import (
    KneeParameters,
    RampReference,
    SampledReference,
    Scenario,
    SineReference,
    StepReference,
)
from kneexo.parameters.paths import changed
from kneexo.systems import (
    IntervalReference,
    RampKneeReference,
    SineKneeReference,
    StepKneeReference,
    make_knee_reference,
)
from kneexo.systems.knee_reference import (
    reference_range_deg,
    require_reference_in_range,
    run_middle_deg,
    run_range_deg,
    sampled_spline,
)

TIMES = (0.0, 0.3, 0.5, 1.1, 1.4, 2.0)
ANGLES = (5.0, 30.0, 62.0, 20.0, 18.0, 40.0)
SAMPLES = SampledReference(times_s=TIMES, angles_deg=ANGLES)

kinds = pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        (SineKneeReference, SineReference(mean_deg=45.0, amplitude_deg=20.0, frequency_hz=0.3)),
        (StepKneeReference, StepReference(start_deg=10.0, time_s=0.05)),
        (
            RampKneeReference,
            RampReference(start_deg=70.0, end_deg=15.0, time_s=0.05, rate_deg_s=20.0),
        ),
    ],
    ids=["sine", "step", "ramp"],
)


def reference(system, time):
    context = system.CreateDefaultContext()
    context.SetTime(time)
    return np.array(system.get_output_port().Eval(context))


def references(system, times):
    return np.array([reference(system, time) for time in times])


def rad(*degrees):
    return pytest.approx(np.radians(degrees), rel=1e-14, abs=1e-15)


# ----------------------------------------------------------------------------- conversion


@kinds
def test_conversions_agree_and_keep_arguments_and_changes(kind, parameters):
    check_leaf(kind(parameters), {"time": (0.2, 1.8)})


def test_an_interval_reference_converts():
    ranges = [(0.1, 0.11), (0.104, 0.116), *[(-1.0, 1.0)] * 12]
    check_leaf(IntervalReference(0.01), {"interval": ranges, "time": (0.1, 0.12)})


# --------------------------------------------------------------------- numbers: intervals


def test_an_interval_has_one_polynomial_up_to_its_break_and_another_after_it():
    system = IntervalReference(0.01)
    context = system.CreateDefaultContext()
    random = np.random.default_rng(3)
    before, after = random.uniform(-1.0, 1.0, 8), random.uniform(-1.0, 1.0, 4)
    system.GetInputPort("interval").FixValue(context, [0.5, 0.504, *before, *after])
    for time, powers in ((0.5, before), (0.503, before), (0.504, before), (0.509, after)):
        context.SetTime(time)
        polynomial = np.polynomial.Polynomial(powers, [0.5, 0.51], [0.0, 1.0])
        expected = [polynomial.deriv(order)(time) for order in range(4)]
        np.testing.assert_allclose(system.get_output_port().Eval(context), expected, rtol=1e-9)


# --------------------------------------------------------------------------- numbers: sine


def test_sine_is_40_minus_30_cosine_with_its_derivatives():
    omega = 2.0 * math.pi * 0.1
    for t in np.linspace(0.0, 12.0, 25):
        expected = np.radians(30.0) * np.array(
            [
                40.0 / 30.0 - math.cos(omega * t),
                omega * math.sin(omega * t),
                omega**2 * math.cos(omega * t),
                -(omega**3) * math.sin(omega * t),
            ]
        )
        np.testing.assert_allclose(reference(SineKneeReference(), t), expected, atol=1e-14)


def test_a_ramp_starts_at_rest_at_the_mean_and_ends_in_the_sine():
    ramped = SineKneeReference(SineReference(ramp_s=4.0))
    assert reference(ramped, 0.0) == rad(40.0, 0.0, 0.0, 0.0)
    for time in (4.0, 4.0 + 1e-9, 7.3):  # all three derivatives join there
        assert reference(ramped, time) == pytest.approx(
            reference(SineKneeReference(), time), abs=1e-8
        )
    # Half the amplitude at half the ramp: the cosine there is cos(0.4π).
    half = 40.0 - 15.0 * math.cos(0.4 * math.pi)
    assert reference(ramped, 2.0)[0] == pytest.approx(math.radians(half), rel=1e-14)


@pytest.mark.parametrize(
    "parameters",
    [SineReference(frequency_hz=0.5), SineReference(frequency_hz=0.5, ramp_s=1.5), SAMPLES],
)
def test_derivatives_are_those_of_the_angle(parameters):
    system, h = make_knee_reference(parameters), 1e-4
    times = np.array([0.13, 0.41, 0.77, 1.23, 1.71])  # between the samples
    at, ahead, behind = (references(system, times + step) for step in (0.0, h, -h))
    # Truncation h²/6 times the fourth to sixth derivatives, rounding 1e-16/h.
    np.testing.assert_allclose((ahead - behind)[:, :3] / (2 * h), at[:, 1:], rtol=0, atol=1e-5)


# ----------------------------------------------------------------------- numbers: step, ramp


def test_step_jumps_just_after_its_time_with_zero_derivatives():
    system = StepKneeReference(StepReference(start_deg=20.0, end_deg=45.0, time_s=0.5))
    for time in (0.0, 0.5):
        assert reference(system, time) == rad(20.0, 0.0, 0.0, 0.0)
    for time in (0.5 + 1e-9, 3.0):
        assert reference(system, time) == rad(45.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("start", "end", "sign"), [(20.0, 50.0, 1.0), (50.0, 20.0, -1.0)])
def test_ramp_moves_at_its_rate_between_its_ends(start, end, sign):
    system = RampKneeReference(
        RampReference(start_deg=start, end_deg=end, time_s=0.5, rate_deg_s=15.0)
    )
    assert reference(system, 0.3) == rad(start, 0.0, 0.0, 0.0)
    assert reference(system, 1.5) == rad(start + sign * 15.0, sign * 15.0, 0.0, 0.0)
    assert reference(system, 2.4) == rad(start + sign * 28.5, sign * 15.0, 0.0, 0.0)
    assert reference(system, 2.6) == rad(end, 0.0, 0.0, 0.0)


def test_ramp_without_a_distance_stands_still():
    system = RampKneeReference(RampReference(start_deg=30.0, end_deg=30.0))
    for time in (0.0, 1.0, 1.5, 5.0):
        assert reference(system, time) == rad(30.0, 0.0, 0.0, 0.0)


# ------------------------------------------------------------------------ numbers: samples


def test_spline_of_a_cubic_is_that_cubic():
    times = (0.0, 0.2, 0.5, 0.9, 1.0)
    cubic = np.poly1d([40.0, -60.0, 30.0, 10.0])
    samples = SampledReference(times_s=times, angles_deg=tuple(map(float, cubic(np.array(times)))))
    derivatives = references(make_knee_reference(samples), np.linspace(0.01, 0.99, 23))
    # Not-a-knot ends reproduce any cubic; rounding of the linear solve.
    for order in range(4):
        expected = np.radians(cubic.deriv(order)(np.linspace(0.01, 0.99, 23)))
        np.testing.assert_allclose(derivatives[:, order], expected, rtol=0.0, atol=1e-10)


def test_spline_holds_its_first_and_last_angle_outside():
    system = make_knee_reference(SAMPLES)
    assert reference(system, 2.5) == rad(40.0, 0.0, 0.0, 0.0)
    assert reference(system, -0.5) == rad(5.0, 0.0, 0.0, 0.0)


# ----------------------------------------------------------------------------------- ranges


@pytest.mark.parametrize(
    ("parameters", "low", "high"),
    [
        (SineReference(), 10.0, 70.0),
        (StepReference(start_deg=50.0, end_deg=20.0), 20.0, 50.0),
        (RampReference(start_deg=5.0, end_deg=80.0), 5.0, 80.0),
    ],
)
def test_range_of_a_reference_in_closed_form(parameters, low, high):
    assert reference_range_deg(parameters) == pytest.approx((low, high))


def test_range_of_a_spline_includes_what_it_overshoots_between_samples():
    low, high = reference_range_deg(SAMPLES)
    angles = np.degrees(references(make_knee_reference(SAMPLES), np.linspace(0, 2, 997))[:, 0])
    assert high > max(ANGLES) + 0.5  # it does overshoot
    assert (low, high) == pytest.approx((angles.min(), angles.max()), abs=1e-2)  # grid of 2 ms
    assert low <= angles.min()
    assert high >= angles.max()


# ------------------------------------------------------------------------ interpolation

STOP = {"times_s": (0.0, 1.0, 2.0, 3.0, 4.0), "angles_deg": (0.0, 0.0, 90.0, 90.0, 40.0)}


def interpolated(interpolation, **values):
    return SampledReference(**STOP | values, interpolation=interpolation)


def test_linear_interpolation_joins_samples_by_straight_lines():
    values = references(make_knee_reference(interpolated("linear")), [0.5, 1.25, 3.5])
    angles = np.radians([0.0, 22.5, 65.0])
    assert values[:, 0] == pytest.approx(angles, abs=1e-14)
    assert values[:, 1] == pytest.approx(np.radians([0.0, 90.0, -50.0]), abs=1e-13)
    assert not values[:, 2:].any()


def test_pchip_interpolation_stays_within_its_samples():
    parameters = interpolated("pchip")
    assert reference_range_deg(parameters) == pytest.approx((0.0, 90.0), abs=1e-12)
    values = references(make_knee_reference(parameters), [0.5, 1.5, 2.5])
    # Between horizontal ends: a smoothstep, half way at 1.5 times the mean rate.
    assert np.degrees(values[1, :2]) == pytest.approx([45.0, 135.0])
    assert np.degrees(values[[0, 2], 0]) == pytest.approx([0.0, 90.0], abs=1e-12)


@pytest.mark.parametrize("interpolation", ["pchip", "linear"])
def test_a_reference_may_touch_the_stops(interpolation):
    require_reference_in_range(interpolated(interpolation), KneeParameters())


def test_a_curve_that_passes_the_stops_names_its_interpolation():
    with pytest.raises(ParameterError, match=r"interpolation cubic .* overshoot_deg = 0.5 deg; "):
        require_reference_in_range(interpolated("cubic"), KneeParameters())


def test_a_curve_may_pass_the_stops_by_the_overshoot():
    small = interpolated("cubic", angles_deg=(0.0, 0.0, 1.0, 1.0, 0.5))
    low, _ = reference_range_deg(small)
    assert -0.5 < low < -0.01
    require_reference_in_range(small, KneeParameters())
    with pytest.raises(ParameterError, match="interpolation cubic"):
        require_reference_in_range(small, KneeParameters(overshoot_deg=0.0))


@pytest.mark.parametrize(
    "duration_s",
    [0.3, 4.6, 11.0, *(pytest.param(t, marks=pytest.mark.slow) for t in (2.0, 9.0, 23.0))],
)
@pytest.mark.parametrize(
    "reference",
    [
        {"kind": "sine", "frequency_hz": 0.13, "ramp_s": 0.0},
        {"kind": "sine", "frequency_hz": 0.13, "ramp_s": 12.0},
        {"kind": "sine", "frequency_hz": 0.9, "ramp_s": 3.0},
        {"kind": "ramp", "start_deg": 60.0, "end_deg": 20.0, "rate_deg_s": 7.0},
        {"kind": "step", "time_s": 4.6},
    ],
)
def test_the_range_of_a_run_is_that_of_its_reference_in_time(reference, duration_s):
    scenario = Scenario(reference=reference, simulation={"duration_s": duration_s})
    system = make_knee_reference(scenario.reference)
    context = system.CreateDefaultContext()
    angles = []
    for time in np.linspace(0.0, duration_s, 1501):
        context.SetTime(time)
        angles.append(math.degrees(system.GetOutputPort("knee_reference").Eval(context)[0]))
    low, high = run_range_deg(scenario)
    assert (low, high) == pytest.approx((min(angles), max(angles)), abs=0.03)
    assert run_middle_deg(scenario) == 0.5 * (low + high)
    assert low <= min(angles) + 0.01
    assert high >= max(angles) - 0.01


def test_samples_and_ends_of_the_curve_are_the_range_of_a_run():
    hill = {"kind": "samples", "times_s": (-1.0, 1.0, 3.0), "angles_deg": (10.0, 50.0, 10.0)}
    for interpolation, ends in (("linear", 30.0), ("cubic", 40.0)):  # 50° − 10°(t − 1)²
        scenario = Scenario(reference=hill | {"interpolation": interpolation})
        at_two = changed(scenario, {"simulation.duration_s": 2.0})
        assert run_range_deg(at_two) == pytest.approx((ends, 50.0))
        assert run_range_deg(scenario) == pytest.approx((10.0, 50.0))


@pytest.mark.parametrize("interpolation", ["cubic", "pchip", "linear"])
def test_the_range_of_a_sampled_reference_is_that_of_the_curve_between_samples(interpolation):
    for seed in range(30):
        random = np.random.default_rng(seed)
        times_s = np.cumsum(random.uniform(0.1, 0.5, 4))
        angles_deg = np.round(random.uniform(20.0, 60.0, 4), -1)  # some neighbours are equal
        samples = SampledReference(
            times_s=times_s, angles_deg=angles_deg, interpolation=interpolation
        )
        dense_s = np.union1d(np.linspace(times_s[0], times_s[-1], 2001), times_s)
        curve_deg = np.degrees(sampled_spline(samples).vector_values(dense_s)[0])
        expected = curve_deg.min(), curve_deg.max()
        np.testing.assert_allclose(reference_range_deg(samples), expected, rtol=0.0, atol=5e-3)
