"""Adds a drawing of the mechanism to parameters that a notebook shows."""

from __future__ import annotations

import sys
from html import escape
from operator import attrgetter
from typing import Any

LINKAGES = {
    ("kneexo.parameters.scenario", "Scenario"): "plant.linkage",
    ("kneexo.parameters.device.plant", "PlantParameters"): "linkage",
    ("kneexo.parameters.device.linkages", "LinkageParameters"): "",
}
"""Module and name of each class with a drawing, and the path from the class to its linkage."""


def register() -> None:
    """Let the running IPython show parameters as HTML with a drawing.

    Without a running IPython this function does nothing. The classes are registered by name, so
    that their modules are not imported.
    """
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None or shell.display_formatter is None:
        return
    formatter = shell.display_formatter.formatters["text/html"]
    for (module, name), path in LINKAGES.items():
        formatter.for_type_by_name(module, name, _shown_with(path))


def _shown_with(path: str) -> Any:
    def html(parameters: Any) -> str:
        return parameters_html(parameters, attrgetter(path)(parameters) if path else parameters)

    return html


def parameters_html(parameters: Any, linkage: Any) -> str:
    """Return HTML: a drawing of the linkage, and below the drawing the text of the parameters.

    If the linkage cannot be assembled, the reason takes the place of the drawing.
    """
    from kneexo.errors import LinkageError
    from kneexo.view.drawing import mechanism_svg

    try:
        drawing = mechanism_svg(linkage)
    except LinkageError as error:
        drawing = f"<p>No drawing: {escape(str(error))}</p>"
    return (
        f'<figure style="margin: 0">{drawing}<figcaption><pre style="white-space: pre-wrap">'
        f"{escape(repr(parameters))}</pre></figcaption></figure>"
    )
