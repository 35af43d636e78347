"""The closed loop against a second program that shares no code with it."""

import math

import numpy as np
import pytest
from loop_cases import COUNT, OBSERVER, PERIOD, PID, REFERENCE, logged, sliding_mode

from kneexo.diagrams import make_closed_loop
from kneexo.parameters import (
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    Scenario,
)

# --------------------------------------------------------- a second program for the same loop

# Lee et al. 2020, Tables 1 to 3; lag, acceleration limit and leakage are assumptions.
TABLE_1 = (1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0)
LAG, ACCELERATION_LIMIT, SPEED_LIMIT = 0.010, 1e4, 5000.0 * math.pi / 30.0
DISPLACEMENT = 0.8e-6 / (2.0 * math.pi) / 6.0  # behind the gear of 6:1
AREA = math.pi / 4.0 * (0.020**2 - 0.5 * 0.010**2)
OIL = 4.0 * 1.72e9 / 41_233e-9
MASS, DAMPING, LEAKAGE = 1.6, 0.05, 2e-13
MASS_ESTIMATE, BETA = math.sqrt(1.4 * 1.8), math.sqrt(1.8 / 1.4)


def knee_sine(time):
    """Taylor coefficients of the knee reference of `REFERENCE` in deg."""
    w = 4.0 * math.pi
    cosine, sine = 1.5 * math.cos(w * time), 1.5 * math.sin(w * time)
    return [40.0 - cosine, w * sine, w**2 * cosine / 2.0, -(w**3) * sine / 6.0]


def rod_reference(knee):
    """x_d and derivatives in m: Table 1 applied to a truncated Taylor series."""
    series = [TABLE_1[0], 0.0, 0.0, 0.0]
    for coefficient in TABLE_1[1:]:
        series = [sum(series[i] * knee[n - i] for i in range(n + 1)) for n in range(4)]
        series[0] += coefficient
    return [1e-3 * s * factorial for s, factorial in zip(series, (1, 1, 2, 6), strict=True)]


def clamp(value, limit):
    return max(-limit, min(limit, value))


class ObserverOracle:
    """α-β-γ filter with a triple pole; T_f = 15 ms."""

    def __init__(self):
        z = math.exp(-PERIOD / 0.015)
        self.gains = (
            1.0 - z**3,
            1.5 * (1.0 - z**2) * (1.0 - z) / PERIOD,
            (1.0 - z) ** 3 / PERIOD**2,
        )
        self.prediction = None

    def __call__(self, y, state):
        if self.prediction is None:
            self.prediction = (y, 0.0, 0.0)
        error = y - self.prediction[0]
        x, v, a = (p + g * error for p, g in zip(self.prediction, self.gains, strict=True))
        self.prediction = (x + PERIOD * v + 0.5 * PERIOD**2 * a, v + PERIOD * a, a)
        return x, v, a


class DifferenceOracle:
    """Backward differences of the last three positions; before the start it was at rest."""

    def __init__(self):
        self.past = []

    def __call__(self, y, state):
        older = [*[y] * (2 - len(self.past)), *self.past[-2:]]
        self.past.append(y)
        v = (y - older[1]) / PERIOD
        return y, v, (y - 2.0 * older[1] + older[0]) / PERIOD**2


class ExactOracle:
    """The plant's own state."""

    def __call__(self, y, state):
        return state


class SlidingModeOracle:
    """Eq. 27 with its errata; λ = 15 1/s, η = 2e5 m/s³; Φ = 0 stands for the signum of Eq. 24."""

    def __init__(self, estimator, phi):
        self.estimator, self.phi = estimator, phi

    def __call__(self, knee, state, knee_reference):
        y = 1e-3 * float(np.polyval(TABLE_1, math.degrees(knee)))
        x, v, a = self.estimator(y, state)
        x_d, v_d, a_d, j_d = rod_reference(knee_reference)
        s = (a - a_d) + 30.0 * (v - v_d) + 225.0 * (x - x_d)
        demand = j_d - 30.0 * (a - a_d) - 225.0 * (v - v_d)
        f = -(OIL * AREA**2 * v + DAMPING * a) / MASS_ESTIMATE
        b = OIL * AREA * DISPLACEMENT / MASS_ESTIMATE
        k = (500.0 * abs(v) + 30.0 * abs(a) + 100.0) / MASS_ESTIMATE
        k += abs(1.0 - BETA) * abs(demand) + BETA * 2e5
        switch = clamp(s / self.phi, 1.0) if self.phi else math.copysign(1.0, s)
        return clamp((demand - f - k * switch) / b, SPEED_LIMIT)


