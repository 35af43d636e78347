"""Control laws of the user: plain functions or Drake systems, named by file or module.

A law is known by its object, or across processes by the fingerprint of its code and values.
"""

from __future__ import annotations

import copy
import copyreg
import hashlib
import importlib.util
import inspect
import math
import sys
import sysconfig
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from functools import cached_property, lru_cache
from numbers import Real
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MappingProxyType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
)
from typing import Any, NamedTuple

import cloudpickle
import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from kneexo.errors import ParameterError, close_names, question, shortened
from kneexo.parameters.faults import shown_value
from kneexo.user_code import function_at, user_code

LAW_INPUTS = {
    "rod_extension": 1,
    "rod_reference": 4,
    "estimated_state": 3,
    "knee_angle": 1,
    "knee_reference": 4,
    "encoder_reading": 1,
    "rod_state": 3,
}
"""For each measurement or reference that a control law can read, the number of its elements.

``rod_extension`` is in m, ``rod_reference`` is x_d in m and its derivatives to the third,
``estimated_state`` is position, velocity and acceleration of the rod in SI units, ``knee_angle`` is
in rad, and ``knee_reference`` is θ_d in rad and its derivatives to the third. ``encoder_reading``
is θ_4 in rad as the encoder reports it. ``rod_state`` is the true position, velocity and
acceleration of the rod, only with the estimator ``exact``.
"""

_RESERVED = ("_", "command_limit_rad_s", "initial_state_")
"""Beginnings of names that no gain can have, because parameters of the law's system have them."""
_DIGITS = 12  # hexadecimal digits of a digest in a text
_NOT_OF_USERS = (
    str(Path(__file__).parents[1]),
    *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")),
)
"""Directories of code that the versions of kneexo and of the libraries identify."""


class LawArguments(NamedTuple):
    """The arguments of a law that is a function."""

    inputs: tuple[str, ...]
    """Names in `LAW_INPUTS`."""
    time: bool
    """Whether the law has the argument ``time_s``."""
    state: bool
    """Whether the law has the argument ``state``."""
    initial_state: tuple[float, ...]
    """Default of the argument ``state``; empty without default."""
    gains: dict[str, float]
    """Dictionary from each argument with a number as default to this number."""


