"""Study `sliding`: sliding condition and bound on the error."""

from kneexo.studies.sliding.study import (
    SLIDING_LAW as SLIDING_LAW,
    SlidingResult as SlidingResult,
    SlidingSettings as SlidingSettings,
    sliding_study as sliding_study,
)
