"""Coupled stability against the eigenvalues of another model and against runs beside the border."""

import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import scipy

from kneexo.analysis import (
    CoupledStability,
    coupled_stability,
    output_impedance,
    simulate,
    stability_map,
    stable_interval,
    stiffness_interval,
)
from kneexo.analysis.wearer.coupling import _interval, coupled_loop
from kneexo.errors import ParameterError
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.parameters import Scenario, StepReference
from kneexo.parameters.wearer.wearer import WEARERS
from kneexo.systems.knee_coordinates import rod_polynomial_values

T = 0.002
STIFFNESS = "controller.stiffness_n_m_per_rad"
PROPORTIONAL = "controller.proportional_rad_s_per_n"


def scenario(wearer="swing", cuff=(), estimator="exact", **law):
    leg = WEARERS[wearer]
    return Scenario(
        # The plant's rod follows the controller's polynomial, so both have one moment arm.
        plant={"load": "knee", "rod_map": "polynomial"},
        wearer=leg.model_copy(update={"cuff": leg.cuff.model_copy(update=dict(cuff))}),
        controller={"kind": "torque", "mode": "impedance", "torque_limit_n_m": 500.0} | law,
        estimator={"kind": estimator},
    )


def moment_arm(case, angle):
    """−dx/dθ of the polynomial p_1 θ⁵ + … + p_6."""
    p = list(rod_polynomial_values(controller_polynomial(case)).values())
    return -np.polyval(np.polyder(p), angle)


def magnitudes(case, angle_deg):
    """The eight largest |λ| from the equations of theory.md, written as matrices by hand.

    States: x, v, P, ω, filtered force, θ_h, dθ_h/dt, ξ_1 … ξ_5, and the integral I.
    """
    law, leg, load = case.controller, case.wearer, case.plant.load
    angle = math.radians(angle_deg)
    r, alpha = moment_arm(case, angle), load.thigh_inclination_rad
    area, flow = math.pi * (0.02**2 - 0.5 * 0.01**2) / 4.0, 0.8e-6 / (2.0 * math.pi) / 6.0
    rate, leakage, lag, mass = 4.0 * 1.72e9 / 4.1233e-5, 2e-13, 0.010, 1.6
    friction = case.plant.cylinder.damping_n_s_per_m
    x, v, p, w, z, q, dq = np.eye(13)[:7]
    memories, integral = np.eye(13)[7:12], np.eye(13)[12]
    knee, knee_rate = -x / r, -v / r
    force = area * p - friction * v
    cuff = leg.cuff.stiffness_n_m_per_rad * (q - knee)
    cuff = cuff + leg.cuff.damping_n_m_s_per_rad * (dq - knee_rate)
    pendulum = 9.81 * math.cos(alpha - angle)
    shank = -load.segment_mass_kg * load.centre_of_mass_m * pendulum * knee
    h, k = leg.loss_modulus_n_m_per_rad, leg.stiffness_n_m_per_rad
    bank = [(0.06, 1.3939), (0.3, 0.9620), (1.4142, 0.9980), (6.6667, 0.9620), (33.333, 1.3939)]
    weight = leg.leg_mass_kg * leg.centre_of_mass_m * pendulum
    at_1_hz = sum(share / (1.0 + f * f) for f, share in bank)  # k is the stiffness at 1 Hz
    torque = -(weight + k - at_1_hz * h) * q - leg.damping_n_m_s_per_rad * dq - cuff
    torque = torque - h * sum(share * (q - m) for (_, share), m in zip(bank, memories, strict=True))
    moving = leg.motion != "prescribed"
    a = np.zeros((14, 14))  # the held command is the last state
    a[:12, :13] = [
        v,
        (force - (cuff + shank) / r) / mass,
        rate * (flow * w - area * v - leakage * p),
        -w / lag,
        (force - z) / case.load_cell.filter_s,
        dq * moving,
        torque / leg.inertia_kg_m2 * moving,
        *(2.0 * math.pi * f * (q - m) * moving for (f, _), m in zip(bank, memories, strict=True)),
    ]
    a[3, 13] = 1.0 / lag
    desired = -law.stiffness_n_m_per_rad * knee - law.damping_n_m_s_per_rad * knee_rate
    error = -desired / r - z
    change = T * (law.integral_rad_s2_per_n * error - law.leak_per_s * integral)
    command = law.proportional_rad_s_per_n * error + integral + change
    command = command + law.speed_feedforward * area / flow * v
    jump = np.eye(14, 13)
    jump[12], jump[13] = integral + change, command
    states = [i for i in range(13) if moving or i not in range(5, 12)]
    step = (scipy.linalg.expm(a * T) @ jump)[np.ix_(states, states)]
    return np.sort(np.abs(np.linalg.eigvals(step)))[:-9:-1]


