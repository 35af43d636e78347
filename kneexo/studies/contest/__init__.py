"""Study `contest`: SMC and PID, tuned alike, on uncertain plants."""

from kneexo.studies.contest.contest import (
    Contestant,
    ContestResult,
    ContestSettings,
    Tuning,
    contest_study,
)

__all__ = ["ContestResult", "ContestSettings", "Contestant", "Tuning", "contest_study"]
