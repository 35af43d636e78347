"""Names of parameters: the paths of a parameter class, and suggestions for an unknown name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from os import PathLike
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kneexo.errors import close_names, listed_names, shortened
from kneexo.parameters.fields import field_of, kind_of, models_of, more_models_of, words_of

Models = tuple[type[BaseModel], ...]
"""Parameter classes, such as the members of a union."""
_Class = TypeVar("_Class", bound=type[BaseModel])

_SEARCHED: list[type[BaseModel]] = []
_MOST = 4  # suggestions in a message
_SIMILAR = 0.8  # names of this similarity are suggested before names at other places


def searched_for_names(model: _Class) -> _Class:
    """Class decorator: messages about every parameter class suggest paths of this class too."""
    _SEARCHED.append(model)
    return model


@dataclass(frozen=True)
class Place:
    """A place in nested parameters: its keys, and the classes and fields on the way to it."""

    models: Models
    """The classes of the parameters at this place. For a union without kind, all its members."""
    keys: tuple[str | int, ...] = ()
    """The path to this place."""
    field: FieldInfo | None = None
    """The field at this place, or the field that contains it."""
    holders: Models = ()
    """The classes to whose fields the last key refers."""
    members: Models = ()
    """All members of the union of the holders."""
    union: Models = ()
    """All members of the union of ``models``, if a kind has been chosen."""
    inside: bool = False
    """Whether the next key is a key of a mapping or an index, so that it stands for no field."""

    @property
    def prefix(self) -> str:
        """The path to the holders, with a dot at its end. Empty at the top."""
        return "".join(f"{key}." for key in self.keys[:-1])

    def of_kind(self, kind: object) -> Place | None:
        """Return this place with the class of a kind alone, or None without union or kind."""
        models = tuple(model for model in self.models if kind_of(model) == kind)
        if not models or len(self.models) < 2:
            return None
        return replace(self, models=models, union=self.models)

    def below(self, key: str | int) -> Place:
        """Return the place of one more key."""
        keys = (*self.keys, key)
        if self.inside:
            return replace(self, keys=keys, inside=False)
        field = field_of(self.models, str(key))
        return Place(
            models_of(field),
            keys,
            field or self.field,
            holders=self.models,
            members=(*(self.union or self.models), *more_models_of(self.field)),
            inside=field is not None and holds_many(field),
        )


@cache
def paths_of(model: type[BaseModel]) -> dict[str, str]:
    """Return the dotted paths of all parts and values that objects of a class can have.

    The result maps a path to the setting that the path needs, such as ``controller.kind = pid``, or
    to an empty text. A class that occurs at two paths is entered at the first path: the result has
    ``plant.pump``, but not ``nominal.pump``. NAME stands for the keys of a mapping.
    """
    paths: dict[str, str] = {}
    for path, needed, _ in _walk(model, "", "", {model}):
        paths.setdefault(path, needed)
    return paths


def path_of_part(model: type[BaseModel]) -> tuple[type[BaseModel], str] | None:
    """Return a class with the decorator `searched_for_names`, and the path of a part in it.

    ``model`` is the class of the part. The result is None if no class has such a part.
    """
    for searched in _SEARCHED:
        for path, _, part in _walk(searched, "", "", {searched}):
            if part is model:
                return searched, path.rpartition(".")[0]
    return None


def _walk(
    model: type[BaseModel], prefix: str, needed: str, entered: set[type[BaseModel]]
) -> Iterator[tuple[str, str, type[BaseModel]]]:
    """Yield path, needed setting and class of each field of a class and its parts."""
    for name, field in model.model_fields.items():
        path = f"{prefix}{name}"
        yield path, needed, model
        parts = [part for part in models_of(field) if part not in entered]
        entered.update(parts)
        for part in parts:
            setting = needed
            if field.discriminator and kind_of(part) != getattr(field.default, "kind", None):
                setting = f"{path}.kind = {kind_of(part)}"
            elif True in words_of(field):
                setting = f"{path} = true"
            below = f"{path}.NAME." if holds_many(field) else f"{path}."
            yield from _walk(part, below, setting, entered)


def holds_many(field: FieldInfo) -> bool:
    """Return True if a field holds a mapping or a tuple of values."""
    annotations = (field.annotation, *get_args(field.annotation))
    return any(get_origin(annotation) in (dict, tuple) for annotation in annotations)


def suggestion(model: type[BaseModel], name: str, known: Iterable[str], prefix: str = "") -> str:
    """Return a text that suggests known names for an unknown name, or lists the known names.

    Parameters
    ----------
    model
        The class whose paths are searched. After it, the classes with the decorator
        `searched_for_names` are searched.
    name
        The unknown name, or the end of a dotted path.
    known
        The names that are known at the place of the unknown name.
    prefix
        The path of this place. The path ends with a dot.
    """
    known = list(known)
    similar = [prefix + other for other in close_names(name, known, _SIMILAR)]
    if paths := [*dict.fromkeys([*paths_ending(model, name), *similar])]:
        return _question(model, paths[:_MOST])
    for searched in _SEARCHED:
        if searched is not model and (others := paths_ending(searched, name)):
            return f"; {searched.__name__} has {_with_needs(searched, others[:_MOST])}"
    leaves = dict.fromkeys(path.rpartition(".")[2] for path in paths_of(model))
    alike = close_names(name, leaves, _SIMILAR)
    elsewhere = [path for leaf in alike for path in paths_ending(model, leaf)]
    if paths := elsewhere or [prefix + other for other in close_names(name, known)]:
        return _question(model, paths[:_MOST])
    listed = ", ".join(sorted(known))
    return f"; known here: {shortened(listed, 200)}" if listed else ""


def other_angle_unit(name: str, known: Iterable[str], prefix: str = "") -> str:
    """Return a remedy for a name that differs from a known name by its unit of angle only.

    The text has the known name and the factor between the units. It is empty if there is no such
    name. ``prefix`` is the path of the known names, with a dot at its end. In ``name`` N·m may be
    ``n_m`` or ``nm``, and ``per`` may be left out.
    """

    def in_rad(words: str) -> list[str]:
        units = words.replace("_nm", "_n_m").replace("_deg", "_rad")
        return [word for word in units.split("_") if word != "per"]

    for other in known:
        if in_rad(other) == in_rad(name) and ("_rad" in other) != ("_rad" in name):
            per_angle = "_per_rad" in other or "_per_deg" in other
            verb = "multiply" if per_angle == ("_rad" in other) else "divide"
            return f"; must be {prefix}{other}; {verb} the value by {math.degrees(1.0):.3g}"
    return ""


def paths_ending(model: type[BaseModel], name: str) -> list[str]:
    """Return the paths of a class that end with ``name``, a name or the end of a dotted path."""
    return [path for path in paths_of(model) if f".{path}".endswith(f".{name}")]


def _with_needs(model: type[BaseModel], paths: list[str]) -> str:
    """Return paths of a class as text, with the settings that they need."""
    needed = [paths_of(model).get(path, "") for path in paths]
    if len(set(needed)) == 1 and needed[0]:
        each = "each needs" if len(paths) > 1 else "needs"
        return f"{listed_names(paths)} ({each} {needed[0]})"
    pairs = zip(paths, needed, strict=True)
    return listed_names(f"{path} (needs {need})" if need else path for path, need in pairs)


def _question(model: type[BaseModel], paths: list[str]) -> str:
    return f"; did you mean {_with_needs(model, paths)}?"


def other_kind(place: Place) -> str:
    """Return the kind that has the last name of ``place``, as ``; needs controller.kind = pid``.

    The text is empty if the place is in no union, or if no other member has the name or a similar
    name.
    """
    name = str(place.keys[-1])
    others = {m: kind_of(m) for m in place.members if m not in place.holders}
    if name in others.values():
        return f"; did you mean {place.prefix}kind = {name}?"
    exact = [str(kind) for model, kind in others.items() if name in model.model_fields]
    if exact:
        return f"; needs {place.prefix}kind = {' or '.join(exact)}"
    known = {known for holder in place.holders for known in holder.model_fields}
    if close_names(name, known, _SIMILAR):
        return ""
    for model, kind in others.items():
        if close := close_names(name, model.model_fields, _SIMILAR, most=1):
            return f"; did you mean {place.prefix}{close[0]} (needs {place.prefix}kind = {kind})?"
    return ""


def unknown_attribute(model: type[BaseModel], name: str) -> str:
    """Return a message for an attribute that the objects of a parameter class do not have."""
    classes = [cls for cls in model.__mro__ if issubclass(cls, BaseModel) and cls is not BaseModel]
    properties = [
        key for cls in classes for key in vars(cls) if key.isidentifier() and key[0] != "_"
    ]
    advice = suggestion(model, name, [*model.model_fields, *properties])
    return f"{model.__name__} has no attribute {shortened(name)}{advice}"


def frozen(model: type[BaseModel], name: str, value: str) -> str:
    """Return a message for the assignment of ``value``, a text, to an attribute of parameters."""
    if name not in model.model_fields:
        return unknown_attribute(model, name)
    whole, prefix = path_of_part(model) or (model, "")
    variable = whole.__name__.lower() if whole in _SEARCHED else "parameters"
    change = f'{variable}.changed({{"{f"{prefix}.{name}".lstrip(".")}": {value}}})'
    return f"{model.__name__} is frozen; make a changed copy: {change}"


def unnamed(model: type[BaseModel], value: Any) -> str:
    """Return a message for a ``value`` without name in the call of a parameter class."""
    first = next((name for name in model.model_fields if name != "kind"), "name")
    line = f"{model.__name__}: takes values by name, such as {model.__name__}({first}=…)"
    is_path = model in _SEARCHED and isinstance(value, str | PathLike)
    return line + ("; load_scenario(path) reads a file" if is_path else "")


def missing_part(model: type[BaseModel], path: str, place: Place, part: Any) -> str:
    """Return a message for a dotted path whose beginning is no part of parameters.

    Parameters
    ----------
    model
        The class of the parameters.
    path
        The whole path.
    place
        The place of its beginning.
    part
        The value at this place, or None without value.
    """
    where = ".".join(str(key) for key in place.keys)
    known = [name for holder in place.holders for name in holder.model_fields]
    if place.keys[-1] not in known:
        rest = path.removeprefix(where)
        close = [f"{place.prefix}{name}{rest}" for name in close_names(str(place.keys[-1]), known)]
        paths = [*paths_ending(model, path), *(p for p in close if p in paths_of(model))]
        advice = _question(model, paths[:_MOST]) if paths else other_kind(place)
        advice = advice or suggestion(model, path.rpartition(".")[2], known)
        return f"{path}: unknown name {where}{advice}"
    if part is None:
        value = "true" if True in words_of(place.field) else "{}"
        return f"{path}: {where} has no value here; set {where} = {value} too"
    return f"{path}: {where} is a single value, which has no names below it"
