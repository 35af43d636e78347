"""A model as C99: header, source and parameter values, of any diagram that compiles.

``NAME_init`` computes what depends on parameters alone and the discrete state after
initialization. ``NAME_step`` goes over one tick, from t to t + T: the updates at t, with the inputs
of the call; fixed steps of the classical fourth-order Runge-Kutta method for continuous states; and
the outputs as they are just before the next updates. So the output of a held controller is the
command that follows from the inputs of the same call.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from ..equations.equations import Equations
from ..errors import CompilationError
from ..native.timing import timing
from ..run_data import Array, State
from .functions import Functions
from .printer import PRECISIONS, Precision, comment_lines, literal, plain_line
from .step_size import rk4_step_s
from .tables import Table, tables_of
from .template import filled

_KEYWORDS = frozenset(
    [
        *("auto", "bool", "break", "case", "char", "const", "continue", "default", "do", "double"),
        *("else", "enum", "extern", "false", "float", "for", "goto", "if", "inline", "int", "long"),
        *("register", "restrict", "return", "short", "signed", "sizeof", "static", "struct"),
        *("switch", "true", "typedef", "union", "unsigned", "void", "volatile", "while"),
        *("_Bool", "_Complex", "_Imaginary", "_Alignas", "_Alignof", "_Atomic", "_Generic"),
        *("_Noreturn", "_Static_assert", "_Thread_local", "asm", "typeof"),
        # C++, for the header may be included there:
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
"""Further macros of math.h, float.h and stdint.h."""

_HEADERS = frozenset(
    [
        *("assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits"),
        *("locale", "math", "setjmp", "signal", "stdalign", "stdarg", "stdatomic", "stdbool"),
        *("stddef", "stdint", "stdio", "stdlib", "stdnoreturn", "string", "tgmath", "threads"),
        *("time", "uchar", "wchar", "wctype"),
    ]
)
"""Headers of C: a file of such a name would take their place."""

_START_MEMBERS = ("initial_x", "initial_d")
"""Of the parameters' struct, beside the leaf systems."""

MARK = "Made by kneexo from a Drake diagram."
"""In the first line of each file."""

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
_LONGEST_CYCLE = 2**31
_MOST_STEPS = 2**16 - 1  # counted by an uint16_t


@dataclass(frozen=True)
class Interface:
    """How ports look in C.

    ``fields``: of a port, the names of its elements, which should end in the unit; by default the
    name of the port, and the number of the element where it has more than one. ``integers``: ports
    that are int32_t, such as encoder counts. ``ranges``: lowest and highest value of a field of the
    inputs.
    """

    fields: Mapping[str, Sequence[str]] = field(default_factory=dict)
    integers: frozenset[str] = frozenset()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def names(self, ports: Mapping[str, int]) -> list[tuple[str, str]]:
        """Port and field of each element of some ports."""
        pairs = []
        for port, size in ports.items():
            default = [port] if size == 1 else [f"{port}_{i}" for i in range(size)]
            names = self.fields.get(port, default)
            if len(names) != size:
                raise CompilationError(
                    f"{port}: has {len(names)} names in C; must be {size}, one an element"
                )
            pairs += [(port, c_name(name)) for name in names]
        return pairs


