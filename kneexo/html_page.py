"""A report as one HTML page: text, tables, pictures as SVG, and what it was computed from."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import yaml
from markdown_it import MarkdownIt

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1c1e21; max-width: 60rem; margin: auto;
  padding: 1rem; }
h1, h2, h3 { line-height: 1.2; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.9rem; margin: 1rem 0; }
th, td { border-bottom: 1px solid #d0d4d9; padding: 0.3rem 0.7rem; text-align: left;
  vertical-align: top; }
figure { margin: 1.5rem 0; }
figure svg { width: 100%; height: auto; }
figcaption { color: #5a6069; font-size: 0.85rem; }
pre { overflow-x: auto; background: #f4f5f7; padding: 0.7rem; font-size: 0.85rem; }
footer { color: #5a6069; border-top: 1px solid #d0d4d9; margin-top: 2rem; }
@media print { details { display: none; } figure, tr { break-inside: avoid; } }
"""


def html_page(
    title: str, report: str, figures: Mapping[str, Figure], origin: Mapping[str, Any]
) -> str:
    """One self-contained page.

    ``report``: Markdown. ``figures`` by name; they stay open. ``origin``: version, scenario and
    settings, as every JSON result begins.
    """
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(report)
    body = body.replace("<table>", '<div class="scroll"><table>').replace(
        "</table>", "</table></div>"
    )
    if not body.lstrip().startswith("<h1"):
        body = f"<h1>{html.escape(title)}</h1>\n{body}"
    pictures = "\n".join(
        f"<figure>{_svg(figure)}<figcaption>{html.escape(name)}</figcaption></figure>"
        for name, figure in figures.items()
    )
    given = {key: value for key, value in origin.items() if key != "kneexo"}
    text = yaml.safe_dump(given, sort_keys=False, allow_unicode=True)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
{body}
{pictures}
<footer>
<p>kneexo {html.escape(str(origin["kneexo"]))}</p>
<details><summary>Scenario and settings</summary><pre>{html.escape(text)}</pre></details>
</footer>
</body>
</html>
"""


def _svg(figure: Figure) -> str:
    """A figure as an SVG element without a date, so that equal figures are equal text."""
    import matplotlib as mpl

    stream = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "kneexo"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
