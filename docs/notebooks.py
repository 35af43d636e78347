"""What a tutorial must lose before Jupyter shows it: links and roles of the site."""

from __future__ import annotations

import json
import re
from pathlib import Path

_ITSELF = re.compile(r"\s*[^.]*\{nb-download\}`[^`]*`\.")
_LINK = re.compile(r"\[([^\]]+)\]\(([\w./-]+)\.md(?:#[\w-]+)?\)")


def _target(match: re.Match[str]) -> str:
    """A tutorial lies beside the notebook; of any other page the name is told."""
    text, page = match.groups()
    return (
        f"{text} (page `{page.removeprefix('../')}`)" if "/" in page else f"[{text}]({page}.ipynb)"
    )


def plain_markdown(text: str) -> str:
    """The text of a cell without the roles of MyST and without links to pages of the site."""
    return _LINK.sub(_target, _ITSELF.sub("", text))


def make_plain(notebook: Path) -> None:
    """Rewrite the Markdown cells of a notebook."""
    content = json.loads(notebook.read_text(encoding="utf-8"))
    for cell in content["cells"]:
        if cell["cell_type"] == "markdown":
            text = plain_markdown("".join(cell["source"]))
            cell["source"] = text.splitlines(keepends=True)
    notebook.write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
