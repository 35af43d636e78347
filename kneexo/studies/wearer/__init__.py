"""Study `wearer`: the torque that a wearer feels, and the help that a wearer gets."""

from kneexo.studies.wearer.wearer import WearerResult, WearerSettings, wearer_study

__all__ = ["WearerResult", "WearerSettings", "wearer_study"]
