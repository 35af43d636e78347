"""What a study shows, for every study: its report and its figures of a result that is made up.

``shown/NAME.txt`` has each word and number of them, so that a wrong unit, sign or factor changes a
line of that file. After a change that is meant, ``python tests/studies/test_shown.py`` writes the
files.
"""

import importlib
import re
import sys
from decimal import Decimal
from functools import cache
from itertools import zip_longest
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import ConnectionPatch
from matplotlib.ticker import FixedLocator
from PIL import Image

from kneexo.command_line.output import words_of
from kneexo.studies.catalogue import STUDIES

SHOWN = Path(__file__).with_name("shown")
DOCS = Path(__file__).parents[2] / "docs"
NUMBER = re.compile(r"([-+−]?(?:\d+\.?\d*(?:e[-+]?\d+)?|inf|nan))")
UNIT = re.compile(r"\(([^()]+)\)$")
SUFFIXES = {
    "deg": "_deg",
    "s": "_s",
    "Hz": "_hz",
    "rpm": "_rpm",
    "rpm/sample": "_rpm",
    "rpm per sample": "_rpm",
    "mm/s": "_mm_s",
    "m/s²": "_m_s2",
    "rad/s²": "_rad_s2",
    "deg/s": "_deg_s",
    "L/min": "_l_min",
    "cm³/rev": "_cm3_per_rev",
    "mm²": "_mm2",
    "N": "_n",
    "N·m": "_n_m",
    "N·m/rad": "_n_m_per_rad",
    "MPa": "_mpa",
    "W": "_w",
    "J": "_j",
    "1/s": "_per_s",
}
"""Ends of the names of results by the unit in the heading of a table."""
OTHERS = {
    "the same (rad/s²)",  # only the report has it
    "smallest acceleration limit at the sized flow (rad/s²)",  # its name has no unit
    *("torque (N·m)", "k/Φ (1/s)"),  # keys of the results
    "lag (s)",  # what is uncertain, before numbers of a metric
}
"""Headings whose numbers are no results with this unit in their name."""


@cache
def result_of(name):
    """Return the result of the study that `made_up` makes without a run."""
    return importlib.import_module(f"{name}_cases").made_up()


@cache
def report_of(name):
    return STUDIES[name].presentation().report(result_of(name))


@cache
def figures_of(name):
    return STUDIES[name].presentation().figures(result_of(name))


def numbers_of(data, name=""):
    """Yield the name and the value of each number in nested results. A name has a unit."""
    if isinstance(data, dict):
        for key, value in data.items():
            unit = str(key).endswith(tuple(SUFFIXES.values()))
            yield from numbers_of(value, key if unit else name)
    elif isinstance(data, list | tuple | np.ndarray):
        for value in data:
            yield from numbers_of(value, name)
    elif isinstance(data, int | float | np.number):
        yield name, float(data)


def summary(values):
    """Return an array of numbers as text: its values, or of many values what tells them apart."""
    values = np.ma.filled(np.ma.asarray(values, dtype=float), np.nan).ravel()
    if values.size > 12:
        finite = values[np.isfinite(values)]
        few = (*values[:2], values[-1], finite.min(), finite.max(), finite.mean())
        return f"{values.size} values " + summary(few)
    return " ".join(f"{0.0 if abs(value) < 1e-9 else value:.4g}" for value in values)


def description(figure):
    """Yield lines that say in words and numbers what a figure shows."""
    yield f"caption: {figure.get_label()}"
    for legend in figure.legends:
        yield f"legend: {' | '.join(text.get_text() for text in legend.get_texts())}"
    for ax in figure.axes:
        titles = [ax.get_title(loc=loc) for loc in ("left", "center", "right")]
        yield f"axes: {' | '.join(filter(None, titles))}".rstrip()
        for along in (ax.xaxis, ax.yaxis):
            limits = summary(along.get_view_interval())
            yield f"  {along.axis_name}: {along.get_label_text()}, {along.get_scale()}, {limits}"
            if isinstance(along.get_major_locator(), FixedLocator):
                ticks = [text.get_text() for text in along.get_ticklabels()]
                yield f"    ticks: {' | '.join(ticks)}".replace("\n", " / ").rstrip()
        if legend := ax.get_legend():
            yield f"  legend: {' | '.join(text.get_text() for text in legend.get_texts())}"
        for child in (ax, *ax.child_axes):
            for line in child.lines:
                style = f"{line.get_color()} {line.get_linestyle()} {line.get_marker()}"
                style = re.sub(r"\[.*\]|\(.*\)", "shade", style, flags=re.DOTALL)
                yield f"  line {line.get_label()}, {style}"
                yield f"    x: {summary(line.get_xdata())}"
                yield f"    y: {summary(line.get_ydata())}"
            for drawn in (*child.collections, *child.images):
                if drawn.get_array() is not None:
                    first = summary(drawn.get_cmap()(0.0))
                    yield f"  colours from {first}, limits {summary(drawn.get_clim())}"
                    yield f"    values: {summary(drawn.get_array())}"
                    if hasattr(drawn, "get_coordinates"):
                        for corners in np.moveaxis(drawn.get_coordinates(), -1, 0):
                            yield f"    corners: {summary(corners)}"
                elif hasattr(drawn, "get_segments"):
                    yield f"  bars of errors: {summary(np.ravel(drawn.get_segments()))}"
            for patch in child.patches:
                if isinstance(patch, ConnectionPatch) or patch.get_label() == "_indicate_inset":
                    continue  # frame and lines of an inset, which newer Matplotlib keeps elsewhere
                box = patch.get_extents().transformed(child.transData.inverted())
                yield f"  patch {patch.get_label()}: {summary(np.ravel(box))}"
            for text in child.texts:
                yield f"  text at {summary(text.get_position())}: {text.get_text()}"


