"""Study `controller`: effects of the sliding-mode controller's parameters λ, Φ and η."""

from kneexo.studies.controller.controller import controller_study
from kneexo.studies.controller.result import Claim, ControllerResult
from kneexo.studies.controller.settings import ControllerSettings

__all__ = ["Claim", "ControllerResult", "ControllerSettings", "controller_study"]
