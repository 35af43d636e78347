"""Study `controller`: effects of the sliding-mode controller's parameters λ, Φ and η."""

from kneexo.studies.controller.result import Claim, ControllerResult
from kneexo.studies.controller.settings import ControllerSettings
from kneexo.studies.controller.study import controller_study

__all__ = ["Claim", "ControllerResult", "ControllerSettings", "controller_study"]
