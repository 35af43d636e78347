import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm
from sliding_cases import (
    AREA,
    AREA_1,
    AREA_TERM,
    BETA,
    GAIN,
    M_HAT,
    OIL,
    STIFFNESS,
)

from kneexo.analysis import simulate
from kneexo.errors import ParameterError
from kneexo.parameters import PidParameters, Scenario, SimulationParameters
from kneexo.parameters.paths import changed
from kneexo.simulation.run import Run
from kneexo.studies.sliding.condition import (
    SlidingMeasurement,
    check_sliding,
    error_bounds,
    sliding_rates,
    sliding_signals,
)
from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings
from kneexo.studies.sliding.study import (
    LAWS,
)

FLOW_PER_SPEED = 0.8e-6 / (2.0 * math.pi) / 6.0
SETTINGS = SlidingSettings()


def short(duration, log, **values):
    """The ideal law over a short time, logged finely."""
    times = {"simulation.duration_s": duration, "controller.sample_time_s": log}
    return changed(SLIDING_LAW, times | values)


def checked(scenario):
    """The measurement of a scenario."""
    return SlidingMeasurement.from_data(check_sliding(SETTINGS, scenario))


def test_rate_is_that_of_the_equations_by_hand():
    force = {"disturbance_amplitude_n": 30.0, "disturbance_frequency_hz": 3.0}
    scenario = changed(
        SLIDING_LAW,
        {f"plant.load.{name}": value for name, value in force.items()}
        | {"plant.cylinder.stiffness_n_per_m": 200.0, "plant.cylinder.damping_n_s_per_m": 7.0},
    )
    random = np.random.default_rng(1)
    n = 20
    data = {
        "rod_extension_m": random.uniform(0.02, 0.13, n),
        "rod_velocity_m_s": random.uniform(-0.05, 0.05, n),
        "load_pressure_pa": random.uniform(-3e6, 3e6, n),
        **{
            f"rod_reference_{name}": random.uniform(-1.0, 1.0, n)
            for name in ("m", "velocity_m_s", "acceleration_m_s2", "jerk_m_s3")
        },
    }
    time, command = random.uniform(0.0, 2.0, n), random.uniform(-500.0, 500.0, n)
    run = Run(time, data, SimulationParameters())
    s, rate = sliding_rates(scenario, run, np.arange(n), command)
    x, v, p = (data[k] for k in ("rod_extension_m", "rod_velocity_m_s", "load_pressure_pa"))
    load = 30.0 * np.sin(6.0 * math.pi * time)
    load_rate = 30.0 * 6.0 * math.pi * np.cos(6.0 * math.pi * time)
    a = (AREA * p - 7.0 * v - 200.0 * x - load) / 1.6
    p_rate = OIL * (FLOW_PER_SPEED * command - 2e-13 * p - AREA * v)
    jerk = (AREA * p_rate - 7.0 * a - 200.0 * v - load_rate) / 1.6
    x_d, v_d, a_d, j_d = (data[k] for k in list(data)[3:])
    # Rounding: terms of 1e7 m/s³ cancel in the rate.
    np.testing.assert_allclose(s, a - a_d + 40.0 * (v - v_d) + 400.0 * (x - x_d), rtol=1e-11)
    np.testing.assert_allclose(
        rate, jerk - j_d + 40.0 * (a - a_d) + 400.0 * (v - v_d), rtol=1e-9, atol=1e-6
    )


@pytest.mark.parametrize("ideal", [True, False], ids=["ideal motor", "motor"])
def test_rate_in_full_order_is_the_slope_of_s_along_a_run(ideal):
    scenario = short(
        0.006,
        2e-5,
        **{
            "initial_offset_m": -0.010,
            "plant.full_order": {"coulomb_friction_n": 5.0, "entrained_air": 0.005},
            "plant.load": {"kind": "knee", "disturbance_n": 60.0},  # and the weight
            "plant.ideal_motor": ideal,
            "controller.eta_m_s3": 1e4,
        },
    )
    run = simulate(scenario, signals=sliding_signals(scenario))
    rows = np.arange(run.time_s.size)
    s, rate = sliding_rates(scenario, run, rows, run["motor_speed_command_rad_s"])
    np.testing.assert_allclose(s, run["sliding_variable_m_s2"], rtol=1e-9, atol=1e-9)
    # Central differences of fourth order, five time constants of the layer after the corner at Φ.
    slope = (8.0 * (s[3:-1] - s[1:-3]) - (s[4:] - s[:-4])) / (12.0 * 2e-5)
    late = slice(150, None)
    np.testing.assert_allclose(rate[2:-2][late], slope[late], atol=2e-3 * np.abs(slope).max())


