"""Renders Jinja2 templates of C code and other text files."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from .printer import comment_lines, literal, plain_line


def rendered(package: str, template: str, **data: Any) -> str:
    """Return a template from the folder ``templates`` of ``package``, filled with ``data``.

    A template can use the filters of Jinja2 and four more: ``cell`` (text in a Markdown table),
    ``comment`` (`comment_lines` as text), ``literal``, and ``quoted`` (a C string literal). Raises
    ``jinja2.UndefinedError`` for a name that ``data`` lacks.
    """
    return _environment(package).get_template(template).render(data)


@cache
def words(package: str, template: str) -> frozenset[str]:
    """Return all words of a template, so that names made from a model do not collide with them."""
    loader = _environment(package).loader
    assert loader is not None
    return frozenset(re.findall(r"\w+", loader.get_source(_environment(package), template)[0]))


@cache
def _environment(package: str) -> Environment:
    environment = Environment(
        loader=PackageLoader(package),
        undefined=StrictUndefined,  # else a misspelt name would be an empty text
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # C is no HTML
    )
    environment.filters["comment"] = _comment
    environment.filters["cell"] = _cell
    environment.filters["literal"] = literal
    environment.filters["quoted"] = _quoted
    return environment


def _quoted(text: str) -> str:
    """Return a C string literal; special characters of C or printf and non-ASCII become ``_``."""
    return '"' + re.sub(r'[^ -~]|[\\"%?]', "_", text) + '"'


def _cell(text: str) -> str:
    """Return the text as a cell of a Markdown table."""
    return plain_line(text).replace("|", "/").replace("<", "&lt;")


def _comment(text: str, indent: str = "") -> str:
    return "\n".join(comment_lines(text, indent))
