"""Fills the Jinja templates of the studies' reports, which lie in the studies' folders."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from kneexo.studies.markdown import column_table, markdown_table, number, percent, row_table

_WRAPPED = re.compile(r"(?<=[^\n])\n *(?=[^\s|>#-]|-\d)")
"""Pattern of a line break inside a paragraph, which `filled` replaces by a space.

A line that begins with a negative number is no item of a list.
"""


def _lines(table: Callable[..., list[str]]) -> Callable[..., str]:
    return lambda *arguments: "\n".join(table(*arguments))


def _form(value: Any, form: str) -> str:
    return number(value, form) if isinstance(value, float) else f"{value:{form}}"


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"form": _form, "number": number, "percent": percent}
    environment.filters["numbers"] = lambda values: ", ".join(map(number, values))
    tables: Iterable[Callable[..., list[str]]] = (column_table, markdown_table, row_table)
    environment.globals |= {table.__name__: _lines(table) for table in tables}
    return environment


_ENVIRONMENT = _environment()


def filled(template: str, **data: Any) -> str:
    """Fill a template of a study with ``data`` and return its text.

    ``template`` is a path such as ``size/report.md``. Each paragraph becomes one line, and several
    empty lines become one. A template can use the tables of `kneexo.studies.markdown` and four
    filters: ``number`` and ``percent`` format a number, ``numbers`` formats a sequence, and
    ``form`` applies a format specification. Raises `jinja2.UndefinedError` for a name that
    ``data`` lacks.
    """
    text = _ENVIRONMENT.get_template(template).render(data)
    return _WRAPPED.sub(" ", re.sub(r"\n{3,}", "\n\n", text)).strip() + "\n"
