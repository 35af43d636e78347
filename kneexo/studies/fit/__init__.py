"""Study `fit`: numbers of a scenario from a log of the real machine."""

from kneexo.studies.fit.fit import FitSettings, fit_study

__all__ = ["FitSettings", "fit_study"]
