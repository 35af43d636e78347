"""Fields of the parameter classes: numbers with unit, range and provenance.

pydantic validates the values. This module adds unit and provenance to pydantic's fields, and turns
pydantic's reports into messages of one line.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo

from kneexo.errors import ParameterError, shortened


def quantity(
    default: float,
    unit: str,
    source: str,
    *,
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
) -> Any:
    """Make a pydantic field for one number, real or integer, with unit, range and provenance."""
    return Field(
        default=default, ge=ge, gt=gt, le=le, json_schema_extra={"unit": unit, "source": source}
    )


def quantities(
    default: tuple[float, ...],
    unit: str,
    source: str,
    *,
    ge: float | None = None,
    le: float | None = None,
    min_length: int | None = 1,
) -> Any:
    """Make a pydantic field for a tuple of numbers, with unit, range and provenance.

    ``ge`` and ``le`` bound each number of the tuple. ``min_length`` is None if the annotation
    fixes the length.
    """
    field: Any = Field(
        default=default, min_length=min_length, json_schema_extra={"unit": unit, "source": source}
    )
    field.metadata.append(_ElementRange(ge, le))
    return field


@dataclass(frozen=True)
class _ElementRange:
    """Bounds for each number in a tuple field. Pydantic's own bounds are for the whole tuple."""

    ge: float | None
    le: float | None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        schema: Any = handler(source)
        bounds = {key: bound for key, bound in vars(self).items() if bound is not None}
        items = [number | bounds for number in schema["items_schema"]]
        return schema | {"items_schema": items}


def choice(default: Any, source: str) -> Any:
    """Make a pydantic field for a value without unit, such as a switch or name, with provenance."""
    return Field(default=default, json_schema_extra={"unit": "", "source": source})


def positive_values(default: tuple[float, ...], unit: str, source: str) -> Any:
    """Make a pydantic field for a tuple of positive numbers, with unit and provenance."""
    return quantities(default, unit, source, ge=1e-6, le=1e9)


def require_increasing(values: tuple[float, ...]) -> tuple[float, ...]:
    """Return ``values`` unchanged. Raise `ValueError` unless each value exceeds the one before."""
    if any(b <= a for a, b in pairwise(values)):
        raise ValueError("must increase")
    return values


def ordered_limits(*, strict: bool = False) -> Any:
    """Make a validator for the pairs of fields ``…_min_…`` and ``…_max_…`` of a parameter class.

    The validator raises `ValueError` if a minimum exceeds its maximum. If ``strict``, it also
    raises `ValueError` if a minimum equals its maximum.
    """

    def check(parameters: Parameters) -> Parameters:
        for name, field in type(parameters).model_fields.items():
            other = name.replace("_min_", "_max_")
            low, high = getattr(parameters, name), getattr(parameters, other)
            if other != name and (low > high or (strict and low == high)):
                unit, relation = unit_of(field), "be below" if strict else "not exceed"
                raise ValueError(
                    f"{name} = {low:g} {unit} must {relation} {other} = {high:g} {unit}"
                )
        return parameters

    return model_validator(mode="after")(check)


def allowed_range(field: FieldInfo) -> str:
    """Return a field's range as text, such as ``>= 0 and <= 150``.

    If the field is a tuple, the range is for each element.
    """
    bounds = [
        f"{sign} {getattr(bound, key):g}"
        for key, sign in (("ge", ">="), ("gt", ">"), ("le", "<="))
        for bound in field.metadata
        if getattr(bound, key, None) is not None
    ]
    return " and ".join(bounds)


def limits_of(field: FieldInfo) -> tuple[float, float]:
    """Return the lowest and the highest allowed value of a field made by `quantity`.

    A missing bound is infinite. A bound ``gt`` excludes the number itself, so the lowest value is
    the next larger double.
    """
    low, high = -math.inf, math.inf
    for bound in field.metadata:
        low = max(low, float(getattr(bound, "ge", low)))
        low = max(low, math.nextafter(getattr(bound, "gt", -math.inf), math.inf))
        high = min(high, float(getattr(bound, "le", high)))
    return low, high


