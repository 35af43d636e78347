"""Numbers, tables and documents of the Markdown reports."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

Cell = str | tuple[str, str] | Callable[[Any], str]
"""What a column shows of a row: the text at a key, the number at a key in a form, or a function's
text. A key of a row that is no mapping is an attribute."""


def number(value: float, form: str = ".3g") -> str:
    """The number in a form of ``format``; a dash where there is none."""
    if math.isnan(value):
        return "–"
    return f"{value:{form}}" if math.isfinite(value) else "∞" if value > 0.0 else "−∞"


def percent(share: float) -> str:
    """A share in whole percent; a dash where there is none."""
    return "–" if math.isnan(share) else f"{100 * share:.0f} %"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def row_table(rows: Iterable[Any], columns: Mapping[str, Cell]) -> list[str]:
    """Lines of a table with a line for each of ``rows``; ``columns`` by their headings."""
    return markdown_table(
        list(columns), [[_text(row, cell) for cell in columns.values()] for row in rows]
    )


def column_table(heads: Sequence[str], items: Iterable[Any], rows: Mapping[str, Cell]) -> list[str]:
    """Lines of a table with a column for each of ``items``; ``rows`` by their labels."""
    columns = list(items)
    return markdown_table(
        ["", *heads],
        [[label, *(_text(item, cell) for item in columns)] for label, cell in rows.items()],
    )


def _text(row: Any, cell: Cell) -> str:
    if callable(cell):
        return cell(row)
    key, form = (cell, "") if isinstance(cell, str) else cell
    value = row[key] if isinstance(row, Mapping) else getattr(row, key)
    return number(value, form) if form else str(value)


def document(*blocks: str | Iterable[str]) -> str:
    """Paragraphs and lists of lines with an empty line between them; empty ones are left out."""
    texts = [block if isinstance(block, str) else "\n".join(block) for block in blocks]
    return "\n\n".join(filter(None, texts)) + "\n"