class PidOracle:
    """PID on the knee angle as its docstring states it, limited to 200 rad/s."""

    def __init__(self):
        self.integral, self.filtered = 0.0, None

    def __call__(self, knee, state, knee_reference):
        error = math.radians(knee_reference[0]) - knee
        if self.filtered is None:
            self.filtered = error
        self.filtered += (1.0 - math.exp(-PERIOD / 0.030)) * (error - self.filtered)
        rate = 20.0 * self.filtered + self.integral + 0.05 * (error - self.filtered) / 0.030
        feedforward = 0.5 * rod_reference(knee_reference)[1]
        per_rod_speed = AREA / DISPLACEMENT
        command = clamp(per_rod_speed * (feedforward - 0.09 * rate), 200.0)
        possible = (feedforward - command / per_rod_speed) / 0.09
        self.integral += PERIOD * (50.0 * error + (possible - rate) / 0.2)
        return command


def sampled_loop(four_bar, controller, samples, substeps, *, quantized, delay=0):
    """Rod extension and held command, both just before each sample, by RK4 between samples."""

    def derivatives(w, v, p, u):
        acceleration = clamp((clamp(u, SPEED_LIMIT) - w) / LAG, ACCELERATION_LIMIT)
        flow = DISPLACEMENT * w - LEAKAGE * p
        return acceleration, (AREA * p - DAMPING * v) / MASS, OIL * (flow - AREA * v)

    knee = math.radians(38.5)
    w, x, v, p = 0.0, four_bar.rod(knee), 0.0, 0.0
    h, command, on_the_bus = PERIOD / substeps, 0.0, [0.0] * delay
    rows = []
    for sample in range(samples + 1):
        rows.append((x, command))
        knee = four_bar.knee_of_rod(x, knee)
        theta_4 = four_bar.theta_4(knee)
        if quantized:
            theta_4 = (math.floor(theta_4 / COUNT) + 0.5) * COUNT
        state = (x, v, derivatives(w, v, p, command)[1])
        on_the_bus.append(controller(four_bar.knee(theta_4), state, knee_sine(PERIOD * sample)))
        command = on_the_bus.pop(0)
        for _ in range(substeps):
            w1, v1, p1 = derivatives(w, v, p, command)
            va = v + 0.5 * h * v1
            w2, v2, p2 = derivatives(w + 0.5 * h * w1, va, p + 0.5 * h * p1, command)
            vb = v + 0.5 * h * v2
            w3, v3, p3 = derivatives(w + 0.5 * h * w2, vb, p + 0.5 * h * p2, command)
            vc = v + h * v3
            w4, v4, p4 = derivatives(w + h * w3, vc, p + h * p3, command)
            x += h / 6.0 * (v + 2.0 * va + 2.0 * vb + vc)
            w += h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
            v += h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
            p += h / 6.0 * (p1 + 2.0 * p2 + 2.0 * p3 + p4)
    return np.array(rows)


LOOPS = {
    "smc": (
        {"controller": sliding_mode(), "estimator": OBSERVER},
        lambda: SlidingModeOracle(ObserverOracle(), 4.0),
    ),
    "signum": (
        {"controller": sliding_mode(switching="signum"), "estimator": OBSERVER},
        lambda: SlidingModeOracle(ObserverOracle(), 0.0),
    ),
    "difference": (
        {"controller": sliding_mode(), "estimator": DifferenceParameters()},
        lambda: SlidingModeOracle(DifferenceOracle(), 4.0),
    ),
    # k/Φ below 1e4 1/s: with exact states the sampled hydraulic mode is unstable above.
    "exact": (
        {"controller": sliding_mode(80.0), "estimator": ExactParameters()},
        lambda: SlidingModeOracle(ExactOracle(), 80.0),
    ),
    "pid": ({"controller": PID}, PidOracle),
}


