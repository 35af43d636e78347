"""Scenarios that reproduce the paper's figures."""

from __future__ import annotations

from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.parameters import (
    BldcPumpParameters,
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    PidParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SineReference,
    SlidingModeParameters,
    StepReference,
)

IDEAL_SMC = Scenario(
    plant=PlantParameters(
        pump=BldcPumpParameters(internal_leakage_m3_per_s_pa=0.0),
        rod_map="polynomial",
        ideal_motor=True,
    ),
    encoder=EncoderParameters(quantized=False),
    estimator=ExactParameters(),
    controller=SlidingModeParameters(continuous=True, lambda_per_s=10.0, command_limit_rad_s=1e12),
    initial_offset_m=-0.089,
    simulation=SimulationParameters(
        duration_s=10.0, tolerance=1e-13, error_controlled=True, accuracy=1e-6
    ),
)
"""Scenario of Fig. 9: continuous sliding mode, exact states, and 89 mm initial error of the rod.

The motor has no speed limit and the cylinder no leakage.
"""

PID_PAPER = PidParameters()
"""A PID whose error is as large as in Fig. 12: proportional action alone, 5 1/s."""

PID_TUNED = PidParameters(proportional_per_s=14.0, integral_per_s2=400.0, filter_s=0.015)
"""The PID with the least error in Fig. 12 among all PIDs that chatter no more than the SMC.

``benchmarks/tune_pid.py`` finds the gains. The largest error depends on single counts of the
encoder, so the errors of neighbouring gains differ irregularly by some hundredths of a degree.
"""

PID_FEEDFORWARD = PidParameters(
    proportional_per_s=1.25,
    integral_per_s2=40.0,
    derivative=0.02,
    filter_s=0.010,
    velocity_feedforward=1.0,
)
"""A PID tuned like `PID_TUNED`, with feedforward of the reference's velocity.

``benchmarks/tune_pid.py --feedforward`` finds the gains.
"""

FIG_12 = {
    "smc": Scenario(),
    "pid": Scenario(controller=PID_PAPER),
    "pid_tuned": Scenario(controller=PID_TUNED),
    "pid_feedforward": Scenario(controller=PID_FEEDFORWARD),
}
"""Dictionary from a controller's name to its scenario in Fig. 12: sliding mode and three PIDs.

The reference covers 10…70° at 0.1 Hz.
"""

_BASE_HZ = (0.20, 0.21, 0.22, 0.23, 0.24)

FIG_13_SCALING = {
    "nominal": (Scenario(), SinestreamSettings(frequencies_hz=_BASE_HZ)),
    "gear_3": (
        Scenario(plant=PlantParameters(pump=BldcPumpParameters(gear_ratio=3.0))),
        SinestreamSettings(frequencies_hz=tuple(2.0 * f for f in _BASE_HZ)),
    ),
    "half_amplitude": (
        Scenario(reference=SineReference(amplitude_deg=15.0)),
        SinestreamSettings(frequencies_hz=tuple(2.0 * f for f in _BASE_HZ)),
    ),
}
"""Dictionary from a name to the scenario and frequencies of a sinestream as in Fig. 13.

The results show how the bandwidth scales. Twice the flow (gear ratio 3) should double the nominal
bandwidth, and so should half the amplitude.
"""


def _eq_27(slope_per_s: float) -> SlidingModeParameters:
    """Return the default controller with Φ such that k/Φ is ``slope_per_s``, where k = β·η."""
    default = SlidingModeParameters()
    return SlidingModeParameters(phi_m_s2=default.gain_ratio * default.eta_m_s3 / slope_per_s)


EQ_27_EXACT_STATES = {
    f"{slope:g}": Scenario(
        encoder=EncoderParameters(quantized=False),
        estimator=ExactParameters(),
        controller=_eq_27(slope),
        reference=StepReference(start_deg=30.0, end_deg=30.0),
        initial_offset_m=5e-5,
        simulation=SimulationParameters(duration_s=3.0, integrator="rk4", step_s=4e-5),
    )
    for slope in (1.0e4, 1.3e4)
}
"""Scenarios of Eq. 27 sampled at 2 ms with exact states. The keys are k/Φ in 1/s.

One k/Φ lies below the stability boundary of the sampled hydraulic mode, the other above. With the
scenarios' step, rk4 damps the mode correctly to 2e-4 1/s. Drake's radau3 adds a damping of 0.06 1/s
and Drake's RK3 adds 0.17 1/s. With a step of 0.2 ms, RK3 adds more damping than the oil has.
"""

EQ_27_DIFFERENCES = {
    f"{slope:g}": Scenario(
        estimator=DifferenceParameters(),
        controller=_eq_27(slope),
        simulation=SimulationParameters(duration_s=20.0),
    )
    for slope in (1.0e4, 4.0e4)
}
"""Scenarios of Eq. 27 sampled at 2 ms, with backward differences of the quantized encoder.

The keys are k/Φ in 1/s.
"""

PAPER_BANDWIDTH_HZ = 0.21
"""−3 dB bandwidth in Hz that the paper measured (Section 5, Fig. 13)."""
