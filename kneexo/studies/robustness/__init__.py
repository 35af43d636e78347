"""Study `robustness`: effects of uncertain values on a closed loop."""

from kneexo.studies.robustness.study import (
    RobustnessResult as RobustnessResult,
    RobustnessSettings as RobustnessSettings,
    assess_plant as assess_plant,
    robustness_study as robustness_study,
    worst as worst,
)
