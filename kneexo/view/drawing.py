"""Draws the mechanism of a linkage as SVG, the whole leg beside its joints."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kneexo.geometry.linkage import shank_is_ground
from kneexo.parameters import LinkageParameters
from kneexo.view.mechanism import points

LINKS = {
    "a₁": ("o_a", "o_b", "#555555"),
    "a₂": ("o_a", "a", "#0072b2"),
    "a₃": ("a", "b", "#007a5a"),
    "a₄": ("o_b", "b", "#c04a00"),
}
"""Both joints and the colour of each link, as in Lee et al. 2020, Fig. 3."""

JOINTS = {"o_a": ("O", "A"), "o_b": ("O", "B"), "a": ("A", ""), "b": ("B", "")}
"""Letter and index of each joint as in the paper."""

WIDTH, HEIGHT = 640, 440
"""Size of the drawing in CSS pixels."""

_LIMB, _STEEL, _INK, _CENTRE = "#d9cba8", "#8a8f98", "#1a1a1a", "#a0005a"


@dataclass(frozen=True)
class _Panel:
    """A rectangle of the drawing in CSS pixels that shows a region of the knee's plane."""

    left: float
    top: float
    width: float
    height: float
    middle: complex
    """Point in the knee's plane that is in the middle of the rectangle, in m."""
    scale: float
    """CSS pixels for each m."""

    @classmethod
    def around(
        cls, rectangle: tuple[float, float, float, float], shown: Iterable[complex]
    ) -> _Panel:
        """Return a panel that shows all points of ``shown``, with a margin around them."""
        values = np.array(list(shown))
        low = complex(values.real.min(), values.imag.min())
        high = complex(values.real.max(), values.imag.max())
        _, _, width, height = rectangle
        size = high - low
        scale = 0.82 * min(width / max(size.real, 1e-3), height / max(size.imag, 1e-3))
        return cls(*rectangle, 0.5 * (low + high), scale)

    def at(self, point: complex) -> tuple[float, float]:
        """Return the place of a point of the knee's plane in CSS pixels."""
        offset = self.scale * (point - self.middle)
        return (
            self.left + 0.5 * self.width + offset.real,
            self.top + 0.5 * self.height - offset.imag,
        )

    def contains(self, point: complex) -> bool:
        """Return whether the panel shows a point."""
        x, y = self.at(point)
        return 0.0 <= x - self.left <= self.width and 0.0 <= y - self.top <= self.height

    def bar(self, start: complex, end: complex, colour: str, width: float, name: str = "") -> str:
        """Return a line between two points. ``name`` is the name of the part for the page."""
        (x1, y1), (x2, y2) = self.at(start), self.at(end)
        part = f' data-part="{name}"' if name else ""
        return (
            f'<line{part} x1="{x1:.2f}" y1="{y1:.2f}" x2="{x2:.2f}" y2="{y2:.2f}" '
            f'stroke="{colour}" stroke-width="{width}" stroke-linecap="round"/>'
        )

    def pin(self, point: complex, radius: float, name: str) -> str:
        """Return a circle for a joint."""
        x, y = self.at(point)
        return (
            f'<circle data-part="{name}" cx="{x:.2f}" cy="{y:.2f}" r="{radius}" fill="white" '
            f'stroke="{_INK}" stroke-width="1.5"/>'
        )

    def label(self, point: complex, text: str, dx: float, dy: float, anchor: str = "middle") -> str:
        """Return a text beside a point, at a distance in CSS pixels."""
        x, y = self.at(point)
        return _text(x + dx, y + dy, text, anchor)

    def scale_bar(self) -> str:
        """Return a scale bar: a line of a round length, with this length in mm."""
        longest_mm = 1e3 * 0.3 * self.width / self.scale
        power = 10.0 ** math.floor(math.log10(longest_mm))
        length_mm = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= longest_mm)
        x, y = self.left + 20.0, self.top + self.height + 12.0
        end = x + 1e-3 * length_mm * self.scale
        return (
            f'<path data-part="scale" d="M{x:.2f} {y - 4:.2f}v8M{x:.2f} {y:.2f}H{end:.2f}m0 -4v8" '
            f'stroke="{_INK}" fill="none"/>' + _text(x, y - 9.0, f"{length_mm:g} mm", "start")
        )


def mechanism_svg(linkage: LinkageParameters, knee_angle_deg: float = 35.0) -> str:
    """Return an SVG drawing of a linkage, as text of an element that needs no other file.

    The left half shows thigh, shank, foot, cylinder and rod. The right half shows the four links
    with their lengths, the joints and the instantaneous centre of rotation (ICR), if the ICR lies
    in this half. `kneexo.view.mechanism.points` gives all positions. Each half has a scale bar.

    ``knee_angle_deg`` is the flexion in deg. Raises `LinkageError` if the linkage cannot be
    assembled at this angle.
    """
    at = {name: complex(p[0]) for name, p in points(linkage, math.radians(knee_angle_deg)).items()}
    title = f"Four-bar knee, flexed by {knee_angle_deg:g}°"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
        f'role="img" aria-label="{title}" font-family="sans-serif" font-size="13" '
        f'style="max-width: 100%; height: auto"><title>{title}</title>'
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="6" fill="white"/>'
        + _text(14, 24, title, "start")
        + "".join(_leg(at))
        + "".join(_joints(at))
        + "".join(_key(at, _limbs(linkage)))
        + "</svg>"
    )


