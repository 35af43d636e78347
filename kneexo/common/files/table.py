"""Reads columns of numbers from a CSV file, or from a .mot or .sto file of OpenSim."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from kneexo.common.files.reading import MIB, file_error, read_text
from kneexo.errors import close_names, shortened

MOST_BYTES_OF_TABLE = 256 * MIB
"""Size in bytes of the largest CSV file that `read_table` accepts."""

SUFFIXES = (".csv", ".mot", ".sto")
"""Ends of the names of files that `read_table` reads."""

NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""Pattern of a decimal number in the digits 0-9. `float` also accepts ``1_0`` and ``nan``."""

_LINE = re.compile(r"[^\n]*\n|[^\n]+")
_END_OF_OPENSIM_HEADER = re.compile(  # Excel adds a separator for each further column
    r"^[ \t]*endheader[ \t,;]*(?:\n|\Z)", re.IGNORECASE | re.MULTILINE
)
_COMMA_NUMBER = re.compile(r"[-+]?[0-9.]*,[0-9]+(?:[eE][-+]?[0-9]+)?")
_IN_DEGREES = re.compile(r"^[ \t]*inDegrees[ \t]*=[ \t]*(yes|no)\b", re.IGNORECASE | re.MULTILINE)
_NO_ANGLES = ("speeds", "velocities", "accelerations", "errors", "controls", "forces", "powers")
"""Ends of the first lines of OpenSim's files of other quantities, such as ``PositionErrors``.

Their columns have the names of the coordinates too.
"""


