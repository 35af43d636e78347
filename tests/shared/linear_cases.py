"""Plants, loops and closed forms that several tests of the linear analysis share."""

import math

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from diagramc import LinearModel, OperatingPoint, TickModel
from diagramc.linear.model import over_period
from kneexo.analysis.linear.sampled_loop import SampledLoop
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
    return sampled_loop(a, b, g_x, np.eye(size, k=-1))


def sampled_loop(a, b, g_x, g_z):
    """A loop whose plant has the last state of the controller as command.

    dx/dt = A x + B u, z⁺ = G_x x + G_z z, u = z[-1]; the output is x[0].
    """
    n, m = len(a), len(g_z)
    tick = TickModel(
        time_s=0.0,
        duration_s=T,
        jump_state=np.block([[np.eye(n), np.zeros((n, m))], [g_x, g_z]]),
        jump_input=np.zeros((n + m, 5)),
        rate_state=np.block([[a, np.zeros((n, m - 1)), b], [np.zeros((m, n + m))]]),
        rate_input=np.pad(b, ((0, m), (4, 0))),
    )
    step_a, step_b = over_period([tick])
    names = (*(f"reference[{i}]" for i in range(4)), "command")
    model = LinearModel(
        a=step_a,
        b=step_b,
        c=np.vstack([np.eye(1, n + m), np.eye(n + m)[-1:]]),
        d=np.pad([[1.0]], ((1, 0), (4, 0))),
        period_s=T,
        state_names=tuple(f"x[{i}]" for i in range(n + m)),
        input_names=names,
        output_names=("output", "command"),
        operating_point=OperatingPoint(0.0, np.zeros(n + m), np.zeros(5), np.zeros(2)),
        ticks=(tick,),
    )
    return SampledLoop(model=model, output="rod_extension", knee_angle_rad=0.0, scenario=Scenario())


class Matrices:
    """Matrices of plant and controller of a loop, for a command that is one of the states.

    dx/dt = A x + B u, y = C x, z⁺ = G_x x + G_z z + G_r r, u = C_u z.
    """

    def __init__(self, loop):
        (tick,) = loop.model.ticks
        n, z = 4, loop.moving[4:]
        assert not tick.rate_state[n:].any()
        self.a, self.b = tick.rate_state[:n, :n], tick.rate_input[:n, 4:]
        self.c, self.c_u = loop.model.c[:1, :n], loop.model.c[1:, z]
        self.g_x, self.g_z = tick.jump_state[z, :n], tick.jump_state[np.ix_(z, z)]
        self.g_r = tick.jump_input[z, :4]


def frequency_response(loop, frequencies_hz):
    """L by python-control on the same matrices."""
    return loop.to_control()(np.exp(2j * math.pi * np.asarray(frequencies_hz) * T))
