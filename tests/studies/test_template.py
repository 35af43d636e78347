"""Templates of reports: wrapped lines, empty blocks, missing names."""

import jinja2
import pytest

from kneexo.studies import template
from kneexo.studies.template import filled


@pytest.fixture
def write(monkeypatch):
    def replace(text):
        environment = template._ENVIRONMENT.overlay(loader=jinja2.DictLoader({"report.md": text}))
        monkeypatch.setattr(template, "_ENVIRONMENT", environment)

    return replace


def test_wrapped_lines_become_one_paragraph(write):
    write("# Title\n\nA sentence\n  in four\nlines of\n-1.5 N.\n\n- an item\nthat goes on\n- one\n")
    assert filled("report.md") == (
        "# Title\n\nA sentence in four lines of -1.5 N.\n\n- an item that goes on\n- one\n"
    )


def test_a_block_that_is_left_out_leaves_one_empty_line(write):
    write("First.\n\n{% if shown %}\nSecond.\n{% endif %}\n\nThird.\n")
    assert filled("report.md", shown=False) == "First.\n\nThird.\n"
    assert filled("report.md", shown=True) == "First.\n\nSecond.\n\nThird.\n"


def test_a_name_without_a_value_is_an_error(write):
    write("{{ missing }}\n")
    with pytest.raises(jinja2.UndefinedError, match="missing"):
        filled("report.md")
