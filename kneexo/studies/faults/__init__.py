"""Study `faults`: how far faults move the knee, and whether the protection acts in time."""

from kneexo.studies.faults.faults import FaultsResult, FaultsSettings, faults_study

__all__ = ["FaultsResult", "FaultsSettings", "faults_study"]