@dataclass(frozen=True)
class CSource:
    """Text of a model in C, and what is known of it.

    Parameters
    ----------
    equations
        Of the diagram: `read_equations`.
    name
        Beginning of all names and files, a C identifier of up to 31 characters.
    parameters, state
        Values of the Context parameters, and the state before the initialization events.
    precision
        ``double`` or ``float``.
    outputs
        Output ports that are exported; all by default.
    interface
        How the ports look in C.
    tick_s
        Time that a step takes, for a diagram without a sample time; else it follows from those.
    step_s
        Largest step of the Runge-Kutta method in s; by default after the fastest mode at the start
        (`rk4_step_s`).
    look_up
        What depends on an integer input with a range alone becomes a table. Parameters that are
        used only there act no more when they are changed in C.
    told
        Of what this is an export, in the first line of each file.

    Raises `CompilationError` for a name that is no identifier, for a number that the precision
    cannot hold, for too many steps in a sample time, and for a diagram without a sample time where
    ``tick_s`` is missing.
    """

    equations: Equations
    name: str
    parameters: Array
    state: State
    precision: str = "double"
    outputs: Sequence[str] | None = None
    interface: Interface = Interface()
    tick_s: float | None = None
    step_s: float | None = None
    look_up: bool = False
    told: str = ""

    def __post_init__(self) -> None:
        """Check name, precision, outputs and times."""
        if self.name.lower() in _HEADERS:
            raise CompilationError(f"name = {self.name!r}: is a header of C; choose another name")
        if not _IDENTIFIER.fullmatch(self.name) or self.name in _KEYWORDS:
            raise CompilationError(
                f"name = {self.name!r}: must be a C identifier of at most 31 letters, digits and _"
            )
        if self.precision not in PRECISIONS:
            raise CompilationError(
                f"precision = {self.precision!r}: must be one of {', '.join(PRECISIONS)}"
            )
        for port in self.outputs or ():
            if port not in self.equations.outputs:
                raise CompilationError(
                    f"output {port!r} is unknown; known: {', '.join(self.equations.outputs)}"
                )
        if not self.equations.updates and self.tick_s is None:
            raise CompilationError(f"{self.name}: tick_s is needed, for it has no sample time")
        if self.step_s is not None and not 0.0 < self.step_s < math.inf:
            raise CompilationError(f"step_s = {self.step_s} s: must be finite and > 0")
        for port in self.interface.integers:
            if port not in self.equations.inputs:
                raise CompilationError(f"{port}: is no input; only inputs may be int32_t")
        for fields in (self.input_fields, self.output_fields):
            _require_unique([name for _, name in fields])
        if self.equations.states and self.steps > _MOST_STEPS:
            raise CompilationError(
                f"step_s = {self.largest_step_s:g} s: makes {self.steps} steps in a sample time of "
                f"{self.sample_time_s:g} s; must be at most {_MOST_STEPS}"
            )
        if self.cycle[1] >= _LONGEST_CYCLE:
            raise CompilationError(f"{self.name}: sample times repeat only after 2^31 ticks")

    # ---------------------------------------------------------------------------- figures

    @property
    def real(self) -> Precision:
        """The floating-point type."""
        return PRECISIONS[self.precision]

    @cached_property
    def input_fields(self) -> list[tuple[str, str]]:
        """Port and name in C of each element of the inputs."""
        return self.interface.names(self.equations.inputs)

    @cached_property
    def output_fields(self) -> list[tuple[str, str]]:
        """Port and name in C of each element of the outputs."""
        sizes = {port: len(self.equations.outputs[port]) for port in self.output_ports}
        return self.interface.names(sizes)

    @property
    def output_ports(self) -> Sequence[str]:
        """Output ports that are exported."""
        return tuple(self.equations.outputs) if self.outputs is None else self.outputs

    @property
    def output_nodes(self) -> list[int]:
        """Nodes of all elements of the outputs."""
        return [node for port in self.output_ports for node in self.equations.outputs[port]]

    @cached_property
    def parameter_fields(self) -> list[str]:
        """Name in C of each Context parameter: ``leaf.parameter`` or ``leaf.group_1[2]``."""
        pairs = [name.rpartition(".")[::2] for name in self.equations.parameters]
        leaves = _short_names({path for path, _ in pairs})
        fields = []
        for path, parameter in pairs:
            leaf = c_name(leaves[path] or self.name)
            leaf += "_" * (leaf in _START_MEMBERS)
            group = re.fullmatch(r"(\d+)\[(\d+)\]", parameter)
            fields.append(
                f"{leaf}.group_{group[1]}[{group[2]}]" if group else f"{leaf}.{c_name(parameter)}"
            )
        _require_unique(fields)
        return fields

    @cached_property
    def timing(self) -> tuple[float, list[int], list[int]]:
        """The tick in s; periods and offsets in ticks."""
        updates = self.equations.updates
        if not updates:
            assert self.tick_s is not None
            return self.tick_s, [], []
        times = timing(tuple((u.period_s, u.offset_s) for u in updates), self.tick_s)
        return times.tick, times.periods.tolist(), times.offsets.tolist()

    @property
    def sample_time_s(self) -> float:
        """What a step takes."""
        return self.timing[0]

    @cached_property
    def largest_step_s(self) -> float:
        """Largest step of the Runge-Kutta method; a whole number of steps makes a tick."""
        if self.step_s is not None:
            return self.step_s
        return rk4_step_s(self.equations, self.parameters, self.state)

    @property
    def steps(self) -> int:
        """Runge-Kutta steps in a tick."""
        return max(1, math.ceil(self.sample_time_s / self.largest_step_s - 1e-9))

    @property
    def counts_ticks(self) -> bool:
        """Whether some update is not due at each tick."""
        _, periods, offsets = self.timing
        return any(offsets) or any(period > 1 for period in periods)

    @property
    def cycle(self) -> tuple[int, int]:
        """First and last tick of the cycle in which the sample times repeat."""
        _, periods, offsets = self.timing
        first = max(offsets, default=0)
        return first, first + math.lcm(1, *periods)

    @cached_property
    def needs_time(self) -> bool:
        """Whether the equations depend on the time."""
        graph = self.equations.graph
        return any("time" in graph.depends[node] for node in self.roots())

    def roots(self) -> list[int]:
        """All nodes that a step computes."""
        equations = self.equations
        updates = [node for update in equations.updates for _, node in update.values]
        limits = [limit.margin for limit in equations.limits]
        return [*updates, *limits, *equations.derivatives, *self.output_nodes]

    @cached_property
    def accumulators(self) -> dict[int, tuple[int, ...]]:
        """In single precision: discrete states that a sum changes, and what is added to each.

        A float loses what is far smaller than the sum, so that an integrator drifts. What is lost
        is kept and added at the next step (Kahan's compensated summation).
        """
        if self.precision != "float":
            return {}
        graph, sums = self.equations.graph, {}
        for update in self.equations.updates:
            for state, node in update.values:
                kind, *terms = graph.nodes[node]
                held = graph.source("discrete", state)
                if kind == "add" and terms.count(held) == 1:
                    sums[state] = tuple(term for term in terms if term != held)
        return sums

    @cached_property
    def tables(self) -> list[Table]:
        """Tables in the place of what depends on one integer input alone, with ``look_up``."""
        if not self.look_up:
            return []
        ranges = {}
        for element, (port, of) in enumerate(self.input_fields):
            if port in self.interface.integers and (limits := self.limits(port, of)):
                ranges[element] = int(limits[0]), int(limits[1])
        roots = [*self.roots(), *self.equations.initial_discrete]
        tables = tables_of(self.equations.graph, roots, ranges, self.parameters)
        if not tables:
            raise CompilationError(
                f"{self.name}: look_up: nothing depends on an integer input with a range alone"
            )
        return tables

    # ------------------------------------------------------------------------------- texts

    @cached_property
    def functions(self) -> Functions:
        """What the source file computes."""
        return Functions(self)

    @property
    def operations(self) -> Counter[str]:
        """Operators and library functions of one step, as often as they are computed."""
        return self.functions.operations

    def files(self) -> dict[str, str]:
        """Name and text of each file: header, source, parameters."""
        texts = {
            f"{self.name}.h": self._filled("model.h"),
            f"{self.name}.c": self._filled("model.c"),
            f"{self.name}_params.c": "\n".join(self._parameter_values()),
        }
        return {name: f"{self.head}\n{text.rstrip()}\n" for name, text in texts.items()}

    @property
    def names(self) -> dict[str, str]:
        """What stands for the words in capitals of a template."""
        return {"NAME": self.name, "UPPER": self.name.upper(), "REAL": self.precision}

    @property
    def state_bytes(self) -> int:
        """Size of the state where a float has 4 and a double 8 bytes."""
        equations, real = self.equations, 8 if self.precision == "double" else 4
        counts = (equations.states, equations.discrete, self.accumulators, self.output_fields)
        numbers = sum(map(len, counts)) + len(self.functions.printer.fixed)
        counters = 4 * (1 + self.counts_steps)  # started, tick
        return real * (numbers + math.ceil(counters / real))

    @property
    def counts_steps(self) -> bool:
        """Whether the state counts steps: for the time, or for several sample times."""
        return self.needs_time or self.counts_ticks

    @property
    def head(self) -> str:
        """The comment that each file begins with."""
        return "\n".join(comment_lines(self.first_line))

    @property
    def first_line(self) -> str:
        """What each file begins with."""
        return plain_line(f"{MARK} {self.told}")

    def _filled(self, template: str) -> str:
        equations, real, functions = self.equations, self.real, self.functions
        step = self.sample_time_s / self.steps
        sizes = {
            "STATES": len(equations.states),
            "HELD": len(equations.discrete),
            "LOST": len(self.accumulators),
            "CONSTANTS": len(functions.printer.fixed),
            "LIMITS": len(equations.limits),
            "STEPS": self.steps,
        }
        numbers = {
            "largest": real.largest,
            "zero": 0.0,
            "two": 2.0,
            "step": step,
            "half_step": 0.5 * step,
            "sixth_step": step / 6.0,
            "sample_time": self.sample_time_s,
        }
        first, last = self.cycle
        words = {
            **{name: literal(value, real, name) for name, value in numbers.items()},
            "first_tick": str(first),
            "last_tick": str(last),
            "tick_meaning": "steps so far"
            if self.needs_time
            else "steps in the cycle of the sample times",
            "update_arguments": "tick, " * self.counts_ticks + "lost, " * bool(sizes["LOST"]),
        }
        nothing = [f"    {self.name}_real_t none; /* nothing here */"]
        blocks = {
            "parameters": self._parameter_members() or nothing,
            "inputs": self._input_members() or nothing,
            "outputs": [f"    {self.name}_real_t {of};" for _, of in self.output_fields] or nothing,
            "state": self._state_members(),
            "tables": [
                f"extern const {self.name}_real_t {self.name}_table_{number}[{table.values.size}];"
                for number, table in enumerate(self.tables)
            ],
            "input_checks": self._input_checks(),
            "parameter_checks": self._parameter_checks(),
            "output_checks": _all_of(
                "out", [f"is_finite(out->{of})" for _, of in self.output_fields]
            ),
            "functions": functions.lines,
        }
        arrays = sizes["STATES"] + sizes["HELD"] + sizes["CONSTANTS"]
        conditions = {
            "double": self.precision == "double",
            "states": sizes["STATES"],
            "held": sizes["HELD"],
            "counted": arrays or self.parameter_fields,
            "stateless": not (arrays or self.needs_time),
            "accumulators": sizes["LOST"],
            "constants": sizes["CONSTANTS"],
            "limits": sizes["LIMITS"],
            "tables": self.tables,
            "outputs": self.output_fields,
            "time": self.needs_time,
            "ticks": self.counts_steps,
            "wraps": self.counts_ticks and not self.needs_time,
            "minimum": any("minimum(" in line for line in functions.lines),
            "maximum": any("maximum(" in line for line in functions.lines),
        }
        names = {**self.names, **{name: str(size) for name, size in sizes.items()}}
        return filled(
            f"c/templates/{template}", names, words, blocks, {k for k, v in conditions.items() if v}
        )

    def limits(self, port: str, of: str) -> list[str] | None:
        """Lowest and highest value of a field as C text; None where all that is finite may come.

        Whole numbers within the range, where the input is an int32_t.
        """
        limits = self.interface.ranges.get(of)
        if limits is None:
            return None
        if port in self.interface.integers:
            return [str(math.ceil(limits[0])), str(math.floor(limits[1]))]
        return [literal(limit, self.real, of) for limit in limits]

    def _input_checks(self) -> list[str]:
        checks = []
        for port, of in self.input_fields:
            if limits := self.limits(port, of):
                checks.append(f"(in->{of} >= {limits[0]}) && (in->{of} <= {limits[1]})")
            elif port not in self.interface.integers:
                checks.append(f"is_finite(in->{of})")
        return _all_of("in", checks)

    def _parameter_checks(self) -> list[str]:
        fields = list(self.parameter_fields)
        fields += [f"initial_{of}[{i}]" for of, start in self._start() for i in range(start.size)]
        if not fields:
            return _all_of("p", [])
        values = [f"        p->{of}," for of in fields]  # as an array: less code than many calls
        size = len(fields)
        return [
            *(f"    const real values[{size}] = {{", *values, "    };", ""),
            f"    return are_finite(values, {size}U);",
        ]

    def _parameter_values(self) -> list[str]:
        name = self.name
        values = [
            literal(value, self.real, told)
            for told, value in zip(self.equations.parameters, self.parameters.tolist(), strict=True)
        ]
        rows = []
        for leaf, members in self._by_leaf().items():
            rows.append(f"    {{ /* {leaf} */")
            for (member, array), indices in members.items():
                text = ", ".join(values[i] for i in indices)
                rows.append(f"        {f'{{{text}}}' if array else text}, /* {member} */")
            rows.append("    },")
        for told, start in self._start():
            texts = (literal(value, self.real, f"initial {told}") for value in start.tolist())
            rows.append(f"    {{{', '.join(texts)}}} /* initial_{told} */,")
        tables = []
        for number, table in enumerate(self.tables):
            texts = (literal(v, self.real, "a value of a table") for v in table.values.tolist())
            tables += ["", f"const {name}_real_t {name}_table_{number}[{table.values.size}] = {{"]
            tables += [f"    {text}," for text in texts]
            tables.append("};")
        return [
            f'#include "{name}.h"',
            "",
            f"const {name}_params_t {name}_params = {{",
            *(rows or ["    0"]),
            "};",
            *tables,
        ]

    def _start(self) -> list[tuple[str, Array]]:
        """Name in C and start values of continuous and discrete states, where there are any."""
        pairs = (("x", self.state.continuous), ("d", self.state.discrete))
        return [(told, start) for told, start in pairs if start.size]

    def _by_leaf(self) -> dict[str, dict[tuple[str, bool], list[int]]]:
        """Members of the parameters' struct: leaf; member and whether it is an array; indices."""
        leaves: dict[str, dict[tuple[str, bool], list[int]]] = {}
        for index, text in enumerate(self.parameter_fields):
            leaf, _, member = text.partition(".")
            name, bracket, _ = member.partition("[")
            leaves.setdefault(leaf, {}).setdefault((name, bool(bracket)), []).append(index)
        return leaves

    def _parameter_members(self) -> list[str]:
        lines = []
        for leaf, members in self._by_leaf().items():
            lines.append("    struct {")
            for (member, array), indices in members.items():
                size = f"[{len(indices)}]" if array else ""
                lines.append(f"        {self.name}_real_t {member}{size};")
            lines.append(f"    }} {leaf};")
        for told, start in self._start():
            lines.append(f"    {self.name}_real_t initial_{told}[{start.size}];")
        return lines

    def _input_members(self) -> list[str]:
        lines = []
        for port, of in self.input_fields:
            kind = "int32_t" if port in self.interface.integers else f"{self.name}_real_t"
            limits = self.limits(port, of)
            told = f" /* {' ... '.join(limits)} */" if limits else ""
            lines.append(f"    {kind} {of};{told}")
        return lines

    def _state_members(self) -> list[str]:
        equations, real = self.equations, f"{self.name}_real_t"
        lost, fixed = len(self.accumulators), len(self.functions.printer.fixed)
        rows = [
            ("x", len(equations.states), f"continuous: {', '.join(equations.states)}"),
            ("d", len(equations.discrete), f"discrete: {', '.join(equations.discrete)}"),
            ("lost", lost, "what the sums among d have lost by rounding"),
            ("c", fixed, "what depends on parameters alone"),
        ]
        lines = []
        for member, size, told in rows:
            if size:
                lines += [*comment_lines(told, "    "), f"    {real} {member}[{size}];"]
        return lines


def c_name(text: str) -> str:
    """Text as a C identifier."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    if not name or name[0].isdigit():
        name = f"_{name}" if not name else f"n{name}"
    return f"{name}_" if name in _KEYWORDS or _MACRO.fullmatch(name) else name


def _short_names(paths: Collection[str]) -> dict[str, str]:
    """Of each path of a system its last name, or more of them where that is not unique."""
    short = {}
    for path in paths:
        names = path.split("/")
        ends = ("/".join(names[first:]) for first in reversed(range(len(names))))
        short[path] = next(
            end for end in ends if sum(f"/{other}".endswith(f"/{end}") for other in paths) == 1
        )
    return short


def _require_unique(names: Sequence[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise CompilationError(f"{name}: {count} values have this name in C; rename a system")


def _all_of(argument: str, checks: Sequence[str]) -> list[str]:
    """The body of a function that says whether all checks hold."""
    if not checks:
        return [f"    (void){argument};", "    return true;"]
    lines = [f"        && {check}" for check in checks]
    return (
        [f"    return {checks[0]}", *lines[1:-1], f"{lines[-1]};"]
        if len(checks) > 1
        else [f"    return {checks[0]};"]
    )
