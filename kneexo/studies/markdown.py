"""Numbers and tables of the Markdown reports."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence


def number(value: float, form: str = ".3g") -> str:
    """The number in a form of `format`; a dash where there is none."""
    if math.isnan(value):
        return "–"
    return f"{value:{form}}" if math.isfinite(value) else "∞" if value > 0.0 else "−∞"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