class Law:
    """A control law: a function, an object that can be called, or a Drake system.

    ``target`` is the function, the object or the system itself. It can also be a class or function
    without arguments, or a function with the argument ``scenario``, that returns a Drake system.
    ``name`` is ``FILE.py:NAME`` or ``MODULE:NAME``. Two laws are equal if their names are equal,
    and their targets are the same object or have equal fingerprints (`fingerprint`). ``memo`` holds
    results that other modules have computed about this law.
    """

    def __init__(self, target: Any, name: str | None = None) -> None:
        """Wrap a law. Raises `ParameterError` if ``target`` is neither callable nor a system."""
        if hasattr(target, "get_instantiation"):  # a template of Drake: its class for floats
            target = target[None]
        if not (callable(target) or _is_system(target)):
            raise ParameterError(
                f"law = {shown_value(target)}: must be a function, a Drake system, or "
                f"their name as text, FILE.py:NAME"
            )
        if inspect.iscoroutinefunction(target):
            raise ParameterError(f"law = {shown_value(target)}: is async; remove the word async")
        self.target = target
        self.name = name or _name_of(target)
        self.memo: dict[Any, Any] = {}

    @classmethod
    def from_text(cls, text: str, directory: str | Path = ".") -> Law:
        """Import the law with a name ``FILE.py:NAME`` or ``MODULE:NAME``.

        A relative path of a file starts at ``directory``. ``#`` and a digest may follow the name.
        Raises `ParameterError` if there is no such law, or if the law has another digest.
        """
        name, _, digest = text.partition("#")
        place, _, path = name.rpartition(":")
        subject = f"law {shortened(name)!r}"
        if "<" in name or place == "__main__":
            raise ParameterError(
                f"{subject}: existed only in the Python session that made it; must be a function "
                f"in a file, FILE.py:NAME"
            )
        if not place or not path or ".py:" in place:
            raise ParameterError(f"{subject}: must be FILE.py:NAME, such as my.py:law")
        if place.endswith(".py"):
            file = Path(directory, place).resolve()
            if not file.is_file():
                raise ParameterError(f"{subject}: there is no file {shortened(str(file), 200)}")
            name = f"{file}:{path}"
            with user_code(f"{subject}: the file cannot be read"):
                source = file.read_bytes()
            if file in _importing:
                raise ParameterError(
                    f"{subject}: importing the file loads this law again; put the lines that use "
                    f"the law below `if __name__ == '__main__':`"
                )
            _forget_changed_helpers()
            with user_code(f"{subject}: the file fails"):
                module = _module(file, hashlib.sha256(source).hexdigest())
            if not hasattr(module, path):
                known = [n for n, v in vars(module).items() if callable(v) and n[:1] != "_"]
                hint = question(close_names(path, known) or known[:4])
                raise ParameterError(f"{subject}: the file has no {shortened(path)!r}{hint}")
            law = cls(getattr(module, path), name)
        else:
            law = cls(function_at(name, subject), name)
        if digest and (law.fingerprint or "")[: len(digest)] != digest:
            raise ParameterError(
                f"{subject}: the code has changed since {digest} was noted; leave out "
                f"'#{digest}' to use the code of today"
            )
        return law

    def require_name(self) -> None:
        """Raise `ParameterError` unless the name of the law leads to this law in a file or module.

        No name leads to a lambda. The name of an object leads to its class.
        """
        if type(self).from_text(self.name) != self:
            raise ParameterError(
                f"law {self.short_name}: this name leads to other code or values; give the law as "
                f"text, FILE.py:NAME"
            )

    @property
    def fingerprint(self) -> str | None:
        """Digest of the present code and values of the law, which differs after any change of them.

        The digest covers closure, attributes, and the user's functions, classes and modules that
        the law reads. It is None if pickle cannot write one of these values.
        """
        try:
            return hashlib.sha256(repr(_Walk().parts(self.target)).encode()).hexdigest()
        except (_UnknownTypeError, RecursionError, OSError):
            return None

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of all globals and attributes that the code of the user reads."""
        walk = _Walk()
        with suppress(_UnknownTypeError, RecursionError, OSError):
            walk.parts(self.target)
        return frozenset(walk.names)

    def copy_of_target(self) -> Any:
        """Return a copy of an object that can be called, or else the function itself.

        An object may hide state, so each run begins with a copy. Raises `ParameterError` for an
        object that cannot be copied.
        """
        with user_code(f"law {self.short_name}: the object cannot be copied for a run"):
            return copy.deepcopy(self.target)

    @cached_property
    def is_system(self) -> bool:
        """Whether the law is a Drake system, or a class or function that makes one."""
        target = self.target
        is_or_makes = isinstance(target, type) or _is_system(target) or self.takes_scenario
        return is_or_makes or not self._parameters

    @cached_property
    def takes_scenario(self) -> bool:
        """Whether the law is a function that makes a Drake system for its argument ``scenario``."""
        target = self.target
        if isinstance(target, type) or _is_system(target):
            return False
        return "scenario" in self._parameters

    def make_system(self, arguments: Mapping[str, Any] = {}) -> Any:
        """Return a new Drake system.

        ``arguments`` has the scenario and the gains for a law that `takes_scenario`. Raises
        `ParameterError` if the law makes no Drake system, or is a system that Drake cannot clone.
        """
        if _is_system(self.target):
            try:
                clone = self.target.Clone()
            except RuntimeError:  # Drake's error for a system that does not support cloning
                clone = None
            # Drake wraps the clone of a system that is written in Python, and renames its ports.
            if clone is None or (
                clone.num_input_ports()
                and (clone.get_input_port(0).get_name() != self.target.get_input_port(0).get_name())
            ):
                raise ParameterError(
                    f"law {self.short_name}: Drake cannot clone this system; give its class, or a "
                    f"function without arguments that makes the system"
                )
            return clone
        takes = "takes a scenario" if self.takes_scenario else "takes no argument"
        failure = "the function fails" if arguments else "cannot be made without arguments"
        if id(self.target) in _making.get():
            raise ParameterError(
                f"law {self.short_name}: the function asks for its own controller; must build the "
                f"system, or ask for a controller of another kind"
            )
        token = _making.set(_making.get() | {id(self.target)})
        try:
            with user_code(f"law {self.short_name}: {failure}"):
                system = self.target(**arguments)
        finally:
            _making.reset(token)
        if not _is_system(system):
            if isinstance(self.target, type):
                raise ParameterError(
                    f"law {self.short_name}: is a class, but no Drake system; give an object of "
                    f"the class, {self.target.__name__}()"
                )
            raise ParameterError(
                f"law {self.short_name}: {takes} and returns "
                f"{type(system).__name__}; must have an argument of {', '.join(LAW_INPUTS)}, or "
                f"return a Drake system"
            )
        return system

    def any_system(self, arguments: Mapping[str, Any] = {}) -> Any:
        """Return the Drake system of the law itself, or a new one if the law makes systems.

        `make_system` describes ``arguments``.
        """
        return self.target if _is_system(self.target) else self.make_system(arguments)

    @cached_property
    def short_name(self) -> str:
        """The name without the directory of the file."""
        return shortened(self.name.rpartition("/")[2])

    @property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        with user_code(f"law {self.short_name}: has no readable arguments"):
            return inspect.signature(self.target).parameters

    @cached_property
    def arguments(self) -> LawArguments:
        """The arguments of a law that is a function, without ``scenario``.

        Raises `ParameterError` for an unknown argument without a number as default, and for an
        argument beside ``scenario`` that is no gain.
        """
        inputs, gains = [], {}
        flags = {"time_s": False, "state": False}
        initial_state: tuple[float, ...] = ()
        for name, parameter in self._parameters.items():
            default = parameter.default
            if name == "scenario":
                continue
            if self.takes_scenario and (name in LAW_INPUTS or name in flags):
                raise ParameterError(
                    f"law {self.short_name}: has the arguments scenario and {name}; a function of "
                    f"a scenario must return a Drake system, whose ports have names such as {name}"
                )
            if name in LAW_INPUTS:
                inputs.append(name)
            elif name in flags:
                flags[name] = True
                if name == "state" and default is not parameter.empty:
                    with user_code(f"law {self.short_name}: the default of state must be numbers"):
                        initial_state = tuple(map(float, np.atleast_1d(default)))
                    self._require_finite("state", *initial_state)
            elif name.startswith(_RESERVED):
                raise ParameterError(
                    f"law {self.short_name}: the argument {name!r} has a name that kneexo uses; "
                    f"rename the argument"
                )
            elif isinstance(default, Real) and not isinstance(default, bool):
                gains[name] = float(default)
                self._require_finite(name, gains[name])
            else:
                known = [*LAW_INPUTS, *flags]
                hint = question(close_names(name, known))
                raise ParameterError(
                    f"law {self.short_name}: unknown argument {name!r}; must have a number as "
                    f"default, or a name of {', '.join(known)}{hint}"
                )
        return LawArguments(tuple(inputs), flags["time_s"], flags["state"], initial_state, gains)

    def _require_finite(self, name: str, *defaults: float) -> None:
        for default in defaults:
            if not math.isfinite(default):
                raise ParameterError(
                    f"law {self.short_name}: the default {name} = {default} must be finite; give "
                    f"the argument a number"
                )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Law) or self.name != other.name:
            return False
        if self.target is other.target:
            return True
        fingerprint = self.fingerprint
        return fingerprint is not None and fingerprint == other.fingerprint

    def __hash__(self) -> int:
        """Return a hash of the name."""
        return hash(self.name)

    def __str__(self) -> str:
        """Return the name, as scenario files have it."""
        return self.name

    def __repr__(self) -> str:
        """Return the name between quotation marks."""
        return repr(self.name)

    def identity(self) -> str:
        """Return ``NAME#DIGEST``, the name and the begin of the fingerprint.

        Return only the name if the law has no fingerprint.
        """
        fingerprint = self.fingerprint
        return self.name if fingerprint is None else f"{self.name}#{fingerprint[:_DIGITS]}"

    def __reduce__(self) -> tuple[Callable[..., Law], tuple[Any, ...]]:
        """Pickle the code and its values, or else the name if it leads to this law."""
        try:
            return _unpickled, (cloudpickle.dumps(self.target), self.name)
        except Exception as error:  # pickling a user's object may raise any error
            with suppress(ParameterError):
                self.require_name()
                return type(self).from_text, (self.identity(),)
            raise ParameterError(
                f"law {self.short_name}: cannot be sent to worker processes "
                f"({shortened(str(error), 100)}); give a function or the class of the system, or "
                f"use one worker"
            ) from None

    def __deepcopy__(self, memo: Any) -> Law:
        """Return the law itself, because laws do not change."""
        return self

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return pydantic's schema: accept a text or a target; write name and digest."""

        def validate(value: Any, info: core_schema.ValidationInfo) -> Law:
            if isinstance(value, Law):
                return value
            try:
                if isinstance(value, str):
                    return cls.from_text(value, (info.context or {}).get("directory", "."))
                return cls(value)
            except ParameterError as error:
                raise ValueError(str(error)) from None

        return core_schema.with_info_plain_validator_function(
            validate,
            serialization=core_schema.plain_serializer_function_ser_schema(
                Law.identity, return_schema=core_schema.str_schema()
            ),
        )

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        """Return the JSON schema of a law in a scenario file, a text."""
        return {"type": "string"}


