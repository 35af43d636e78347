"""Fields of the parameter classes: numbers with unit, range and provenance.

pydantic validates the values. This module adds unit and provenance to pydantic's fields.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from os import PathLike
from typing import TYPE_CHECKING, Any, Self, get_args, get_origin

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)

from kneexo.errors import ParameterError, shortened
from kneexo.parameters.fields.fields import Words, limits_of, unit_of, words_of
from kneexo.parameters.fields.messages import one_line, shown_value
from kneexo.parameters.fields.names import Place, advice, frozen, unknown_attribute
from kneexo.parameters.fields.replaced import believed, is_replaced


def quantity(
    default: float | None,
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


def choice(default: Any, source: str, *, words: Mapping[Any, Any] | None = None) -> Any:
    """Make a pydantic field for a value without unit, such as a switch or name, with provenance.

    ``words`` maps words that the field accepts to the values for which they stand.
    """
    field: Any = Field(default=default, json_schema_extra={"unit": "", "source": source})
    return named(field, words) if words else field


def optional_part(source: str) -> Any:
    """Make a pydantic field for parameters that are left out, unless given or switched on.

    The words true and false stand for the default parameters and for none. ``source`` is the
    provenance.
    """
    return choice(None, source, words={True: {}, False: None})


def named(field: Any, words: Mapping[Any, Any]) -> Any:
    """Return a pydantic field that accepts ``words`` for the values for which they stand."""
    field.metadata.append(Words(words))
    return field


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


@cache
def _default_kinds(model: type[BaseModel]) -> tuple[tuple[str, str], ...]:
    """Return the name of each union field that has a default, with the default's ``kind``."""
    return tuple(
        (name, field.default.kind)
        for name, field in model.model_fields.items()
        if field.discriminator and not field.is_required()
    )


@cache
def _words(model: type[BaseModel]) -> tuple[tuple[str, dict[Any, Any]], ...]:
    """Return the name of each field that accepts words, with the values of the words."""
    fields = ((name, words_of(field)) for name, field in model.model_fields.items())
    return tuple((name, words) for name, words in fields if words)


@cache
def _tuple_fields(model: type[BaseModel]) -> tuple[tuple[str, bool], ...]:
    """Return the name of each tuple field, with True if the tuple can have any length."""
    return tuple(
        (name, get_args(field.annotation)[-1] is ...)
        for name, field in model.model_fields.items()
        if get_origin(field.annotation) is tuple
    )


@cache
def _number_ranges(model: type[Parameters]) -> dict[str, tuple[float, float]]:
    """Return the smallest and the largest float that each field for one float accepts.

    Fields with a validator are left out.
    """
    validators = model.__pydantic_decorators__.field_validators.values()
    validated = {name for validator in validators for name in validator.info.fields}
    largest = sys.float_info.max
    ranges = {}
    for name, field in model.model_fields.items():
        if field.annotation in (float, float | None) and name not in validated:
            low, high = limits_of(field)
            ranges[name] = max(low, -largest), min(high, largest)
    return ranges


@cache
def _checks(model: type[Parameters]) -> list[Callable[[Any], Any]]:
    """Return the functions of a class that check the values of an object against each other."""
    validators = model.__pydantic_decorators__.model_validators.values()
    return [validator.func for validator in validators if validator.info.mode == "after"]


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


