"""Study `sliding`: the sliding condition, and bounds on the tracking error."""

from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings
from kneexo.studies.sliding.study import SlidingResult, sliding_study

__all__ = ["SLIDING_LAW", "SlidingResult", "SlidingSettings", "sliding_study"]
