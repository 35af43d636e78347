"""A report as one HTML page: text, tables, pictures as SVG, and what it was computed from.

A page of `kneexo.view` lies within it compressed; a button opens it.
"""

from __future__ import annotations

import base64
import gzip
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
figure label { display: block; overflow-x: auto; cursor: zoom-in; }
figure svg { display: block; max-width: 100%; height: auto; }
figure input { position: absolute; opacity: 0; }
figure input:checked + svg { width: 90rem; max-width: none; cursor: zoom-out; }
figure input:focus-visible + svg { outline: 2px solid #1a6fb5; }
.view button { font: inherit; padding: 0.5rem 1rem; }
.view iframe { width: 100%; height: 70vh; border: 1px solid #d0d4d9; }
figcaption { color: #5a6069; font-size: 0.85rem; }
pre { overflow-x: auto; background: #f4f5f7; padding: 0.7rem; font-size: 0.85rem; }
footer { color: #5a6069; border-top: 1px solid #d0d4d9; margin-top: 2rem; }
@media screen and (pointer: coarse) { figcaption::after { content: " (tap to enlarge)"; } }
@media print {
  body { max-width: none; padding: 0; font-size: 11pt; }
  table { font-size: 7.5pt; }
  th, td { padding: 0.2rem 0.4rem; }
  .scroll, figure label { overflow: visible; }
  details, .view { display: none; }
  figure, tr { break-inside: avoid; }
  figure input:checked + svg { width: 100%; }
}
"""

_VIEW_SCRIPT = """
const section = document.querySelector(".view"), button = section.querySelector("button");
button.hidden = false;
button.onclick = async () => {
  if (!window.DecompressionStream) {
    button.replaceWith("This browser is too old for the view: it lacks DecompressionStream.");
    return;
  }
  const text = atob(document.getElementById("view-data").textContent);
  const bytes = new Blob([Uint8Array.from(text, (letter) => letter.charCodeAt(0))]);
  const page = bytes.stream().pipeThrough(new DecompressionStream("gzip"));
  const frame = document.createElement("iframe");
  frame.title = "The knee in three dimensions";
  frame.srcdoc = await new Response(page).text();
  button.replaceWith(frame);
};
"""


def html_page(
    title: str,
    report: str,
    figures: Mapping[str, Figure],
    origin: Mapping[str, Any],
    view: str = "",
) -> str:
    """One self-contained page.

    ``title``: the command that wrote it. ``report``: Markdown. ``figures`` by name; they stay open.
    ``origin``: version, scenario and settings, as every JSON result begins. ``view``: a whole HTML
    page that a button opens within this one; left out: none.
    """
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(report)
    body = body.replace("<table>", '<div class="scroll"><table>').replace(
        "</table>", "</table></div>"
    )
    if not body.lstrip().startswith("<h1"):
        body = f"<h1>{html.escape(title)}</h1>\n{body}"
    pictures = "\n".join(
        f'<figure><label><input type="checkbox" aria-label="Enlarge {html.escape(name)}">'
        f"{_svg(figure)}</label><figcaption>{html.escape(name)}</figcaption></figure>"
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
{_view(view) if view else ""}
<footer>
<p>kneexo {html.escape(str(origin["kneexo"]))}: <code>{html.escape(title)}</code></p>
<details><summary>Scenario and settings</summary><pre>{html.escape(text)}</pre></details>
</footer>
</body>
</html>
"""


def _view(page: str) -> str:
    """A page that a button unpacks into a frame; without JavaScript a line says what is missing."""
    data = base64.b64encode(gzip.compress(page.encode(), mtime=0)).decode()
    return f"""<section class="view">
<h2>The knee in three dimensions</h2>
<button type="button" hidden>Show the knee move</button>
<noscript>The view needs JavaScript.</noscript>
<script type="application/octet-stream" id="view-data">{data}</script>
<script>{_VIEW_SCRIPT}</script>
</section>"""


def _svg(figure: Figure) -> str:
    """A figure as an SVG element without a date, so that equal figures are equal text."""
    import matplotlib as mpl

    stream = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "kneexo"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