def both_loops(four_bar, fixed_step, loop, samples, step, *, quantized, delay=0):
    settings, oracle = LOOPS[loop]
    scenario = Scenario(
        encoder=EncoderParameters(quantized=quantized),
        reference=REFERENCE,
        bus={"latency_samples": delay},
        **settings,
    )
    diagram = make_closed_loop(scenario)
    simulator = fixed_step(diagram, "runge_kutta5", step)
    simulator.AdvanceTo(samples * PERIOD)
    ours, _ = logged(
        diagram, simulator.get_context(), scenario, "rod_extension_m", "motor_speed_command_rad_s"
    )
    other = sampled_loop(
        four_bar,
        oracle(),
        samples,
        6 * round(PERIOD / step),  # of RK4, which is then as accurate
        quantized=quantized,
        delay=delay,
    )
    assert ours.shape == other.shape == (samples + 1, 2)
    return ours, other


@pytest.mark.slow
@pytest.mark.parametrize("loop", ["smc", "pid"])
def test_commands_and_rod_agree_with_a_second_program_at_every_sample(loop, four_bar, fixed_step):
    ours, other = both_loops(four_bar, fixed_step, loop, 150, PERIOD / 20, quantized=False)
    peak = np.max(np.abs(other[:, 1]))
    # The error of the commands, relative to their peak, is 3e-8 at 200 µs and 8e-10 here (a
    # thirty-second). One period more or less of delay would make it 0.02.
    np.testing.assert_allclose(ours[:, 1], other[:, 1], rtol=0.0, atol=2e-9 * peak)
    np.testing.assert_allclose(ours[:, 0], other[:, 0], rtol=0.0, atol=2e-9 * np.ptp(other[:, 0]))
    at_limit = np.abs(other[:, 1]) == 200.0
    assert np.any(at_limit[:-1] & ~at_limit[1:]) == (loop == "pid")  # so anti-windup shows


@pytest.mark.parametrize(
    ("loop", "delay"),
    [
        ("smc", 1),
        *(
            pytest.param(loop, delay, marks=pytest.mark.slow)
            for loop, delay in (
                ("smc", 0),
                ("signum", 0),
                ("difference", 0),
                ("pid", 0),
                ("pid", 2),
            )
        ),
    ],
)
def test_commands_agree_with_a_second_program_from_encoder_counts(
    loop, delay, four_bar, fixed_step
):
    ours, other = both_loops(
        four_bar, fixed_step, loop, 120, PERIOD / 5, quantized=True, delay=delay
    )
    # Both see the same counts, so the commands differ by rounding only: 1e-16 m of rod times
    # the controller's slope, up to 1e8 (rad/s)/m for differences; 1e-7 rad/s leaves room.
    np.testing.assert_allclose(ours[:, 1], other[:, 1], rtol=0.0, atol=1e-7)
    # The integrators differ by 3e-8 m, through the 447 Hz mode; a count is 1e-4 m.
    np.testing.assert_allclose(ours[:, 0], other[:, 0], rtol=0.0, atol=5e-8)
    assert np.max(np.abs(other[:, 1])) > 150.0


@pytest.mark.slow
def test_commands_from_exact_states_agree_with_a_second_program(four_bar, fixed_step):
    ours, other = both_loops(four_bar, fixed_step, "exact", 75, PERIOD / 20, quantized=False)
    peak = np.max(np.abs(other[:, 1]))
    # The acceleration feeds the 447 Hz mode to the command: its error is 4e-6 of the peak at
    # 200 µs and 1e-7 here.
    np.testing.assert_allclose(ours[:, 1], other[:, 1], rtol=0.0, atol=3e-7 * peak)
