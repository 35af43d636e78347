"""Values of parameters by their dotted paths, such as ``plant.cylinder.mass_kg``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any, TypeVar

from pydantic import BaseModel

from kneexo.errors import ParameterError
from kneexo.parameters.quantity import Parameters, models_of
from kneexo.parameters.scenario import Scenario
from kneexo.parameters.uncertainty import Uncertainty, UncertaintySet

_Changed = TypeVar("_Changed", bound=Parameters)


def changed(scenario: _Changed, values: Mapping[str, Any]) -> _Changed:
    """A copy with other values at dotted paths, such as ``plant.cylinder.mass_kg``; validated.

    ``scenario``: a scenario, or other parameters. A value may be a mapping, as in a scenario file.
    Raises `ParameterError` for a path that they do not have, and for a value out of range.
    """
    data = dict(vars(scenario))
    for path, value in values.items():
        *parents, name = path.split(".")
        holder: Any = data
        for parent in parents:
            part = holder.get(parent)
            if isinstance(part, Parameters):  # only the parts that change are validated again
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


def applicable(
    scenario: Scenario, uncertainty: UncertaintySet
) -> tuple[UncertaintySet, tuple[str, ...]]:
    """The uncertain values that a scenario has, and the paths of the others.

    Raises `ParameterError` for a path that no scenario has, one within another, a value out of
    range, ``known`` for what is no part of the plant, and when no path is left.
    """
    values = uncertainty.values
    kept = {
        path: value
        for path, value in values.items()
        if require_applicable(scenario, path, value, values)
    }
    if not kept:
        raise ParameterError(
            f"none of the uncertain values is in this scenario: {', '.join(values)}"
        )
    return UncertaintySet(values=kept), tuple(path for path in values if path not in kept)


def require_applicable(
    scenario: Scenario, path: str, uncertainty: Uncertainty, paths: Iterable[str]
) -> bool:
    """Whether the scenario has that uncertain value; raises what `applicable` raises.

    ``paths``: those of the whole set, of which none may lie within another.
    """
    if within := next((other for other in paths if path.startswith(f"{other}.")), None):
        raise ParameterError(f"{path}: lies within {within}, which is uncertain too")
    if uncertainty.known and not path.startswith("plant."):
        raise ParameterError(f"{path}: known is for values of the plant")
    if not _has(scenario, path) and _known(path):
        return False
    for value in uncertainty.options or (uncertainty.low, uncertainty.high):
        try:
            changed(scenario, {path: value})
        except ParameterError as error:
            raise ParameterError(str(error).removeprefix("Scenario: ")) from None
    return True


def _has(scenario: Scenario, path: str) -> bool:
    """Whether the scenario has a value at a dotted path."""
    holder: Any = scenario
    for name in path.split("."):
        if not isinstance(holder, Parameters) or name not in type(holder).model_fields:
            return False
        holder = getattr(holder, name)
    return True


def _known(path: str) -> bool:
    """Whether some scenario has a value at a dotted path."""
    holders: tuple[type[BaseModel], ...] = (Scenario,)
    for name in path.split("."):
        fields = [holder.model_fields[name] for holder in holders if name in holder.model_fields]
        if not fields:
            return False
        holders = tuple(model for field in fields for model in models_of(field))
    return True
