"""Reads columns of numbers from a CSV file."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from kneexo.errors import shortened
from kneexo.files.reading import MIB, file_error, read_text

MOST_BYTES_OF_TABLE = 256 * MIB
"""Size in bytes of the largest CSV file that `read_table` accepts."""

NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""Pattern of a decimal number in the digits 0-9. `float` also accepts ``1_0`` and ``nan``."""

_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")


@dataclass(frozen=True)
class Table:
    """Columns of numbers of a CSV file.

    ``lines`` has the line number at which each row starts. ``columns`` maps the name of a column to
    its values, which are finite.
    """

    path: str | os.PathLike[str]
    lines: list[int]
    columns: dict[str, list[float]]

    def require(self, name: str, low: float, high: float, unit: str) -> None:
        """Raise `ScenarioError` if a column has a value outside ``low`` … ``high``, in ``unit``."""
        for line, value in zip(self.lines, self.columns[name], strict=True):
            if not low <= value <= high:
                message = (
                    f"{name} = {value:g} {unit} is out of range: must be >= {low:.6g} and "
                    f"<= {high:.6g} {unit}"
                )
                raise file_error(self.path, line, message)

    def require_increase(self, name: str, step: float, unit: str) -> None:
        """Raise `ScenarioError` if a column rises by less than ``step`` from a row to the next."""
        values = self.columns[name]
        for line, before, value in zip(self.lines[1:], values, values[1:], strict=False):
            if not value - before >= step:
                message = (
                    f"{name} = {value:.10g} {unit} after {before:.10g} {unit}: must increase by at "
                    f"least {step:g} {unit} from row to row"
                )
                raise file_error(self.path, line, message)


def read_table(path: str | os.PathLike[str], names: Sequence[str], remedy: str = "") -> Table:
    """Read columns of a CSV file. The first record of the file has the names of the columns.

    Lines between records are ignored if they are empty or start with ``#``. If the first record has
    no comma, semicolons or else tabs separate the values, and numbers can have a decimal comma.

    Parameters
    ----------
    path
        A regular file of at most 256 MiB in UTF-8.
    names
        Names of the columns to read. Spaces around a name in the file are ignored.
    remedy
        End of the message about a missing column.

    Raises
    ------
    ScenarioError
        The file cannot be read, a record is damaged or too long, a column is missing or occurs
        twice, or a value is no finite number in decimal digits.
    """
    try:
        text = read_text(path, MOST_BYTES_OF_TABLE)
        separator = _separator(text)
        records = _records(path, text, separator)
        _, header = next(records, (0, None))
        if header is None:
            raise file_error(path, None, "is empty; must have a line with the names of columns")
        header = [name.strip() for name in header]
        places = [_place(path, header, name, remedy) for name in names]
        lines: list[int] = []
        values: list[list[float]] = [[] for _ in names]
        for line, row in records:
            if any(field.strip() for field in row[len(header) :]):
                message = f"has {len(row)} values; must have {len(header)}, one of each column"
                raise file_error(path, line, message)
            lines.append(line)
            if separator != ",":
                row = [field.replace(",", ".") for field in row]
            for name, place, column in zip(names, places, values, strict=True):
                column.append(_number(path, line, name, row[place] if place < len(row) else ""))
    except MemoryError:
        message = "cannot be read: has too many rows for the free memory"
        raise file_error(path, None, message) from None
    return Table(path, lines, dict(zip(names, values, strict=True)))


def _separator(text: str) -> str:
    """Return the first of comma, semicolon and tab that the first record has; else a comma."""
    lines = (match[0] for match in _LINE.finditer(text))
    header = next((line for line in lines if not _ignored(line)), "")
    return next((separator for separator in ",;\t" if separator in header), ",")


def _ignored(line: str) -> bool:
    return not line.strip() or line.startswith("#")


def _records(
    path: str | os.PathLike[str], text: str, separator: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield each record with the number of its first line. A quoted field may span lines."""
    count = 0

    def next_lines() -> Iterator[str]:
        nonlocal count
        for match in _LINE.finditer(text):
            count += 1
            yield match[0]

    lines = next_lines()
    for line in lines:
        if _ignored(line):
            continue
        first, rest = count, chain([line], lines)
        try:
            yield (
                first,
                next(csv.reader(rest, delimiter=separator, skipinitialspace=True, strict=True)),
            )
        except csv.Error as error:
            if "unexpected end" in str(error):
                reason = "a quotation mark opens a field that does not end"
            elif "field larger" in str(error):
                reason = f"a field has more than {csv.field_size_limit()} characters"
            else:
                reason = f"{error}"
            raise file_error(path, first, f"{reason}; must be a record of CSV") from None


def _place(path: str | os.PathLike[str], header: list[str], name: str, remedy: str) -> int:
    places = [place for place, other in enumerate(header) if other == name]
    quoted = repr(shortened(name))
    if not places:
        listed = shortened(", ".join(header), 300)
        raise file_error(path, None, f"has no column {quoted}; it has {listed}{remedy}")
    if len(places) > 1:
        message = f"has {len(places)} columns {quoted}; must have one column of this name"
        raise file_error(path, None, message)
    return places[0]


def _number(path: str | os.PathLike[str], line: int, name: str, text: str) -> float:
    text = text.strip(" \t")
    if NUMBER.fullmatch(text) and math.isfinite(value := float(text)):
        return value
    quoted = repr(shortened(text, 60)) if text else "no value"
    message = f"{shortened(name)}: {quoted}; must be a finite number in the digits 0-9"
    raise file_error(path, line, message)
