"""Numbers, tables and commands of the Markdown reports."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

Cell = str | tuple[str, str] | Callable[[Any], str]
"""Rule for the text of a table cell, which describes an item (a mapping or an object).

If the rule is a name, the text is the item's value at this key or attribute. Names with dots
between them lead to a value inside a value. If the rule is a pair (name, format), the value is
printed as a number, or in whole percent if the format is ``%``. If the rule is a function, the
function returns the text for the item.
"""


def number(value: float, form: str = ".3g") -> str:
    """Format a number as text, with an exponent only below 1e-4 and from 1e6 on.

    The text is a dash for nan, and ∞ or −∞ for an infinite number.
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0.0 else "−∞"
    text = f"{value or 0:{form}}"  # or 0: no negative zero
    if text.startswith("-") and float(text) == 0.0:  # nor one by rounding
        text = text[1:]
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text


def percent(share: float) -> str:
    """Format a share (0 … 1) in whole percent. The text is a dash for nan."""
    return "–" if math.isnan(share) else f"{100 * share:.0f} %"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table from the headings ``head`` and the texts in ``rows``."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def row_table(rows: Iterable[Any], columns: Mapping[str, Cell]) -> list[str]:
    """Return a Markdown table with a line for each item of ``rows``.

    ``columns`` maps the heading of a column to the `Cell` that takes the text from an item.
    """
    return markdown_table(
        list(columns), [[_text(row, cell) for cell in columns.values()] for row in rows]
    )


def column_table(heads: Sequence[str], items: Iterable[Any], rows: Mapping[str, Cell]) -> list[str]:
    """Return a table with one column for each item. ``rows`` maps a line label to a `Cell` rule."""
    columns = list(items)
    return markdown_table(
        ["", *heads],
        [[label, *(_text(item, cell) for item in columns)] for label, cell in rows.items()],
    )


def _text(row: Any, cell: Cell) -> str:
    if callable(cell):
        return cell(row)
    key, form = (cell, "") if isinstance(cell, str) else cell
    value = row
    for name in key.split("."):
        value = value[name] if isinstance(value, Mapping) else getattr(value, name)
    if form == "%":
        return percent(value)
    return number(value, form) if form else str(value)


def failure_file(number: int) -> str:
    """Return the name of the file of failed run ``number`` of a study, counted from 1."""
    return f"failure_{number}.yaml"


def repeating_commands(errors: Iterable[str]) -> dict[str, str]:
    """Return for each error of a study's failed runs the command that repeats the run, as code."""
    return {
        error: f"`kneexo simulate {failure_file(number)} --out failure_{number}`"
        for number, error in enumerate(errors, start=1)
    }
