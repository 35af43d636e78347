"""Recorded runs as one HTML page: Drake's Meshcat with a time slider."""

from __future__ import annotations

import html
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.ticker import EngFormatter
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform, RotationMatrix

from kneexo.files.writing import require_mark, write_file
from kneexo.parameters import LinkageParameters
from kneexo.result import Array
from kneexo.version import __version__
from kneexo.view.mechanism import (
    BARS,
    GHOST,
    ICR_COLOUR,
    PINS,
    Bar,
    Look,
    Points,
    depths_m,
    icr_path,
    in_world,
    look_at_legs,
    points,
    pressure_colours,
    shapes,
)

FRAMES_PER_S = 32.0
"""Frames of a recording in a second."""

MOST_FRAMES = 4800
"""Frames of all legs of a page together, 150 s of one leg: the page stays below 8 MB."""

MOST_FRAMES_IN_REPORT = 1920
"""The same of a page within a report, which stays below 3 MB."""

MOST_LEGS = 30
"""Legs of a page, whose parts count too: it stays below 8 MB."""

COLUMNS = ("time_s", "knee_angle_rad", "knee_reference_rad", "load_pressure_pa")
"""What a page shows of a run."""

MARK = "<!-- made by kneexo view -->"
"""In each page, so that one page may replace another."""

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

_ALONG, _ACROSS = (
    RotationMatrix.MakeYRotation(0.5 * np.pi),
    RotationMatrix.MakeXRotation(0.5 * np.pi),
)
_TOLERANCE = 1e-9  # m and rad


@dataclass(frozen=True)
class Leg:
    """What a page shows of one run.

    ``time_s``, ``knee_angle_rad``, ``reference_rad``, ``pressure_pa``: (n,) each.
    """

    name: str
    linkage: LinkageParameters
    time_s: Array
    knee_angle_rad: Array
    reference_rad: Array
    pressure_pa: Array

    @classmethod
    def of_signals(
        cls, name: str, linkage: LinkageParameters, signals: Mapping[str, ArrayLike]
    ) -> Leg:
        """A leg of the columns `COLUMNS` of a run."""
        return cls(name, linkage, *(np.asarray(signals[column]) for column in COLUMNS))


def shown_s(legs: Sequence[Leg], most_frames: int = MOST_FRAMES) -> float:
    """Time in s that a page shows of its legs: of the longest run, or what the size allows."""
    return min(max(float(leg.time_s[-1]) for leg in legs), most_frames / (FRAMES_PER_S * len(legs)))


def view_page(legs: Sequence[Leg], most_frames: int = MOST_FRAMES) -> str:
    """One self-contained HTML page: legs beside each other, with a slider for the time.

    The cylinder's colour is its load pressure: blue for negative, red for positive, at full colour
    for the largest of all legs. The grey shank is the reference; the line is the path of the
    instantaneous centre of rotation. A leg whose run is shorter stands still at its end. What comes
    after `shown_s` is left out.
    """
    meshcat = _quiet_meshcat()
    meshcat.SetProperty("/Background", "visible", False)
    look_at_legs(meshcat, len(legs))
    end_s = shown_s(legs, most_frames)
    largest = max(float(np.abs(leg.pressure_pa).max()) for leg in legs)
    # Shown at once too, a colour would replace the object that the recording alters.
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
    return page.encode("utf-8", "replace").decode()  # a file name may have bytes that are no text


