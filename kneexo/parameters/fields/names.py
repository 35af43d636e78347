"""Names of parameters: a flat list of the dotted paths of a class, and remedies for wrong paths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kneexo.errors import close_names, listed_names, shortened
from kneexo.parameters.fields.fields import field_of, kind_of, models_of, more_models_of, words_of

Models = tuple[type[BaseModel], ...]
"""Parameter classes, such as the members of a union."""
Path = tuple[str, ...]
"""The names of a dotted path."""
_Class = TypeVar("_Class", bound=type[BaseModel])

_SEARCHED: list[type[BaseModel]] = []
_MOST = 4  # paths in a message
_SIMILAR_HERE, _SIMILAR = 0.7, 0.8  # least similarity of names at the same and at other places


def searched_for_names(model: _Class) -> _Class:
    """Class decorator: every message about an unknown name suggests paths of ``model`` too."""
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
    """The classes whose field, or unknown field, the last key names."""
    inside: bool = False
    """Whether the next key is a key of a mapping or an index, so that it stands for no field."""

    def of_kind(self, kind: object) -> Place | None:
        """Return this place with only the class of a kind.

        Returns None if the place does not hold one of several classes, or no class of this kind.
        """
        models = tuple(model for model in self.models if kind_of(model) == kind)
        return replace(self, models=models) if models and len(self.models) > 1 else None

    def below(self, key: str | int) -> Place:
        """Return the place one key further down."""
        keys = (*self.keys, key)
        if self.inside:
            return replace(self, keys=keys, inside=False)
        field = field_of(self.models, str(key))
        inside = field is not None and _holds_many(field)
        return Place(models_of(field), keys, field or self.field, self.models, inside)


def _holds_many(field: FieldInfo) -> bool:
    """Return True if a field holds a mapping or a tuple of values."""
    annotations = (field.annotation, *get_args(field.annotation))
    return any(get_origin(annotation) in (dict, tuple) for annotation in annotations)


@dataclass(frozen=True)
class Name:
    """A name in the flat list of a parameter class: of a field, or of a kind of parameters."""

    path: Path
    """The names from the top to this one. The last name of a kind is ``kind = pid``."""
    word: str
    """The name of the field, or the kind."""
    owner: type[BaseModel]
    """The class that has the field, or the class of the kind."""
    setting: Path
    """Path of the setting that the name needs, such as ``controller.kind``. Empty if none."""
    choice: str
    """The value that the setting must have, such as ``pid``."""


@lru_cache(maxsize=32)
def names_of(model: type[BaseModel], path: Path = ()) -> tuple[Name, ...]:
    """Return all names in parameters of a class, for every kind that a part can have.

    A name inside a mapping, such as a gain of a law of the user, has a key in its path. The keys
    come from ``path``, if it leads into the mapping. Otherwise the key is ``NAME``.
    """
    return tuple(_walk(model, path, (), (), ""))


def _walk(
    model: type[BaseModel], keys: Path, prefix: Path, setting: Path, choice: str
) -> Iterator[Name]:
    """Yield the names of a class at the path ``prefix``, which needs ``setting`` = ``choice``."""
    for word, field in model.model_fields.items():
        path = below = (*prefix, word)
        yield Name(path, word, model, setting, choice)
        if _holds_many(field):
            entered = keys[: len(path)] == path and len(keys) > len(path)
            if not entered and not field.is_required() and field.default == ():
                continue  # an empty list has no place for a name
            below = (*path, keys[len(path)] if entered else "NAME")
        more = more_models_of(field) if field.discriminator else ()
        for part in (*models_of(field), *more):
            needed = setting, choice
            if field.discriminator:
                kind = str(kind_of(part))
                yield Name((*path, f"kind = {kind}"), kind, part, setting, choice)
                needed = (*path, "kind"), kind
            elif field.default is None:
                needed = path, "true" if True in words_of(field) else "{}"
            yield from _walk(part, keys, below, *needed)


def advice(model: type[BaseModel], path: Path, here: Models = ()) -> str:
    """Return a remedy for a wrong path, such as ``; did you mean plant.cylinder.mass_kg?``.

    The first of these remedies that applies is returned:

    1. the kind of a part with which the path exists,
    2. paths whose last name is equal to that of the wrong path,
    3. paths whose last name is similar, first at this place and then anywhere,
    4. paths of other classes with an equal last name,
    5. all names that are possible at this place.

    Among several paths, the remedy has those that share most names with the wrong path.

    Parameters
    ----------
    model
        The class whose names are searched. After it, the classes with the decorator
        `searched_for_names` are searched.
    path
        The names from the top of ``model`` to the wrong name.
    here
        The classes of the present parameters to whose fields the last name refers.
    """
    names, word = names_of(model, path), path[-1]
    inner = {name.path[:count] for name in names for count in range(len(name.path))}
    known = [name for name in names if name.path == path]
    known = known or [n for n in names if n.path == path[: len(n.path)] and n.path not in inner]
    if known:
        if need := _need(known, path, here):
            return f"; needs {need}"
        if path[0] == "faults":
            return "; give the whole list, such as faults=[{place: encoder, start_s: 5}]"
        if known[0].path == path:  # in one key of a mapping
            return f"; nest the names: {': {'.join(path)}: …{'}' * (len(path) - 1)}"
        return f"; {'.'.join(known[0].path)} is a single value"
    near = sorted(name for holder in here for name in holder.model_fields)
    words = list(dict.fromkeys(name.word for name in names))
    # From certain to vague: the same name elsewhere, a similar name here, a similar name elsewhere,
    # and the same name in other classes.
    for whole, alike in (
        (model, [word]),
        (model, close_names(word, near, _SIMILAR_HERE)),
        (model, close_names(word, words, _SIMILAR, len(words))),
        *((searched, [word]) for searched in _SEARCHED),
    ):
        found = [name for one in alike for name in names_of(whole, path) if name.word == one]
        if found:
            nearest = listed_names(_nearest(found, path, here))
            if whole is model:
                return f"; did you mean {nearest}?"
            return f"; {whole.__name__} has {nearest}"
    return f"; known here: {shortened(', '.join(near), 200)}" if near else ""


def _nearest(names: list[Name], path: Path, here: Models) -> list[str]:
    """Return the paths of the names that are nearest to a wrong path, with what they need.

    Paths that need nothing come first.

    A name is near if its path and the wrong path have names in common, at their beginnings and at
    their ends, and if parameters ``here`` have the name.
    """
    common = [_in_common(name.path, path) + (name.owner in here) for name in names]
    nearest: dict[tuple[type[BaseModel], str], Name] = {}
    for name, count in zip(names, common, strict=True):
        if count == max(common):
            # The plant and its nominal values have the same classes: the first path is enough.
            nearest.setdefault((name.owner, name.word), name)
    by_path: dict[Path, list[Name]] = {}
    for name in nearest.values():
        by_path.setdefault(name.path, []).append(name)
    ready, needing = [], []
    for place, same in by_path.items():
        if need := _need(same, path, here):
            needing.append(f"{'.'.join(place)} (needs {need})")
        else:
            ready.append(".".join(place))
    return (ready + needing)[:_MOST]


def _in_common(path: Path, other: Path) -> int:
    """Return how many names two paths have in common, from their beginnings and from their ends."""
    count = 0
    for pairs in (zip(path, other, strict=False), zip(path[::-1], other[::-1], strict=False)):
        for one, two in pairs:
            if one != two:
                break
            count += 1
    return count


def _need(names: list[Name], path: Path, here: Models) -> str:
    """Return the setting that a path needs, such as ``controller.kind = smc or pid``.

    ``names`` are the names with this path, one for each kind of parameters that has the path.
    The text is empty if parameters ``here`` have one of the names, or if the wrong path ``path``
    leads into the part that the setting makes.
    """
    first = names[0]
    entered = path[: len(first.setting)] == first.setting and first.path != path
    if not first.setting or entered or any(name.owner in here for name in names):
        return ""
    choices = listed_names(dict.fromkeys(name.choice for name in names))
    return f"{'.'.join(first.setting)} = {choices}"


def unknown_attribute(model: type[BaseModel], name: str) -> str:
    """Return a message for an attribute that the objects of a parameter class do not have."""
    return f"{model.__name__} has no attribute {shortened(name)}{advice(model, (name,), (model,))}"


def frozen(model: type[BaseModel], name: str, value: str) -> str:
    """Return the error message for a user who assigns to the attribute ``name`` of parameters.

    Parameters
    ----------
    model
        Class of the parameters.
    name
        Name of the attribute.
    value
        The assigned value as Python text.
    """
    if name not in model.model_fields:
        return unknown_attribute(model, name)
    places = [
        f'{whole.__name__.lower()}.changed({{"{".".join(known.path)}": {value}}})'
        for whole in _SEARCHED
        for known in names_of(whole)
        if (known.owner, known.word) == (model, name)
    ]
    change = [*places, f'parameters.changed({{"{name}": {value}}})'][0]
    return f"{model.__name__} is frozen; make a changed copy: {change}"
