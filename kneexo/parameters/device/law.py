"""Control laws of the user: plain functions or Drake systems, named by file or module.

In a process a law is known by its object. A law that a scenario file names is data until its first
use: only then the file of the law is imported.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import importlib.util
import inspect
import math
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from functools import cached_property, lru_cache
from io import BytesIO
from numbers import Real
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import cloudpickle
import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from kneexo.common.ports import input_ports
from kneexo.common.user_code import NOT_OF_USERS, function_at, text_of, user_code
from kneexo.errors import ParameterError, close_names, question, shortened
from kneexo.parameters.fields.messages import shown_value

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


class LawArguments(NamedTuple):
    """The arguments of a law that is a function."""

    inputs: tuple[str, ...]
    """Names in `LAW_INPUTS`."""
    names: tuple[str, ...]
    """All names, but for ``scenario``: inputs, ``time_s``, ``state`` and gains."""
    initial_state: tuple[float, ...]
    """Default of the argument ``state``; empty without default."""
    gains: dict[str, float]
    """Dictionary from each argument with a number as default to this number."""


class Law:
    """A control law: a function, an object that can be called, or a Drake system.

    ``target`` is the function, the object or the system itself. It can also be a class or function
    without arguments, or a function with the argument ``scenario``, that returns a Drake system.
    ``name`` is ``FILE.py:NAME`` or ``MODULE:NAME``, and ``written`` is the name that a scenario
    file gets. Two laws are equal if their targets are the same object, or if they have the same
    name in files of equal names and contents.
    """

    noun = "law"
    """What messages call the object."""
    elsewhere = "name a law that you trust with --law"
    """How a user names code that lies elsewhere."""

    def __init__(self, target: Any, name: str | None = None) -> None:
        """Wrap a law. Raises `ParameterError` if ``target`` is neither callable nor a system."""
        self.target = _checked(target, self.noun)
        self.name = self.written = name or _name_of(self.target)

    @classmethod
    def from_text(cls, text: str, directory: str | Path = ".", *, is_data: bool = False) -> Law:
        """Import the law with a name ``FILE.py:NAME`` or ``MODULE:NAME``.

        Parameters
        ----------
        text
            The name of the law.
        directory
            Where a relative path of a file starts.
        is_data
            True: a scenario file in ``directory`` has the name. Such a file may be a stranger's, so
            it names a Python file in ``directory`` or below, and no link leads out of it. The file
            of the law is imported when `target` is read first.

        Raises
        ------
        ParameterError
            There is no such law.
        """
        place, _, path = text.rpartition(":")
        subject = f"{cls.noun} {shortened(text)!r}"
        if not place or not path or ".py:" in place:
            raise ParameterError(f"{subject}: must be FILE.py:NAME, such as my.py:{cls.noun}")
        law = cls.__new__(cls)
        law.name = text
        with user_code(f"{subject}: the file cannot be read"):
            file = Path(directory, place).resolve() if place.endswith(".py") else None
            if is_data and not (file and file.is_relative_to(Path(directory).resolve())):
                raise ParameterError(
                    f"{subject}: must be NAME.py:function, in a file beside or below the scenario "
                    f"file; copy the {cls.noun} there, or {cls.elsewhere}"
                )
            if file is not None:
                if not file.is_file():
                    raise ParameterError(f"{subject}: there is no file {shortened(str(file), 200)}")
                law.file, law.name = file, f"{file}:{path}"
        law.written = text if is_data else law.name
        if not is_data:
            _ = law.target
        return law

    @cached_property
    def target(self) -> Any:
        """The function, object or system; the first reading of a named law runs its file."""
        subject, path = f"{self.noun} {self.short_name!r}", self.name.rpartition(":")[2]
        if vars(self).get("file") is None:
            return _checked(function_at(self.name, subject), self.noun)
        if self.file in _importing:
            raise ParameterError(
                f"{subject}: importing the file loads this law again; put the lines that use the "
                f"law below `if __name__ == '__main__':`"
            )
        with user_code(f"{subject}: the file fails"):
            module = _module(self.file, tuple(self.sources.items()))
        if not hasattr(module, path):
            known = [n for n, v in vars(module).items() if callable(v) and n[:1] != "_"]
            hint = question(close_names(path, known) or known[:4])
            raise ParameterError(f"{subject}: the file has no {shortened(path)!r}{hint}")
        return _checked(getattr(module, path), self.noun)

    @cached_property
    def memo(self) -> dict[Any, Any]:
        """What a process has found out about the law. All laws of one function share it."""
        is_function = isinstance(self.target, FunctionType)
        return _memos.setdefault(self.target, {}) if is_function else {}

    @property
    def is_loaded(self) -> bool:
        """Whether `target` is there; False for a law of a scenario file that nothing has used."""
        return "target" in vars(self)

    def require_name(self) -> None:
        """Raise `ParameterError` unless a file of the user has this very law under its name.

        A lambda and an inner function are refused, because the file has no name for them. An object
        that is passed as ``law`` is refused, because its name is the name of its class.
        """
        if not self.sources:
            raise ParameterError(
                f"{self.subject}: this name leads to no file with this law; give a law of a "
                f"file as text, FILE.py:NAME"
            )

    @cached_property
    def file(self) -> Path | None:
        """File of a user in which the name of the law leads to this very law, or None."""
        module = sys.modules.get(getattr(self.target, "__module__", None) or "")
        file = getattr(module, "__file__", None) or ""
        known = vars(module or self).get(self.name.rpartition(":")[2])
        if known is None or _checked(known) is not self.target or not file.endswith(".py"):
            return None
        return None if file.startswith(NOT_OF_USERS) else Path(file).resolve()

    @cached_property
    def sources(self) -> dict[str, bytes]:
        """Contents of `file` and of the modules that it imports from its folder, by file name.

        The law's file is first. Empty without `file`.
        """
        with user_code(f"{self.subject}: the file cannot be read"):
            return {} if self.file is None else _sources(self.file)

    @property
    def digest(self) -> str:
        """Digest of `sources`; an empty text without sources."""
        return _digest(tuple(self.sources.items())) if self.sources else ""

    @cached_property
    def names(self) -> frozenset[str]:
        """Words in the file of the law's code and in the files that it imports from its folder.

        Code without a file, such as code that was typed in, might have ``if_then_else``.
        """
        code = getattr(self.target, "func", self.target)  # of a functools.partial
        code = code if inspect.isroutine(code) or inspect.isclass(code) else type(code)
        with suppress(TypeError, OSError):
            file = Path(inspect.getsourcefile(code) or "")
            return _words(file, file.stat().st_mtime_ns)
        return frozenset({"if_then_else"})

    def copy_of_target(self) -> Any:
        """Return a copy of an object that can be called, or else the function itself.

        An object may hide state, so each run begins with a copy. Raises `ParameterError` for an
        object that cannot be copied.
        """
        with user_code(f"{self.subject}: the object cannot be copied for a run"):
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
            if clone is None or [*input_ports(clone)] != [*input_ports(self.target)]:
                raise ParameterError(
                    f"{self.subject}: Drake cannot clone this system; give its class, or a "
                    f"function that makes the system"
                )
            return clone
        takes = "takes a scenario" if self.takes_scenario else "takes no argument"
        failure = "the function fails" if arguments else "cannot be made without arguments"
        if id(self.target) in _making.get():
            raise ParameterError(
                f"{self.subject}: the function asks for its own controller; must build the "
                f"system, or ask for a controller of another kind"
            )
        token = _making.set(_making.get() | {id(self.target)})
        try:
            with user_code(f"{self.subject}: {failure}"):
                system = self.target(**arguments)
        finally:
            _making.reset(token)
        if not _is_system(system):
            if isinstance(self.target, type):
                raise ParameterError(
                    f"{self.subject}: is a class, but no Drake system; give an object of "
                    f"the class, {self.target.__name__}()"
                )
            raise ParameterError(
                f"{self.subject}: {takes} and returns "
                f"{type(system).__name__}; must have an argument of {', '.join(LAW_INPUTS)}, or "
                f"return a Drake system"
            )
        return system

    @property
    def subject(self) -> str:
        """Name of the law at the beginning of messages."""
        return f"{self.noun} {self.short_name}"

    @cached_property
    def short_name(self) -> str:
        """The name without the directory of the file."""
        # Drake's template of a leaf system marks the name of its class for floats.
        return shortened(self.name.rpartition("/")[2].partition("_𝓣")[0])

    @property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        with user_code(f"{self.subject}: has no readable arguments"):
            return inspect.signature(self.target).parameters

    @cached_property
    def arguments(self) -> LawArguments:
        """The arguments of a law that is a function, without ``scenario``.

        Raises `ParameterError` for an unknown argument without a number as default, and for an
        argument beside ``scenario`` that is no gain.
        """
        names, gains = [], {}
        known = (*LAW_INPUTS, "time_s", "state")
        initial_state: tuple[float, ...] = ()
        for name, parameter in self._parameters.items():
            default = parameter.default
            if name == "scenario":
                continue
            if self.takes_scenario and name in known:
                raise ParameterError(
                    f"{self.subject}: has the arguments scenario and {name}; a function of "
                    f"a scenario must return a Drake system, whose ports have names such as {name}"
                )
            if name in known:
                names.append(name)
                if name == "state" and default is not parameter.empty:
                    initial_state = self._numbers(name, default)
            elif name.startswith(_RESERVED):
                raise ParameterError(
                    f"{self.subject}: the argument {name!r} has a name that kneexo uses; "
                    f"rename the argument"
                )
            elif isinstance(default, Real) and not isinstance(default, bool):
                (gains[name],) = self._numbers(name, default)
            else:
                hint = question(close_names(name, known))
                raise ParameterError(
                    f"{self.subject}: unknown argument {name!r}; must have a number as "
                    f"default, or a name of {', '.join(known)}{hint}"
                )
        inputs = tuple(name for name in names if name in LAW_INPUTS)
        return LawArguments(inputs, (*names, *gains), initial_state, gains)

    def _numbers(self, name: str, default: Any) -> tuple[float, ...]:
        """Return the default of an argument as finite numbers."""
        with user_code(f"{self.subject}: the default of {name} must be numbers"):
            numbers = tuple(map(float, np.atleast_1d(default)))
        for number in numbers:
            if not math.isfinite(number):
                raise ParameterError(
                    f"{self.subject}: the default {name} = {number} must be finite; give "
                    f"the argument a number"
                )
        return numbers

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Law):
            return False
        if self.is_loaded and other.is_loaded:
            one, two = self.target, other.target
            if one is two or (isinstance(one, MethodType) and one == two):
                return True
        if not self.digest or self.digest != other.digest:
            return False
        return hash(self) == hash(other)  # also a copy of the files in a run's folder

    def __hash__(self) -> int:
        """Return a hash of the name without file or module."""
        return hash(self.name.rpartition(":")[2])

    def __str__(self) -> str:
        """Return the name, as scenario files have it."""
        return self.name

    def __repr__(self) -> str:
        """Return the name between quotation marks."""
        return repr(self.name)

    def __reduce__(self) -> tuple[Callable[..., Law], tuple[Any, ...]]:
        """Pickle the code and its values, or else the name if it leads to this law."""
        sources = tuple(self.sources.items())
        try:
            data = BytesIO()
            _Pickler(data).dump(self.target)
            return _unpickled, (type(self), data.getvalue(), self.name, self.file, sources)
        except Exception as error:  # pickling a user's object may raise any error
            if sources:
                return type(self).from_text, (self.name,)
            raise ParameterError(
                f"{self.subject}: cannot be sent to worker processes "
                f"({shortened(text_of(error), 100)}); give a function or the class of the system, "
                f"or use one worker"
            ) from None

    def __deepcopy__(self, memo: Any) -> Law:
        """Return the law itself, because laws do not change."""
        return self

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return pydantic's schema: accept a text or a target; write the name.

        A text of a scenario file is data, so its law is not imported yet: see `from_text`.
        """

        def validate(value: Any, info: core_schema.ValidationInfo) -> Law:
            if isinstance(value, Law):
                return value
            try:
                if not isinstance(value, str):
                    return cls(value)
                directory = (info.context or {}).get("directory")  # of a scenario file
                return cls.from_text(value, directory or ".", is_data=directory is not None)
            except ParameterError as error:
                raise ValueError(str(error)) from None

        return core_schema.with_info_plain_validator_function(
            validate,
            serialization=core_schema.plain_serializer_function_ser_schema(
                str, return_schema=core_schema.str_schema()
            ),
        )

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        """Return the JSON schema of a law in a scenario file, a text."""
        return {"type": "string"}


