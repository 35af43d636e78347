"""Plants, loops and closed forms that several tests of the linear analysis share."""

import math

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from kneexo.analysis.sampled_loop import SampledLoop
from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    DifferenceParameters,
    ExactParameters,
    KneeLoadParameters,
    PidParameters,
    PlantParameters,
    RodPolynomialParameters,
    Scenario,
    SlidingModeParameters,
)

T = 0.002

AREA = math.pi / 4.0 * (0.020**2 - 0.5 * 0.010**2)

DISPLACEMENT = 0.8e-6 / (2.0 * math.pi)

GRAVITY = 9.81

# Lee et al. 2020, Tables 2 and 3; lag and leakage are this project's assumptions.
PAPER = {
    "lag": 0.010,
    "gear": 6.0,
    "c_im": 2e-13,
    "c_em": 0.0,
    "c_l": 0.0,
    "volume": 41_233e-9,
    "bulk": 1.72e9,
    "mass": 1.6,
    "damping": 0.05,
    "stiffness": 0.0,
}

LEAKY = PAPER | {"c_im": 3e-12, "c_em": 8e-12, "c_l": 5e-12, "damping": 40.0, "lag": 0.003}

# Soft oil, a spring and every leakage, so that no term of Eq. 13, 15, 16 can hide.
SOFT = LEAKY | {"gear": 4.0, "bulk": 5e7, "mass": 1.4, "stiffness": 1500.0, "lag": 0.020}

SPRING = PAPER | {"stiffness": 2e4, "c_em": 1e-12, "damping": 300.0}

SETS = {"paper": PAPER, "leaky": LEAKY, "soft": SOFT, "spring": SPRING}


def plant_parameters(n, **more):
    return PlantParameters(
        pump=BldcPumpParameters(
            lag_s=n["lag"],
            gear_ratio=n["gear"],
            displacement_m3_per_rad=DISPLACEMENT,
            internal_leakage_m3_per_s_pa=n["c_im"],
            external_leakage_m3_per_s_pa=n["c_em"],
        ),
        cylinder=CylinderParameters(
            total_volume_m3=n["volume"],
            bulk_modulus_pa=n["bulk"],
            mass_kg=n["mass"],
            damping_n_s_per_m=n["damping"],
            stiffness_n_per_m=n["stiffness"],
            leakage_m3_per_s_pa=n["c_l"],
        ),
        **more,
    )


def total_leakage(n):
    return n["c_l"] + n["c_im"] + 0.5 * n["c_em"]


def distance(values, expected):
    """Largest distance of two sets of complex numbers, paired as well as can be."""
    values, expected = np.asarray(values), np.asarray(expected)
    assert values.size == expected.size
    cost = np.abs(values[:, None] - expected[None, :])
    return cost[linear_sum_assignment(cost)].max()


def nearest(values, value):
    return values[np.argmin(np.abs(values - value))]


def raises_one_line(kind, match):
    return pytest.raises(kind, match=rf"\A(?=.*{match})[^\n]*\Z")


WEIGHT = KneeLoadParameters(thigh_inclination_rad=0.4)


def slope_of_table_1(angle_deg):
    """dx/dθ_p of Eq. 10 in m/rad."""
    return 0.18 / math.pi * np.polyval(np.polyder(RodPolynomialParameters().p_mm_deg), angle_deg)


PI = PidParameters(
    proportional_per_s=11.89, integral_per_s2=380.5, derivative=0.02, filter_s=0.01915
)

SCENARIOS = {
    "smc": Scenario(),
    "pid": Scenario(controller=PidParameters()),
    "pid_tuned": Scenario(controller=PI),
    "can_1": Scenario(bus={"latency_samples": 1}),
    "can_2": Scenario(bus={"latency_samples": 2}),
    "difference": Scenario(estimator=DifferenceParameters()),
    "exact": Scenario(
        estimator=ExactParameters(), controller=SlidingModeParameters(phi_m_s2=31.75)
    ),
    "weight": Scenario(plant=PlantParameters(load=KneeLoadParameters())),
    "other_plant": Scenario(
        plant=plant_parameters(SOFT | {"stiffness": 0.0}, rod_map="polynomial"),
        nominal=PlantParameters(),
    ),
}


def eq_27(slope_per_s):
    """k/Φ with k = β η, β = √(1.8/1.4)."""
    phi = math.sqrt(1.8 / 1.4) * 2.8e5 / slope_per_s
    return Scenario(estimator=ExactParameters(), controller=SlidingModeParameters(phi_m_s2=phi))


STABLE = ["smc", "pid", "pid_tuned", "can_2", "difference", "exact"]


def delayed(a, b, gain, samples):
    """The first state of a plant, fed back with a gain after a delay."""
    size = samples + 1
    g_x = np.zeros((size, len(a)))
    g_x[0, 0] = -gain
    return SampledLoop(
        a=a,
        b=b,
        c=np.eye(1, len(a)),
        g_x=g_x,
        g_z=np.eye(size, k=-1),
        g_r=np.zeros((size, 4)),
        c_u=np.eye(size)[-1:],
        sample_time_s=T,
        output="rod_extension",
        knee_angle_rad=0.0,
        scenario=Scenario(),
    )


def frequency_response(loop, frequencies_hz):
    """L by python-control on the same matrices."""
    return loop.to_control()(np.exp(2j * math.pi * np.asarray(frequencies_hz) * T))
