"""Recorded runs as one HTML page: Drake's Meshcat with a time slider."""

from __future__ import annotations

import html
import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, MeshcatParams, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from kneexo.errors import OutputError
from kneexo.mechanism import (
    BARS,
    GHOST,
    PIN,
    PINS,
    SPACING_M,
    Bar,
    Points,
    bar_pose,
    in_world as _world,
    points,
    pressure_colours,
)
from kneexo.parameters import LinkageParameters
from kneexo.version import __version__

Array = NDArray[np.float64]

FRAMES_PER_S = 32.0
"""Frames of a recording in a second."""

MARK = "<!-- made by kneexo view -->"
"""In each page, so that one page may replace another."""

_ACROSS = RotationMatrix.MakeXRotation(0.5 * np.pi)


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


def view_page(legs: Sequence[Leg]) -> str:
    """One self-contained HTML page: legs beside each other, with a slider for the time.

    The cylinder's colour is its load pressure: blue for negative, red for positive, at full colour
    for the largest of all legs. The grey shank is the reference; the line is the path of the
    instantaneous centre of rotation. A leg whose run is shorter stands still at its end.
    """
    meshcat = _quiet_meshcat()
    meshcat.SetProperty("/Background", "visible", False)
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    largest = max(float(np.abs(leg.pressure_pa).max()) for leg in legs)
    meshcat.StartRecording(frames_per_second=FRAMES_PER_S)
    for number, leg in enumerate(legs):
        depth = (number - 0.5 * (len(legs) - 1)) * SPACING_M
        _record(meshcat, f"/knee/leg{number}", leg, depth, largest)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    distance = 0.55 + 0.5 * SPACING_M * (len(legs) - 1)
    meshcat.SetCameraPose([0.5 * distance, -distance, 0.05], [-0.04, 0.0, -0.03])
    page = str(meshcat.StaticHtml())
    return page.replace("</body>", f"{MARK}{_caption(legs, largest)}</body>")


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
    if not path.exists():
        return
    # A pipe or device may never end.
    if not path.is_file() or MARK not in path.read_text("utf-8", "replace"):
        raise OutputError(f"--out {path}: exists and is no page of kneexo view; choose another")


def write_page(path: Path, page: str) -> None:
    """Write a page in the place of an earlier one; `OutputError` where that cannot be."""
    require_page(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=path.parent, prefix=".kneexo-view-") as folder:
            whole = Path(folder, path.name)
            whole.write_text(page, encoding="utf-8")
            os.replace(whole, path)
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"--out {path}: cannot write there ({reason})") from None


def _record(meshcat: Meshcat, path: str, leg: Leg, depth: float, largest: float) -> None:
    times = np.arange(0.0, leg.time_s[-1] + 0.5 / FRAMES_PER_S, 1.0 / FRAMES_PER_S)
    angle, reference, pressure = (
        np.interp(times, leg.time_s, values)
        for values in (leg.knee_angle_rad, leg.reference_rad, leg.pressure_pa)
    )
    now, wanted = points(leg.linkage, angle), points(leg.linkage, reference)
    for name, bar in BARS.items():
        _bar(meshcat, f"{path}/{name}", bar, now, times, depth)
    for name in GHOST:
        _bar(meshcat, f"{path}/reference_{name}", BARS[name], wanted, times, depth, ghost=True)
    for name in (*PINS, "icr"):
        colour = Rgba(0.8, 0.0, 0.5) if name == "icr" else Rgba(0.15, 0.15, 0.18)
        meshcat.SetObject(f"{path}/pin_{name}", PIN, colour)
        for time, point in zip(times.tolist(), now[name].tolist(), strict=True):
            place = RigidTransform(_ACROSS, _world(point, depth))
            meshcat.SetTransform(f"{path}/pin_{name}", place, time_in_recording=time)
    sweep = np.radians(np.linspace(0.0, 90.0, 91))
    trail = np.array([_world(point, depth) for point in points(leg.linkage, sweep)["icr"]])
    meshcat.SetLine(f"{path}/icr_path", trail.T, 2.0, Rgba(0.8, 0.0, 0.5))
    for time, colour in zip(times.tolist(), pressure_colours(pressure, largest), strict=True):
        meshcat.SetProperty(
            f"{path}/cylinder/<object>", "color", [*colour.tolist(), 1.0], time_in_recording=time
        )


def _bar(
    meshcat: Meshcat,
    path: str,
    bar: Bar,
    at: dict[str, Points],
    times: Array,
    depth: float,
    *,
    ghost: bool = False,
) -> None:
    start, end = at[bar.start], at[bar.end]
    colour = Rgba(0.35, 0.35, 0.35, 0.35) if ghost else Rgba(*bar.colour)
    radius = bar.radius_m * (0.85 if ghost else 1.0)  # hidden within what it agrees with
    meshcat.SetObject(path, Cylinder(radius, float(np.abs(end[0] - start[0]))), colour)
    count = 1 if bar.fixed else times.size
    for time, first, last in zip(times[:count].tolist(), start, end, strict=False):
        meshcat.SetTransform(
            path, bar_pose(first, last, depth + bar.layer_m), time_in_recording=time
        )


def _caption(legs: Sequence[Leg], largest: float) -> str:
    names = "".join(f"<li>{html.escape(leg.name)}</li>" for leg in legs)
    if len(legs) > 1:
        names = names.replace("</li>", " (nearest)</li>", 1)
    return (
        '<div style="position:absolute;left:12px;top:8px;font:14px sans-serif;color:#222;'
        'background:rgba(255,255,255,0.8);padding:6px 10px">'
        f'<b>kneexo {__version__}</b><ol style="margin:4px 0 4px -18px">{names}</ol>'
        f"cylinder: load pressure, blue −{largest / 1e6:.3g} MPa … red {largest / 1e6:.3g} MPa"
        "<br>grey shank: reference<br>line: path of the instantaneous centre of rotation</div>"
    )
