"""Study `size`: the smallest hardware with which the knee walks."""

from kneexo.studies.size.result import SizeResult as SizeResult, WalkingDesign as WalkingDesign
from kneexo.studies.size.settings import SizeSettings as SizeSettings
from kneexo.studies.size.study import size_study as size_study