def _leg(at: dict[str, complex]) -> Iterable[str]:
    """Yield the elements of the left half, the whole leg."""
    panel = _Panel.around((0, 34, 300, HEIGHT - 58), at.values())
    for start, end, colour, width, name in (
        ("hip", "thigh_end", _LIMB, 18, "thigh"),
        ("shank_start", "ankle", _LIMB, 18, "shank"),
        ("ankle", "toe", _LIMB, 14, "foot"),
        ("thigh_axis", "thigh_pin", _STEEL, 3, ""),
        ("shank_axis", "shank_pin", _STEEL, 3, ""),
        ("rod_start", "rod_pin", _INK, 3, "rod"),
        ("cylinder_pin", "cylinder_end", _STEEL, 11, "cylinder"),
    ):
        yield panel.bar(at[start], at[end], colour, width, name)
    for start, end, colour in LINKS.values():
        yield panel.bar(at[start], at[end], colour, 3)
    for name in ("cylinder_pin", "rod_pin"):
        yield panel.pin(at[name], 4, name)
    for name, start, end, side in (
        ("thigh", "hip", "thigh_end", 1),
        ("shank", "shank_start", "ankle", 1),
        ("cylinder", "cylinder_pin", "cylinder_end", -1),
        ("rod", "cylinder_end", "rod_pin", -1),
    ):
        normal = 1j * (at[end] - at[start]) / abs(at[end] - at[start])
        forwards = normal if normal.real > -1e-9 else -normal
        offset = 16.0 * side * forwards
        anchor = "start" if side > 0 else "end"
        yield panel.label(0.5 * (at[start] + at[end]), name, offset.real, 4 - offset.imag, anchor)
    yield panel.scale_bar()


def _joints(at: dict[str, complex]) -> Iterable[str]:
    """Yield the elements of the right half, the four links."""
    joints = [at[name] for name in JOINTS]
    panel = _Panel.around((310, 34, 320, HEIGHT - 196), joints)
    middle = sum(joints) / len(joints)
    for name, (start, end, colour) in LINKS.items():
        yield panel.bar(at[start], at[end], colour, 7, name)
    for name, (letter, index) in JOINTS.items():
        yield panel.pin(at[name], 6, name)
        away = at[name] - middle
        away *= 20.0 / max(abs(away), 1e-9)
        yield panel.label(at[name], f"{letter}{_index(index)}", away.real, 5 - away.imag)
    inside = panel.contains(at["icr"])
    if inside:
        yield _cross(*panel.at(at["icr"]))
    yield panel.scale_bar()
    centre = f"centre of rotation (ICR){'' if inside else ', outside'}"
    yield _cross(341, HEIGHT - 20.0) + _text(366, HEIGHT - 16.0, centre, "start")


def _limbs(linkage: LinkageParameters) -> dict[str, str]:
    """Return the limb that carries link a₁ and the limb that carries link a₃."""
    limbs = ("shank", "thigh") if shank_is_ground(linkage) else ("thigh", "shank")
    return dict(zip(("a₁", "a₃"), limbs, strict=True))


def _key(at: dict[str, complex], limbs: dict[str, str]) -> Iterable[str]:
    """Yield the key of the four links with their lengths."""
    for row, (name, (start, end, colour)) in enumerate(LINKS.items()):
        y = HEIGHT - 96.0 + 20.0 * row
        ends = " – ".join(f"{JOINTS[j][0]}{_index(JOINTS[j][1])}" for j in (start, end))
        limb = f", on the {limbs[name]}" if name in limbs else ""
        length_mm = 1e3 * abs(at[end] - at[start])
        yield (
            f'<path d="M330 {y - 4:.1f}h22" stroke="{colour}" stroke-width="7" '
            f'stroke-linecap="round"/>'
        )
        yield _text(366, y, f"{name}  {ends}  {length_mm:.1f} mm{limb}", "start")


def _cross(x: float, y: float) -> str:
    """Return the mark of the instantaneous centre of rotation."""
    return (
        f'<path data-part="icr" d="M{x - 7:.2f} {y:.2f}h14M{x:.2f} {y - 7:.2f}v14" '
        f'stroke="{_CENTRE}" stroke-width="2.5"/>'
    )


def _index(text: str) -> str:
    """Return a text as an index below the line. The empty text remains empty."""
    lowered = f'<tspan dy="3" font-size="9">{text}</tspan><tspan dy="-3">&#8203;</tspan>'
    return lowered if text else ""


def _text(x: float, y: float, text: str, anchor: str) -> str:
    """Return a text with a white rim, which keeps it legible on a line."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{_INK}" stroke="white" '
        f'stroke-width="3" paint-order="stroke">{text}</text>'
    )
