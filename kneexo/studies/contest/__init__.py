"""Study `contest`: SMC and PID, tuned alike, on uncertain plants."""

from kneexo.studies.contest.study import (
    Contestant as Contestant,
    ContestResult as ContestResult,
    ContestSettings as ContestSettings,
    Tuning as Tuning,
    contest_study as contest_study,
)
