"""Makes one HTML page of recorded runs: moving legs with a slider for the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from kneexo.version import __version__
from kneexo.view.legs import Leg
from kneexo.view.stage import STAGE_SCRIPTS, STAGE_STYLES, pack, stage_leg
from kneexo.view.web_page import self_contained_page, web_text

FRAMES_PER_S = 100.0
"""Largest number of recorded samples per second that a page holds."""

MOST_FRAMES = 300_000
"""Largest number of samples of a page, summed over its legs. The page has at most 8 MB."""

MOST_FRAMES_IN_REPORT = 60_000
"""Largest number of samples of a stage in a report, summed over its legs: at most 3 MB."""

MOST_LEGS = 30
"""Largest number of legs of a page, one leg for each run. The page has at most 8 MB."""

_BEYOND_RAD = 0.1  # the linkage can be assembled this far beyond the range of motion


def shown_s(legs: Sequence[Leg], most_frames: int = MOST_FRAMES) -> float:
    """Return the time in s at which a page ends: the end of the longest run, or earlier.

    A full page, with ``most_frames`` samples of all its legs, ends earlier. A sample of a leg with
    a wearer counts 1.5, because it has six columns instead of four.
    """
    frames_per_s = FRAMES_PER_S * sum(1.0 if leg.wearer_rad is None else 1.5 for leg in legs)
    return min(max(float(leg.time_s[-1]) for leg in legs), most_frames / frames_per_s)


class StageContent(NamedTuple):
    """Arguments of `self_contained_page` for the stage of some runs, without page style."""

    body_html: str
    styles: list[str]
    scripts: list[str]
    data: dict[str, Any]


def view_page(legs: Sequence[Leg]) -> str:
    """Return one self-contained HTML page with the `stage_content` of some legs.

    Raises `LinkageError` if a linkage cannot be assembled.
    """
    content = stage_content(legs)
    return self_contained_page(
        f"kneexo: {', '.join(leg.name for leg in legs)}",
        f"<main>\n<h1>The knee in motion</h1>\n{content.body_html}\n</main>",
        [*content.styles, web_text("view/web/view.css")],
        content.scripts,
        content.data,
    )


def stage_content(legs: Sequence[Leg], most_frames: int = MOST_FRAMES) -> StageContent:
    """Return the parts of a page with legs beside each other and a slider for the time.

    The colour of a cylinder shows its load pressure, with full colour at the rating of the leg. An
    outline shows the reference, and a curve shows the error. The page ends at `shown_s`, without
    the rest of a longer run. After the end of a shorter run the leg stays at its last pose.

    Raises `LinkageError` if a linkage cannot be assembled.
    """
    end_s = shown_s(legs, most_frames)
    last_s = max(float(leg.time_s[-1]) for leg in legs)
    cut = f"The page shows the first {end_s:.4g} of {last_s:.4g} s. " if end_s < last_s else ""
    body = f"""<div id="stage"></div>
<noscript>The view needs JavaScript.</noscript>
<p class="stage-note">{cut}Joints, pins, cylinder and rod have the places and lengths of the
linkage. Limbs, brace, pump and motor are illustrative. kneexo {__version__}</p>"""
    return StageContent(
        body,
        [*map(web_text, STAGE_STYLES)],
        [*map(web_text, STAGE_SCRIPTS), web_text("view/web/view.js")],
        {"legs": [_stage_leg(leg) for leg in legs], "runs": [_run(leg, end_s) for leg in legs]},
    )


def _stage_leg(leg: Leg) -> dict[str, Any]:
    angles = np.concatenate([leg.knee_angle_rad, leg.reference_rad])
    low, high = float(angles.min()), float(angles.max())
    if leg.wearer_rad is not None:
        low = max(low - _BEYOND_RAD, min(low, float(leg.wearer_rad.min())))
        high = min(high + _BEYOND_RAD, max(high, float(leg.wearer_rad.max())))
    return stage_leg(leg.name, leg.linkage, low, high, leg.pressure_rating_pa)


def _run(leg: Leg, end_s: float) -> dict[str, str]:
    """Return the samples of a leg up to the time ``end_s``, at most `FRAMES_PER_S` of them."""
    end_s = min(end_s, float(leg.time_s[-1]))
    times = np.arange(leg.time_s[0], end_s + 0.5 / FRAMES_PER_S, 1.0 / FRAMES_PER_S)
    # The nearest records and no interpolation, so that the page shows samples of the run.
    near = np.rint(np.interp(times, leg.time_s, np.arange(len(leg.time_s))))
    last = np.searchsorted(leg.time_s, end_s, side="right") - 1
    rows = np.unique([*near.astype(int), last])
    columns = {
        "time": leg.time_s,
        "angle": leg.knee_angle_rad,
        "reference": leg.reference_rad,
        "pressure": leg.pressure_pa,
        "wearer": leg.wearer_rad,
        "torque": leg.torque_n_m,
    }
    return {name: pack(column[rows]) for name, column in columns.items() if column is not None}