def _unpickled(data: bytes, name: str) -> Law:
    return Law(cloudpickle.loads(data), name)


def _is_bound_function(value: Any) -> bool:
    """Whether a value is a function of C++, such as those of Drake, but no method of an object.

    pybind11 (Drake 1.51) hands a capsule to such functions, nanobind (Drake 1.58) has a type.
    """
    binding = value.__self__ if isinstance(value, BuiltinFunctionType) else value
    return type(binding).__name__ in ("PyCapsule", "nb_func")


def _is_system(value: Any) -> bool:
    """Return True for an object of Drake's class System, without an import of Drake."""
    return not isinstance(value, type) and hasattr(value, "CreateDefaultContext")


_making: ContextVar[frozenset[int]] = ContextVar("making", default=frozenset())
"""The id of each function that is making its system, by which recursion is detected."""

_importing: set[Path] = set()
"""Files of laws that are being imported, by which recursion is detected."""


@lru_cache(maxsize=64)
def _module(file: Path, digest: str) -> ModuleType:
    """Execute a file as a module and return the module. ``digest`` is that of its contents.

    The file may import files of its directory, which stays on the path of modules, also for worker
    processes. The module is pickled by value.
    """
    name = f"law_{file.stem}_{digest[:_DIGITS]}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None  # the name ends with .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    _importing.add(file)
    before = set(sys.modules)
    try:
        spec.loader.exec_module(module)
    except BaseException:  # SystemExit of the user's file too
        del sys.modules[name]
        raise
    finally:
        _importing.discard(file)
    cloudpickle.register_pickle_by_value(module)
    for other in sys.modules.keys() - before:
        path = Path(getattr(sys.modules[other], "__file__", None) or "")
        if path.is_relative_to(file.parent) and path.is_file():
            _helpers[other] = path, path.read_bytes()
    return module


