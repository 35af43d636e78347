"""Read and change values of parameters by dotted paths, such as ``plant.cylinder.mass_kg``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel

from kneexo.parameters.fields.fields import models_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.fields.replaced import believed, is_replaced
from kneexo.parameters.scenario import Scenario

_Changed = TypeVar("_Changed", bound=Parameters)


def value_at(parameters: Parameters, path: str) -> Any:
    """Return the value at a dotted path, or None if the parameters have no such path."""
    value: Any = parameters
    for name in path.split("."):
        value = getattr(believed(value), name, None)
    return value


def changed(scenario: _Changed, values: Mapping[str, Any]) -> _Changed:
    """Return a copy of a scenario, or of other parameters, with changed values.

    The function calls the method `Parameters.changed`, which describes ``values``.
    """
    return scenario.changed(values)


def has_path(scenario: Scenario, path: str) -> bool:
    """Return True if ``scenario``, with its present parts, has a value at a dotted path.

    A scenario does not have the numbers that a part of the user replaces.
    """
    holder: Any = scenario
    for name in path.split("."):
        values = vars(holder) if isinstance(holder, Parameters) else holder
        if is_replaced(holder) or not isinstance(values, dict) or name not in values:
            return False
        holder = values[name]
    return True


def known_path(path: str) -> bool:
    """Return True if some scenario, with any choice of its parts, has a value at a dotted path."""
    holders: tuple[type[BaseModel], ...] = (Scenario,)
    for name in path.split("."):
        fields = [holder.model_fields[name] for holder in holders if name in holder.model_fields]
        if not fields:
            return False
        holders = tuple(model for field in fields for model in models_of(field))
    return True
