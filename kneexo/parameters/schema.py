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
from kneexo.parameters.fields.fields import (
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
    definitions = models_json_schema(requests)[1]["$defs"]
    for model in models:
        for name, field in model.model_fields.items():
            field_schema = definitions[model.__name__]["properties"][name]
            _accept_words(field_schema, field)
            if text := _description(field):
                field_schema["description"] = text
    scenario = definitions.pop("Scenario")
    reference = scenario["properties"]["reference"]
    moment = definitions["LegParameters"]["properties"]["moment"]
    for alternatives in (reference["oneOf"], moment["anyOf"]):  # both also accept a file name
        alternatives.append({"type": "string", "pattern": r"\.(csv|mot|sto)$"})
    for part in definitions["PartsParameters"]["properties"].values():  # also its maker alone
        part["anyOf"].append({"type": "string", "pattern": r"\.py:\w+$"})
    definitions["GaitMoment"]["required"] = ["kind"]
    summaries = "; ".join(f"{name}: {preset.summary}" for name, preset in PRESETS.items())
    scenario["properties"]["preset"] = {"enum": list(PRESETS), "description": summaries}
    for class_schema in (scenario, *definitions.values()):
        for field_schema in class_schema.get("properties", {}).values():
            _require_kinds(field_schema, definitions)
            members = (*field_schema.get("anyOf", []), *field_schema.get("oneOf", []))
            for schema in (field_schema, *members):
                _without_prefix_items(schema)
    return {"$schema": DRAFT, **scenario, "$defs": definitions}


def _models(model: type[BaseModel]) -> list[type[BaseModel]]:
    """Return a parameter class, and the classes of all parts that a scenario file accepts in it."""
    found = [model]
    for model in found:  # the list grows meanwhile
        for field in model.model_fields.values():
            parts = (*models_of(field), *more_models_of(field))
            found += [part for part in parts if part not in found]
    return found


def _accept_words(field_schema: dict[str, Any], field: FieldInfo) -> None:
    """Add the words that a file may have for a field, and classes that become another class.

    A word stands for a class whose values all have defaults, such as ``none``.
    """
    more_models = more_models_of(field)
    alternatives = field_schema.get("oneOf", field_schema.get("anyOf", []))
    alternatives.extend({"$ref": f"#/$defs/{model.__name__}"} for model in more_models)
    incomplete = {
        kind_of(model)
        for model in (*models_of(field), *more_models)
        if any(part.is_required() for part in model.model_fields.values())
    }
    if words := [word for word in words_of(field) if word not in incomplete]:
        if "$ref" in field_schema:
            field_schema["anyOf"] = [{"$ref": field_schema.pop("$ref")}]
        alternatives = field_schema.get("oneOf", field_schema.get("anyOf", []))
        alternatives.insert(0, {"enum": words})


def _require_kinds(field_schema: dict[str, Any], definitions: dict[str, Any]) -> None:
    """Mark ``kind`` as required in all members of a union except the default member.

    ``definitions`` has the schemas of the members, which this function changes. If the type of the
    field is no union, nothing changes.
    """
    if field_schema.pop("discriminator", None) is None:
        return
    default = field_schema["default"]["kind"]
    for member in field_schema["oneOf"]:
        class_schema = definitions.get(member.get("$ref", "").removeprefix("#/$defs/"))
        if class_schema is not None and class_schema["properties"]["kind"]["const"] != default:
            class_schema["required"] = ["kind", *class_schema.get("required", [])]


def _without_prefix_items(schema: dict[str, Any]) -> None:
    """Rewrite the schema of a tuple with equal items as an array, for draft 7.

    Draft 7 has no ``prefixItems``. Any other schema stays as it is.
    """
    items = schema.pop("prefixItems", None)
    if items is not None:
        schema["items"] = items[0]


def _description(field: FieldInfo) -> str:
    """Return unit, range and source of a value on one line.

    The text is empty for a value without source.
    """
    unit, source = unit_of(field), source_of(field)
    texts = ("" if unit == "1" else unit, allowed_range(field), source)
    return "; ".join(filter(None, texts)) if source else ""
