"""Study `reproduce`: the paper's figures and numbers."""

from kneexo.studies.reproduce.study import (
    ReproduceResult as ReproduceResult,
    ReproduceSettings as ReproduceSettings,
    growth_rate as growth_rate,
    reproduce_study as reproduce_study,
)
