"""Values and readings of the log that several tests of the closed loop share."""

import math

import numpy as np

from kneexo.diagrams import available_signals, columns
from kneexo.parameters import (
    EncoderParameters,
    ObserverParameters,
    PidParameters,
    SineReference,
    SlidingModeParameters,
)

PERIOD = 0.002

UNQUANTIZED = EncoderParameters(quantized=False)

COUNT = 2.0 * math.pi / 4096.0

REFERENCE = SineReference(mean_deg=40.0, amplitude_deg=1.5, frequency_hz=2.0)

PID = PidParameters(
    proportional_per_s=20.0,
    integral_per_s2=50.0,
    derivative=0.05,
    filter_s=0.030,
    anti_windup_s=0.2,
    velocity_feedforward=0.5,
    moment_arm_m=0.09,
    command_limit_rad_s=200.0,
)

OBSERVER = ObserverParameters(time_constant_s=0.015)


def logged(diagram, context, scenario, *names):
    """The named columns of the log, one row a sample; and the sample times."""
    log = diagram.GetSubsystemByName("log").FindLog(context)
    everything = columns(available_signals(scenario))
    return (
        np.array([log.data()[everything.index(name)] for name in names]).T,
        log.sample_times().copy(),
    )


def sliding_mode(phi=4.0, switching="saturation"):
    return SlidingModeParameters(
        switching=switching,
        lambda_per_s=15.0,
        phi_m_s2=phi,
        eta_m_s3=2e5,
        stiffness_uncertainty_n_per_m=500.0,
        damping_uncertainty_n_s_per_m=30.0,
        load_rate_uncertainty_n_per_s=100.0,
    )