def require_object(name: str, value: Any, kind: type[Any], example: str = "") -> None:
    """Raise `ParameterError` if an argument is no object of a class; the message has an example.

    Parameters
    ----------
    name, value
        The argument.
    kind
        The class.
    example
        Code that makes an object. Empty: a call of the class.
    """
    if not isinstance(value, kind):
        kind_name = f"{kind.__name__}, such as {example or f'{kind.__name__}()'}"
        raise ParameterError(f"{name} = {shown_value(value)}: must be an object of {kind_name}")


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
    for a tuple of any length also accepts a single number. A field for one of several classes also
    accepts the ``kind`` of the class as a word: ``controller="pid"``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _completed(cls, data: Any) -> Any:
        """Bring the data of a user to the types of the fields.

        A word that a field knows, such as ``pid``, becomes its value, a number of NumPy becomes a
        number of Python, and lists and arrays become tuples.

        Also insert the default ``kind`` into mappings without ``kind``.
        """
        if not isinstance(data, dict):
            return data
        data = {
            name: value.item() if isinstance(value, np.generic) else value
            for name, value in data.items()
        }
        for name, words in _words(cls):
            if isinstance(word := data.get(name), str | bool):
                data[name] = words.get(word, word)
        for name, any_length in _tuple_fields(cls):
            if name in data:
                data[name] = _as_tuple(data[name], any_length=any_length)
        for name, kind in _default_kinds(cls):
            if isinstance(part := data.get(name), dict):
                data[name] = {"kind": kind} | part
        return data

    def changed(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with changed values.

        ``values`` maps a dotted path, such as ``plant.cylinder.mass_kg``, to the new value. The
        value can be a mapping or a word, as in a scenario file. A path that is part of another path
        is applied first. A new ``kind`` replaces the part by the defaults of this kind. Raises
        `ParameterError` for a path that the parameters do not have, and for a value out of range.
        """
        if not isinstance(values, Mapping) or not all(isinstance(path, str) for path in values):
            raise ParameterError(
                'changed: must have a mapping from paths to values, such as {"seed": 2}'
            )
        if (copy := self._with_numbers(values)) is not None:
            return copy
        data = {name: believed(value) for name, value in vars(self).items()}
        # Parts before what is in them, and a kind before its values, so that the order of the user
        # does not matter.
        for path in sorted(values, key=lambda path: (path.count("."), not path.endswith(".kind"))):
            *parents, name = path.split(".")
            holder = self._holder(data, path, parents)
            value = values[path]
            if name == "kind" and value != holder.get("kind"):
                holder.clear()
            # A later path may reach into a mapping.
            holder[name] = deepcopy(value) if isinstance(value, dict) else value
        return type(self)(**data)

    def _with_numbers(self, values: Mapping[str, Any]) -> Self | None:
        """Return a copy in which only numbers change; None if that is not enough.

        `changed` describes ``values``. The copy is much faster than a validation of all values,
        because parts without a change are shared. Each number must be a float within the range of
        its field, and the validators of the changed parts must accept the copy. In all other cases
        the result is None.
        """
        if is_replaced(self):
            return believed(self)._with_numbers(values)
        ranges = _number_ranges(type(self))
        update: dict[str, Any] = {}
        parts: dict[str, dict[str, Any]] = {}
        for path, value in values.items():
            name, _, below = path.partition(".")
            if below:
                parts.setdefault(name, {})[below] = value
                continue
            low, high = ranges.get(name, (math.inf, -math.inf))
            if type(value) is not float or not low <= value <= high:
                return None
            update[name] = value
        for name, numbers in parts.items():
            part = vars(self).get(name)
            copy = part._with_numbers(numbers) if isinstance(part, Parameters) else None
            if copy is None:
                return None
            update[name] = copy
        copy = self.model_copy(update=update)
        try:
            for check in _checks(type(self)):
                check(copy)
        except ValueError:
            return None
        return copy

    def _holder(self, data: dict[str, Any], path: str, parents: list[str]) -> dict[str, Any]:
        """Return the mapping in ``data`` at the path ``parents``, as a copy that may change.

        Parts that are parameters or words become mappings. Raises `ParameterError` if there is no
        such part. ``path`` is the whole path, for the message.
        """
        holder, place = data, Place((type(self),))
        for parent in parents:
            place = place.below(parent)
            part = holder.get(parent)
            if isinstance(part, str | bool):
                part = words_of(place.field).get(part, part)
            if isinstance(part, Parameters):  # parts without a change are not validated again
                part = vars(believed(part))
            if not isinstance(part, dict):
                wrong = tuple(path.split("."))
                remedy = advice(type(self), wrong) or advice(
                    type(self), wrong[: len(place.keys)], place.holders
                )
                raise ParameterError(f"{path}: unknown name{remedy}")
            place = place.of_kind(part.get("kind")) or place
            holder[parent] = holder = dict(part)
        # The validation reports a wrong name in an existing mapping.
        return holder

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

    if not TYPE_CHECKING:  # the type checker keeps pydantic's signatures

        def __new__(cls, *values: Any, **_: Any) -> Self:
            """Make an object. Raises `ParameterError` for values without name."""
            if values:
                first = next((name for name in cls.model_fields if name != "kind"), "name")
                line = f"{cls.__name__}: takes values by name, such as {cls.__name__}({first}=…)"
                file = isinstance(values[0], str | PathLike)
                raise ParameterError(line + ("; load_scenario(path) reads a file" if file else ""))
            return super().__new__(cls)

        def __init__(self, **data: Any) -> None:
            """Validate the values. Raises `ParameterError` with a message of one line."""
            with _one_line(type(self)):
                super().__init__(**data)

        # Nested parameters are validated by the outermost constructor, which knows their path.
        __init__.__pydantic_base_init__ = True

        @classmethod
        def model_validate(cls, data: Any, **options: Any) -> Self:
            """Make an object from a mapping. Raises `ParameterError` as the constructor does."""
            with _one_line(cls):
                return super().model_validate(data, **options)

        @classmethod
        def model_validate_json(cls, data: Any, **options: Any) -> Self:
            """Make an object from a JSON text. Raises `ParameterError` as the constructor does."""
            with _one_line(cls):
                return super().model_validate_json(data, **options)

        def model_copy(self, *, update: Mapping[str, Any] | None = None, **options: Any) -> Self:
            """Return a copy. The values of ``update`` are not checked, only their names."""
            for name in (update or {}).keys() - type(self).model_fields.keys():
                raise ParameterError(
                    f"model_copy: {type(self).__name__} has no field {shortened(str(name))}; call "
                    f"changed(), which also reaches into parts"
                )
            return super().model_copy(update=update, **options)

        def __getattr__(self, name: str) -> Any:
            """Raise `AttributeError` with names that are similar to ``name``."""
            if name.startswith("_"):
                return super().__getattr__(name)
            raise AttributeError(unknown_attribute(type(self), name))

        def __setattr__(self, name: str, value: Any) -> None:
            """Raise `ParameterError`, because parameters are frozen."""
            raise ParameterError(frozen(type(self), name, shown_value(value)))

        def __delattr__(self, name: str) -> None:
            """Raise `ParameterError`, because parameters are frozen."""
            raise ParameterError(frozen(type(self), name, "…"))


@contextmanager
def _one_line(model: type[Parameters]) -> Iterator[None]:
    """Context manager: turn pydantic's report into a `ParameterError` with one line."""
    try:
        yield
    except ValidationError as error:
        raise ParameterError(f"{model.__name__}: {one_line(model, error)[1]}") from None
