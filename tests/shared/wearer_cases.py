"""Settings and helpers of the tests of the study `wearer`."""

import math

from kneexo.studies.wearer.study import WEARER_KNEE, WearerSettings, in_motion

SMALL = WearerSettings(
    cadences_hz=(1.0,),
    rise_times_s=(0.8,),
    help_cadences_hz=(1.0,),
    help_rise_times_s=(0.8,),
    cycles=2,
    postures_deg=(45.0,),
    shares=(0.2,),
)
WALKING = (1.0, math.nan)


def walking(body=""):
    """A second of walking after the first one, by the default scenario of the study."""
    return in_motion(WEARER_KNEE, SMALL, WALKING, body)
