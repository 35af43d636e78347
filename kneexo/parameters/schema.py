"""The JSON schema of scenario files, for editors and other programs.

pydantic creates the schema from the parameter classes. This module adds a description of each
value, and the words that a file accepts in place of a mapping, such as ``linkage: G1``.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic.json_schema import models_json_schema

from kneexo.parameters import Scenario
from kneexo.parameters.fields import (
    allowed_range,
    kind_of,
    models_of,
    more_models_of,
    source_of,
    unit_of,
    words_of,
)
from kneexo.parameters.presets import PRESETS

DRAFT = "http://json-schema.org/draft-07/schema#"
"""URI of draft 7 of JSON schema, the newest draft that editors support."""


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a scenario file (draft 7).

    Each value has ``unit``, ``source`` and a ``description`` with unit, range and source. The
    schema checks each value alone. Only `load_scenario` also checks conditions on several values,
    for example that a reference stays in the range of motion.
    """
    models = _models(Scenario)
    requests: Any = [(model, "validation") for model in models]
    classes = models_json_schema(requests)[1]["$defs"]
    for model in models:
        for name, field in model.model_fields.items():
            value = classes[model.__name__]["properties"][name]
            _accept_words(value, field)
            if text := _description(field):
                value["description"] = text
    scenario = classes.pop("Scenario")
    moment = classes["LegParameters"]["properties"]["moment"]
    for alternatives in (scenario["properties"]["reference"]["oneOf"], moment["anyOf"]):
        alternatives.append({"type": "string", "pattern": r"\.(csv|mot|sto)$"})
    classes["GaitMoment"]["required"] = ["kind"]
    summaries = "; ".join(f"{name}: {preset.summary}" for name, preset in PRESETS.items())
    scenario["properties"]["preset"] = {"enum": list(PRESETS), "description": summaries}
    for schema in (scenario, *classes.values()):
        for value in schema.get("properties", {}).values():
            _require_kinds(value, classes)
            for part in (value, *value.get("anyOf", []), *value.get("oneOf", [])):
                _without_prefix_items(part)
    return {"$schema": DRAFT, **scenario, "$defs": classes}


def _models(model: type[BaseModel]) -> list[type[BaseModel]]:
    """Return a parameter class, and the classes of all parts that a scenario file accepts in it."""
    models = [model]
    for model in models:  # grows meanwhile
        for field in model.model_fields.values():
            parts = (*models_of(field), *more_models_of(field))
            models += [part for part in parts if part not in models]
    return models


def _accept_words(value: dict[str, Any], field: FieldInfo) -> None:
    """Add the words that a field accepts, and the classes that it does not keep.

    ``value`` is the schema of the field. A kind that has values without default is no word.
    """
    more = more_models_of(field)
    alternatives = value.get("oneOf", value.get("anyOf", []))
    alternatives.extend({"$ref": f"#/$defs/{model.__name__}"} for model in more)
    incomplete = {
        kind_of(model)
        for model in (*models_of(field), *more)
        if any(part.is_required() for part in model.model_fields.values())
    }
    if words := [word for word in words_of(field) if word not in incomplete]:
        if "$ref" in value:
            value["anyOf"] = [{"$ref": value.pop("$ref")}]
        value.get("oneOf", value.get("anyOf", [])).insert(0, {"enum": words})


def _require_kinds(value: dict[str, Any], classes: dict[str, Any]) -> None:
    """Mark ``kind`` as required in all members of a union except the default member.

    ``value`` is the schema of a field. ``classes`` has the schemas of the members, which this
    function changes. If the field's type is no union, nothing changes.
    """
    if value.pop("discriminator", None) is None:
        return
    default = value["default"]["kind"]
    for member in value["oneOf"]:
        model = classes.get(member.get("$ref", "").removeprefix("#/$defs/"))
        if model is not None and model["properties"]["kind"]["const"] != default:
            model["required"] = ["kind", *model.get("required", [])]


def _without_prefix_items(value: dict[str, Any]) -> None:
    """If the schema is a tuple whose items are equal, rewrite it as an array.

    The reason is that draft 7 has no ``prefixItems``.
    """
    items = value.pop("prefixItems", None)
    if items is not None:
        value["items"] = items[0]


def _description(field: FieldInfo) -> str:
    """Return unit, range and source of a value on one line.

    The text is empty for a value without source.
    """
    unit, source = unit_of(field), source_of(field)
    texts = ("" if unit == "1" else unit, allowed_range(field), source)
    return "; ".join(filter(None, texts)) if source else ""