class _Pickler(cloudpickle.Pickler):
    """Pickler of the user's code, which pickles the metaclass of Drake's classes by its name.

    cloudpickle would pickle the metaclass by value, and such a copy cannot be made.
    """

    def reducer_override(self, obj: Any) -> Any:
        """Return how an object is made again, as `pickle.Pickler.reducer_override` does."""
        framework = sys.modules.get("pydrake.systems.framework")
        if framework is not None and obj is type(framework.System):
            return _metaclass_of_drake, ()
        return super().reducer_override(obj)


def _metaclass_of_drake() -> type:
    from pydrake.systems.framework import System

    return type(System)


@lru_cache(maxsize=64)  # a worker process gets the same law with each unit of work
def _unpickled(
    kind: type[Law],
    data: bytes,
    name: str,
    file: Path | None,
    sources: tuple[tuple[str, bytes], ...],
) -> Law:
    law = kind(cloudpickle.loads(data), name)
    law.file, law.sources = file, dict(sources)
    return law


def _checked(target: Any, noun: str = "law") -> Any:
    """Return the target of a law. Raise `ParameterError` for one that cannot be a law."""
    # Attributes are looked up in the type, because an object may run code at each look-up.
    if hasattr(type(target), "get_instantiation"):  # a template of Drake: its class for floats
        target = target[None]
    if not (callable(target) or _is_system(target)):
        raise ParameterError(
            f"{noun} = {shown_value(target)}: must be a function, a Drake system, or "
            f"their name as text, FILE.py:NAME"
        )
    if inspect.iscoroutinefunction(target):
        raise ParameterError(f"{noun} = {shown_value(target)}: is async; remove the word async")
    return target


