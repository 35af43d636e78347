"""Study `design`: a linkage that follows a wearer's knee, within limits."""

from kneexo.studies.design.design import DesignResult, DesignSettings, design_study

__all__ = ["DesignResult", "DesignSettings", "design_study"]
