"""Study `controller`: effects of λ, Φ and η of the sliding-mode controller."""

from kneexo.studies.controller.study import (
    Claim as Claim,
    ControllerResult as ControllerResult,
    ControllerSettings as ControllerSettings,
    controller_study as controller_study,
)
