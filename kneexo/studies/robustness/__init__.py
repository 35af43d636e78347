"""Study `robustness`: effects of uncertain values on a closed loop."""

from kneexo.studies.robustness.robustness import (
    RobustnessResult,
    RobustnessSettings,
    assess_plant,
    robustness_study,
    worst,
)

__all__ = ["RobustnessResult", "RobustnessSettings", "assess_plant", "robustness_study", "worst"]
