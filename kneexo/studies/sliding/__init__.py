"""Study `sliding`: the sliding condition, and bounds on the tracking error."""

from kneexo.studies.sliding.settings import (
    SLIDING_LAW as SLIDING_LAW,
    SlidingSettings as SlidingSettings,
)
from kneexo.studies.sliding.study import (
    SlidingResult as SlidingResult,
    sliding_study as sliding_study,
)
