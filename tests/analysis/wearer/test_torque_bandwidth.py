"""Response of the rod force: a locked rod by hand, a run behind the cuff."""

import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis import TorqueResponse, fundamental, simulate, torque_response
from kneexo.errors import ParameterError
from kneexo.parameters import (
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    StepReference,
)

WEIGHTLESS = PlantParameters(load=KneeLoadParameters(segment_mass_kg=0.0))


def scenario(controller=None, **values):
    values = {"wearer": {"kind": "leg"}} | values
    return Scenario(plant=WEIGHTLESS, controller={"kind": "torque"} | (controller or {}), **values)


def test_plot_shows_gain_phase_and_bandwidth():
    f = np.array([1.0, 2.0, 4.0])
    result = TorqueResponse(f, np.array([1.0, -1.0j, -0.1]), 2.5, "leg", True, scenario())
    gain, phase = result.plot()
    assert list(gain.lines[0].get_ydata()) == pytest.approx([0.0, 0.0, -20.0])
    assert list(phase.lines[0].get_ydata()) == pytest.approx([0.0, -90.0, -180.0])
    assert gain.get_legend().get_texts()[0].get_text() == "−3 dB at 2.5 Hz"
    plt.close(gain.figure)


@pytest.mark.parametrize(
    ("case", "options", "line"),
    [
        (Scenario(), {}, r"wearer.kind = none: torque_response needs wearer.kind = leg, .*"),
        (scenario(), {"held": "hand"}, r"held = 'hand': must be rod, leg or nothing"),
        (
            scenario({"kind": "pid"}),
            {},
            r"controller.kind = pid: torque_response needs controller.kind = torque",
        ),
    ],
)
def test_bad_input_is_one_line(case, options, line):
    with pytest.raises(ParameterError, match=rf"\A{line}\Z"):
        torque_response(case, **options)


@pytest.mark.slow
def test_a_locked_rod_is_oil_behind_lag_and_hold():
    """F/u = k_q D_m Ā/gear/((τ_m s + 1)(s + k_q C_t)), sampled, held, with u = K_p (F_d − F)."""
    gain, period, lag, cell = 0.02, 0.002, 0.010, 1e-5
    law = {"proportional_rad_s_per_n": gain, "integral_rad_s2_per_n": 0.0, "speed_feedforward": 0.0}
    case = scenario(law, load_cell={"filter_s": cell})
    f = np.array([0.1, 1.0, 5.0, 20.0])
    result = torque_response(case, f, knee_angle_deg=45.0, held="rod")
    assert result.stable
    area = math.pi * (0.02**2 - 0.5 * 0.01**2) / 4.0
    rate = 4.0 * 1.72e9 / 4.1233e-5
    flow = 0.8e-6 / (2.0 * math.pi) / 6.0 * area
    s = 2j * np.pi * f[:, None] + 2j * np.pi / period * np.arange(-2000, 2001)
    oil = rate * flow / ((lag * s + 1.0) * (s + rate * 2e-13))
    held = oil * (1.0 - np.exp(-s * period)) / (s * period)
    read = held / (cell * s + 1.0)
    loop = gain * read.sum(axis=1)  # the reading has all aliases
    expected = gain * held[:, 2000] / (1.0 + loop)
    assert np.abs(result.response / expected - 1.0).max() < 1e-3


