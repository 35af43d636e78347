"""Study `size`: hardware that a task needs."""

from kneexo.studies.size.study import (
    SizeResult as SizeResult,
    SizeSettings as SizeSettings,
    WalkingDesign as WalkingDesign,
    size_study as size_study,
)