_helpers: dict[str, tuple[Path, bytes]] = {}
"""Files, with their contents, of the modules that files of laws import from their directories."""


def _forget_changed_helpers() -> None:
    """Let files of laws import their modules anew if one of these modules has changed since."""
    if any(not p.is_file() or p.read_bytes() != content for p, content in _helpers.values()):
        for name in _helpers:
            sys.modules.pop(name, None)
        _helpers.clear()
        _module.cache_clear()


def _name_of(target: Any) -> str:
    """Return ``MODULE:NAME`` of a target, or ``FILE:NAME`` if its module is no importable one."""
    if not hasattr(target, "__qualname__"):
        target = type(target)
    module = str(target.__module__)
    if module == "__main__" or "<" in target.__qualname__:
        try:
            return f"{inspect.getsourcefile(target)}:{target.__qualname__}"
        except TypeError:  # a class that was typed into an interpreter
            pass
    return f"{module}:{target.__qualname__}"


class _UnknownTypeError(Exception):
    """A value of a law that cannot be compared with a value of another process."""


class _Walk:
    """Turns a law into nested tuples of texts and numbers that stand for its code and its values.

    Equal tuples mean equal laws. The walk follows what pickle would keep of a value, so it covers
    every type that pickle can write, and raises `_UnknownTypeError` for all others.
    """

    def __init__(self) -> None:
        # The values are kept, because Python uses the id of a freed value again.
        self._seen: dict[int, tuple[int, Any]] = {}
        self.names: set[str] = set()
        """Names of globals and attributes that the functions found so far read."""

    def parts(self, value: Any) -> Any:
        """Return nested tuples of texts and numbers that stand for ``value``."""
        if value is None or type(value) in (bool, int, float, complex, str, bytes, type(...)):
            return value
        if id(value) in self._seen:
            return "seen", self._seen[id(value)][0]
        self._seen[id(value)] = len(self._seen), value
        match value:
            case CodeType():
                constants = self._all(value.co_consts)
                return value.co_code, value.co_names, value.co_varnames, constants
            case FunctionType():
                return self._function(value)
            case ModuleType():
                return self._module(value, ())
            case _ if _is_bound_function(value):
                return value.__module__, value.__qualname__
            case MethodType():
                return self._all((value.__func__, value.__self__))
            case staticmethod() | classmethod():
                return self.parts(value.__func__)
            case property():
                return self._all((value.fget, value.fset))
            case cached_property():
                return self.parts(value.func)
            case type():
                return self._class(value)
        if hasattr(value, "get_instantiation"):  # a template of Drake
            return self.parts(value[None])
        kind = type(value)
        if kind is np.ndarray and value.dtype != object:
            return value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()
        if kind in (dict, MappingProxyType):
            return self._all(value.keys()), self._all(value.values())
        if kind in (set, frozenset):
            return kind.__name__, sorted(map(repr, self._all(value)))
        if kind in (list, tuple):
            return kind.__name__, self._all(value)
        return self._pickled(value)

    def _all(self, values: Iterable[Any]) -> tuple[Any, ...]:
        return tuple(map(self.parts, values))

    def _function(self, function: FunctionType) -> Any:
        code = function.__code__
        if code.co_filename.startswith(_NOT_OF_USERS):
            return function.__module__, function.__qualname__
        cells = (cell.cell_contents for cell in function.__closure__ or () if _filled(cell))
        names = _names(code)
        self.names.update(names)
        found = {name: function.__globals__[name] for name in names if name in function.__globals__}
        return (
            *self._all((code, function.__defaults__, function.__kwdefaults__, vars(function))),
            self._all(cells),
            [
                (name, self._module(g, names) if isinstance(g, ModuleType) else self.parts(g))
                for name, g in found.items()
            ],
        )

    def _module(self, module: ModuleType, names: Iterable[str]) -> Any:
        """Return parts of a module: its file, and those of its ``names`` that code may read."""
        file = getattr(module, "__file__", None)
        if not file or file.startswith(_NOT_OF_USERS):
            return module.__name__, str(getattr(module, "__version__", ""))
        values = [(name, self.parts(vars(module)[name])) for name in names if name in vars(module)]
        return module.__name__, Path(file).read_bytes(), values

    def _class(self, value: type) -> Any:
        package = value.__module__.partition(".")[0]  # a compiled module may have no file
        modules = map(sys.modules.get, (value.__module__, package))
        file = next(filter(None, (getattr(module, "__file__", None) for module in modules)), "")
        if value.__module__ == "builtins" or file.startswith(_NOT_OF_USERS):
            return value.__module__, value.__qualname__
        members = [
            (name, self.parts(member))
            for name, member in vars(value).items()
            if name not in _NO_MEMBERS
            and not isinstance(member, MemberDescriptorType | GetSetDescriptorType)
        ]
        return value.__qualname__, members, self._all(value.__bases__)

    def _pickled(self, value: Any) -> Any:
        """Return parts of what pickle would keep of a value."""
        if hasattr(value, "__wrapped__"):  # a cached function, of which pickle keeps the name only
            return self.parts(value.__wrapped__)
        try:
            reduce = copyreg.dispatch_table.get(type(value))
            reduced = value.__reduce_ex__(4) if reduce is None else reduce(value)
        except Exception as error:  # a type of the user may raise any error
            raise _UnknownTypeError(type(value).__name__) from error
        if isinstance(reduced, str):  # a global name
            return str(getattr(value, "__module__", "")), reduced
        make, arguments, state, items, pairs = (*reduced, None, None, None)[:5]
        return self._all((make, arguments, state, [*(items or ())], [*(pairs or ())]))


_NO_MEMBERS = {"__dict__", "__weakref__", "__module__", "__doc__", "__firstlineno__", "_abc_impl"}
"""Names in a class that do not change what its objects compute."""


def _filled(cell: Any) -> bool:
    try:
        cell.cell_contents  # noqa: B018  (raises ValueError before the variable has a value)
    except ValueError:
        return False
    return True


def _names(code: CodeType) -> list[str]:
    """Return the names of globals and attributes that a code and its nested functions read."""
    names = list(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names += _names(constant)
    return names
