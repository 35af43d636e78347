"""The chapter for diagrams: its examples run in their order and print what the page shows."""

import re
import shutil
from pathlib import Path

import pytest

import diagramc

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "diagram_examples.md").read_text(encoding="utf-8")
FIRST_PAGE = (DOCS / "compile_your_diagram.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (\d+)\. [^\n]*\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE))
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


def blocks(language, text):
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def require_alike(printed, shown):
    """The words are equal, and a number differs by one in its last digit at most."""
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown)
    for number, expected in zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True):
        digits = len(expected.partition(".")[2])
        assert abs(float(number) - float(expected)) <= 1.01 * (digits > 0) * 10.0**-digits


def test_a_number_may_be_rounded_otherwise_and_nothing_else():
    require_alike("at 1.24 Hz: 3\n", "at 1.25 Hz: 3\n")
    for printed in ("at 1.23 Hz: 3\n", "at 1.25 Hz: 4\n", "at 1.25 s: 3\n", "at 1.25 Hz\n"):
        with pytest.raises(AssertionError):
            require_alike(printed, "at 1.25 Hz: 3\n")


@pytest.mark.parametrize(
    "numbers",
    [
        "123",
        pytest.param(
            [*SECTIONS],
            marks=[
                pytest.mark.slow,
                pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler"),
            ],
        ),
    ],
)
def test_the_examples_print_what_the_page_shows(numbers, tmp_path, monkeypatch, capsys):
    if "6" in numbers:
        pytest.importorskip("fmpy")
    monkeypatch.chdir(tmp_path)
    names = {}
    for number in numbers:
        (code,), (shown,) = (blocks(kind, SECTIONS[number]) for kind in ("python", "text"))
        exec(compile(code, f"example {number}", "exec"), names)
        require_alike(capsys.readouterr().out, shown)
        assert NUMBER.search(shown)


@pytest.mark.parametrize(
    "index",
    [
        pytest.param(0, marks=pytest.mark.slow, id="a pendulum"),
        pytest.param(1, id="a MultibodyPlant"),
        pytest.param(2, id="a fit"),
        pytest.param(3, id="a test of a leaf"),
        pytest.param(4, id="a failed run"),
    ],
)
def test_the_examples_of_the_first_page_print_what_it_shows(index, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    codes, texts = (blocks(kind, FIRST_PAGE) for kind in ("python", "text"))
    assert len(codes) == len(texts) == 5
    exec(compile(codes[index], "an example", "exec"), {"__name__": __name__})
    require_alike(capsys.readouterr().out, texts[index])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*an absolute value is at its corner")
def test_the_page_of_the_systems_prints_what_it_shows(capsys):
    text = (DOCS / "drake_systems.md").read_text(encoding="utf-8")
    names = {"__name__": __name__}  # TemplateSystem asks for the module of its caller
    pairs = re.findall(
        r"^```python\n(.*?)^```(?:\n\n```text\n(.*?)^```)?", text, re.DOTALL | re.MULTILINE
    )
    assert len(pairs) == 7
    for code, shown in pairs:
        exec(compile(code, "an example", "exec"), names)
        require_alike(capsys.readouterr().out, shown)


def test_each_name_of_the_chapter_is_a_name_of_the_compiler():
    rows = re.findall(
        r"^\|[^|]+\| (`[^|]+) \|", FIRST_PAGE.partition("## Install")[0], re.MULTILINE
    )
    names = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert len(names) > 8
    assert [n for n in names if n not in {*diagramc.__all__, "simulate_batch"}] == []
    sections = re.findall(r"diagram_examples\.md#(\d+)", FIRST_PAGE)
    assert {*sections} == {*SECTIONS}
