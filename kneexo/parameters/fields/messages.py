"""Messages of one line about faulty values of parameters, each with its remedy.

pydantic reports the faults. This module turns a report into a message.
"""

from __future__ import annotations

import types
from collections.abc import Mapping
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from kneexo.errors import close_names, listed_names, question, shortened
from kneexo.parameters.fields.fields import (
    allowed_range,
    kind_of,
    models_of,
    more_models_of,
    others_of,
    source_of,
    unit_of,
    words_of,
)
from kneexo.parameters.fields.names import Place, advice

Location = tuple[str | int, ...]
"""Path to a value in nested mappings and lists: names and indices."""


def one_line(model: type[BaseModel], error: ValidationError) -> tuple[Location, str]:
    """Return the location of a fault, and a message of one line about this fault.

    ``error`` is pydantic's report on ``model``. If the report has several faults, the first unknown
    name is chosen, or the first fault if no name is unknown. The message ends with the number of
    the other faults.
    """
    faults = error.errors(include_url=False)
    # A misspelt name also makes a required value missing: report the name.
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])
    place = _place(model, fault["loc"])
    path = shortened(".".join(str(key) for key in place.keys))
    error_type, value, context = fault["type"], fault["input"], fault.get("ctx", {})
    unit = unit_of(place.field) if place.field else ""
    unit = "" if unit == "1" or unit.startswith("by ") else unit
    bounds = allowed_range(place.field) if place.field else ""
    location = place.keys
    # A bad sample also makes its list too short, which does not count as a second fault.
    other_count = sum(f is not fault and f["type"] != "too_short" for f in faults)
    if error_type == "extra_forbidden":
        names = tuple(".".join(str(key) for key in place.keys).split("."))
        line = f"{path}: unknown name{advice(model, names, place.holders)}"
    elif error_type in {"greater_than", "greater_than_equal", "less_than_equal", "finite_number"}:
        bounds = f"finite and {bounds} {unit}".rstrip() if bounds else "finite"
        line = (
            f"{path} = {shown_value(value)} {unit}".rstrip() + f" is out of range: must be {bounds}"
        )
    elif error_type == "union_tag_invalid":
        parts = (*models_of(place.field), *more_models_of(place.field))
        kinds = [str(kind_of(part)) for part in parts]
        line = f"{path}.kind = {shortened(str(context['tag']))!r}: must be {_listed(kinds)}"
        line += question(_meant(context["tag"], place.field))
        location = (*location, "kind")
    elif error_type == "missing" and isinstance(place.keys[-1], int) and place.field:
        # Every missing element of a tuple is a fault of its own.
        location, count = place.keys[:-1], len(get_args(place.field.annotation))
        path, other_count = path.rpartition(".")[0], 0
        line = f"{path} has {len(value)} values: must have {count}"
    elif error_type == "missing":
        source = source_of(place.field) if place.field else ""
        is_given = source.startswith("given")
        expected = source if is_given else _expected(error_type, context, place.field, None)
        line = f"{path}: is missing; must be {expected}"
    elif error_type in {"too_short", "too_long"}:
        bound = context.get("min_length", context.get("max_length"))
        word = "at least" if error_type == "too_short" else "at most"
        line = f"{path} has {context['actual_length']} values: must have {word} {bound}"
    elif error_type == "value_error":
        line = f"{path}: {context['error']}" if path else str(context["error"])
    elif error_type == "json_invalid":
        line = f"is not JSON: {context['error']}; correct the text"
    else:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        found = f"{path} = {shown_value(value)} {unit if is_number else ''}".rstrip()
        if value is None:
            found = f"{path} has no value"
        line = f"{found}: must be {_expected(error_type, context, place.field, value)}"
        line += f", {bounds} {unit}".rstrip() if bounds else ""
    return location, line + (f" (and {other_count} more)" if other_count else "")


def _place(model: type[BaseModel], location: Location) -> Place:
    """Return the place of a location in pydantic's report on ``model``.

    pydantic inserts the values of ``kind`` for unions into the location.
    """
    place = Place((model,))
    for key in location:
        place = place.of_kind(key) or place.below(key)
    return place


def _expected(
    error_type: str, context: Mapping[str, Any], field: FieldInfo | None, value: Any
) -> str:
    """Return what a field accepts, such as ``a number in s``, for a value of another type.

    ``error_type`` and ``context`` come from pydantic's report.
    """
    models = models_of(field)
    if error_type.startswith("bool_"):
        return "true or false"
    if error_type.startswith("int_"):
        return "a whole number"
    if error_type.startswith(("float_", "decimal_")):
        unit = unit_of(field) if field and not allowed_range(field) else ""
        point = " with a decimal point" if isinstance(value, str) and "," in value else ""
        return f"a number{point}" + (f" in {unit}" if unit not in ("", "1") else "")
    if error_type == "literal_error":
        if field is None or not isinstance(value, str):
            return str(context["expected"])
        options = (str(option) for option in get_args(field.annotation))
        return context["expected"] + question(close_names(value, options, most=1))
    if error_type == "string_too_short":
        return "a text that is not empty"
    if error_type.startswith("string_"):
        return "text"
    if error_type == "tuple_type":
        numbers = field is not None and {float, int} & set(get_args(field.annotation))
        return "a list of numbers" if numbers else "a list"
    if isinstance(value, type) and value in models:
        return f"an object, such as {value.__name__}()"
    if isinstance(value, BaseModel) and models:
        return "an object of " + " or ".join(part.__name__ for part in models)
    if words := words_of(field):
        shown = ["true" if w is True else "false" if w is False else str(w) for w in words]
        accepted = listed_names([*shown, *others_of(field), "a mapping"])
        return accepted + question(_meant(value, field))
    if models:
        first = next(iter(models[0].model_fields))
        return f"a mapping of names to values, such as {{{first}: …}}"
    if error_type == "dict_type":
        return "a mapping of names to values"
    return f"another value ({error_type.replace('_', ' ')})"


def _meant(word: Any, field: FieldInfo | None) -> list[str]:
    """Return the kind or other word of a field that is similar to the text ``word``, if any."""
    if not isinstance(word, str):
        return []
    words = words_of(field)
    if isinstance(alike := words.get(word), dict):
        return [alike["kind"]]
    return close_names(word, [other for other in words if isinstance(other, str)])[:1]


def _listed(names: list[str]) -> str:
    """Return names in quotation marks, such as ``'a', 'b' or 'c'``."""
    return listed_names(repr(name) for name in names)


def shown_value(value: Any) -> str:
    """Return a value as text of at most 60 characters. An object is shown by its class."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, types.FunctionType | types.BuiltinFunctionType):
        return f"the function {shortened(value.__name__, 40)}"
    if isinstance(value, float) and value == float(f"{value:g}"):
        return f"{value:g}"
    if isinstance(value, int) and abs(value) >= 10**50:  # Python refuses the text of long integers
        return "an integer of more than 50 digits"
    shown = shortened(repr(value), 60) if isinstance(value, str) else repr(value)
    return shown if len(shown) <= 63 and " at 0x" not in shown else type(value).__name__
