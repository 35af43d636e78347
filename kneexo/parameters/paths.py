"""Read and change values of parameters by dotted paths, such as ``plant.cylinder.mass_kg``."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, TypeVar

from pydantic import BaseModel

from kneexo.errors import ParameterError
from kneexo.parameters.quantity import Parameters, models_of
from kneexo.parameters.scenario import Scenario

_Changed = TypeVar("_Changed", bound=Parameters)


def value_at(parameters: Parameters, path: str) -> Any:
    """Return the value at a dotted path, or None if the parameters have no such path."""
    value: Any = parameters
    for name in path.split("."):
        value = getattr(value, name, None)
    return value


def changed(scenario: _Changed, values: Mapping[str, Any]) -> _Changed:
    """Return a copy of a scenario, or of other parameters, with changed values.

    ``values`` maps a dotted path to the new value, which can be a mapping as in a scenario file.
    Raises `ParameterError` for a path that the parameters do not have, and for a value out of
    range.
    """
    data = dict(vars(scenario))
    for path, value in values.items():
        *parents, name = path.split(".")
        holder: Any = data
        for parent in parents:
            part = holder.get(parent)
            if isinstance(part, Parameters):  # parts without a change are not validated again
                part = holder[parent] = dict(vars(part))
            elif isinstance(part, dict):
                part = holder[parent] = dict(part)
            holder = part
            if not isinstance(holder, dict):
                break
        # The validation below reports a wrong name in an existing mapping.
        if not isinstance(holder, dict):
            what = "this scenario has" if isinstance(scenario, Scenario) else "there is"
            raise ParameterError(f"{path}: {what} no {path.rpartition('.')[0]}")
        # A later path may reach into a mapping.
        holder[name] = deepcopy(value) if isinstance(value, dict) else value
    return type(scenario)(**data)


def has_path(scenario: Scenario, path: str) -> bool:
    """Return True if ``scenario``, with its present parts, has a value at a dotted path."""
    holder: Any = scenario
    for name in path.split("."):
        if not isinstance(holder, Parameters) or name not in type(holder).model_fields:
            return False
        holder = getattr(holder, name)
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
