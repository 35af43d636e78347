"""Studies of a few short runs: to compare engines, and to see what a sweep does with executors."""

from kneexo.analysis.frequency.sine_estimate import SineEstimateSettings
from kneexo.parameters import PidParameters, Scenario, SineReference, Uncertainty, UncertaintySet
from kneexo.parameters.paths import changed
from kneexo.studies.bandwidth import BandwidthSettings, bandwidth_study
from kneexo.studies.contest import Contestant, ContestSettings, contest_study
from kneexo.studies.controller import ControllerSettings, controller_study
from kneexo.studies.robustness import RobustnessSettings, robustness_study
from kneexo.studies.size import SizeSettings, size_study

SMOOTH = changed(
    Scenario(),
    {
        "encoder.quantized": False,
        "plant.load": {"kind": "knee"},
        "reference.amplitude_deg": 2.0,
        "reference.frequency_hz": 2.0,
        "simulation.duration_s": 0.6,
    },
)
"""A scenario whose runs are alike by both engines."""

MASS = UncertaintySet(values={"plant.cylinder.mass_kg": Uncertainty(low=1.4, high=1.8)})
QUICK = SineEstimateSettings(averaged_cycles=2, largest_cycles=3, ramp_min_s=0.1)
SMALL = {
    "bandwidth": (
        bandwidth_study,
        SMOOTH,
        BandwidthSettings(amplitudes_deg=(1.0,), frequencies_hz=(6.3, 8.0, 10.0), estimate=QUICK),
    ),
    "robustness": (
        lambda scenario, **options: robustness_study(scenario, MASS, **options),
        SMOOTH,
        RobustnessSettings(
            samples=2, corners_max=2, bandwidth=False, sensitivity_duration_s=0.0, nyquist_loops=0
        ),
    ),
    "study controller": (
        controller_study,
        SMOOTH,
        ControllerSettings(
            lambdas_per_s=(20.0,),
            phis_m_s2=(3.2,),
            etas_m_s3=(2.8e5,),
            step_duration_s=0.3,
            large_step_deg=5.0,
            fast_duration_s=0.3,
            fast_frequency_hz=5.0,
            fast_amplitude_deg=0.5,
            hold_duration_s=0.2,
            limit_cycle_lambdas_per_s=(20.0,),
            map_time_constants_s=(0.02,),
            map_slopes_per_s=(1e5,),
        ),
    ),
    "study contest": (
        lambda scenario, **options: contest_study(scenario, MASS, **options),
        SMOOTH,
        ContestSettings(
            contestants={
                "P": Contestant(
                    controller=PidParameters(),
                    gains={
                        "controller.proportional_per_s": Uncertainty(low=1.0, high=9.0, scale="log")
                    },
                )
            },
            training_samples=1,
            test_samples=1,
            optimizer_seeds=(1,),
            population=5,
            generations=1,
            duration_s=0.6,
            other_reference=SineReference(amplitude_deg=0.5, frequency_hz=10.0),
            other_duration_s=0.2,
        ),
    ),
    "size": (
        size_study,
        changed(SMOOTH, {"reference.amplitude_deg": 0.2, "reference.frequency_hz": 5.0}),
        SizeSettings(
            factors=(1.0,),
            walking_factors=(1.0,),
            stride_frequencies_hz=(1.0,),
            cycles=2,
            lambda_per_s=(80.0,),
            slope_per_s=(5e4,),
            observer_s=(0.02,),
            search_tolerance=0.5,
            check_step_s=5e-4,
            seal_friction_n=0.0,
            wearer_torques_n_m=(0.0,),
        ),
    ),
}
"""Name of a study: its function, scenario and settings."""