def _is_system(value: Any) -> bool:
    """Return True for an object of Drake's class System, without an import of Drake."""
    return not isinstance(value, type) and hasattr(type(value), "CreateDefaultContext")


_making: ContextVar[frozenset[int]] = ContextVar("making", default=frozenset())
"""The id of each function that is making its system, by which recursion is detected."""

_memos: WeakKeyDictionary[FunctionType, dict[Any, Any]] = WeakKeyDictionary()

_importing: set[Path] = set()
"""Files of laws that are being imported, by which recursion is detected."""


def _sources(file: Path) -> dict[str, bytes]:
    """Return the contents of a Python file, and of the modules that it imports from its folder."""
    found, waiting = dict[str, bytes](), [file]
    while waiting:
        path = waiting.pop()
        if path.name not in found and path.is_file():
            found[path.name] = path.read_bytes()
            waiting += [path.with_name(f"{name}.py") for name in _imports(found[path.name])]
    return found


def _imports(source: bytes) -> list[str]:
    """Return the names of the modules that a source imports; no names if it is not Python."""
    names = []
    with warnings.catch_warnings(action="ignore"), suppress(SyntaxError, ValueError):
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                names += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names.append(node.module or "")
    return [name for name in names if name not in sys.stdlib_module_names]


def _digest(sources: tuple[tuple[str, bytes], ...]) -> str:
    return hashlib.sha256(repr(sources).encode()).hexdigest()