def unit_of(field: FieldInfo) -> str:
    """Return the unit of a parameter field, or an empty string for a field without unit."""
    extra = field.json_schema_extra
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


def source_of(field: FieldInfo) -> str:
    """Return the provenance of a parameter field, or an empty string for a field without source."""
    extra = field.json_schema_extra
    return str(extra.get("source", "")) if isinstance(extra, dict) else ""


def one_line(model: type[BaseModel], error: ValidationError) -> tuple[tuple[str | int, ...], str]:
    """Return the location (a path of keys) of a fault, and a message of one line about this fault.

    ``error`` is pydantic's report on ``model``. If it has several faults, the first unknown name is
    chosen, or the first fault if no name is unknown. The message ends with the number of the
    other faults.
    """
    faults = error.errors()
    # A misspelt name also makes a required value missing: report the name.
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])
    location, holders = _without_tags(model, fault["loc"])
    path = shortened(".".join(str(key) for key in location))
    value = fault["input"]
    field = _field_at(model, location)
    unit = unit_of(field) if field else ""
    unit = "" if unit == "1" else unit
    bounds = allowed_range(field) if field else ""
    shown = repr(value)
    if isinstance(value, float) and value == float(f"{value:g}"):
        shown = f"{value:g}"
    if len(shown) > 60:
        shown = type(value).__name__ if not isinstance(value, str) else shortened(shown, 60)
    shown_with_unit = f"{shown} {unit}".strip()
    kind = fault["type"]
    if kind == "extra_forbidden":
        names = sorted({name for holder in holders for name in holder.model_fields})
        line = f"{path}: unknown name; known here: {', '.join(names)}"
        for close in get_close_matches(str(location[-1]), names, n=1):
            line += f"; did you mean {close!r}?"
    elif value is None:
        line = f"{path} has no value"
    elif kind in {"greater_than", "greater_than_equal", "less_than_equal", "finite_number"}:
        bounds = f"finite and {bounds}" if bounds else "finite"
        if field is None or not allowed_range(field):
            unit = ""  # "must be finite" has no unit
        line = f"{path} = {shown_with_unit} is out of range: must be {bounds} {unit}".rstrip()
    elif kind == "union_tag_invalid":
        tag, expected = shortened(fault["ctx"]["tag"]), fault["ctx"]["expected_tags"]
        line = f"{path}.kind = {tag!r}: must be {expected}"
        location = (*location, "kind")
    elif kind == "missing":
        line = f"{path}: is missing"
    elif kind in {"too_short", "too_long"}:
        context = fault["ctx"]
        bound = context.get("min_length", context.get("max_length"))
        word = "at least" if kind == "too_short" else "at most"
        line = f"{path} has {context['actual_length']} values: must have {word} {bound}"
    elif kind == "value_error":
        line = str(fault["ctx"]["error"])
        line = f"{path}: {line}" if path else line
    else:
        expected = fault["msg"].removeprefix("Input should be ")
        line = f"{path} = {shown_with_unit}: must be {expected}"
        if bounds:
            line += f", {bounds} {unit}".rstrip()
    # A bad sample also makes its list too short, which does not count as a second fault.
    more = sum(f is not fault and f["type"] != "too_short" for f in faults)
    return location, line + (f" (and {more} more)" if more else "")


def _without_tags(
    model: type[BaseModel], location: tuple[str | int, ...]
) -> tuple[tuple[str | int, ...], tuple[type[BaseModel], ...]]:
    """Return ``location`` without the values of ``kind`` that pydantic inserts for unions.

    The second result is a tuple of the parameter classes to whose fields the last key refers. For a
    union without a value of ``kind`` in ``location``, these are all members of the union.
    """
    keys: list[str | int] = []
    holders: tuple[type[BaseModel], ...] = ()
    members: tuple[type[BaseModel], ...] = (model,)
    for key in location:
        if len(members) > 1 and any(_kind(member) == key for member in members):
            members = tuple(member for member in members if _kind(member) == key)
            continue
        keys.append(key)
        holders = members
        members = models_of(members[0].model_fields.get(str(key))) if members else ()
    return tuple(keys), holders


def _kind(model: type[BaseModel]) -> object:
    field = model.model_fields.get("kind")
    return None if field is None else field.default


