"""Study `sliding`: sliding condition and bound on the error."""

from kneexo.studies.sliding.settings import (
    SLIDING_LAW as SLIDING_LAW,
    SlidingSettings as SlidingSettings,
)
from kneexo.studies.sliding.study import (
    SlidingResult as SlidingResult,
    sliding_study as sliding_study,
)