def _quiet_meshcat() -> Meshcat:
    """A Meshcat whose address nobody needs, so that Drake does not print it."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    finally:
        logger.setLevel(level)


def require_page(path: Path) -> None:
    """Raise `OutputError` for a file that is no page of a view."""
    require_mark(path, MARK, "page of kneexo view")


def write_page(path: Path, page: str) -> None:
    """Write a page in the place of an earlier one; `OutputError` where that cannot be."""
    require_page(path)
    write_file(path, page.encode())


def _record(
    meshcat: Meshcat, path: str, leg: Leg, depth: float, largest: float, end_s: float
) -> None:
    end_s = min(end_s, leg.time_s[-1])
    times = np.arange(0.0, end_s + 0.5 / FRAMES_PER_S, 1.0 / FRAMES_PER_S)
    angle, reference, pressure = (
        np.interp(times, leg.time_s, values)
        for values in (leg.knee_angle_rad, leg.reference_rad, leg.pressure_pa)
    )
    now, wanted = points(leg.linkage, angle), points(leg.linkage, reference)
    meshcat.SetTransform(path, RigidTransform(in_world(0j, depth)))
    looks = shapes(leg.linkage)
    parts = _Parts(meshcat, path, times, now)
    for name, bar in BARS.items():
        parts.add_bar(name, looks[name], bar, now)
    for name in (*PINS, "icr"):
        parts.add_pin(f"pin_{name}", looks[f"pin_{name}"], now[name])
    ghost = _Parts(meshcat, f"{path}/reference", times, wanted)
    for name in GHOST:
        ghost.add_bar(name, looks[f"reference_{name}"], BARS[name], wanted)
    meshcat.SetLine(f"{path}/icr_path", icr_path(leg.linkage), 2.0, ICR_COLOUR)
    for time, colour in zip(times.tolist(), pressure_colours(pressure, largest), strict=True):
        meshcat.SetProperty(
            f"{path}/cylinder/<object>", "material.color", colour.tolist(), time_in_recording=time
        )


class _Parts:
    """Parts of a leg in a recording.

    The page holds a pose at each frame only for the shank and for what moves otherwise: what stands
    still has a single pose, and what turns with the shank has a single pose on it.
    """

    def __init__(self, meshcat: Meshcat, path: str, times: Array, at: Mapping[str, Points]) -> None:
        self._meshcat, self._path, self._times = meshcat, path, times.tolist()
        down = at["ankle"] - at["shank_start"]
        still = np.zeros_like(down)
        self._frames = {
            path: (still, still + 1.0),
            f"{path}/on_shank": (at["shank_start"], down / np.abs(down)),
        }
        self._move(f"{path}/on_shank", RotationMatrix(), *self._frames[f"{path}/on_shank"])

    def add_bar(self, name: str, look: Look, bar: Bar, at: Mapping[str, Points]) -> None:
        start, end = at[bar.start], at[bar.end]
        turn = (end - start) / np.abs(end - start)
        self._add(name, look, _ALONG, 0.5 * (start + end), turn, bar.layer_m)

    def add_pin(self, name: str, look: Look, place: Points) -> None:
        self._add(name, look, _ACROSS, place, None)

    def _add(
        self,
        name: str,
        look: Look,
        axis: RotationMatrix,
        place: Points,
        turn: Points | None,
        layer_m: float = 0.0,
    ) -> None:
        """Add a part on the frame on which it stands still; ``turn`` None: it is round."""
        seen = {
            frame: ((place - origin) / way, np.ones_like(way) if turn is None else turn / way)
            for frame, (origin, way) in self._frames.items()
        }
        frame = next((f for f, poses in seen.items() if all(map(_is_constant, poses))), self._path)
        self._meshcat.SetObject(f"{frame}/{name}", *look)
        self._move(f"{frame}/{name}", axis, *seen[frame], layer_m)

    def _move(
        self, path: str, axis: RotationMatrix, place: Points, turn: Points, layer_m: float = 0.0
    ) -> None:
        angle = -np.angle(turn)
        poses = (
            RigidTransform(RotationMatrix.MakeYRotation(y) @ axis, in_world(point, layer_m))
            for point, y in zip(place, angle, strict=True)
        )
        if _is_constant(place) and _is_constant(turn):
            self._meshcat.SetTransform(path, next(poses))
            return
        for time, pose in zip(self._times, poses, strict=True):
            self._meshcat.SetTransform(path, pose, time_in_recording=time)


def _is_constant(values: Points) -> bool:
    return bool(np.abs(values - values[0]).max() < _TOLERANCE)


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
