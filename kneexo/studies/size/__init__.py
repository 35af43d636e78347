"""Study `size`: the smallest hardware with which the knee walks."""

from kneexo.studies.size.result import SizeResult, WalkingDesign
from kneexo.studies.size.settings import SizeSettings
from kneexo.studies.size.size import size_study

__all__ = ["SizeResult", "SizeSettings", "WalkingDesign", "size_study"]
