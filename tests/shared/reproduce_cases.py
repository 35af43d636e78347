"""Settings, numbers and helpers of the tests of the reproduce study."""

from functools import cache

import numpy as np

from kneexo.analysis import FrequencyResponse, PolynomialFit, Run, TrackingMetrics, TrackingResult
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.parameters import RodPolynomialParameters, Scenario, SimulationParameters
from kneexo.studies.paper import EQ_27_DIFFERENCES, EQ_27_EXACT_STATES, FIG_12
from kneexo.studies.reproduce.reproduce import ReproduceResult

METRICS = {
    "max_error_deg": 0.11,
    "rms_error_deg": 0.12,
    "max_error_overall_deg": 0.13,
    "rms_error_overall_deg": 0.14,
    "mean_command_change_rpm": 15.0,
    "saturated_share": 0.16,
    "peak_command_rpm": 1700.0,
    "peak_pressure_mpa": 0.18,
    "pressure_over_rating_share": 0.19,
    "peak_shaft_power_w": 20.0,
    "power_over_rating_share": 0.21,
    "shaft_energy_j": 22.0,
    "shaft_energy_delivered_j": 23.0,
    "hydraulic_energy_j": 24.0,
}
"""Numbers that tell each other apart; those of the n-th run are n + 1 times as large."""
TIME = np.array([0.0, 0.5, 1.0, 1.5])
ANGLES = np.linspace(0.0, 90.0, 91)
GAINS = np.array([[0.9, 0.8, 0.5], [1.0, 0.7, 0.6]])
PHASES = np.array([[-10.0, -20.0, -40.0], [-12.0, -24.0, -48.0]])


TRIALS = (
    {"plant.cylinder.mass_kg": 4.0, "encoder.phase_rad": 5e-3},
    {"plant.cylinder.mass_kg": 9.0, "encoder.phase_rad": 1e-2},
)


def tracked(scenario, factor):
    reference, angle = np.radians([40.0, 41.0, 42.0, 43.0]), np.radians([40.0, 40.0, 44.0, 40.0])
    return TrackingResult(
        scenario,
        Run(
            2.0 * TIME,
            {"knee_reference_rad": factor * reference, "knee_angle_rad": factor * angle},
            scenario.simulation,
        ),
        TrackingMetrics(**{name: factor * value for name, value in METRICS.items()}),
    )


def response(bandwidth_hz):
    return FrequencyResponse(
        frequencies_hz=np.array([0.1, 0.2, 0.4]),
        response=GAINS * np.exp(1j * np.radians(PHASES)),
        bandwidth_hz=bandwidth_hz,
        phase_at_bandwidth_deg=-31.5,
        trials=TRIALS,
        scenario=Scenario(),
        settings=SinestreamSettings(),
    )


def oscillation(rate):
    time = np.arange(0.0, 3.0, 0.002)
    command = np.where(np.arange(time.size) % 2, 2.0, -1.0)  # 3 rad/s of change at each sample
    pressure = 5.0 * np.exp(rate * time) * np.sin(330.0 * time)
    columns = {"load_pressure_pa": pressure, "motor_speed_command_rad_s": command}
    return Run(time, columns, SimulationParameters())


def _first(values):
    """An error at the first angles alone."""
    return np.append(values, np.zeros(ANGLES.size - len(values)))


FIG_9 = {
    "rod_reference_m": np.array([0.10, 0.11, 0.12, 0.13]),
    "rod_extension_m": np.array([0.05, 0.10, 0.1198, 0.12999]),
}


RATIOS = {"nominal": 0.2, "gear_3": 0.42, "half_amplitude": 0.3}


@cache
def made_up():
    """A reproduction whose numbers all differ and are known by hand."""
    p, q = (np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * scale for scale in (1e-9, 1e-8))
    return ReproduceResult(
        fit=PolynomialFit(
            table=RodPolynomialParameters(),
            angle_deg=ANGLES,
            extension_mm=148.0 - ANGLES,
            p_mm_deg=p,
            q_deg_mm=q,
            p_error_mm=_first([3.0, -4.0]),
            q_error_deg=_first([0.6, -0.8]),
            table_p_error_mm=_first([0.5, -1.2]),
            table_q_error_deg=_first([8.0, -15.0]),
        ),
        fig9=Run(TIME, FIG_9, SimulationParameters()),
        fig12={name: tracked(case, n + 1) for n, (name, case) in enumerate(FIG_12.items())},
        fig13=response(0.22),
        scaling={name: response(hertz) for name, hertz in RATIOS.items()},
        eq27_exact={name: oscillation(n - 0.5) for n, name in enumerate(EQ_27_EXACT_STATES)},
        eq27_differences={
            name: tracked(case, 10 * (n + 1))
            for n, (name, case) in enumerate(EQ_27_DIFFERENCES.items())
        },
    )
