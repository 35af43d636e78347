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
TEXT = """A title

 • word word word word word word word word word word word word word word word word word word word
   word end
 • bold code, |s| < 1, a link (https://a.org), :smile: and [brackets]

    word word word word word word word word word word word word word word word word word word word
 a  word
 ──────────────────────────────────────────────────────────────────────────────────────────────────
 1  x

The last line.
"""


@pytest.mark.parametrize(
    "environment",
    [{}, {"COLUMNS": "40"}, {"FORCE_COLOR": "1", "TERM": "xterm-256color"}, {"NO_COLOR": "1"}],
)
def test_the_text_is_the_same_for_each_terminal(monkeypatch, environment):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert plain_text(head_of(REPORT.format(words=" ".join(["word"] * 20)))) == TEXT


def test_a_report_without_sections_is_its_head():
    assert head_of("# a\n\nb\n") == "# a\n\nb\n"
