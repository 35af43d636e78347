"""Limits of passivity: the real part of the sampled loop's impedance changes its sign there."""

import math

import numpy as np
import pytest

from kneexo.analysis import output_impedance, passivity_limits
from kneexo.errors import ParameterError
from kneexo.parameters import KneeLoadParameters, PlantParameters, Scenario

LOADED = PlantParameters(load=KneeLoadParameters())
FAST_CELL = {"filter_s": 1e-5}  # the smallest, so that the formula's lags are hold and motor
# D_m Ā/gear of 0.8 cc/rev, bore 20 mm, rod 10 mm and 6:1, in m³/s for (rad/s)/N, and C_t
FLOW = 0.8e-6 / (2.0 * math.pi) / 6.0 * math.pi * (0.02**2 - 0.5 * 0.01**2) / 4.0
LEAKAGE = 2e-13
T, LAG = 0.002, 0.010


def scenario(estimator="exact", load_cell=FAST_CELL, **law):
    return Scenario(
        plant=LOADED,
        wearer="leg",
        controller={"kind": "torque", "leak_per_s": 0.0, "speed_feedforward": 0.5} | law,
        estimator={"kind": estimator},
        load_cell=load_cell,
    )


def test_limits_are_the_formulas_of_the_theory():
    limits = passivity_limits(
        scenario(proportional_rad_s_per_n=0.05, speed_feedforward=0.4, sample_time_s=T)
    )
    gain = 0.6 * (LEAKAGE + 0.05 * FLOW) / (LAG + 0.4 * T / 2.0) / FLOW
    # The load cell's 10 µs count 6e-4.
    assert limits.integral_rad_s2_per_n == pytest.approx(gain, rel=1e-3)
    # H by integration of the held command's response: a sine every T, held, with the motor's lag.
    w = np.linspace(1.0, math.pi / T, 20001)
    held = np.sinc(w * T / (2.0 * math.pi)) * np.exp(-0.5j * w * T)
    worst = -(held / (1.0 + 1j * w * LAG)).real.min()
    assert 1.0 / worst == pytest.approx(14.36, rel=1e-3)  # the figure of the derivation
    expected = LEAKAGE / FLOW / worst
    assert limits.proportional_rad_s_per_n == pytest.approx(expected, rel=2e-2)


def test_full_feedforward_with_an_integral_is_never_passive():
    assert passivity_limits(scenario(speed_feedforward=1.0)).integral_rad_s2_per_n == 0.0


def test_lags_lower_the_limit():
    limit = [
        passivity_limits(case).integral_rad_s2_per_n
        for case in (
            scenario(),
            scenario(load_cell={"filter_s": 0.005}),
            scenario("difference"),
            scenario().changed({"bus": {"kind": "none", "latency_samples": 2}}),
            scenario().changed({"plant.ideal_motor": True}),
        )
    ]
    lag = LAG + 0.25 * T + 0.5e-5
    changes = [0.0, 0.5 * (0.005 - 1e-5), 0.25 * T, 2.0 * T, -LAG]
    assert limit == pytest.approx([limit[0] * lag / (lag + c) for c in changes], rel=1e-9)


def test_another_controller_has_no_limits():
    line = r"\Acontroller.kind = smc: passivity_limits needs controller.kind = torque\Z"
    with pytest.raises(ParameterError, match=line):
        passivity_limits(Scenario())


def changes_sign(case, gain, frequency_hz, share):
    """Return whether the least real part changes its sign within a share of the limit of a gain."""
    limit = getattr(passivity_limits(case), gain)
    least = []
    for factor in (1.0 - share, 1.0 + share):
        beside = case.changed({f"controller.{gain}": limit * factor})
        z = output_impedance(beside, frequency_hz, knee_angle_deg=45.0, port="knee")
        assert z.stable
        least.append(z.least_real_part[0])
    return least[0] > 0.0 > least[1]


INTEGRAL, PROPORTIONAL = "integral_rad_s2_per_n", "proportional_rad_s_per_n"
BUS = {"bus": {"kind": "none", "latency_samples": 2}}


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
def test_low_frequency_border(share):
    case = scenario(proportional_rad_s_per_n=0.05, speed_feedforward=share)
    assert changes_sign(case, INTEGRAL, [0.01], 0.001)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["observer", "difference"])
def test_low_frequency_border_with_an_estimator(estimator):
    # The slope of Eq. 10 differs from the linkage by some tenths of a percent, as γ does.
    case = scenario(estimator, {}, proportional_rad_s_per_n=0.05)
    assert changes_sign(case, INTEGRAL, [0.01], 0.01)


@pytest.mark.slow
def test_low_frequency_border_with_a_bus():
    case = scenario(proportional_rad_s_per_n=0.05).changed(BUS)
    assert changes_sign(case, INTEGRAL, [0.01], 0.001)


@pytest.mark.slow
@pytest.mark.parametrize(("bus", "share"), [({}, 0.01), (BUS, 0.02)])
def test_high_frequency_border(bus, share):
    case = scenario(integral_rad_s2_per_n=0.0, speed_feedforward=0.0).changed(bus)
    assert changes_sign(case, PROPORTIONAL, np.linspace(20.0, 245.0, 451), share)
