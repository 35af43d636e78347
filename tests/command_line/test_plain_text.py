"""Reports as plain text: lines of at most 100 columns, whatever the terminal."""

import pytest

from kneexo.command_line.plain_text import head_of, plain_text

REPORT = """# A title

- {words} end
- **bold** `code`, \\|s\\| < 1, [a link](https://a.org), :smile: and [brackets]

| a | {words} |
| --- | --- |
| 1 | x |

![](picture.png)

The last line.

## Next

Not printed.
"""
WORDS = "word " * 20
REPORT = REPORT.format(words=WORDS.strip())
TEXT = f"""A title
• {WORDS} end
• bold code, |s| < 1, a link (https://a.org), :smile: and [brackets]
a {WORDS}
1 x
The last line.
"""


@pytest.mark.parametrize(
    "environment",
    [{"COLUMNS": "140"}, {"FORCE_COLOR": "1", "TERM": "xterm-256color"}, {"NO_COLOR": "1"}],
)
def test_the_text_is_the_same_for_each_terminal(monkeypatch, environment):
    text = plain_text(head_of(REPORT))
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert plain_text(head_of(REPORT)) == text


@pytest.mark.parametrize("columns", [80, 100])
def test_the_text_has_all_words_in_lines_of_the_terminal(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    text = plain_text(head_of(REPORT))
    # Versions of rich differ in indentation and in where they break a cell of a table.
    words = [word for word in text.split() if not set(word) <= set("─━")]
    assert sorted(words) == sorted(TEXT.split())
    assert columns - 10 < max(len(line) for line in text.splitlines()) <= columns


def test_a_report_without_sections_is_its_head():
    assert head_of("# a\n\nb\n") == "# a\n\nb\n"
