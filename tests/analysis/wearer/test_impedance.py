"""Output impedance against the formula of oil and mass, and against runs with sines."""

import math

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis import OutputImpedance, measure_impedance, output_impedance, passivity_limits
from kneexo.analysis.wearer import impedance as module
from kneexo.errors import LinearizationError, ParameterError
from kneexo.parameters import KneeLoadParameters, PlantParameters, Scenario

WEIGHTLESS = PlantParameters(load=KneeLoadParameters(segment_mass_kg=0.0))
ANGLE_DEG = 45.0
# Lee et al. 2020, Tables 2 and 3, and the assumptions of the package, in SI units.
BULK_MODULUS, VOLUME, LEAKAGE, MASS, DAMPING = 1.72e9, 4.1233e-5, 2e-13, 1.6, 0.05
CUFF = 1500.0


def scenario(plant=WEIGHTLESS, controller=None, **values):
    values = {"wearer": {"kind": "leg"}} | values
    return Scenario(plant=plant, controller={"kind": "torque"} | (controller or {}), **values)


def arm(rod_of_knee):
    return float(-rod_of_knee(math.radians(ANGLE_DEG), 1))


def oil_and_mass(frequency_hz, arm_m):
    """Return r² (k_q Ā²/(s + k_q C_t) + B + m s), as in the theory page."""
    s = 2j * np.pi * np.asarray(frequency_hz)
    area = math.pi * (0.02**2 - 0.5 * 0.01**2) / 4.0  # bore 20 mm, rod 10 mm
    rate = 4.0 * BULK_MODULUS / VOLUME
    return arm_m**2 * (rate * area**2 / (s + rate * LEAKAGE) + DAMPING + MASS * s)


def made(impedance, frequency_hz=(0.1, 1.0, 10.0), **values):
    case = {"port": "cuff", "knee_angle_rad": 0.8, "moment_arm_m": 0.1, "stable": True}
    scenario_ = values.pop("scenario", scenario())
    return OutputImpedance(
        np.array(frequency_hz), np.array(impedance), scenario=scenario_, **case | values
    )


# ------------------------------------------------------------------------------- the result


def test_asymptotes_are_those_of_the_data_sheet():
    result = made([1.0, 2.0, 3.0])
    # 4β/V_t = 1.6686e14 Pa/m³, Ā = 2.7489 cm², C_t = 2e-13 m³/(s·Pa), at r = 0.1 m
    assert result.held_damper_n_m_s_per_rad == pytest.approx(0.01 * 3.778e5, rel=2e-4)
    assert result.held_spring_n_m_per_rad == pytest.approx(0.01 * 1.2608e7, rel=2e-4)
    assert result.held_inertia_kg_m2 == pytest.approx(0.016, rel=1e-12)
    sealed = scenario().changed({"plant.pump.internal_leakage_m3_per_s_pa": 0.0})
    assert made([1.0, 2.0, 3.0], scenario=sealed).held_damper_n_m_s_per_rad == math.inf


def test_magnitude_phase_and_least_real_part():
    result = made([3.0 + 4.0j, -2.0j, -1.0])
    assert result.magnitude == pytest.approx([5.0, 2.0, 1.0])
    assert result.phase_deg == pytest.approx([math.degrees(math.atan2(4, 3)), -90.0, 180.0])
    assert result.least_real_part == (-1.0, 10.0)
    table = result.to_dataframe()
    assert list(table.index) == [0.1, 1.0, 10.0]
    assert list(table["magnitude_n_m_s_per_rad"]) == pytest.approx([5.0, 2.0, 1.0])
    assert list(table["real_part_n_m_s_per_rad"]) == [3.0, 0.0, -1.0]
    assert list(table["phase_deg"]) == pytest.approx(list(result.phase_deg))


