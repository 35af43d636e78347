"""Writes a report as one HTML page: text, tables, pictures as SVG, scenario and settings.

The page can hold the stage of `kneexo.view` with moving legs.
"""

from __future__ import annotations

import base64
import html
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kneexo.command_line.request import Request
    from kneexo.view.legs import Motion
    from kneexo.view.page import StageContent

_STYLE = """
:root { color-scheme: light dark; --paper: light-dark(#fff, #14171b);
  --line: light-dark(#d0d4d9, #3a414a); --soft: light-dark(#50565e, #a9b2bd); }
body { font: 16px/1.5 system-ui, sans-serif; color: light-dark(#1c1e21, #e6e9ed); margin: auto;
  background: var(--paper); max-width: 60rem; padding: 1rem; overflow-wrap: break-word; }
h1, h2, h3 { line-height: 1.2; }
.scroll { overflow-x: auto; background:
    linear-gradient(to left, var(--paper) 2rem, transparent) right / 4rem 100% no-repeat local,
    linear-gradient(to left, var(--line), transparent) right / 1rem 100% no-repeat; }
table { border-collapse: collapse; font-size: 0.9rem; margin: 1rem 0; overflow-wrap: normal; }
th, td { border-bottom: 1px solid var(--line); padding: 0.3rem 0.7rem; text-align: left;
  vertical-align: top; }
.number { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: 1.5rem 0; }
figure label { display: block; overflow-x: auto; cursor: zoom-in; }
figure img { display: block; max-width: 100%; height: auto; }
figure input { position: absolute; opacity: 0; }
figure input:checked + img { width: 90rem; max-width: none; cursor: zoom-out; }
figure input:focus-visible + img, .scroll:focus-visible { outline: 2px solid #1a6fb5; }
.view { margin: 2rem 0; }
figcaption { color: var(--soft); font-size: 0.9rem; max-width: 44rem; }
pre { background: light-dark(#f4f5f7, #1d2126); padding: 0.7rem; font-size: 0.85rem;
  white-space: pre-wrap; columns: 22rem; }
footer { border-top: 1px solid var(--line); margin-top: 2rem; }
@media screen and (pointer: coarse) { figcaption::after { content: " (tap to enlarge)"; } }
@media print {
  :root { color-scheme: light; }
  details::details-content { content-visibility: visible; }
  body { max-width: none; padding: 0; font-size: 11pt; }
  h1, h2, h3 { break-after: avoid; }
  table { font-size: 7.5pt; }
  th, td { padding: 0.2rem 0.4rem; }
  .scroll, figure label { overflow: visible; }
  .view { break-inside: avoid; }
  figure, tr { break-inside: avoid; }
  figure img { max-height: 12cm; }
  figure input:checked + img { width: auto; max-width: 100%; }
  pre { font-size: 7pt; columns: 16rem; background: none; padding: 0; }
}
"""


def page_file(
    request: Request,
    report: str,
    figures: Mapping[str, Figure],
    origin: Mapping[str, Any],
    motions: Mapping[str, Motion] | None = None,
) -> dict[str, str]:
    """Return a dictionary from the name of the HTML file of a command to the text of the page.

    For the other parameters see `html_page`.

    Parameters
    ----------
    request
        The command with its arguments. The command names the file. The title of the page has the
        command and the arguments.
    motions
        Dictionary from name to a run that the page shows in three dimensions, or None.
    """
    view = None
    if motions:
        from kneexo.view.legs import Leg
        from kneexo.view.page import MOST_FRAMES_IN_REPORT, stage_content

        legs = [Leg.of_plant(name, *motion) for name, motion in motions.items()]
        view = stage_content(legs, MOST_FRAMES_IN_REPORT)
    return {f"{request.command}.html": html_page(request.title, report, figures, origin, view)}


def html_page(
    title: str,
    report: str,
    figures: Mapping[str, Figure],
    origin: Mapping[str, Any],
    view: StageContent | None = None,
) -> str:
    """Return the text of one self-contained HTML page.

    Parameters
    ----------
    title
        The command that computed the report.
    report
        Text in Markdown, which begins with a title. A paragraph ``![](NAME.png)`` is the place of
        the figure NAME. The titles of its parts become the contents.
    figures
        Dictionary from name to Matplotlib figure. A figure without place comes after the text. The
        figures stay open.
    origin
        The first items of every JSON result: version, scenario and settings.
    view
        Runs that the page shows in three dimensions, or None.
    """
    import yaml
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(report)
    body = re.sub(r"<td>([-+±\d][^<]{0,20})</td>", _number_cell, body)
    body = body.replace("<table>", '<div class="scroll" tabindex="0"><table>').replace(
        "</table>", "</table></div>"
    )
    parts, number = re.findall("<h2>(.*)</h2>", body), itertools.count()
    links = " · ".join(f'<a href="#part-{n}">{part}</a>' for n, part in enumerate(parts))
    body = re.sub("<h2>", lambda _: f'<h2 id="part-{next(number)}">', body)
    body = body.replace("</h1>", f"</h1>\n<nav>{links}</nav>", 1)
    rest = dict(figures)
    place = re.compile(r'<p><img src="(\w+)\.png" alt="" /></p>')
    body = place.sub(lambda found: _picture(found[1], rest.pop(found[1])), body)
    pictures = "\n".join(_picture(name, figure) for name, figure in rest.items())
    inputs = {key: value for key, value in origin.items() if key != "kneexo"}
    text = yaml.dump(inputs, Dumper=_lists_in_lines(), sort_keys=False, allow_unicode=True)
    from kneexo.view.web_page import self_contained_page

    motion = ""
    if view is not None:
        motion = (
            f'<section class="view">\n<h2>The knee in motion</h2>\n{view.body_html}\n</section>'
        )
    whole = f"""<main>
{body}
{pictures}
{motion}
</main>
<footer>
<h2>Scenario and settings</h2>
<p>kneexo {html.escape(str(origin["kneexo"]))}: <code>{html.escape(title)}</code></p>
<details><summary>in YAML</summary><pre>{html.escape(text)}</pre></details>
</footer>"""
    styles, scripts, data = ([], [], {}) if view is None else view[1:]
    return self_contained_page(title, whole, [*styles, _STYLE], scripts, data)


def _number_cell(cell: re.Match[str]) -> str:
    """Return a cell with a number, aligned to the right, with the sign − in place of a hyphen."""
    return f'<td class="number">{cell[1].replace("-", "−")}</td>'


def _lists_in_lines() -> Any:
    """Return a class of PyYAML that writes each list in one line."""
    import yaml

    class Dumper(yaml.SafeDumper):
        """Writes YAML with each list in one line."""

    def listed(dumper: Dumper, values: Sequence[Any]) -> Any:
        return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=True)

    for kind in (list, tuple):
        Dumper.add_representer(kind, listed)
    return Dumper


def _picture(name: str, figure: Figure) -> str:
    """Return an HTML figure with the caption of a Matplotlib figure, else with its ``name``."""
    caption = html.escape(str(figure.get_label()) or name.replace("_", " "))
    from kneexo.command_line.output import svg_text

    label = html.escape(name.replace("_", " "))
    data = base64.b64encode(svg_text(figure).encode()).decode()
    return (
        f'<figure><label><input type="checkbox" aria-label="Enlarge {label}">'
        f'<img src="data:image/svg+xml;base64,{data}" alt="{caption}"></label>'
        f"<figcaption>{caption}</figcaption></figure>"
    )