@pytest.mark.slow
def test_a_free_knee_has_only_the_force_of_its_mass():
    """v/ω_m = (D_m/gear) Ā/(m A² (s² + …)) of oil and mass, F = m v̇, sampled, held, with PI and γ.

    u = K_p e + K_i T z/(z − 1 + λT) e + γ G v, e = F_d − F.
    """
    gain, integral, leak, share = 4.0, 20.0, 5.0, 0.45
    period, lag, cell, mass = 0.002, 0.010, 1e-5, 1.6
    law = {
        "proportional_rad_s_per_n": gain,
        "integral_rad_s2_per_n": integral,
        "leak_per_s": leak,
        "speed_feedforward": share,
    }
    case = scenario(law, wearer="none", load_cell={"filter_s": cell}, estimator="exact")
    f = np.array([0.3, 1.0, 5.0, 20.0])
    result = torque_response(case, f, knee_angle_deg=45.0, held="nothing")
    assert result.held == "nothing"
    area = math.pi * (0.02**2 - 0.5 * 0.01**2) / 4.0
    rate, flow = 4.0 * 1.72e9 / 4.1233e-5, 0.8e-6 / (2.0 * math.pi) / 6.0
    s = 2j * np.pi * f[:, None] + 2j * np.pi / period * np.arange(-2000, 2001)
    hold = (1.0 - np.exp(-s * period)) / (s * period) / (lag * s + 1.0)
    friction = case.plant.cylinder.damping_n_s_per_m
    # The net force on the mass is m s v = Ā P − B v, and P = rate (flow ω − Ā v)/(s + rate C_t).
    oil = rate / (s + rate * 2e-13)
    speed = area * oil * flow / (mass * s + friction + area**2 * oil)
    force = mass * s * speed
    z = np.exp(2j * np.pi * f * period)
    pi = gain + integral * period * z / (z - 1.0 + leak * period)
    read = (hold * force / (cell * s + 1.0)).sum(axis=1)
    loop = pi * read - share * area / flow * (hold * speed).sum(axis=1)
    expected = pi * (hold * force)[:, 2000] / (1.0 + loop)
    assert np.abs(result.response / expected - 1.0).max() < 1e-3


@pytest.mark.slow
def test_a_free_leg_yields_behind_the_cuff():
    f = np.array([0.05, 0.5, 50.0])
    stiff = {"kind": "leg", "inertia_kg_m2": 10.0, "stiffness_n_m_per_rad": 1e3}
    held, stiff_leg, leg = (
        np.abs(torque_response(scenario(wearer=wearer), f, knee_angle_deg=45.0, held=what).response)
        for wearer, what in (("leg", "leg"), (stiff, "nothing"), ("leg", "nothing"))
    )
    assert stiff_leg[2] == pytest.approx(held[2], rel=1e-2)  # its inertia does not move
    assert leg[0] == pytest.approx(held[0], rel=0.1)  # the weight of the leg is a spring
    assert leg[1] < 0.5 * held[1]


@pytest.mark.slow
def test_a_run_behind_the_cuff_has_the_bandwidth():
    result = torque_response(scenario(), knee_angle_deg=45.0)
    assert result.stable
    at = np.interp(result.bandwidth_hz, result.frequency_hz, np.abs(result.response))
    assert at == pytest.approx(1.0 / math.sqrt(2.0), rel=1e-2)
    assert not torque_response(scenario(), held="rod").stable
    frequency, duration = 5.0, 6.0
    times = np.arange(0.0, duration + 0.02, 0.002)
    moment = {
        "times_s": tuple(times),
        "moments_n_m": tuple(0.2 * np.sin(2.0 * np.pi * frequency * times)),
    }
    case = scenario(
        {"mode": "assist", "assistance": 1.0},
        wearer={"kind": "leg", "moment": moment},
        reference=StepReference(start_deg=45.0, end_deg=45.0),
        simulation=SimulationParameters(duration_s=duration),
    ).without_quantizers()
    run = simulate(case)
    late = slice(int(4.0 / 0.002), int(5.0 / 0.002))
    force, desired = (
        fundamental(run.time_s[late], run[name][late], frequency)
        for name in ("rod_force_n", "desired_torque_n_m")
    )
    measured = force * -0.10206 / desired  # F_d = −τ_d/r
    linear = torque_response(case, [frequency], knee_angle_deg=45.0).response[0]
    assert abs(measured / linear - 1.0) < 1e-2


@pytest.mark.slow
def test_numbers_of_the_theory():
    text = (Path(__file__).parents[3] / "docs" / "theory.md").read_text(encoding="utf-8")
    case = Scenario(
        plant=PlantParameters(load=KneeLoadParameters()), wearer="leg", controller="torque"
    )
    free = torque_response(case, knee_angle_deg=45.0, held="nothing").bandwidth_hz
    assert f"the force then falls by 3 dB at {free:.2f} Hz" in text
