"""Settings and default scenario of the study `sliding`."""

from __future__ import annotations

from kneexo.parameters import (
    EncoderParameters,
    ExactParameters,
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SlidingModeParameters,
)
from kneexo.parameters.quantity import Parameters, quantities, quantity


class SlidingSettings(Parameters):
    """Settings of the study `sliding`: η, loads and initial states of the runs."""

    etas_m_s3: tuple[float, ...] = quantities(
        (1e3, 1e4, 3e4, 3.6e4, 7e4, 9e4, 2.8e5),
        "m/s³",
        "assumption: from 1/300 of the speed authority to all of it, with two each "
        "about 3.3e4 and 8.0e4, what the closed forms ask for with P_1 and P_2 loaded",
        ge=1e-3,
        le=1e12,
    )
    loads_n: tuple[float, ...] = quantities(
        (60.0, -60.0),
        "N",
        "assumption: four times the switching force, so that one chamber carries "
        "the load throughout, P_1 or P_2",
        ge=-1e4,
        le=1e4,
    )
    start_eta_m_s3: float = quantity(
        1e3,
        "m/s³",
        "assumption: so small that reaching the layer takes a time worth looking at",
        ge=1e-3,
        le=1e12,
    )
    start_offset_m: float = quantity(
        -0.010, "m", "assumption: λ² times it lies outside the layer", ge=-0.15, le=0.15
    )
    start_duration_s: float = quantity(
        0.010, "s", "assumption: ten times what reaching takes", ge=1e-3, le=1e3
    )
    start_sample_time_s: float = quantity(
        2e-5, "s", "assumption: of the log; fifty before the layer is reached", ge=1e-5, le=1
    )
    sampled_eta_m_s3: float = quantity(
        2.8e4,
        "m/s³",
        "assumption: k/Φ = 9.9e3 1/s, below the stability boundary of exact states at 2 ms",
        ge=1e-3,
        le=1e12,
    )
    sampled_offset_m: float = quantity(
        -0.020, "m", "assumption: half a second at the speed limit", ge=-0.15, le=0.15
    )
    settling_factor: float = quantity(
        8.0,
        "1",
        "assumption: times 1/λ after which what is left of the start does not count, 0.3 %",
        ge=0,
        le=1e3,
    )
    rated_samples: int = quantity(
        2000,
        "1",
        "assumption: samples outside the layer at which ds/dt is evaluated, at most",
        ge=10,
        le=1_000_000,
    )


SLIDING_LAW = Scenario(
    plant=PlantParameters(
        load=KneeLoadParameters(segment_mass_kg=0.0), rod_map="polynomial", ideal_motor=True
    ),
    encoder=EncoderParameters(quantized=False),
    estimator=ExactParameters(),
    controller=SlidingModeParameters(
        continuous=True,
        sample_time_s=2e-4,
        load_rate_uncertainty_n_per_s=2.5e3,
        command_limit_rad_s=1e12,
    ),
    simulation=SimulationParameters(duration_s=10.0),
)
"""Default scenario of the study: continuous time, exact states, an ideal motor.

The sample time is the interval of the log. Eq. 27 neglects the leakage, which acts like a load that
changes by 4 β_e C_t/V_t = 33 N/s per newton. Here the bound on dF_L/dt covers the leakage of 75 N.
"""
