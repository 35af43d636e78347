"""Study `bandwidth`: frequency response from small to large amplitude."""

from kneexo.studies.bandwidth.study import (
    BandwidthResult as BandwidthResult,
    BandwidthSettings as BandwidthSettings,
    bandwidth_study as bandwidth_study,
)