def test_plot_shows_z_and_its_asymptotes():
    result = made([3.0 + 4.0j, -2.0j, -1.0])
    magnitude, phase = result.plot()
    assert list(magnitude.lines[0].get_ydata()) == pytest.approx([5.0, 2.0, 1.0])
    assert list(phase.lines[0].get_ydata()) == pytest.approx(list(result.phase_deg))
    damper, spring, inertia = (line.get_ydata() for line in magnitude.lines[1:])
    assert list(damper) == pytest.approx([result.held_damper_n_m_s_per_rad] * 3)
    assert spring[1] == pytest.approx(result.held_spring_n_m_per_rad / (2.0 * math.pi))
    assert inertia[1] == pytest.approx(result.held_inertia_kg_m2 * 2.0 * math.pi)
    assert "45.8°" in magnitude.figure.get_label()
    plt.close(magnitude.figure)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (
            lambda: output_impedance(Scenario()),
            r"wearer.kind = none: output_impedance needs wearer.kind = leg, with its cuff",
        ),
        (lambda: output_impedance(scenario(), port="foot"), r"port = 'foot': .* knee or cuff"),
        (lambda: output_impedance(scenario(), [1.0, 0.0]), r"frequency = 0 Hz: must be > 0"),
        (
            lambda: measure_impedance(Scenario(), 1.0),
            r"wearer.kind = none: measure_impedance needs wearer.kind = leg, with its cuff",
        ),
        (
            lambda: measure_impedance(scenario(controller={"mode": "impedance"}), 1.0),
            r"controller: follows the reference, .* mode = zero_torque or assist",
        ),
        (
            lambda: measure_impedance(scenario(controller={"kind": "pid"}), 1.0),
            r"controller: follows the reference, .* mode = zero_torque or assist",
        ),
        (lambda: measure_impedance(scenario(), 1.0, 0.0), r"amplitude_deg = 0 deg: must be > 0"),
        (
            lambda: measure_impedance(scenario(), 51.0),
            r"frequencies_hz: 51 Hz is too high: must be <= 50 Hz, ten samples a period",
        ),
    ],
)
def test_bad_input_is_one_line(call, line):
    with pytest.raises((ParameterError, LinearizationError), match=rf"\A{line}\Z"):
        call()


# -------------------------------------------------------------------------- a motor at rest


@pytest.mark.slow
def test_a_held_motor_is_oil_and_mass(rod_of_knee):
    f = np.geomspace(0.013, 5003.0, 120)
    case = scenario(wearer={"kind": "leg", "motion": "passive"})
    result = output_impedance(case, f, knee_angle_deg=ANGLE_DEG, port="knee", motor_held=True)
    expected = oil_and_mass(f, arm(rod_of_knee))
    assert np.abs(result.impedance / expected - 1.0).max() < 1e-4
    assert result.moment_arm_m == pytest.approx(arm(rod_of_knee), rel=1e-5)
    assert result.knee_angle_rad == pytest.approx(math.radians(ANGLE_DEG), rel=1e-6)
    # The asymptotes, where the whole formula has them within 2 %.
    z, omega = result.impedance, 2.0 * np.pi * f
    spring = (f > 30.0) & (f < 55.0)
    inertia = f > 3200.0
    assert spring.sum() > 3
    assert inertia.sum() > 3
    damper_hz = output_impedance(
        case, [0.1], knee_angle_deg=ANGLE_DEG, port="knee", motor_held=True
    )
    assert damper_hz.magnitude[0] == pytest.approx(result.held_damper_n_m_s_per_rad, rel=2e-2)
    springs = np.abs(z * omega)[spring] / result.held_spring_n_m_per_rad
    assert springs == pytest.approx(np.ones(spring.sum()), abs=2e-2)
    inertias = np.abs(z / omega)[inertia] / result.held_inertia_kg_m2
    assert inertias == pytest.approx(np.ones(inertia.sum()), abs=2e-2)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_held_motor_moves_the_inertia_of_the_load(rod_of_knee):
    f = np.geomspace(0.013, 5003.0, 120)
    case = scenario().changed({"plant.load.inertia_kg_m2": 0.064})
    result = output_impedance(case, f, knee_angle_deg=ANGLE_DEG, port="knee", motor_held=True)
    at_rod = 2j * np.pi * f * MASS * arm(rod_of_knee) ** 2
    expected = oil_and_mass(f, arm(rod_of_knee)) - at_rod + 2j * np.pi * f * 0.064
    assert np.abs(result.impedance / expected - 1.0).max() < 1e-4
    assert result.held_inertia_kg_m2 == pytest.approx(0.064, rel=1e-14)


