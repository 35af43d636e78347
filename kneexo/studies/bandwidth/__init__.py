"""Study `bandwidth`: frequency response of the knee at small and at large amplitudes."""

from kneexo.studies.bandwidth.study import (
    BandwidthResult as BandwidthResult,
    BandwidthSettings as BandwidthSettings,
    bandwidth_study as bandwidth_study,
)
