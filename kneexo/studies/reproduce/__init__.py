"""Study `reproduce`: the paper's figures and numbers."""

from kneexo.studies.reproduce.reproduce import (
    ReproduceResult,
    ReproduceSettings,
    growth_rate,
    reproduce_study,
)

__all__ = ["ReproduceResult", "ReproduceSettings", "growth_rate", "reproduce_study"]
