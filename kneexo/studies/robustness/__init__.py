"""Study `robustness`: effects of uncertain values on a closed loop."""

from kneexo.studies.robustness.study import (
    RobustnessResult,
    RobustnessSettings,
    assess_plant,
    robustness_study,
    worst,
)

__all__ = ["RobustnessResult", "RobustnessSettings", "assess_plant", "robustness_study", "worst"]
