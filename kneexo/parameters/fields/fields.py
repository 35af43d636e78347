"""Read unit, range, provenance, classes and words of the fields of parameter classes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo


@dataclass(frozen=True)
class Words:
    """Words that a field accepts in place of a value. `Words` are an item of a field's metadata."""

    values: Mapping[Any, Any] = field(default_factory=dict)
    """The values for which the words stand."""
    models: tuple[type[BaseModel], ...] = ()
    """More classes whose ``kind`` is a word. The scenario replaces their objects by others."""
    others: tuple[str, ...] = ()
    """What else the field accepts besides words and a mapping, for messages."""


def allowed_range(field: FieldInfo) -> str:
    """Return a field's range as text, such as ``>= 0 and <= 150``.

    If the field is a tuple, the range is for each element.
    """
    bounds = [
        f"{sign} {_inside(getattr(bound, key), sign)}"
        for key, sign in (("ge", ">="), ("gt", ">"), ("le", "<="))
        for bound in field.metadata
        if getattr(bound, key, None) is not None
    ]
    return " and ".join(bounds)


def _inside(bound: float, sign: str) -> str:
    """Return a bound as text with six digits or more, so that the text itself obeys the bound."""
    # Six digits alone may round a bound beyond the range that the text states.
    texts = (f"{bound:.{digits}g}" for digits in range(6, 18))
    return next(t for t in texts if (float(t) >= bound if sign[0] == ">" else float(t) <= bound))


def limits_of(field: FieldInfo) -> tuple[float, float]:
    """Return the lowest and the highest allowed value of a number field.

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


def field_of(models: tuple[type[BaseModel], ...], name: str) -> FieldInfo | None:
    """Return the field ``name`` of the first class that has this field, or None."""
    return next((m.model_fields[name] for m in models if name in m.model_fields), None)


def kind_of(model: type[BaseModel]) -> str | None:
    """Return the value of ``kind`` that selects a class of a union. None for any other class."""
    field = model.model_fields.get("kind")
    return None if field is None else field.default


def more_models_of(field: FieldInfo | None) -> tuple[type[BaseModel], ...]:
    """Return the classes whose objects a field accepts and replaces by objects of other classes.

    They are the ``models`` of `Words`.
    """
    metadata = [] if field is None else field.metadata
    return tuple(model for more in metadata if isinstance(more, Words) for model in more.models)


def others_of(field: FieldInfo | None) -> tuple[str, ...]:
    """Return what a field accepts besides words and a mapping, as `Words` says."""
    metadata = [] if field is None else field.metadata
    return tuple(text for more in metadata if isinstance(more, Words) for text in more.others)


def words_of(field: FieldInfo | None) -> dict[Any, Any]:
    """Return the words that a field accepts, each with the value for which the word stands.

    The value of ``kind`` of each class of a union is a word, which stands for a mapping with this
    kind. So ``controller: pid`` is ``controller: {kind: pid}``.
    """
    if field is None:
        return {}
    models = models_of(field) if field.discriminator else ()
    kinds = [kind_of(model) for model in (*models, *more_models_of(field))]
    words: dict[Any, Any] = {str(kind): {"kind": kind} for kind in kinds}
    for more in field.metadata:
        if isinstance(more, Words):
            words |= more.values
    return words
