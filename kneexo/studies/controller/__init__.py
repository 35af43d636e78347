"""Study `controller`: effects of the sliding-mode controller's parameters λ, Φ and η."""

from kneexo.studies.controller.result import Claim as Claim, ControllerResult as ControllerResult
from kneexo.studies.controller.settings import ControllerSettings as ControllerSettings
from kneexo.studies.controller.study import controller_study as controller_study
