"""Study `mechanism`: how well a linkage or a hinge follows the wearer's knee."""

from kneexo.studies.mechanism.mechanism import MechanismResult, MechanismSettings, mechanism_study

__all__ = ["MechanismResult", "MechanismSettings", "mechanism_study"]
