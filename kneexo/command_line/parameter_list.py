"""The list of ``kneexo params``: parameters, settings and uncertain values, in groups."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from textwrap import wrap
from typing import Any

from pydantic import BaseModel

from kneexo.common.progress import line_width
from kneexo.errors import ParameterError, close_names, question, shortened
from kneexo.parameters import LINKAGES, UNCERTAINTY, WEARER_UNCERTAINTY, Scenario
from kneexo.parameters.fields.fields import (
    allowed_range,
    kind_of,
    models_of,
    source_of,
    unit_of,
    words_of,
)
from kneexo.parameters.paths import value_at
from kneexo.parameters.presets import PRESETS
from kneexo.studies.catalogue import STUDIES

Row = dict[str, Any]
"""A row: ``parameter`` (its path), ``value``, ``default``, ``unit``, ``range`` and ``provenance``.

The path ``plant.load(knee).segment_mass_kg`` stands for a value of a kind that is not the default.
"""

_LONGEST_LIST = 30  # a reference can have thousands of samples


def parameter_rows(
    model: BaseModel | type[BaseModel], path: str = "", *, all_kinds: bool = False
) -> Iterator[Row]:
    """Yield a row for each number and choice of a parameter object or class.

    Parameters
    ----------
    model
        The object, or the class. For a class the defaults are listed.
    path
        Text before the name of each parameter.
    all_kinds
        Whether to list every kind of each part, for example every kind of controller. If False,
        only the kinds in ``model`` are listed.
    """
    cls = model if isinstance(model, type) else type(model)
    for name, field in cls.model_fields.items():
        default = "(required)" if field.is_required() else field.default
        value = default if isinstance(model, type) else vars(model)[name]
        if isinstance(value, BaseModel):
            yield from parameter_rows(value, f"{path}{name}.", all_kinds=all_kinds)
            for other in models_of(field) if all_kinds and field.discriminator else ():
                if other is not type(value):
                    yield from parameter_rows(other, f"{path}{name}({kind_of(other)}).")
        elif source_of(field):
            yield {
                "parameter": path + name,
                "value": value,
                "default": default,
                "unit": unit_of(field),
                "range": allowed_range(field),
                "provenance": source_of(field),
            }
            if all_kinds and True in words_of(field):
                for part in models_of(field):
                    yield from parameter_rows(part, f"{path}{name}(true).")


def mark_changes(rows: Iterable[Row], scenario: Scenario) -> None:
    """Change the provenance of values that differ from their defaults.

    The new provenance says whether the value comes from a preset or from the user, and has the
    default. A value that ``scenario`` leaves out keeps its provenance, and so does a value without
    default and a linkage that has a name. The provenance of a fitted polynomial says that the
    polynomial is fitted.
    """
    presets = {name: Scenario.preset(name) for name in PRESETS}
    for row in rows:
        path, value = row["parameter"], value_at(scenario, row["parameter"])
        part = value_at(scenario, path.rpartition(".")[0])
        if path.startswith("polynomial.") and part is None and row["value"] != row["default"]:
            row["provenance"] = f"fitted to the linkage (paper: {row['provenance']})"
        if value in (None, row["default"]) or part in LINKAGES.values():
            continue
        if row["default"] == "(required)":  # its source is the user
            continue
        named = [name for name, preset in presets.items() if value_at(preset, path) == value]
        owner = f"of the preset {named[0]}" if named else "yours"
        source = row["provenance"]
        origin = "paper" if re.match("Table|Section|Eq|Fig", source) else "default"
        row["provenance"] = f"{owner} ({origin}: {_shown(row['default'])}; {source})"


def setting_rows() -> Iterator[Row]:
    """Yield a row for each setting of each study.

    The function imports the studies, which import Drake, so it is slow.
    """
    for study in STUDIES.values():
        settings = study.computation().settings()
        yield from parameter_rows(settings, f"{study.label or study.command}: ")


def uncertainty_rows() -> Iterator[Row]:
    """Yield a row for each value of the default uncertainty sets."""
    for path, uncertainty in (UNCERTAINTY.values | WEARER_UNCERTAINTY.values).items():
        options = uncertainty.options
        yield {
            "parameter": f"uncertainty: {path}",
            "value": list(options) or [uncertainty.low, uncertainty.high],
            "default": list(options) or [uncertainty.low, uncertainty.high],
            "unit": "",
            "range": "one of these" if options else f"from, to; {uncertainty.scale}",
            "provenance": uncertainty.source
            + ("; known to the controller" if uncertainty.known else ""),
        }


def matching(rows: Iterable[Row], text: str) -> list[Row]:
    """Return the rows that have ``text`` in name, unit or provenance, in upper or lower case.

    Raises `ParameterError`, which suggests similar names, if there is no such row.
    """
    rows, searched = list(rows), text.casefold()
    keys = ("parameter", "unit", "provenance")
    matches = [row for row in rows if any(searched in row[key].casefold() for key in keys)]
    if not matches:
        leaves = dict.fromkeys(re.split("[. ]", row["parameter"])[-1] for row in rows)
        raise ParameterError(
            f"--find {shortened(text)}: no parameter has this text in its name, unit or provenance"
            + question(close_names(text, leaves))
        )
    return matches


def listing(rows: Iterable[Row], *, grouped: bool = True) -> str:
    """Return the rows as text of at most 100 columns, one line for a row that fits into it.

    If ``grouped``, each group of parameters has a heading, such as ``plant.cylinder:``, and the
    lines below have the rest of the names. Otherwise each line has the whole name.
    """
    if not grouped:
        return "\n".join(line for row in rows for line in _entry(*_named(row), row, "")) + "\n"
    groups: dict[str, list[tuple[str, Row]]] = {}
    for row in rows:
        group, separator, name = row["parameter"].rpartition(": ")
        if not separator:
            group, _, name = name.rpartition(".")
        groups.setdefault(group or "scenario", []).append((name, row))
    lines: list[str] = []
    for group, entries in groups.items():
        # The words that select a kind, such as plant.load = knee.
        lines += ["", re.sub(r"\((\w+)\)", r" = \1", group) + ":"]
        above = ""
        for name, row in entries:
            short = "as above" if row["provenance"] == above else ""
            above = row["provenance"]
            lines += _entry(name, above, row, "  ", short)
    return "\n".join(lines[1:]) + "\n"


def _named(row: Row) -> tuple[str, str]:
    """Return the path of a row, and its provenance with the setting that the path needs."""
    name, provenance = row["parameter"], row["provenance"]
    if needed := re.search(r"([\w.]+)\((\w+)\)", name):
        return name.replace(f"({needed[2]})", ""), f"{provenance}; needs {needed[1]} = {needed[2]}"
    return name, provenance


def _entry(name: str, provenance: str, row: Row, indent: str, short: str = "") -> list[str]:
    """Return the lines of a row. ``short`` replaces a provenance that takes a line of its own."""
    bounds = re.sub(r">= (\S+) and <= (\S+)", r"\1 … \2", row["range"])
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    value = f"{name} = {_shown(row['value'])}{unit}" + (f"  [{bounds}]" if bounds else "")
    for text in (provenance, short):
        if text and len(line := f"{indent}{value}  {text}") <= line_width():
            return [line]
    below = f"{indent}    "
    return [
        *wrap(value, line_width(), initial_indent=indent, subsequent_indent=below),
        *wrap(provenance, line_width(), initial_indent=below, subsequent_indent=below),
    ]


def _shown(value: Any) -> str:
    """Return a value as in a scenario file, with at most ten digits."""
    if value is None:
        return "left out"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, tuple | list) and len(value) > _LONGEST_LIST:
        first, second, *_, last = map(_shown, value)
        return f"[{first}, {second}, …, {last}] ({len(value)} values)"
    if isinstance(value, tuple | list):
        return f"[{', '.join(_shown(part) for part in value)}]"
    return str(value)
