"""The drawing is measured as with a ruler, against the lengths of the parameters."""

import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from kneexo.errors import LinkageError
from kneexo.geometry.linkage import rod_extension
from kneexo.parameters import G1, HINGE, LINKAGES
from kneexo.view.drawing import HEIGHT, WIDTH, mechanism_svg

NAME = "{http://www.w3.org/2000/svg}"
ANGLES_DEG = (0.0, 35.0, 90.0)


class Drawing:
    """The elements of a drawing by part; positions in CSS pixels with y up."""

    def __init__(self, link, angle_deg):
        self.root = ET.fromstring(mechanism_svg(link, angle_deg))
        self.parts = {}
        for element in self.root.iter():
            if part := element.get("data-part"):
                self.parts.setdefault(part, []).append(element)
        self.texts = ["".join(element.itertext()) for element in self.root.iter(f"{NAME}text")]

    def ends(self, part):
        (line,) = self.parts[part]
        x1, y1, x2, y2 = (float(line.get(name)) for name in ("x1", "y1", "x2", "y2"))
        return complex(x1, -y1), complex(x2, -y2)

    def pin(self, part):
        (circle,) = self.parts[part]
        return complex(float(circle.get("cx")), -float(circle.get("cy")))

    def mm_per_px(self, half):
        """By the scale bar of the left (0) or the right (1) half."""
        x1, x2 = re.match(
            r".*M([\d.]+) [\d.]+H([\d.]+)", self.parts["scale"][half].get("d")
        ).groups()
        (length,) = re.findall(r"^(\d+) mm$", "\n".join(self.texts), re.MULTILINE)[half : half + 1]
        return float(length) / (float(x2) - float(x1))


@pytest.fixture(params=sorted(LINKAGES))
def link(request):
    return LINKAGES[request.param]


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_links_have_their_lengths_by_the_scale_bar_and_in_the_key(link, angle_deg):
    drawing = Drawing(link, angle_deg)
    key = dict(re.findall(r"^(a.) .* ([\d.]+) mm", "\n".join(drawing.texts), re.MULTILINE))
    ground = math.hypot(link.o_a_x_m - link.o_b_x_m, link.o_a_y_m - link.o_b_y_m)
    lengths = dict(zip("₁₂₃₄", (ground, link.a_2_m, link.a_3_m, link.a_4_m), strict=True))
    for index, length_m in lengths.items():
        start, end = drawing.ends(f"a{index}")
        # Coordinates have two decimals: an error of 0.02 px of the bar and of the link.
        measured = abs(end - start) * drawing.mm_per_px(1)
        assert measured == pytest.approx(1e3 * length_m, rel=0.002)
        assert float(key[f"a{index}"]) == pytest.approx(1e3 * length_m, abs=0.051)


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_the_limbs_make_the_angle_and_the_pins_have_the_distance_of_the_rod(link, angle_deg):
    drawing = Drawing(link, angle_deg)
    thigh, shank = (np.subtract(*drawing.ends(limb)[::-1]) for limb in ("thigh", "shank"))
    flexion = -np.degrees(np.angle(shank / thigh))  # the shank swings back, to the left
    assert flexion == pytest.approx(angle_deg, abs=0.1)
    distance = abs(drawing.pin("rod_pin") - drawing.pin("cylinder_pin")) * drawing.mm_per_px(0)
    length_m = link.rod_length_m + rod_extension(link, math.radians(angle_deg))
    assert distance == pytest.approx(1e3 * length_m, rel=0.002)


def test_the_centre_of_rotation_is_where_the_lines_of_both_links_meet(link):
    drawing = Drawing(link, 90.0)
    ((x, y),) = re.findall(r"M([\d.]+) ([\d.]+)h", drawing.parts["icr"][0].get("d"))
    centre = complex(float(x) + 7.0, -float(y))
    for joint, other in (("o_a", "a"), ("o_b", "b")):
        start, end = drawing.pin(joint), drawing.pin(other)
        along = (end - start) / abs(end - start)
        assert abs(((centre - start) / along).imag) < 0.2  # px


def test_a_centre_outside_the_picture_is_said(link):
    drawings = [Drawing(link, angle) for angle in np.linspace(0.0, 90.0, 19)]
    for drawing in drawings:
        outside = any(text.endswith("(ICR), outside") for text in drawing.texts)
        assert outside == (len(drawing.parts["icr"]) == 1)  # the key alone has a mark
    outside_at_times = link != HINGE  # a hinge turns about its drawn axis
    assert len({len(drawing.parts["icr"]) for drawing in drawings}) == 1 + outside_at_times


def test_the_key_says_which_limb_carries_a_link():
    for name, limbs in {"G1": ("shank", "thigh"), "G2": ("thigh", "shank")}.items():
        texts = "\n".join(Drawing(LINKAGES[name], 35.0).texts)
        assert tuple(re.findall(r"^a[₁₃] .*, on the (\w+)$", texts, re.MULTILINE)) == limbs


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_nothing_lies_outside_and_parts_have_names(link, angle_deg):
    drawing = Drawing(link, angle_deg)
    for text in drawing.root.iter(f"{NAME}text"):
        x, y = float(text.get("x")), float(text.get("y"))
        width = 7.5 * len("".join(text.itertext()))  # px, of 13 px letters
        left = x - {"start": 0.0, "middle": 0.5, "end": 1.0}[text.get("text-anchor")] * width
        assert left >= 0.0
        assert left + width <= WIDTH
        assert 13.0 <= y <= HEIGHT
    for line in drawing.root.iter(f"{NAME}line"):
        assert all(0.0 <= float(line.get(name)) <= WIDTH for name in ("x1", "x2"))
        assert all(0.0 <= float(line.get(name)) <= HEIGHT for name in ("y1", "y2"))
    assert {"thigh", "shank", "cylinder", "rod", "A", "B"} <= set(drawing.texts)
    assert drawing.root.get("aria-label") == f"Four-bar knee, flexed by {angle_deg:g}°"


def test_a_linkage_that_cannot_be_assembled_is_refused():
    with pytest.raises(LinkageError, match=r"a_2_m = 0\.3 m and a_4_m"):
        mechanism_svg(G1.changed({"a_2_m": 0.3}))