def models_of(field: FieldInfo | None) -> tuple[type[BaseModel], ...]:
    """Return all parameter classes in a field's annotation. Without a field there are none."""
    models: list[type[BaseModel]] = []
    pending: list[Any] = [] if field is None else [field.annotation]
    while pending:
        annotation = pending.pop(0)
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            models.append(annotation)
        else:
            pending.extend(getattr(annotation, "__args__", ()))
    return tuple(models)


def _field_at(model: type[BaseModel], location: tuple[str | int, ...]) -> FieldInfo | None:
    models: tuple[type[BaseModel], ...] = (model,)
    field = None
    for key in location:
        fields = [m.model_fields[str(key)] for m in models if str(key) in m.model_fields]
        if not fields:
            return field
        field = fields[0]
        models = models_of(field)
    return field


@cache
def _default_kinds(model: type[BaseModel]) -> tuple[tuple[str, str], ...]:
    """Return the name of each union field that has a default, with the default's ``kind``."""
    return tuple(
        (name, field.default.kind)
        for name, field in model.model_fields.items()
        if field.discriminator and not field.is_required()
    )


@cache
def _tuple_fields(model: type[BaseModel]) -> tuple[tuple[str, bool], ...]:
    """Return the name of each tuple field, with True if the tuple can have any length."""
    return tuple(
        (name, get_args(field.annotation)[-1] is ...)
        for name, field in model.model_fields.items()
        if get_origin(field.annotation) is tuple
    )


def _as_tuple(value: Any, *, any_length: bool) -> Any:
    """Convert a list, a NumPy array or a pandas column to a tuple.

    With ``any_length`` a single number becomes a tuple of one number. A value of another type is
    returned unchanged, so that pydantic reports the wrong type.
    """
    if hasattr(value, "tolist"):  # NumPy and pandas
        value = value.tolist()
    if isinstance(value, list):
        return tuple(value)
    if any_length and isinstance(value, int | float) and not isinstance(value, bool):
        return (value,)
    return value


class _Short:
    """Wrapper of a long tuple. The `repr` shows the first two values, the last and the length."""

    def __init__(self, values: tuple[Any, ...]) -> None:
        self._values = values

    def __repr__(self) -> str:
        first, second, *_, last = self._values
        return f"({first!r}, {second!r}, …, {last!r}: {len(self._values)} values)"


class Parameters(BaseModel):
    """Base of all parameter classes. Objects are frozen. Unknown names and wrong types are errors.

    A field for a tuple of numbers also accepts a list, a NumPy array or a pandas column. A field
    for a tuple of any length also accepts a single number.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _completed(cls, data: Any) -> Any:
        """Convert arrays to tuples. Insert the default ``kind`` into mappings without ``kind``."""
        if not isinstance(data, dict):
            return data
        tuples = {
            name: _as_tuple(data[name], any_length=any_length)
            for name, any_length in _tuple_fields(cls)
            if name in data
        }
        data = data | tuples if tuples else data
        kinds = {
            name: {"kind": kind} | data[name]
            for name, kind in _default_kinds(cls)
            if isinstance(data.get(name), dict)
        }
        return data | kinds if kinds else data

    def __repr_args__(self) -> Iterator[tuple[str, Any]]:
        """Yield name and value of each field that differs from its default, for a short `repr`.

        `repr` is code that makes an equal object, unless a tuple has more than 8 values.
        """
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if field.is_required() or value != field.default:
                yield name, _Short(value) if isinstance(value, tuple) and len(value) > 8 else value

    def __str__(self) -> str:
        """Return `repr`."""
        return repr(self)

    if not TYPE_CHECKING:  # the type checker keeps the signature that pydantic makes

        def __init__(self, **data: Any) -> None:
            """Validate the values. Raises `ParameterError` with a message of one line."""
            try:
                super().__init__(**data)
            except ValidationError as error:
                line = one_line(type(self), error)[1]
                raise ParameterError(f"{type(self).__name__}: {line}") from None

        # Nested parameters are validated by the outermost constructor, which knows their path.
        __init__.__pydantic_base_init__ = True
