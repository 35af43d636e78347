"""Reports in Markdown as plain text for a terminal."""

from __future__ import annotations

import io
import re

from kneexo.common.progress import line_width


def plain_text(markdown: str) -> str:
    """Return Markdown as plain text: paragraphs, lists and tables in lines of `line_width`.

    Pictures are left out. A word longer than a line, such as a path, is broken.
    """
    from rich.console import Console
    from rich.markdown import Markdown

    stream = io.StringIO()
    console = Console(file=stream, width=line_width(), color_system=None, force_terminal=False)
    markdown = re.sub(r"^!\[\]\(.*\)$", "", markdown, flags=re.MULTILINE)
    title, _, body = markdown.removeprefix("# ").partition("\n")
    console.print(Markdown(body, hyperlinks=False))
    lines = (line.rstrip() for line in stream.getvalue().splitlines())
    text = re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip("\n")
    return f"{title}\n\n{text}\n"


def head_of(report: str) -> str:
    """Return title and findings of a report: all before the first heading below the title."""
    return report.partition("\n## ")[0]
