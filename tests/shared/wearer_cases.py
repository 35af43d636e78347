"""Settings and helpers of the tests of the study `wearer`."""

import itertools
import math
from functools import cache

from kneexo.parameters.paths import changed
from kneexo.studies.wearer.wearer import (
    HELPING,
    LOOPS,
    WEARER_KNEE,
    MarginRow,
    WearerResult,
    WearerRow,
    WearerSettings,
    WearerTrace,
    designs,
    in_motion,
    modes,
)

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


NUMBERS = (
    *("rms_torque_n_m", "mean_torque_n_m", "peak_torque_n_m", "assistance_ratio"),
    *("power_from_wearer_w", "power_to_wearer_w", "deviation_deg"),
)


@cache
def made_up():
    """Rows with numbers that are all different, and one failed run."""
    settings = changed(SMALL, {"cadences_hz": (0.5, 2.0), "help_cadences_hz": (0.5,)})
    counter = itertools.count(1)
    nan = math.nan

    def row(design, wearer, mode, cadence_hz, rise_time_s):
        n = next(counter)
        period = 3.0 * rise_time_s if math.isnan(cadence_hz) else 1.0 / cadence_hz
        trace = WearerTrace(
            time_s=tuple(0.25 * period * k for k in range(5)),
            leg_deg=(n, n + 1.0, n + 2.0, n + 1.0, n),
            knee_deg=(n + 0.1, n + 1.2, n + 2.3, n + 1.4, n + 0.1),
            torque_n_m=(n + 0.5, n + 0.6, -n, n + 0.8, n + 0.5),
        )
        numbers = {name: 1.37 * n + 0.0617 * k for k, name in enumerate(NUMBERS)}
        return WearerRow(
            design=design,
            wearer=wearer,
            mode=mode,
            cadence_hz=cadence_hz,
            rise_time_s=rise_time_s,
            **numbers,
            saturated_share=0.003 * n,
            lowest_pressure_pa=-1e4 * n,
            trace=trace,
        )

    motions = [(0.5, nan), (2.0, nan), (nan, 0.8)]
    names = list(designs(WEARER_KNEE, settings))
    follow = [row(name, "any", "zero torque", *m) for name in names for m in motions]
    weak = [
        row(name, body, mode, *motion)
        for name in HELPING
        for body, motion in (("light", motions[0]), ("average", motions[0]))
        for mode in modes(settings, assisting=True)
    ]
    failed = WearerRow("sized pump", "heavy", "zero torque", 0.5, nan, failure="left the range")
    margins = [
        MarginRow(name, 0.4 + 0.2 * k, 2.11 + k, 1.0 + k, 2346.0 + k, 71.7 + k)
        for k, name in enumerate(LOOPS)
    ]
    return WearerResult(tuple(follow), (*weak, failed), tuple(margins), WEARER_KNEE, settings)


SMALL_STUDY = {"scenario": WEARER_KNEE, "settings": SMALL}
"""Arguments of a study that takes about a second."""
