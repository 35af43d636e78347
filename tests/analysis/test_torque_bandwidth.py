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
        (scenario(), {"held": "hand"}, r"held = 'hand': must be rod or leg"),
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
    law = {
        "proportional_rad_s_per_n": gain,
        "integral_rad_s2_per_n": 0.0,
        "speed_feedforward": 0.0,
    }
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
    text = (Path(__file__).parents[2] / "docs" / "theory.md").read_text(encoding="utf-8")
    case = Scenario(
        plant=PlantParameters(load=KneeLoadParameters()), wearer="leg", controller="torque"
    )
    default = torque_response(case, knee_angle_deg=45.0).bandwidth_hz
    assert f"it falls by 3 dB at {default:.2f} Hz" in text
    low = case.changed(
        {
            "controller.proportional_rad_s_per_n": 0.02,
            "controller.integral_rad_s2_per_n": 1.0,
        }
    )
    rod, leg = (
        torque_response(low, knee_angle_deg=45.0, held=held).bandwidth_hz for held in ("rod", "leg")
    )
    assert f"{rod:.2f} Hz on a locked rod and {leg:.2f} Hz behind the cuff" in text