def figures_text(name):
    """Return what the figures of a study show, in words and numbers."""
    lines = []
    for title, figure in figures_of(name).items():
        lines += [f"figure {title}", *description(figure), ""]
    return "\n".join(lines).rstrip() + "\n"


def expected(name):
    """Return the report and the text of the figures that the file of a study has."""
    text = (SHOWN / f"{name}.txt").read_text(encoding="utf-8")
    report, first, figures = text.partition("\nfigure ")
    return report, first.lstrip() + figures


def differs(line, expected):
    """Whether two lines differ by more than a unit of the last digit of a number.

    Whole numbers must be equal.
    """
    parts, others = NUMBER.split(line), NUMBER.split(expected)
    if parts[::2] != others[::2]:
        return True
    for part, other in zip(parts[1::2], others[1::2], strict=True):
        if part == other:
            continue
        if not re.search(r"[.e]", part + other) or re.search("inf|nan", part + other):
            return True
        value, close = (Decimal(text.replace("−", "-")) for text in (part, other))
        digit = Decimal(10) ** max(value.as_tuple().exponent, close.as_tuple().exponent)
        if abs(value - close) > digit:
            return True
    return False


@pytest.mark.parametrize("name", STUDIES)
def test_the_report_has_its_words_and_numbers(name):
    assert report_of(name) == expected(name)[0]


@pytest.mark.parametrize("name", STUDIES)
def test_the_figures_have_their_words_and_numbers(name):
    lines = zip_longest(*(t.splitlines() for t in (figures_text(name), expected(name)[1])))
    assert [pair for pair in lines if None in pair or differs(*pair)] == []


def is_shown(cell, values):
    """Whether a cell shows one of the values, to the digits of the cell or to 0.5 %."""
    digit = 10.0 ** Decimal(cell).as_tuple().exponent
    return any(abs(float(cell) - v) <= max(0.51 * digit, 5e-3 * abs(v)) for v in values)


@pytest.mark.parametrize("name", STUDIES)
def test_the_numbers_of_a_unit_are_results_whose_name_ends_in_this_unit(name, tables):
    values = {}
    for key, value in numbers_of(result_of(name).results()):
        values.setdefault(key, []).append(value)
    for table in tables(report_of(name)):
        rows = [row for row in table[1:] if UNIT.search(row[0])]
        for heading, *cells in rows or zip(*table, strict=True):
            unit = UNIT.search(heading)
            if unit and unit[1] in SUFFIXES and heading not in OTHERS:
                numbers = [cell for cell in cells if NUMBER.fullmatch(cell)]
                keys = [key for key in values if key.endswith(SUFFIXES[unit[1]])]
                assert any(all(is_shown(n, values[k]) for n in numbers) for k in keys), heading


@pytest.mark.parametrize("name", STUDIES)
def test_the_screen_has_the_findings(name, check_screen):
    check_screen(report_of(name), most=21)


@pytest.mark.parametrize("name", STUDIES)
def test_each_figure_has_one_place_in_the_report(name):
    places = re.findall(r"^!\[\]\((\w+)\.png\)$", report_of(name), re.MULTILINE)
    assert sorted(places) == sorted(figures_of(name))


def masked(words):
    """Sentences and labels of a figure. Another result has other numbers in them."""
    return {NUMBER.sub("#", words) for words in re.split(r"\n|(?<=\.) ", words)}


@pytest.mark.parametrize("name", STUDIES)
def test_the_docs_show_the_words_and_the_size_of_today(name):
    """A PNG that a command wrote has the words of its figure, also words of its real result."""
    for title, figure in figures_of(name).items():
        if (picture := DOCS / f"{title}.png").exists():
            with Image.open(picture) as image:
                assert masked(words_of(figure)) <= masked(image.info["Description"]), title
                assert image.size == pytest.approx(150.0 * figure.get_size_inches(), abs=1.0)


@pytest.mark.parametrize("name", STUDIES)
def test_each_figure_has_a_caption_and_its_axes_have_labels(name):
    """A caption has sentences and no identifier."""
    for figure in figures_of(name).values():
        caption = figure.get_label()
        assert caption[:1].isupper() or caption[:1] in "ηλΦ"
        assert caption.endswith(".")
        assert "  " not in caption
        assert not re.search(r"[a-z]{2}_[a-z]{2}|[;!]", caption), caption
        assert figure.axes[0].images or any(ax.get_xlabel() for ax in figure.axes)


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_each_figure_can_be_drawn_and_no_legend_hides_another(name):
    for figure in figures_of(name).values():
        figure.canvas.draw()
        legends = [*figure.legends, *(ax.get_legend() for ax in figure.axes if ax.get_legend())]
        boxes = [legend.get_window_extent() for legend in legends]
        for n, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[:n])


if __name__ == "__main__":
    sys.path.append(str(Path(__file__).parents[1] / "shared"))
    SHOWN.mkdir(exist_ok=True)
    for name in STUDIES:
        (SHOWN / f"{name}.txt").write_text(
            f"{report_of(name)}\n{figures_text(name)}", encoding="utf-8"
        )
        plt.close("all")