def test_eigenvalues_are_those_of_the_equations():
    case = scenario("tense", {"stiffness_n_m_per_rad": 3e3, "damping_n_m_s_per_rad": 7.0})
    loop = coupled_loop(case, 30.0)
    assert math.degrees(loop.knee_angle_rad) == pytest.approx(30.0, abs=1e-7)
    assert np.abs(loop.eigenvalues[:8]) == pytest.approx(magnitudes(case, 30.0), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("wearer", WEARERS)
def test_each_wearer_has_the_eigenvalues_of_the_equations(wearer):
    for angle in (10.0, 80.0):
        for changes in ({}, {STIFFNESS: 4e4}, {PROPORTIONAL: 30.0}):
            case = scenario(wearer, damping_n_m_s_per_rad=3.0).changed(changes)
            values = np.abs(coupled_loop(case, angle).eigenvalues[:6])
            assert values == pytest.approx(magnitudes(case, angle)[:6], abs=1e-6)


def test_a_passive_leg_is_an_active_one_at_the_angle():
    case = scenario().changed({"wearer.motion": "passive"})
    value = abs(coupled_loop(case, 30.0).eigenvalues[0])
    assert value == pytest.approx(magnitudes(scenario(), 30.0)[0], abs=1e-6)


# ------------------------------------------------------------------------------ runs


def grows(case, angle_deg, path, value):
    """Return whether a rod that starts 1 µm beside its equilibrium does not come to rest in a run.

    An oscillation grows until the motor reaches its limits. A stable loop comes to rest by
    e^{−4} between the two quarters, by the slowest mode alone.
    """
    case = case.changed({path: value})
    load, angle = case.plant.load, math.radians(angle_deg)
    weight = load.segment_mass_kg * load.gravity_m_s2 * load.centre_of_mass_m
    rate = math.log(abs(coupled_loop(case, angle_deg).eigenvalues[0])) / T
    changes = {
        "plant.load.knee_torque_n_m": -weight * math.sin(load.thigh_inclination_rad - angle),
        "reference": StepReference(start_deg=angle_deg, end_deg=angle_deg),
        "initial_offset_m": 1e-6,
        "simulation.duration_s": max(8.0 / abs(rate), 2.0),
    }
    run = simulate(case.changed(changes).without_quantizers(), signals=["motor_speed_command"])
    size = np.abs(run["motor_speed_command_rad_s"])
    quarter = size.size // 4
    rounding = 1e-6  # rad/s; the run begins with some 10 rad/s
    return bool(size[-quarter:].max() > max(0.3 * size[quarter : 2 * quarter].max(), rounding))


def confirmed(case, angle_deg, path, values):
    """Return the number of ends of the stable interval, after a run 5 % inside and outside each."""
    low, high = stable_interval(case, path, values, knee_angle_deg=angle_deg)
    ends = [(low, 0.05)] if low > values[0] else []  # nan is no end
    ends += [(high, -0.05)] if high < values[-1] else []
    for end, inwards in ends:
        assert not grows(case, angle_deg, path, end * (1.0 + inwards))
        assert grows(case, angle_deg, path, end * (1.0 - inwards))
    return len(ends)


NO_DAMPING = {"speed_feedforward": 1.0, "leak_per_s": 0.0, "damping_n_m_s_per_rad": 0.0}
"""Gains whose zero torque is unstable, so that the interval of the stiffness has two ends."""

VALUES = {
    STIFFNESS: np.append(0.0, np.geomspace(1.0, 1e6, 21)),
    PROPORTIONAL: np.geomspace(0.1, 300.0, 13),
    "controller.speed_feedforward": np.linspace(0.0, 0.95, 6),
    "controller.integral_rad_s2_per_n": np.geomspace(1.0, 3000.0, 9),
}


@pytest.mark.slow(gate=0)
def test_runs_confirm_the_border_at_60_random_cells():
    random, ends, cells = np.random.default_rng(23), 0, 0
    while cells < 60:
        path = list(VALUES)[cells % len(VALUES)]
        cuff = {
            "stiffness_n_m_per_rad": math.exp(random.uniform(math.log(500.0), math.log(5000.0))),
            "damping_n_m_s_per_rad": random.choice([0.0, 5.0]),
        }
        law = {
            "speed_feedforward": random.uniform(0.0, 0.9),
            "proportional_rad_s_per_n": math.exp(random.uniform(math.log(0.5), math.log(8.0))),
            "damping_n_m_s_per_rad": random.uniform(0.0, 10.0),
        }
        case = scenario(random.choice(list(WEARERS)), cuff, **law)
        number = confirmed(case, random.uniform(10.0, 85.0), path, VALUES[path])
        cells, ends = cells + bool(number), ends + number
    assert ends >= 60


# ------------------------------------------------------------------------------ intervals


def test_ends_of_an_interval_have_an_eigenvalue_on_the_circle():
    case = scenario("swing", **NO_DAMPING)
    interval = stiffness_interval(case, knee_angle_deg=45.0)
    assert 1e3 < interval.low_n_m_per_rad < interval.high_n_m_per_rad < 1e6
    for end in (interval.low_n_m_per_rad, interval.high_n_m_per_rad):
        # A change of the stiffness by 1 % moves |λ| by 1e-3.
        assert magnitudes(case.changed({STIFFNESS: end}), 45.0)[0] == pytest.approx(1.0, abs=2e-6)


@pytest.mark.parametrize(
    ("given", "expected"),
    [(1.0, (0.0, 2.0)), (2.5, (0.0, 2.0)), (3.6, (4.0, 7.0)), (5.0, (4.0, 7.0)), (9.0, (4.0, 7.0))],
)
def test_the_interval_is_that_of_the_given_value_or_the_nearest(given, expected):
    growth = np.poly1d([2.0, 4.0, 7.0], r=True)
    assert _interval(growth, np.linspace(0.0, 10.0, 11) + 0.01, given) == pytest.approx(
        expected, abs=0.02
    )


def test_ends_of_the_grid_and_no_interval():
    assert _interval(lambda value: -1.0, [1.0, 2.0], 1.5) == (1.0, 2.0)
    assert np.isnan(_interval(lambda value: 1.0, [1.0, 2.0], 1.5)).all()


@pytest.mark.slow
def test_stiffness_interval_is_the_stable_interval():
    law = {"speed_feedforward": 0.9, "damping_n_m_s_per_rad": 0.0, "mode": "zero_torque"}
    case = scenario("swing", estimator="observer", **law)
    for stiffness in (20.0, 5e3):
        given = case.changed({STIFFNESS: stiffness})
        interval = stiffness_interval(given)
        slow = stable_interval(
            given.changed({"controller.mode": "impedance"}), STIFFNESS, VALUES[STIFFNESS]
        )
        assert (interval.low_n_m_per_rad, interval.high_n_m_per_rad) == pytest.approx(
            slow, rel=1e-3
        )
        assert (interval.low_n_m_per_rad > 1e3) is (stiffness == 5e3)  # one of two intervals
    assert interval.felt_n_m_per_rad == pytest.approx(
        2.0 * math.pi * output_impedance(case, [1.0]).magnitude[0]
    )


@pytest.mark.slow
def test_assist_as_needed_has_no_virtual_damping():
    case = scenario("swing", mode="assist_as_needed", speed_feedforward=0.9)
    bare = case.changed({"controller.mode": "impedance", "controller.damping_n_m_s_per_rad": 0.0})
    assert stiffness_interval(case).high_n_m_per_rad == stiffness_interval(bare).high_n_m_per_rad
    damped = bare.changed({"controller.damping_n_m_s_per_rad": 1.0})
    assert stiffness_interval(damped).high_n_m_per_rad > stiffness_interval(case).high_n_m_per_rad


def test_another_controller_has_no_virtual_stiffness():
    line = r"\Acontroller.kind = smc: stiffness_interval needs controller.kind = torque\Z"
    with pytest.raises(ParameterError, match=line):
        stiffness_interval(Scenario())


# ------------------------------------------------------------------------------ tables and maps


@pytest.mark.slow
def test_each_wearer_is_stable_with_the_default_gains():
    case = Scenario(plant={"load": "knee"}, wearer="leg", controller="torque")
    for stiffness in (500.0, 1500.0):
        cuffed = case.changed({"wearer.cuff.stiffness_n_m_per_rad": stiffness})
        result = coupled_stability(cuffed)
        assert result.rows == tuple(WEARERS)
        assert result.gain_margin.min() > 2.0
        assert result.phase_margin_deg.min() > 40.0
    assert (result.disk_margin.shape, result.border) == ((6, 3), ())
    loop = coupled_loop(cuffed.changed({"wearer": WEARERS["tense"]}), 45.0)
    row, margins = list(WEARERS).index("tense"), loop.margins()
    assert result.largest_eigenvalue[row, 1] == pytest.approx(abs(loop.eigenvalues[0]), rel=1e-12)
    for name in ("gain_margin", "lower_gain_margin", "delay_margin_s", "disk_margin"):
        assert getattr(result, name)[row, 1] == pytest.approx(getattr(margins, name), rel=1e-9)


@pytest.mark.slow
def test_a_map_has_the_border():
    case = scenario("swing")
    values = {"controller.speed_feedforward": [0.2, 0.9], STIFFNESS: [100.0, 2000.0, 6e4]}
    result = stability_map(case, values, knee_angle_deg=45.0)
    assert result.row_label == "speed feedforward"
    assert result.column_label == "controller stiffness (N·m/rad)"
    assert np.isnan(result.disk_margin[:, 2]).all()
    assert (result.largest_eigenvalue[:, 2] > 1.0).all()
    assert [row for row, _ in result.border] == [0.2, 0.9]
    for row, end in result.border:
        there = case.changed({"controller.speed_feedforward": row, STIFFNESS: end})
        assert magnitudes(there, 45.0)[0] == pytest.approx(1.0, abs=2e-6)
    frame = result.to_dataframe()
    assert list(frame["controller stiffness (N·m/rad)"]) == [100.0, 2000.0, 6e4] * 2
    assert list(frame["speed feedforward"]) == [0.2] * 3 + [0.9] * 3
    assert frame["largest_eigenvalue"][4] == result.largest_eigenvalue[1, 1]


@pytest.mark.slow
def test_numbers_of_the_theory():
    text = (Path(__file__).parents[3] / "docs" / "theory.md").read_text(encoding="utf-8")
    case = Scenario(plant={"load": "knee"}, wearer="leg", controller="torque")
    default = coupled_stability(case)
    gain, phase = default.gain_margin.min(), default.phase_margin_deg.min()
    assert f"gain margin is {gain:.2f} and the least phase margin is {phase:.1f}°" in text
    integral = coupled_stability(case.changed({"controller.leak_per_s": 0.0})).phase_margin_deg
    assert f"the least phase margin is {integral[0].min():.1f}°, that of a relaxed leg" in text
    assert integral.min() == integral[0].min()
    cuff = {"stiffness_n_m_per_rad": 5000.0, "damping_n_m_s_per_rad": 0.0}
    unstable = coupled_stability(case.changed({"wearer.cuff": cuff})).largest_eigenvalue > 1.0
    assert np.argwhere(unstable).tolist() == [[list(WEARERS).index("light"), 0]]

    def interval(angle_deg, **law):
        changes = {f"controller.{name}": value for name, value in law.items()}
        active = {"wearer.motion": "active", "controller.damping_n_m_s_per_rad": 0.0}
        return stiffness_interval(case.changed(active | changes), knee_angle_deg=angle_deg)

    at_45, at_10 = interval(45.0), interval(10.0)
    high, short = 1e-3 * at_45.high_n_m_per_rad, 1e-3 * at_10.high_n_m_per_rad
    assert f"0 … {high:.1f} kN·m/rad at 45° and 0 … {short:.1f} kN·m/rad at 10°" in text
    stiff = 1e-3 * interval(45.0, proportional_rad_s_per_n=16.0).high_n_m_per_rad
    assert f"the high end at 45° is {stiff:.1f} kN·m/rad" in text
    full = interval(45.0, speed_feedforward=1.0)
    low, high = 1e-3 * full.low_n_m_per_rad, 1e-3 * full.high_n_m_per_rad
    assert f"the interval at 45° is {low:.1f} … {high:.1f} kN·m/rad" in text
    assert f"{at_45.felt_n_m_per_rad:.0f} N·m/rad at 1 Hz" in text


def test_a_map_needs_two_parameters():
    with pytest.raises(ParameterError, match=r"\Avalues: has 1 parameters; must have two\Z"):
        stability_map(scenario(), {STIFFNESS: [1.0]})


def test_no_values_and_unknown_names_are_one_line():
    with pytest.raises(ParameterError, match=r"\Awearer: has no values; give at least one\Z"):
        coupled_stability(scenario(), {})
    line = r"\Aproportional \(\(rad/s\)/N\): has no values; give at least one\Z"
    with pytest.raises(ParameterError, match=line):
        stability_map(scenario(), {STIFFNESS: [1.0], PROPORTIONAL: []})
    with pytest.raises(ParameterError, match=r"controller.gain: unknown name; known here: .*"):
        stable_interval(scenario(), "controller.gain", [1.0])


def test_a_plot_marks_sound_small_and_unstable_loops():
    disk = np.array([[0.5, 0.49, np.nan], [np.nan, 2.0, 0.1]])
    nothing = np.ones_like(disk)
    result = CoupledStability(
        "gain", "wearer (kg)", (1.0, 30.0), (5.0, 6.0, 7.0), *[nothing] * 5, disk, ((1.0, 6.5),)
    )
    ax = result.plot()
    points = {line.get_label(): line.get_xydata().tolist() for line in ax.lines}
    assert points == {
        "sound": [[1.0, 5.0], [30.0, 6.0]],
        "small margin": [[1.0, 6.0], [30.0, 7.0]],
        "unstable": [[1.0, 7.0], [30.0, 5.0]],
        "border": [[1.0, 6.5]],
    }
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "linear")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("gain", "wearer (kg)")
    plt.close(ax.figure)