@dataclass(frozen=True)
class Table:
    """Columns of numbers of a file.

    ``lines`` has the line number at which each row starts. ``columns`` maps the name of a column to
    its values, which are finite. ``opensim_header`` is the text down to ``endheader`` in a file of
    OpenSim, and empty for any other file.
    """

    path: str | os.PathLike[str]
    lines: list[int]
    columns: dict[str, list[float]]
    opensim_header: str = ""

    def degrees(self, name: str) -> list[float]:
        """Return a column of angles in deg. OpenSim's angles are in rad if ``inDegrees=no``.

        Raises `ScenarioError` if a file of OpenSim has another quantity than coordinates, does not
        state the unit, or has more than 2π rad.
        """
        what = self.opensim_header.partition("\n")[0].strip(" \t,;")
        if what.lower().endswith(_NO_ANGLES):
            message = f"is a file of {shortened(what)}; must be of Coordinates (_Kinematics_q.sto)"
            raise file_error(self.path, 1, message)
        unit = _IN_DEGREES.search(self.opensim_header)
        if self.opensim_header and unit is None:
            message = "lacks the unit of angles; add inDegrees=yes or inDegrees=no above endheader"
            raise file_error(self.path, None, message)
        if unit is not None and unit[1].lower() == "no":
            if (largest := max(map(abs, self.columns[name]), default=0.0)) > 2.0 * math.pi:
                message = (
                    f"{name} reaches {largest:.4g} rad by the flag inDegrees=no: must be <= 6.28 "
                    f"rad; write inDegrees=yes if it is in deg, 57.3 times as large"
                )
                raise file_error(self.path, None, message)
            return [math.degrees(value) for value in self.columns[name]]
        return self.columns[name]

    def without_repeats(self) -> Table:
        """Return the table without rows that are equal to the row before, in all columns read.

        OpenSim's RRA and CMC write the last row twice (opensim-core#2536).
        """
        rows = list(zip(*self.columns.values(), strict=True))
        kept = [i for i, row in enumerate(rows) if not i or row != rows[i - 1]]
        columns = {name: [values[i] for i in kept] for name, values in self.columns.items()}
        return replace(self, lines=[self.lines[i] for i in kept], columns=columns)

    def require(self, name: str, low: float, high: float, unit: str, remedy: str = "") -> None:
        """Raise `ScenarioError` if a column has a value out of range.

        Parameters
        ----------
        name
            Name of the column.
        low, high, unit
            Range of the values, and the unit of all three.
        remedy
            End of the message.
        """
        for line, value in zip(self.lines, self.columns[name], strict=True):
            if not low <= value <= high:
                message = (
                    f"{name} = {value:g} {unit} is out of range: must be >= {low:.6g} and "
                    f"<= {high:.6g} {unit}{remedy}"
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


def read_table(
    path: str | os.PathLike[str],
    names: Sequence[str],
    remedy: str = "",
    optional: Sequence[str] = (),
) -> Table:
    """Read columns of a CSV file, or of a .mot or .sto file of OpenSim.

    The first record of the file has the names of the columns. In a file of OpenSim the first record
    stands below the line ``endheader``, and ``time_s`` means the column ``time``. Lines between
    records are ignored if they have no values or start with ``#``, ``%`` or ``sep=``.

    The separator of values is the comma, semicolon, tab, bar or space that separates most of
    ``names`` in the first record. If the separator is not the comma, and any number of the file has
    a comma, commas are the decimal signs of the whole file, and numbers must not have points.

    Parameters
    ----------
    path
        A regular file of at most 256 MiB in UTF-8.
    names
        Names of the columns to read. Spaces around a name in the file are ignored.
    remedy
        End of the message about a missing column.
    optional
        Names of columns that are read too if the file has them.

    Raises
    ------
    ScenarioError
        The file cannot be read, a record is damaged or too long, a column is missing or occurs
        twice, or a value is no finite number in decimal digits.
    """
    text = read_text(path, MOST_BYTES_OF_TABLE).replace("\r\n", "\n").replace("\r", "\n")
    names_in_file, start = names, 0
    if end := _END_OF_OPENSIM_HEADER.search(text):
        start = end.end()
        names_in_file = ["time" if name == "time_s" else name for name in names]
        text = text.replace("\t", " ")  # OpenSim allows both between values
    separator = _separator(text, start, names_in_file)
    comma_number = ""
    if separator != "," and text.find(",", start) >= 0:
        comma_number = _comma_number(_records(path, text, start, separator))
    records = _records(path, text, start, separator)
    first, header = next(records, (0, None))
    if header is None:
        raise file_error(path, None, "is empty; must have a line with the names of columns")
    header = [name.strip() for name in header]
    if all(NUMBER.fullmatch(word.replace(",", ".")) for word in " ".join(header).split()):
        message = "has numbers; must have the names of the columns, without # or %"
        raise file_error(path, first, message)
    more = [name for name in dict.fromkeys(optional) if name in header and name not in names]
    names, names_in_file = [*names, *more], [*names_in_file, *more]
    places = [_place(path, header, name, remedy) for name in names_in_file]
    lines: list[int] = []
    values: list[list[float]] = [[] for _ in names]
    for line, row in records:
        # Between spaces no field is empty: a missing value would shift the others.
        shifted = separator == " " and len(row) < len(header)
        if shifted or any(field.strip() for field in row[len(header) :]):
            message = f"has {len(row)} values; must have {len(header)}, one of each column"
            if separator == ",":
                message += "; separate them by semicolons if commas are decimal signs"
            raise file_error(path, line, message)
        lines.append(line)
        for name, place, column in zip(names, places, values, strict=True):
            field = row[place] if place < len(row) else ""
            column.append(_number(path, line, name, field, comma_number))
    return Table(path, lines, dict(zip(names, values, strict=True)), text[:start])


def _separator(text: str, start: int, names: Sequence[str]) -> str:
    """Return what separates most of ``names`` in the first record below ``start``.

    If none of the names is found, return what occurs most often. Spaces are the last choice.
    """
    lines = (match[0] for match in _LINE.finditer(text, start))
    header = next((line for line in lines if not _ignored(line)), "")

    def fit(separator: str) -> tuple[int, bool, int]:
        found = {field.strip(' "\t\n') for field in header.split(separator)}
        return len(found.intersection(names)), separator != " ", header.count(separator)

    # Spaces last, because names and units have spaces too.
    return max(",;\t| ", key=fit)


def _comma_number(records: Iterator[tuple[int, list[str]]]) -> str:
    """Return the first number with a decimal comma, or an empty text if there is none."""
    fields = (field.strip() for _, row in records for field in row)
    return next((field for field in fields if _COMMA_NUMBER.fullmatch(field)), "")


def _ignored(line: str) -> bool:
    return not line.strip(" ,;|\t\n") or line.startswith(("#", "%", "sep=", '"sep='))


def _records(
    path: str | os.PathLike[str], text: str, start: int, separator: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield each record below ``start`` with the number of its first line.

    A quoted field may span lines.
    """
    count = sum(1 for _ in _LINE.finditer(text, 0, start))

    def next_lines() -> Iterator[str]:
        nonlocal count
        for match in _LINE.finditer(text, start):
            count += 1
            yield match[0]

    lines = next_lines()
    for line in lines:
        if _ignored(line):
            continue
        first, rest = count, chain([line], lines)
        try:
            row = next(csv.reader(rest, delimiter=separator, skipinitialspace=True, strict=True))
            yield first, [*filter(None, row)] if separator == " " else row
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
        listed = shortened(", ".join(dict.fromkeys([*close_names(name, header), *header])), 300)
        raise file_error(path, None, f"has no column {quoted}; it has {listed}{remedy}")
    if len(places) > 1:
        message = f"has {len(places)} columns {quoted}; must have one column of this name"
        raise file_error(path, None, message)
    return places[0]


def _number(
    path: str | os.PathLike[str], line: int, name: str, text: str, comma_number: str
) -> float:
    text = text.strip(" \t")
    # In a file with decimal commas a point makes no number: it may be a decimal or for thousands.
    number = text.translate(str.maketrans(",.", ".,")) if comma_number else text
    if NUMBER.fullmatch(number) and math.isfinite(value := float(number)):
        return value
    if ":" in text:
        remedy = "write a time in seconds"
    elif not any(map(str.isdigit, text)):
        remedy = "delete or fill the rows of units and of missing values"
    elif comma_number and "." in text:
        remedy = f"write no points in a file with decimal commas such as {shortened(comma_number)}"
    else:
        remedy = "write no unit and no sign for thousands"
    quoted = repr(shortened(text, 60)) if text else "no value"
    message = f"{shortened(name)}: {quoted}; must be a finite number in the digits 0-9; {remedy}"
    raise file_error(path, line, message)