@lru_cache(maxsize=64)
def _words(file: Path, time_ns: int) -> frozenset[str]:
    """Return the words in `_sources` of a file that was changed last at ``time_ns``."""
    text = b" ".join(_sources(file).values()).decode(errors="replace")
    return frozenset(re.findall(r"\w+", text))


@lru_cache(maxsize=64)
def _module(file: Path, sources: tuple[tuple[str, bytes], ...]) -> ModuleType:
    """Execute the file of a law as a module and return the module.

    ``sources`` has name and content of the file, and then of each module that the file imports from
    its folder. These modules are imported from this folder, also if the folder of another law has
    modules of the same names. They are imported again if one of them has changed. The folder stays
    on Python's search path, because functions may import later. The file and the modules from its
    folder are pickled by value, so worker processes need no file. If the file is the script that is
    running, it is not executed again: the result is the module ``__main__``.
    """
    main = sys.modules["__main__"]
    if Path(getattr(main, "__file__", None) or "").resolve() == file:
        return main
    helpers = {str(file.with_name(name)): content for name, content in sources[1:]}
    changed = any(_imported.get(path, content) != content for path, content in helpers.items())
    _imported.update(helpers)
    for path in helpers:
        place = getattr(sys.modules.get(Path(path).stem), "__file__", None) or ""
        if place and not place.startswith(NOT_OF_USERS) and (changed or place != path):
            del sys.modules[Path(path).stem]
    name = f"law_{file.stem}_{_digest(sources)[:12]}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None  # the name ends with .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    sys.path.insert(0, str(file.parent))
    _importing.add(file)
    try:
        spec.loader.exec_module(module)
    except BaseException:  # SystemExit of the user's file too
        del sys.modules[name]
        raise
    finally:
        _importing.discard(file)
        sys.path.remove(str(file.parent))
    if str(file.parent) not in sys.path:  # for imports in functions
        sys.path.append(str(file.parent))
    cloudpickle.register_pickle_by_value(module)
    for helper in map(sys.modules.get, (Path(path).stem for path in helpers)):
        if getattr(helper, "__file__", None) in helpers:
            cloudpickle.register_pickle_by_value(helper)
    return module


_imported: dict[str, bytes] = {}
"""Contents of the modules beside the files of laws when they were imported, by path."""


def _name_of(target: Any) -> str:
    """Return ``MODULE:NAME`` of a target, or ``FILE:NAME`` if its module is no importable one."""
    if not isinstance(target, type | FunctionType | MethodType | BuiltinFunctionType):
        target = type(target)
    module = str(target.__module__)
    if module == "__main__" or "<" in target.__qualname__:
        try:
            return f"{inspect.getsourcefile(target)}:{target.__qualname__}"
        except TypeError:  # a class that was typed into an interpreter
            pass
    return f"{module}:{target.__qualname__}"
