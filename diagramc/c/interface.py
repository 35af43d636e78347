"""Names and types in C of the inputs, outputs and parameters of a model."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

from ..equations.equations import Section
from ..errors import CompilationError, shown
from .checks import distinct_names, require_type
from .printer import Precision, in_ascii, literal

_KEYWORDS = frozenset(
    [
        *("auto", "bool", "break", "case", "char", "const", "continue", "default", "do", "double"),
        *("else", "enum", "extern", "false", "float", "for", "goto", "if", "inline", "int", "long"),
        *("register", "restrict", "return", "short", "signed", "sizeof", "static", "struct"),
        *("switch", "true", "typedef", "union", "unsigned", "void", "volatile", "while"),
        *("_Bool", "_Complex", "_Imaginary", "_Alignas", "_Alignof", "_Atomic", "_Generic"),
        *("_Noreturn", "_Static_assert", "_Thread_local", "asm", "typeof"),
        # C++, because a program in C++ may include the header:
        *("alignas", "alignof", "and", "and_eq", "bitand", "bitor", "catch", "char8_t", "char16_t"),
        *("char32_t", "class", "co_await", "co_return", "co_yield", "compl", "concept"),
        *("consteval", "constexpr", "constinit", "decltype", "delete", "dynamic_cast", "explicit"),
        *("const_cast", "export", "friend", "mutable", "namespace", "new", "noexcept", "not"),
        *("not_eq", "nullptr"),
        *("operator", "or", "or_eq", "private", "protected", "public", "reinterpret_cast"),
        *("requires", "static_assert", "static_cast", "template", "this", "thread_local", "throw"),
        *("try", "typeid", "typename", "using", "virtual", "wchar_t", "xor", "xor_eq"),
        # Macros of the standard headers and of compilers:
        *("NULL", "NAN", "INFINITY", "HUGE_VAL", "HUGE_VALF", "HUGE_VALL", "EOF", "DECIMAL_DIG"),
        *("errno", "math_errhandling", "stdin", "stdout", "stderr", "linux", "unix", "i386"),
    ]
)
_MACRO = re.compile(r"(M|FP|FLT|DBL|LDBL)_[A-Z0-9]\w*|U?INT\w*_(MAX|MIN|C)")
"""Pattern of the macros in math.h, float.h and stdint.h, whose names a model must not use."""

_HEADERS = frozenset(
    [
        *("assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits"),
        *("locale", "math", "setjmp", "signal", "stdalign", "stdarg", "stdatomic", "stdbool"),
        *("stddef", "stdint", "stdio", "stdlib", "stdnoreturn", "string", "tgmath", "threads"),
        *("time", "uchar", "wchar", "wctype"),
    ]
)
"""Headers of the C library. A model's header with the same name would hide the library's."""

_START_MEMBERS = ("initial_x", "initial_d")
"""Members of the parameter struct that hold the initial states; no leaf system gets these names."""

_SIGNALS = {
    "time derivatives": "rate",
    "discrete update": "next",
    "initialization": "start",
}
"""Dictionary from a section's purpose to the first part of the names of the section's signals.

