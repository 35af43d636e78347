"""Makes one HTML page of recorded runs: Drake's Meshcat with a time slider."""

from __future__ import annotations

import html
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.ticker import EngFormatter
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform

from kneexo.errors import OutputError, shown
from kneexo.files.writing import require_mark
from kneexo.parameters import LinkageParameters
from kneexo.result import Array
from kneexo.version import __version__
from kneexo.view.legs import Leg
from kneexo.view.mechanism import points
from kneexo.view.parts import (
    ICR_COLOUR,
    REFERENCE,
    Placement,
    depths_m,
    icr_path,
    in_world,
    look_at_legs,
    placements,
    shapes,
)
from kneexo.view.pressure_colour import pressure_colours

FRAMES_PER_S = 32.0
"""Frames per second of a recording."""

MOST_FRAMES = 4800
"""Largest number of frames of a page, summed over its legs. The page has at most 8 MB."""

MOST_FRAMES_IN_REPORT = 1920
"""Largest number of frames of a page in a report, summed over its legs: at most 3 MB."""

MOST_LEGS = 30
"""Largest number of legs of a page, one leg for each run. The page has at most 8 MB."""

MARK = "<!-- made by kneexo view -->"
"""A comment in each page. No command replaces a file without this comment."""

_HEAD = """
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
#caption { position: absolute; left: 12px; top: 8px; max-width: 60vw; font: 14px sans-serif;
  color: #222; background: rgba(255, 255, 255, 0.8); padding: 6px 10px; pointer-events: none; }
#caption ol { margin: 4px 0; padding-left: 1.4em; }
@media (max-width: 600px) {
  #caption { font-size: 11px; left: 0; top: auto; bottom: 0; max-width: none; }
}
</style>
"""


def shown_s(legs: Sequence[Leg], most_frames: int = MOST_FRAMES) -> float:
    """Return the time in s at which a page ends: the end of the longest run, or earlier.

    The page ends earlier if it is full, which means that its legs have ``most_frames`` frames
    together.
    """
    return min(max(float(leg.time_s[-1]) for leg in legs), most_frames / (FRAMES_PER_S * len(legs)))


def view_page(legs: Sequence[Leg], most_frames: int = MOST_FRAMES) -> str:
    """Return one self-contained HTML page of legs beside each other, with a slider for the time.

    The colour of a cylinder shows its load pressure. Red is the largest magnitude of all legs, blue
    is the same magnitude with negative sign. A grey shank shows the reference, and a line shows the
    path of the instantaneous centre of rotation. The page ends at `shown_s`, so the rest of a
    longer run is not shown. After the end of a shorter run the leg stays at its last pose.
    """
    meshcat = _quiet_meshcat()
    meshcat.SetProperty("/Background", "visible", False)
    look_at_legs(meshcat, len(legs))
    end_s = shown_s(legs, most_frames)
    largest = max(float(np.abs(leg.pressure_pa).max()) for leg in legs)
    # A colour that is also shown now would replace the object that the recording changes.
    meshcat.StartRecording(FRAMES_PER_S, set_visualizations_while_recording=False)
    for number, (leg, depth) in enumerate(zip(legs, depths_m(len(legs)), strict=True)):
        _record(meshcat, f"/knee/leg{number}", leg, depth, largest, end_s)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    page = str(meshcat.StaticHtml()).replace("<html>", '<html lang="en">', 1)
    title = f"kneexo: {', '.join(leg.name for leg in legs)}"
    page = page.replace(
        "<title>Drake MeshCat</title>", f"{_HEAD}<title>{html.escape(title)}</title>", 1
    )
    page = page.replace("</body>", f"{MARK}{_caption(legs, largest, end_s)}</body>")
    return page.encode(
        "utf-8", "replace"
    ).decode()  # the name of a file may have bytes that are not UTF-8


