"""The theory page and the drawings: each equation of the paper in its order; the arm."""

import re
from pathlib import Path

import numpy as np
import pytest
from elsewhere import module_of

from kneexo.geometry.linkage import pose
from kneexo.parameters import LINKAGES

DOCS = Path(__file__).parents[1] / "docs"
THEORY = (DOCS / "theory.md").read_text(encoding="utf-8")
FORMULAS = re.findall(r"^\$\$\n(.*?)^\$\$$", THEORY, re.DOTALL | re.MULTILINE)


def test_each_equation_of_the_paper_is_displayed_in_its_order():
    tag = re.compile(r"\\qquad \\text\{\(Eq\. (\d+)\)\}\s*$")
    numbers = [int(match[1]) for formula in FORMULAS if (match := tag.search(formula))]
    assert numbers == list(range(1, 28))


def test_each_section_names_its_code_and_its_test():
    sections = re.split(r"^## ", THEORY, flags=re.MULTILINE)[2:]  # after the table of symbols
    assert len(sections) >= 14
    for section in sections:
        title = section.splitlines()[0]
        assert re.search(r"\]\(\.\./kneexo/[\w/]+\.py\)", section), title
        tests = re.findall(r"\[(test_\w+\.py)\]\(\.\./tests/([\w/]+\.py)\)", section)
        assert tests, title
        assert all(path.endswith(name) for name, path in tests), title


@pytest.mark.parametrize(
    "geometry",
    [name if name == "G1" else pytest.param(name, marks=pytest.mark.slow) for name in LINKAGES],
)
def test_the_drawn_arm_is_the_moment_arm(geometry):
    drawings = module_of("drawings", DOCS / "drawings.py")
    figure = drawings.mechanism(LINKAGES[geometry], 50.0)
    (arm,) = (line for line in figure.axes[0].lines if line.get_gid() == "r")
    length_m = 1e-3 * np.hypot(*np.diff(arm.get_xydata(), axis=0)[0])
    r = pose(LINKAGES[geometry], np.radians(50.0)).moment_arm
    assert length_m == pytest.approx(float(r), rel=1e-9)