`signal_names` adds numbers.
"""

_LONGEST_NAME = 63
"""Number of characters of a name inside a function that each C99 compiler distinguishes."""

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")

_MEMBER = re.compile(rf"[A-Za-z_][A-Za-z0-9_]{{0,{_LONGEST_NAME - 1}}}")
"""Pattern of the names that a user gives to elements of ports."""

INT32 = (-(2**31), 2**31 - 1)
"""The smallest and the largest int32_t."""


@dataclass(frozen=True)
class Field:
    """One element of an input or output port. The element is a member of a C struct."""

    port: str
    name: str
    is_integer: bool = False
    """If True, the C type is int32_t; if False, the floating-point type of the model."""
    range: tuple[float, float] | None = None
    """Lowest and highest allowed value; None: every finite value is allowed."""
    failed: float | None = None
    """Value of an output after a failed call; None: that of the last successful one."""

    def limits(self, real: Precision) -> list[str]:
        """Return the lowest and highest allowed value as C text, or an empty list without a range.

        The limits of an int32_t are the smallest and the largest whole number within the range.
        """
        if self.range is None:
            return []
        low, high = self.range
        if self.is_integer:
            return [str(math.ceil(low)), str(math.floor(high))]
        return [literal(low, real, self.name), literal(high, real, self.name)]


@dataclass(frozen=True)
class Interface:
    """Names, types and ranges of ports in C, and what a failed call does.

    Parameters
    ----------
    fields
        Dictionary from the name of a port to the C names of its elements. A C name has letters,
        digits and _, and should end in the unit. A name that C or C++ reserves gets an underscore
        at its end. If the port ``x`` is missing in the dictionary, a single element is called
        ``x``, and several elements are called ``x_0``, ``x_1`` …  A port ``θ`` is called ``theta``.
    integers
        Input ports of type int32_t, such as encoder counts.
    ranges
        Dictionary from the C name of an input element to its lowest and highest allowed value.
    failed_outputs
        Dictionary from the C name of an output element to its value after a failed call. All other
        outputs then have their last values.
    accepts_inputs
        If True, the code accepts all inputs, also those that are not finite or out of their range:
        the diagram replaces them. Then a step can fail only because of the model or its
        parameters. After such a failure every step fails until the code is started again.

    Raises `CompilationError` if a name is no C identifier, or if a range is empty or not finite, or
    a value after a failure is no number. `CSource` raises it if the diagram lacks a port or an
    element, or a value after a failure does not fit into the type.
    """

    fields: Mapping[str, Sequence[str]] = field(default_factory=dict)
    integers: frozenset[str] = frozenset()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    failed_outputs: Mapping[str, float] = field(default_factory=dict)
    accepts_inputs: bool = False

    def __post_init__(self) -> None:
        """Check names, ranges and values."""
        for what in ("fields", "ranges", "failed_outputs"):
            require_type(f"interface: {what}", getattr(self, what), Mapping, "a dictionary")
        for port, names in self.fields.items():
            require_type(f"interface: fields of {port!r:.60}", names, Sequence, "a list of names")
            for name in [names] if isinstance(names, str) else names:
                if not isinstance(name, str) or not _MEMBER.fullmatch(name):
                    raise CompilationError(
                        f"interface: the field {shown(f'{name!r:.60}')} of {port!r:.60}: must be a "
                        f"C identifier of at most {_LONGEST_NAME} letters, digits and _"
                    )
        distinct_names("interface: integers", self.integers)
        for name, ends in self.ranges.items():
            _require_range(name, ends)
        for name, value in self.failed_outputs.items():
            require_type(f"interface: {name!r:.60} after a failure", value, Real, "a number")

    def require_ports(self, inputs: Mapping[str, int], outputs: Mapping[str, int]) -> None:
        """Raise `CompilationError` if a name of the interface is unknown, or a range empty.

        ``inputs`` and ``outputs`` map the names of all input and output ports to their sizes.
        """
        for port in self.fields:
            if port not in inputs and port not in outputs:
                known = ", ".join(dict.fromkeys([*inputs, *outputs])) or "none"
                raise CompilationError(
                    f"interface: fields: the port {shown(repr(port))} is unknown; known: {known}"
                )
        for port in self.integers:
            if port not in inputs:
                raise CompilationError(
                    f"{shown(port)}: is no input; only inputs may be int32_t; inputs: "
                    f"{', '.join(inputs) or 'none'}"
                )
        members = self.members(inputs)
        for what, elements in (("ranges", members), ("failed_outputs", self.members(outputs))):
            present = [element.name for element in elements]
            for name in getattr(self, what):
                if name not in present:
                    raise CompilationError(
                        f"interface: {what}: the element {shown(repr(name))} is unknown; known: "
                        f"{', '.join(present) or 'none'}"
                    )
        for member in members:
            low, high = member.range or (0, 0)
            if member.is_integer and not INT32[0] <= math.ceil(low) <= math.floor(high) <= INT32[1]:
                raise CompilationError(
                    f"interface: range of {member.name} = {low:g} … {high:g}: must have a whole "
                    f"number, and lie in {INT32[0]} … {INT32[1]}"
                )

    def members(self, sizes: Mapping[str, int]) -> tuple[Field, ...]:
        """Return the members of the C struct that holds the values of ports, one for each element.

        ``sizes`` maps the name of each port to its size. The members have the order of the ports.
        Raises `CompilationError` if ``fields`` has a wrong number of names for a port, or if two
        members would have the same name.
        """
        members = []
        for port, size in sizes.items():
            default = [port] if size == 1 else [f"{port}_{i}" for i in range(size)]
            names = self.fields.get(port, default)
            names = [names] if isinstance(names, str) else names
            if len(names) != size:
                raise CompilationError(
                    f"{port}: has {len(names)} names in C; must be {size}, one an element"
                )
            for name in map(c_name, names):
                values = self.ranges.get(name), self.failed_outputs.get(name)
                members.append(Field(port, name, port in self.integers, *values))
        _require_unique([field.name for field in members], [field.port for field in members])
        return tuple(members)


def _require_range(name: Any, ends: Any) -> None:
    """Raise `CompilationError` unless ``ends`` are two finite numbers, the lower one first."""
    what = f"interface: range of {name!r:.60}"
    require_type(what, ends, (tuple, list), "a pair of finite numbers (lowest, highest)")
    is_pair = len(ends) == 2 and all(isinstance(end, Real) and math.isfinite(end) for end in ends)
    if not is_pair or ends[0] > ends[1]:
        raise CompilationError(
            f"{what} = {shown(f'{ends!r:.60}')}: must be a pair of finite numbers, the lower one "
            f"first"
        )


def parameter_members(parameters: Sequence[str], root: str) -> tuple[str, ...]:
    """Return the member of the C parameter struct that holds each Context parameter.

    Parameters
    ----------
    parameters
        Names of the Context parameters. A name has the path of the leaf system, a dot, and the name
        of the parameter or ``group[element]``.
    root
        Name of the leaf system in C if the whole diagram is one leaf system, which has no path.

    Returns
    -------
        ``leaf.parameter`` or ``leaf.group_1[2]``. ``leaf`` is the last part of the path, or more
        parts if two paths have the same last part.

    Raises `CompilationError` if two parameters have the same member.
    """
    pairs = [name.rpartition(".")[::2] for name in parameters]
    leaves = _short_names({path for path, _ in pairs})
    members = []
    for path, parameter in pairs:
        leaf = c_name(leaves[path] or root)
        leaf += "_" * (leaf in _START_MEMBERS)
        group = re.fullmatch(r"(\d+)\[(\d+)\]", parameter)
        members.append(
            f"{leaf}.group_{group[1]}[{group[2]}]" if group else f"{leaf}.{c_name(parameter)}"
        )
    _require_unique(members, parameters)
    return tuple(members)


def signal_names(sections: Sequence[Section], root: str, taken: Collection[str]) -> dict[int, str]:
    """Return a dictionary from a graph node to the name of the node's signal in C.

    The signal is an element of an output port, a time derivative, the value of a discrete state
    after an update, or a margin. The name has the short name of the leaf system and the name of the
    signal, for example ``knee_moment_arm`` or ``motor_rate_0``. A node that belongs to several
    sections has the name from the first section.

    Parameters
    ----------
    sections
        The sections of the equations.
    root
        Name of the leaf system in C if the whole diagram is one leaf system, which has no path.
    taken
        Names that the C code uses for other things. A signal with such a name has no entry.
    """
    owners = [section.where.rpartition(": ")[::2] for section in sections]
    leaves = _short_names({path for path, _ in owners})
    names: dict[int, str] = {}
    taken = set(taken)
    for section, (path, purpose) in zip(sections, owners, strict=True):
        signal = _SIGNALS.get(purpose, purpose.removeprefix("output port "))
        start = c_name(f"{leaves[path] or root}_{signal}")
        numbered = len(section.nodes) > 1 or purpose in _SIGNALS
        for element, node in enumerate(section.nodes):
            name = f"{start}_{element}" if numbered else start
            if node not in names and name not in taken and len(name) <= _LONGEST_NAME:
                names[node] = name
                taken.add(name)
    return names


def require_model_name(name: str) -> None:
    """Raise `CompilationError` if ``name`` cannot be the prefix of a model's files and C names.

    ``name`` must be a C identifier of at most 31 characters. Keywords and names of C headers are
    refused.
    """
    require_type("name", name, str, "a C identifier")
    if name.lower() in _HEADERS:
        raise CompilationError(f"name = {name!r}: is a header of C; choose another name")
    if name in _KEYWORDS:
        raise CompilationError(f"name = {name!r}: is reserved in C or C++; choose another name")
    if not _IDENTIFIER.fullmatch(name):
        raise CompilationError(
            f"name = {shown(repr(name))}: must be a C identifier of at most 31 letters, digits "
            f"and _"
        )


def c_name(text: str) -> str:
    """Return the text, changed to a C identifier that is no keyword and no common macro.

    Letters beyond ASCII become their names, so ``θ`` becomes ``theta``.
    """
    name = re.sub(r"[^A-Za-z0-9_]", "_", "".join(map(in_ascii, text)))
    if not name or name[0].isdigit():
        name = f"_{name}" if not name else f"n{name}"
    return f"{name}_" if name in _KEYWORDS or _MACRO.fullmatch(name) else name


def _short_names(paths: Collection[str]) -> dict[str, str]:
    """Return a short name for each system path.

    The short name is the last name in the path, preceded by as many names as are required to tell
    the path from all other paths.
    """
    short = {}
    for path in paths:
        names = path.split("/")
        ends = ("/".join(names[first:]) for first in reversed(range(len(names))))
        short[path] = next(
            end for end in ends if sum(f"/{other}".endswith(f"/{end}") for other in paths) == 1
        )
    return short


def _require_unique(names: Sequence[str], origins: Sequence[str]) -> None:
    """Raise `CompilationError` if two ports or parameters, ``origins``, have one of the names."""
    for name, count in Counter(names).items():
        if count > 1:
            same = [shown(repr(o)) for n, o in zip(names, origins, strict=True) if n == name]
            raise CompilationError(
                f"{name}: {' and '.join(same)} have this name in C; rename one of them"
            )
