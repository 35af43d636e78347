"""Assembles a self-contained web page with a strict security policy and without network."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from kneexo.errors import OutputError, shown

_LICENCES = {
    "view/web/vendor/three.min.js": "view/web/vendor/three.LICENSE.txt",
    "view/web/vendor/uPlot.iife.min.js": "view/web/vendor/uPlot.LICENSE.txt",
}


def web_text(name: str) -> str:
    """Return the text of a file in the package ``kneexo``, such as ``view/web/stage.js``.

    The text of a vendored library, such as three.js, begins with the library's licence as a
    comment.
    """
    folder = resources.files("kneexo")
    text = (folder / name).read_text(encoding="utf-8")
    if name in _LICENCES:
        licence = (folder / _LICENCES[name]).read_text(encoding="utf-8")
        text = f"/*!\n{licence.strip()}\n*/\n{text}"
    return text


def require_page_name(path: Path) -> None:
    """Raise `OutputError` unless the name of a page ends in .html or .htm.

    A misspelt name therefore cannot replace a file that is no page.
    """
    if path.suffix not in (".html", ".htm"):
        raise OutputError(f"{shown(path)}: the name of a page must end in .html")


def self_contained_page(
    title: str,
    body_html: str,
    styles: Sequence[str],
    scripts: Sequence[str],
    data: Mapping[str, Any],
    *,
    worker: str | None = None,
    wasm: bool = False,
) -> str:
    """Return an HTML page that needs no other file.

    The page allows only the given styles and scripts, by their hashes. It allows no connection, and
    no style or handler in attributes of ``body_html``.

    Parameters
    ----------
    title
        Plain text.
    body_html
        HTML of the page's body. The caller escapes texts that come from the user, such as names of
        files and scenarios.
    styles, scripts
        Texts of style sheets and classic scripts. The scripts run in this order, after the body
        exists.
    data
        Dictionary from the ``id`` of an element to JSON data. A script reads the data by
        ``JSON.parse(document.getElementById(id).textContent)``.
    worker
        Text of the script of a web worker, or None for a page without worker. The page holds the
        text as JSON in the element with the id ``worker``, so ``data`` must not use this id. A
        script of ``scripts`` makes a data URL of the text and starts the worker.
    wasm
        Whether scripts and worker may compile WebAssembly.

    Raises
    ------
    ValueError
        A script or style contains the end tag of its element or ``<!--``, or ``data`` contains a
        number that is not finite.
    """
    styles = [_as_parsed(text, "style") for text in styles]
    scripts = [_as_parsed(text, "script") for text in scripts]
    elements = dict(data) | ({} if worker is None else {"worker": worker})
    head = "".join(f"<style>{text}</style>\n" for text in styles)
    blocks = [
        f'<script type="application/json" id="{html.escape(name)}">{_json(value)}</script>'
        for name, value in elements.items()
    ]
    blocks += [f"<script>{text}</script>" for text in scripts]
    page = f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_policy(styles, scripts, worker, wasm)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title>
{head}</head>
<body>
{body_html}
{chr(10).join(blocks)}
</body>
</html>
"""
    return page.encode("utf-8", "replace").decode()  # names of files may have bytes without a text


def _as_parsed(text: str, element: str) -> str:
    """Return a script or style as a browser reads it, so that the hash in the policy fits.

    A browser replaces the line ends ``\\r\\n`` and ``\\r`` by ``\\n``. Raises `ValueError` if
    ``text`` would end its ``element``, ``script`` or ``style``, too early.
    """
    if f"</{element}" in text.lower() or "<!--" in text:
        raise ValueError(f"a {element} must not contain </{element} or <!--")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _policy(styles: Sequence[str], scripts: Sequence[str], worker: str | None, wasm: bool) -> str:
    """Return the content security policy that allows these texts and nothing else."""
    script_sources = [*map(_hash, scripts), *(["'wasm-unsafe-eval'"] if wasm else [])]
    # Hashes in place of 'unsafe-inline': a name of a file or scenario that came into the page as a
    # script would not run.
    rules = {
        "default-src": ["'none'"],
        "script-src": script_sources or ["'none'"],
        "style-src": [*map(_hash, styles)] or ["'none'"],
        # Figures of a report are img elements with data URLs. No page of kneexo has an image with a
        # blob URL. Both kinds of URL lead into the page itself, so neither allows a connection.
        "img-src": ["data:", "blob:"],
        # Notebooks in VS Code allow workers from data URLs only.
        "worker-src": ["'none'"] if worker is None else ["data:"],
        "base-uri": ["'none'"],
        "form-action": ["'none'"],
    }
    return "; ".join(f"{rule} {' '.join(sources)}" for rule, sources in rules.items())


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8", "replace")).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def _json(value: Any) -> str:
    """Return JSON that is also safe as the text of a script element."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