def test_control_reduces_the_damping_of_the_cylinder(rod_of_knee):
    """Z = r² ((Ā²(1 − γH) + B(s/k_q + C_t))/Y + m s): the load cell is behind the damping B."""
    law = {"proportional_rad_s_per_n": 0.05, "integral_rad_s2_per_n": 0.0, "speed_feedforward": 0.3}
    damping = 1e5
    damped = scenario(controller=law, estimator={"kind": "exact"}).changed(
        {"plant.cylinder.damping_n_s_per_m": damping}
    )
    frequency_hz = np.array([0.1, 0.3, 1.0])
    z = output_impedance(damped, frequency_hz, knee_angle_deg=ANGLE_DEG, port="knee")
    s = 2j * np.pi * frequency_hz
    hold = (1.0 - np.exp(-0.002 * s)) / (0.002 * s) / (1.0 + 0.01 * s)
    area = math.pi * (0.02**2 - 0.5 * 0.01**2) / 4.0
    oil = s * VOLUME / (4.0 * BULK_MODULUS) + LEAKAGE
    flow = 0.8e-6 / (2.0 * math.pi) / 6.0 * area  # 0.8 cm³/rev behind a gear of 6
    total = oil + 0.05 * flow * hold / (1.0 + 0.001 * s)
    formula = (area**2 * (1.0 - 0.3 * hold) + damping * oil) / total + MASS * s
    assert z.impedance == pytest.approx(arm(rod_of_knee) ** 2 * formula, rel=1e-4)


@pytest.mark.slow
def test_at_the_cuff_a_held_motor_is_in_series_with_the_cuff(rod_of_knee):
    f = np.geomspace(0.013, 503.0, 40)
    result = output_impedance(scenario(), f, knee_angle_deg=ANGLE_DEG, motor_held=True)
    cuff = CUFF / (2j * np.pi * f) + 5.0
    knee = oil_and_mass(f, arm(rod_of_knee))
    assert np.abs(result.impedance * (1.0 / cuff + 1.0 / knee) - 1.0).max() < 1e-4


@pytest.mark.slow
def test_the_weight_of_the_shank_is_a_spring():
    """Shank of 1.6 kg, 0.20 m from the knee, thigh hanging: K = m g l cos θ."""
    plant = PlantParameters(load=KneeLoadParameters())
    f = np.array([1e-4, 1e-3])
    result = output_impedance(
        scenario(plant=plant), f, knee_angle_deg=ANGLE_DEG, port="knee", motor_held=True
    )
    rest = result.impedance - oil_and_mass(f, result.moment_arm_m)
    spring = 1.6 * 9.81 * 0.20 * math.cos(result.knee_angle_rad)
    assert (rest * 2j * np.pi * f).real == pytest.approx([spring, spring], rel=1e-4)


# ------------------------------------------------------------------------------ closed loop


@pytest.mark.slow
def test_a_biological_moment_is_no_part_of_the_impedance():
    moment = {"times_s": (0.0, 100.0), "moments_n_m": (3.0, 9.0)}
    leg = {"kind": "leg", "motion": "active", "effort": 0.7, "moment": moment}
    f = [0.3, 3.0]
    assisted = scenario(wearer=leg, controller={"mode": "assist"})
    free = output_impedance(scenario(), f).impedance
    assert output_impedance(assisted, f).impedance == pytest.approx(free, rel=1e-12)
    measured = measure_impedance(assisted, 3.0, 0.2)
    assert measured.impedance == measure_impedance(scenario(), 3.0, 0.2).impedance