def _quiet_meshcat() -> Meshcat:
    """Return a new Meshcat, without Drake's message about the address of the server."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    finally:
        logger.setLevel(level)


def require_page(path: Path) -> None:
    """Raise `OutputError` if a file exists without `MARK`, or if the name lacks .html."""
    require_mark(path, MARK, "page of kneexo view")
    if path.suffix not in (".html", ".htm"):
        raise OutputError(f"{shown(path)}: the name of a page must end in .html")


def _record(
    meshcat: Meshcat, path: str, leg: Leg, depth_m: float, largest_pa: float, end_s: float
) -> None:
    """Record a leg up to the time ``end_s``.

    ``path`` is the leg's path in Meshcat. ``depth_m`` is the y coordinate of the leg's plane.
    ``largest_pa`` is the load pressure in Pa at which the cylinder is red.
    """
    end_s = min(end_s, leg.time_s[-1])
    times = np.arange(0.0, end_s + 0.5 / FRAMES_PER_S, 1.0 / FRAMES_PER_S)
    angle, reference, pressure = (
        np.interp(times, leg.time_s, values)
        for values in (leg.knee_angle_rad, leg.reference_rad, leg.pressure_pa)
    )
    meshcat.SetTransform(path, RigidTransform(in_world(0j, depth_m)))
    parts = placements(leg.linkage, angle, reference)
    looks = shapes(leg.linkage)
    for group, shank_angle, is_ghost in (
        (path, angle, False),
        (f"{path}/reference", reference, True),
    ):
        shank = _shank(leg.linkage, shank_angle)
        _move(meshcat, f"{group}/on_shank", times, shank, shank.frames())
        for name, placement in parts.items():
            if name.startswith(REFERENCE) != is_ghost:
                continue
            on_shank = placement.seen_from(shank)
            if on_shank.is_constant and not placement.is_constant:
                place, placement = f"{group}/on_shank", on_shank
            else:
                place = group
            place += f"/{name.removeprefix(REFERENCE)}"
            meshcat.SetObject(place, *looks[name])
            _move(meshcat, place, times, placement, placement.poses())
    meshcat.SetLine(f"{path}/icr_path", icr_path(leg.linkage), 2.0, ICR_COLOUR)
    for time, colour in zip(times.tolist(), pressure_colours(pressure, largest_pa), strict=True):
        meshcat.SetProperty(
            f"{path}/cylinder/<object>", "material.color", colour.tolist(), time_in_recording=time
        )


def _shank(linkage: LinkageParameters, knee_angle: Array) -> Placement:
    """Return the placement of the shank's frame, whose x axis points to the ankle."""
    at = points(linkage, knee_angle)
    down = at["ankle"] - at["shank_start"]
    return Placement(at["shank_start"], down / np.abs(down))


def _move(
    meshcat: Meshcat,
    path: str,
    times: Array,
    placement: Placement,
    poses: Iterator[RigidTransform],
) -> None:
    """Record the pose of the object ``path`` at each of ``times``, or one pose if it is constant.

    The frame of the shank carries all parts that are fixed to the shank. So the page records a pose
    for each time only for this frame, and for the few parts that are not fixed to the shank.
    """
    if placement.is_constant:
        meshcat.SetTransform(path, next(poses))
        return
    for time, pose in zip(times.tolist(), poses, strict=True):
        meshcat.SetTransform(path, pose, time_in_recording=time)


def _caption(legs: Sequence[Leg], largest: float, end_s: float) -> str:
    names = "".join(f"<li>{html.escape(leg.name)}</li>" for leg in legs)
    if len(legs) > 1:
        names = names.replace("</li>", " (nearest)</li>", 1)
    last_s = max(float(leg.time_s[-1]) for leg in legs)
    pressure = EngFormatter("Pa", places=1)(largest)
    cut = f"the first {end_s:.3g} of {last_s:.3g} s<br>" if end_s < last_s else ""
    return (
        f'<div id="caption"><b>kneexo {__version__}</b><ol>{names}</ol>{cut}'
        f"cylinder: load pressure, blue −{pressure} … red {pressure}"
        "<br>grey shank: reference<br>line: path of the instantaneous centre of rotation</div>"
    )
