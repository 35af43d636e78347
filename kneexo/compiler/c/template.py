"""Text files from the templates of a package, by Jinja2."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from .printer import comment_lines, literal


def rendered(package: str, template: str, **data: Any) -> str:
    """Return the text of a template in the folder ``templates`` of a package.

    Besides the filters of Jinja2 a template has ``comment`` (`comment_lines` as text), ``literal``,
    and ``quoted`` (a string of C). Raises ``jinja2.UndefinedError`` for a name that ``data`` lacks.
    """
    return _environment(package).get_template(template).render(data)


@cache
def _environment(package: str) -> Environment:
    environment = Environment(
        loader=PackageLoader(package),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # C is no HTML
    )
    environment.filters["comment"] = _comment
    environment.filters["literal"] = literal
    environment.filters["quoted"] = _quoted
    return environment


def _quoted(text: str) -> str:
    """Return the text as a string of C; characters that mean something to C or printf become _."""
    return '"' + re.sub(r'[^ -~]|[\\"%?]', "_", text) + '"'


def _comment(text: str, indent: str = "") -> str:
    return "\n".join(comment_lines(text, indent))
