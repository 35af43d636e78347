"""The rows that ``kneexo params`` lists: parameters, settings and uncertain values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from kneexo.parameters import UNCERTAINTY
from kneexo.parameters.quantity import allowed_range, models_of, source_of, unit_of
from kneexo.studies.catalogue import STUDIES

Row = dict[str, Any]
"""A row: ``parameter`` (a dotted name), ``value``, ``unit``, ``range`` and ``provenance``."""


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
        required = isinstance(model, type) and field.is_required()
        default = "(required)" if required else field.default
        value = default if isinstance(model, type) else getattr(model, name)
        if isinstance(value, BaseModel):
            yield from parameter_rows(value, f"{path}{name}.", all_kinds=all_kinds)
            for other in models_of(field) if all_kinds and field.discriminator else ():
                if other is not type(value):
                    kind = other.model_fields["kind"].default
                    yield from parameter_rows(other, f"{path}{name}({kind}).")
        elif source_of(field):
            yield {
                "parameter": path + name,
                "value": value,
                "unit": unit_of(field),
                "range": allowed_range(field),
                "provenance": source_of(field),
            }


def setting_rows() -> Iterator[Row]:
    """Yield a row for each setting of each study. Imports the studies, and so Drake."""
    for study in STUDIES.values():
        yield from parameter_rows(study.settings(), f"{study.label or study.command}: ")


def uncertainty_rows() -> Iterator[Row]:
    """Yield a row for each value of the default uncertainty set."""
    for path, uncertainty in UNCERTAINTY.values.items():
        options = uncertainty.options
        yield {
            "parameter": f"uncertainty: {path}",
            "value": list(options) or [uncertainty.low, uncertainty.high],
            "unit": "",
            "range": "one of these" if options else f"from, to; {uncertainty.scale}",
            "provenance": uncertainty.source
            + ("; known to the controller" if uncertainty.known else ""),
        }
