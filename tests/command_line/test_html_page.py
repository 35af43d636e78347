"""Reports as HTML pages."""

import base64
import html
import re
import shlex
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.command_line.html_page import html_page
from kneexo.command_line.main import main
from kneexo.version import __version__
from kneexo.view.page import StageContent

VOID = {"meta", "link", "br", "hr", "img", "input", "path", "use"}


class Page(HTMLParser):
    """Cells of all tables, and whether every element is closed in order."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.cells, self.links = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        if tag not in VOID:
            self.open.append(tag)
        self.links += [v for k, v in attributes if k in ("src", "href") and v[:1] != "#"]
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


@pytest.fixture
def figure():
    figure, axes = plt.subplots()
    axes.plot([0, 1], [1, 3], label="speed")
    yield figure
    plt.close(figure)


def test_a_page_has_tables_pictures_and_origin(figure):
    report = "# Title\n\n| a (m) | b |\n|---|---|\n| 1.5 | <x> & y |\n\n## Part\n\nText.\n"
    origin = {"kneexo": "9.9", "scenario": {"plant": {"mass_kg": 1.6}}, "of": "µ", "a": 1}
    text = html_page("kneexo test", report, {"speed_of_walking": figure}, origin)
    page = Page(text)
    assert page.cells == ["a (m)", "b", "1.5", "<x> & y"]
    assert not page.open
    assert [link[:5] for link in page.links] == ["data:"]  # self-contained
    (picture,) = re.findall('src="data:image/svg[+]xml;base64,([^"]*)"', text)
    assert base64.b64decode(picture).startswith(b"<svg")
    assert "<figcaption>speed of walking</figcaption>" in text  # no caption: the name in words
    assert 'alt="speed of walking"' in text
    assert "kneexo 9.9" in text
    assert "mass_kg: 1.6\nof: µ\na: 1\n" in text  # in the order given
    assert 'aria-label="Enlarge speed of walking"' in text
    assert "style=" not in text
    assert "script-src 'none'" in text
    assert text.count("<h1>") == 1
    assert 'name="viewport"' in text


def test_the_caption_of_a_figure_is_below_it_and_its_text_for_screen_readers(figure):
    figure.set_label("The speed <rises> & falls.")
    text = html_page("t", "text", {"a": figure}, {"kneexo": "1"})
    escaped = "The speed &lt;rises&gt; &amp; falls."
    assert f"<figcaption>{escaped}</figcaption>" in text
    assert f'alt="{escaped}"' in text


def test_a_figure_is_at_its_place_in_the_report_or_after_the_text(figure):
    other = plt.figure()
    report = "# Title\n\nFirst.\n\n![](placed.png)\n\nLast.\n"
    text = html_page("t", report, {"unplaced": other, "placed": figure}, {"kneexo": "1"})
    plt.close(other)
    parts = ["First.", "<figcaption>placed", "Last.", "<figcaption>unplaced"]
    assert sorted(parts, key=text.index) == parts
    assert text.count("<figure>") == 2
    assert ".png" not in text


def test_numbers_are_on_the_right_with_the_sign_minus_and_parts_are_contents():
    cells = ("-1.5e-05", "± 0.5", "-1 … -0.5 MPa", "x-1", "2 of the 3 best runs of all")
    report = (
        f"# T\n\n## A & b\n\n| {' | '.join('abcde')} |\n|{'---|' * 5}\n| {' | '.join(cells)} |\n"
    )
    text = html_page("t", f"{report}\n## C\n", {}, {"kneexo": "1"})
    assert re.findall(r"<td(.*?)>(.*)</td>", text) == [
        (' class="number"', "−1.5e−05"),
        (' class="number"', "± 0.5"),
        (' class="number"', "−1 … −0.5 MPa"),
        ("", "x-1"),
        ("", cells[4]),
    ]
    links = re.findall('<a href="#(.*?)">(.*?)</a>', text)
    assert links == re.findall('<h2 id="(.*?)">(.*?)</h2>', text)
    assert [part for _, part in links] == ["A &amp; b", "C"]


def test_html_in_a_report_is_text():
    text = html_page("<t>", "a <script>alert(1)</script>", {}, {"kneexo": "<v>", "a": "<script>"})
    assert "<script>" not in text
    assert f"<title>{html.escape('<t>')}</title>" in text


@pytest.mark.parametrize("command", ["simulate", pytest.param("linearize", marks=pytest.mark.slow)])
def test_html_of_a_command_names_command_and_settings(command, short, tmp_path, capsys, undrawn):
    out = tmp_path / "out"
    changes = ["--preset=bench", "--set=simulation.duration_s=0.25"]
    assert main([command, short, *changes, "--out", str(out), "--html"]) == 0
    text = (out / f"{command}.html").read_text()
    cells = Page(text).cells
    assert cells
    assert not [cell for cell in cells if "_" in cell]  # no identifiers
    assert re.search("duration_s: 0.25", text)
    # the middle of the range that a quarter of the period reaches, 38…40°
    assert ("knee_angle_deg: 39" in text) == (command == "linearize")
    title = html.escape(shlex.join(["kneexo", command, short, *changes]))
    assert f"<title>{title}</title>" in text
    assert f"<p>kneexo {__version__}: <code>{title}</code></p>" in text
    assert len(text) < 3e6


VIEW = StageContent('<p id="stage">legs</p>', ["p { margin: 0; }"], ["var a = 1;"], {"legs": [1]})


def test_a_page_with_moving_legs_holds_the_stage(figure):
    text = html_page("t", "text", {"a": figure}, {"kneexo": "1"}, VIEW)
    assert VIEW.body_html in text
    assert "<style>p { margin: 0; }</style>" in text
    assert "<script>var a = 1;</script>" in text
    assert '<script type="application/json" id="legs">[1]</script>' in text
    assert text == html_page("t", "text", {"a": figure}, {"kneexo": "1"}, VIEW)
    assert "<script" not in html_page("t", "text", {"a": figure}, {"kneexo": "1"})


# -------------------------------------------------------------------------------- browser


def rows_of(report):
    """Rows of the tables of a Markdown report, heads included."""
    return len(re.findall(r"^\|(?! --- )", report, re.MULTILINE))


@pytest.mark.slow(gate=2)
@pytest.mark.parametrize(
    ("command", "report", "figures", "view"),
    [
        (["simulate"], None, 1, True),
        (["linearize"], None, 3, False),
        (["reproduce"], "report.md", 5, True),
        (
            [
                *("study", "bandwidth", "--set", "frequencies_hz=[2, 3, 4]"),
                *("--set", "amplitudes_deg=[1]"),
            ],
            "bandwidth.md",
            3,
            False,
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_browser_shows_a_report(command, report, figures, view, browser, tmp_path):
    out = tmp_path / "out"
    assert main([*command, "--out", str(out), "--html"]) == 0
    (page,) = out.glob("*.html")
    assert page.stat().st_size < 3e6
    for width, phone in ((1200, False), (390, True)):
        browser.open(page, width, 800, phone=phone, motion=view)
        browser.require_width()
        counts = "['.scroll tr', 'figure img'].map((tag) => document.querySelectorAll(tag).length)"
        rows, pictures = browser.evaluate(counts)
        assert pictures == figures
        assert rows == rows_of((out / report).read_text()) if report else rows > 10
        narrow = "[...document.querySelectorAll('img')].map((s) => s.getBoundingClientRect().width)"
        assert all(100.0 < shown <= width for shown in browser.evaluate(narrow))
        browser.evaluate("document.querySelector('figure label').click()")
        assert browser.evaluate(narrow)[0] > 1400.0  # enlarged, and scrolled within its frame
        browser.require_width()
        browser.require_health()
    assert browser.evaluate("document.querySelectorAll('.view').length") == view
    if view:
        browser.evaluate("document.querySelector('.view').scrollIntoView()")
        before, after = browser.views_of_playing()
        assert 0.005 < (after.min(axis=2) < 0.9).mean() < 0.5
        assert (np.abs(after - before).max(axis=2) > 0.1).sum() > 300
        browser.require_health()
        browser.require_width()


@pytest.mark.slow
def test_a_report_on_paper_and_without_javascript(figure, browser, tmp_path):
    table = "| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    page = tmp_path / "page.html"
    note = StageContent("<noscript>needs JavaScript</noscript><p>note</p>", [], [], {})
    page.write_text(html_page("t", table, {"a": figure}, {"kneexo": "1"}, note))
    browser.open(page)
    shown = "(what) => document.querySelector(what).checkVisibility()"
    parts = [".view", "img", "table", "pre"]
    assert browser.evaluate(f"{parts}.map({shown})") == [True, True, True, False]
    browser.emulate(media="print")
    assert browser.evaluate(f"{parts}.map({shown})") == [True, True, True, True]
    browser.emulate()
    browser.require_health()
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(page)
        assert "needs JavaScript" in browser.evaluate("document.body.innerText")
        assert browser.evaluate(f"{parts}.map({shown})") == [True, True, True, False]
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
