"""Study `bandwidth`: frequency response of the knee at small and at large amplitudes."""

from kneexo.studies.bandwidth.bandwidth import BandwidthResult, BandwidthSettings, bandwidth_study

__all__ = ["BandwidthResult", "BandwidthSettings", "bandwidth_study"]