@given(
    signs=st.lists(st.sampled_from([-1.0, 0.3, 1.0]), min_size=60, max_size=60),
    error=st.floats(-0.01, 0.01),
    rate=st.floats(-0.2, 0.2),
    lambda_=st.floats(3.0, 60.0),
)
@settings(max_examples=60)
def test_no_s_within_the_layer_beats_the_bounds(signs, error, rate, lambda_):
    phi, dt = 3.2, 0.1 / lambda_
    time = dt * np.arange(len(signs) + 1)
    step = expm(
        dt * np.array([[0.0, 1.0, 0.0], [-(lambda_**2), -2.0 * lambda_, 1.0], [0.0, 0.0, 0.0]])
    )
    state, states = np.array([error, rate, 0.0]), [(error, rate)]
    for sign in signs:
        state[2] = sign * phi
        state = step @ state
        states.append(tuple(state[:2]))
    bound, rate_bound = error_bounds(time, error, rate, lambda_per_s=lambda_, phi_m_s2=phi)
    e, e_rate = np.abs(np.transpose(states))
    assert np.all(e <= bound * (1.0 + 1e-9) + 1e-12)
    assert np.all(e_rate <= rate_bound * (1.0 + 1e-9) + 1e-12)


def test_bounds_are_reached_by_the_worst_s():
    z = np.linspace(0.0, 20.0, 2001)
    lambda_, phi = 20.0, 3.2
    bound, rate_bound = error_bounds(z / lambda_, 0.0, 0.0, lambda_per_s=lambda_, phi_m_s2=phi)
    # s = Φ throughout; its e is Φ/λ² (1 − (1 + z) e^−z), its ė Φ/λ z e^−z with the peak at z = 1.
    np.testing.assert_allclose(bound, phi / lambda_**2 * (1.0 - (1.0 + z) * np.exp(-z)), atol=1e-15)
    np.testing.assert_allclose(rate_bound[100], phi / lambda_ / math.e, rtol=1e-12)
    # For ė the sign changes one time constant before the end: 2/e in all, below Slotine's 2.
    assert bound[-1] == pytest.approx(phi / lambda_**2, rel=1e-6)
    assert rate_bound[-1] == pytest.approx(2.0 / math.e * phi / lambda_, rel=1e-6)
    assert np.all(np.diff(rate_bound) >= 0.0)


START = {"initial_offset_m": -0.010, "controller.eta_m_s3": 1e3}
FULL = {"plant.full_order": {}, "plant.load.disturbance_n": 60.0}


@pytest.mark.parametrize("mass", [1.4, 1.8])
def test_reduced_order_keeps_the_promise_with_every_mass(mass):
    values = START | {"plant.cylinder.mass_kg": mass, "plant.load.disturbance_n": 60.0}
    measured = checked(short(0.002, 2e-5, **values))
    assert (measured.failure, measured.holding_share, measured.left_share) == (
        "",
        1.0,
        0.0,
    )
    assert 0.0 < measured.reaching_s <= measured.promised_s + 2e-5
    assert measured.promised_s == pytest.approx(0.8 / 1e3, rel=0.02)  # s starts at about −4 m/s²
    assert measured.worst_rate_m_s3 < -1e3
    assert measured.bounded_share == 1.0


@pytest.mark.parametrize(
    ("law", "attracts", "holds"),
    [({}, False, False), (AREA_TERM, True, False), (GAIN, True, True)],
    ids=list(LAWS),
)
def test_full_order_needs_the_area_to_attract_and_the_gain_to_hold(law, attracts, holds):
    measured = checked(short(0.006, 2e-5, **START, **FULL, **law))
    assert (measured.attracting_share == 1.0) is attracts
    assert (measured.holding_share == 1.0) is holds
    assert (measured.left_share == 0.0) is attracts
    assert measured.holding_share < 0.1 or holds
    assert measured.bounded_share == 1.0


def test_worst_rate_is_the_closed_form():
    values = START | FULL | {"initial_offset_m": -0.040}
    scenario = short(0.002, 2e-5, **values)
    run = simulate(scenario, signals=sliding_signals(scenario))
    rows = np.flatnonzero(run.time_s > 1e-3)  # the make-up valve has settled, 0.06 ms
    s, rate = sliding_rates(scenario, run, rows, run["motor_speed_command_rad_s"][rows])
    v = run["rod_velocity_m_s"][rows]
    ratio = M_HAT / 1.6 * AREA_1 / AREA * 41_233e-9 / 4.0
    gain = ratio / (5e-6 + AREA_1 * run["rod_extension_m"][rows])  # b/b̂ of P_1's chamber
    e_2 = s - 40.0 * (v - run["rod_reference_velocity_m_s"][rows])
    e_2 -= 400.0 * (run["rod_extension_m"] - run["rod_reference_m"])[rows]
    demand = run["rod_reference_jerk_m_s3"][rows] - 40.0 * e_2
    demand -= 400.0 * (v - run["rod_reference_velocity_m_s"][rows])
    k = 2.5e3 / M_HAT + (BETA - 1.0) * np.abs(demand) + BETA * 1e3
    leak = STIFFNESS * 2e-13 * (run["cap_pressure_pa"] - run["rod_side_pressure_pa"])[rows] / AREA
    expected = gain * (STIFFNESS * (1.0 - AREA_1 / AREA) * v + k - leak) + (gain - 1.0) * demand
    # 5 % of k: behind its valve P_2 is P_r − (A_1 − A_2) v/2e-10, so it pushes with 58 m/s³ per
    # m/s² of the rod.
    np.testing.assert_allclose(rate, expected, atol=0.05 * np.max(gain * k))
    assert np.all(np.abs(s) > 3.2)


def test_another_controller_is_refused():
    with pytest.raises(ParameterError, match=r"^controller\.kind = pid: must be smc$"):
        check_sliding(SETTINGS, Scenario(controller=PidParameters()))
