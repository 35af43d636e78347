"""Parameters of the plant in whose place a part of the user stands.

The plant does not have these numbers, so reading one raises an error. The controller still believes
the numbers. Code that needs the believed numbers reads them by `believed`.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any, TypeVar, cast

from pydantic import BaseModel

from kneexo.errors import ParameterError

P = TypeVar("P")


def replaced(parameters: P, path: str) -> P:
    """Return parameters whose numbers only the controller believes: reading one raises an error.

    ``path`` is the place of the parameters in a scenario. `believed` returns them readable.
    """
    if is_replaced(parameters):
        return parameters
    kind: Any = _replaced_kind(cast(Any, type(parameters)), path)
    copy = kind.__new__(kind)
    # All data of a pydantic model. The model is frozen, and a validator of the new kind could read
    # a number, which raises. So the data is copied without a call of pydantic.
    for name in (
        "__dict__",
        "__pydantic_fields_set__",
        "__pydantic_extra__",
        "__pydantic_private__",
    ):
        object.__setattr__(copy, name, object.__getattribute__(parameters, name))
    return cast(P, copy)


def believed(value: P) -> P:
    """Return a value that can be read, also if it is, or contains, parameters `replaced`."""
    if not isinstance(value, BaseModel):
        return value
    if is_replaced(value) or any(map(is_replaced, vars(value).values())):
        return cast(P, _readable(value))
    return value


@lru_cache(maxsize=64)  # a run asks some 20 times for the believed plant
def _readable(parameters: BaseModel) -> BaseModel:
    if is_replaced(parameters):
        kind: type[BaseModel] = type(parameters).__bases__[0]
        return kind.model_construct(**vars(parameters))
    readable = {name: believed(value) for name, value in vars(parameters).items()}
    return parameters.model_copy(update=readable)


_REPLACED = "Replaced"


def is_replaced(parameters: Any) -> bool:
    """Return whether parameters are those that a part of the user replaces."""
    return type(parameters).__name__ == _REPLACED


@cache
def _replaced_kind(kind: type[BaseModel], path: str) -> type[BaseModel]:
    numbers = {name for name in dir(kind) if name[:1] != "_" and name not in dir(BaseModel)}
    numbers |= {*kind.model_fields} - {"kind"}  # a kind decides the structure

    def read(self: Any, name: str) -> Any:
        if name in numbers:
            raise ParameterError(
                f"needs {path}.{name}, but a part of yours replaces what has this number; leave "
                f"out the part, or ask for what needs no number of it"
            )
        return super(type(self), self).__getattribute__(name)

    members = {
        "__getattribute__": read,
        "__module__": kind.__module__,
        "__reduce__": lambda self: (replaced, (believed(self), path)),
        "__repr_args__": lambda self: believed(self).__repr_args__(),
    }
    return type(_REPLACED, (kind,), members)