@pytest.mark.slow
def test_a_virtual_spring_is_felt_in_series_with_the_cuff():
    law = {"mode": "impedance", "stiffness_n_m_per_rad": 200.0, "damping_n_m_s_per_rad": 0.0}
    result = output_impedance(scenario(controller=law), [1e-3], knee_angle_deg=ANGLE_DEG)
    stiffness = complex(result.impedance[0]) * 2j * math.pi * 1e-3
    # The moment arm of Eq. 10 differs from that of the linkage by some tenths of a percent.
    assert stiffness.real == pytest.approx(1.0 / (1.0 / 200.0 + 1.0 / CUFF), rel=1e-2)
    assert abs(stiffness.imag) < 0.05 * stiffness.real


@pytest.mark.slow
def test_damping_of_the_cuff_makes_the_default_gains_passive():
    case = scenario(plant=PlantParameters(load=KneeLoadParameters()))
    bare = case.changed({"wearer.cuff.damping_n_m_s_per_rad": 0.0})
    law = case.controller
    assert law.proportional_rad_s_per_n > passivity_limits(case).proportional_rad_s_per_n
    least = [
        output_impedance(each, knee_angle_deg=ANGLE_DEG).least_real_part for each in (case, bare)
    ]
    assert least[0][0] > 0.0 > least[1][0]


@pytest.mark.slow
def test_default_frequencies_end_below_half_the_sampling_rate():
    result = output_impedance(scenario())
    assert result.frequency_hz.shape == (200,)
    assert result.frequency_hz[0] == pytest.approx(0.05)
    assert result.frequency_hz[-1] == pytest.approx(245.0)
    assert result.stable
    assert not output_impedance(scenario(), port="knee").stable  # as on a locked rod


@pytest.mark.slow
@pytest.mark.parametrize("frequency_hz", [0.1, 0.5, 2.0, 10.0, 25.0, 50.0])
def test_small_sines_measure_the_linear_impedance(frequency_hz):
    case = scenario(plant=PlantParameters(load=KneeLoadParameters())).without_quantizers()
    measured = measure_impedance(case, frequency_hz, 0.02, knee_angle_deg=ANGLE_DEG)
    linear = output_impedance(case, [frequency_hz], knee_angle_deg=ANGLE_DEG)
    ratio = measured.impedance / linear.impedance[0]
    # Measured: at most 1.5e-4 and 0.012°, from the curvature of the linkage.
    assert measured.settled
    assert abs(ratio) == pytest.approx(1.0, abs=2e-3)
    assert abs(math.degrees(np.angle(ratio))) < 0.12
    assert measured.speed_limited_share == 0.0
    torque = abs(linear.impedance[0]) * 2.0 * math.pi * frequency_hz * math.radians(0.02)
    assert measured.torque_amplitude_n_m == pytest.approx(torque, rel=2e-3)


@pytest.mark.slow
def test_the_uncertainty_is_that_of_the_impedance(monkeypatch):
    monkeypatch.setattr(module, "response_uncertainty", lambda responses: 20.0 * math.pi)
    assert measure_impedance(scenario(), 10.0, 0.2).uncertainty == pytest.approx(1.0)


@pytest.mark.slow
def test_a_leg_faster_than_the_pump_feels_the_oil():
    case = scenario().without_quantizers()
    linear = output_impedance(case, [1.0], knee_angle_deg=ANGLE_DEG)
    large = measure_impedance(case, 1.0, 10.0, knee_angle_deg=ANGLE_DEG)
    # 1 Hz with 10° needs 63 °/s, and the pump moves the knee at 22 °/s.
    assert large.speed_limited_share > 0.3
    assert abs(large.impedance) > 3.0 * linear.magnitude[0]
