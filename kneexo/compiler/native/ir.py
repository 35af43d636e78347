"""LLVM IR as text, written by tracing Python.

A `Value` overloads the operators of Python, an `Array` loads and stores elements, and a `Function`
collects the instructions. The same tracing code writes scalar code and code for several lanes of a
vector. No floating-point flag is used: what is fused is an explicit `Function.fma`, so the same
trace gives the same bits in scalar and vector code, on every processor.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

UNROLLED = 8
"""Longest loop that `Function.each` writes out."""


@dataclass(frozen=True)
class Type:
    """An LLVM type: an element, or a vector of ``lanes`` of them."""

    element: str
    lanes: int = 1

    def __str__(self) -> str:
        return self.element if self.lanes == 1 else f"<{self.lanes} x {self.element}>"

    def of(self, lanes: int) -> Type:
        """The same element in another number of lanes."""
        return Type(self.element, lanes)

    @property
    def suffix(self) -> str:
        """Name of the type within the name of an intrinsic."""
        name = {"double": "f64"}.get(self.element, self.element)
        return name if self.lanes == 1 else f"v{self.lanes}{name}"


DOUBLE, INT, BOOL, BYTE, POINTER = (Type(name) for name in ("double", "i64", "i1", "i8", "ptr"))
"""The types of LLVM that are used."""


class Value:
    """A value of the code: a register or a literal, and its type."""

    __slots__ = ("function", "name", "type")

    def __init__(self, function: Function, name: str, type_: Type) -> None:
        self.function, self.name, self.type = function, name, type_

    def __add__(self, other: Operand) -> Value:
        return self.function.binary("add", self, other)

    def __radd__(self, other: Operand) -> Value:
        return self.function.binary("add", other, self)

    def __sub__(self, other: Operand) -> Value:
        return self.function.binary("sub", self, other)

    def __rsub__(self, other: Operand) -> Value:
        return self.function.binary("sub", other, self)

    def __mul__(self, other: Operand) -> Value:
        return self.function.binary("mul", self, other)

    def __rmul__(self, other: Operand) -> Value:
        return self.function.binary("mul", other, self)

    def __truediv__(self, other: Operand) -> Value:
        return self.function.binary("div", self, other)

    def __rtruediv__(self, other: Operand) -> Value:
        return self.function.binary("div", other, self)

    def __mod__(self, other: Operand) -> Value:
        return self.function.binary("srem", self, other)

    def __lshift__(self, other: Operand) -> Value:
        return self.function.binary("shl", self, other)

    def __rshift__(self, other: Operand) -> Value:
        return self.function.binary("lshr", self, other)

    def __and__(self, other: Operand) -> Value:
        return self.function.binary("and", self, other)

    def __or__(self, other: Operand) -> Value:
        return self.function.binary("or", self, other)

    def __xor__(self, other: Operand) -> Value:
        return self.function.binary("xor", self, other)

    def __invert__(self) -> Value:
        return self.function.binary("xor", self, 1 if self.type.element == "i1" else -1)

    def __neg__(self) -> Value:
        return self.function.instruction(f"fneg {self.type} {self.name}", self.type)

    def __lt__(self, other: Operand) -> Value:
        return self.function.compare("lt", self, other)

    def __le__(self, other: Operand) -> Value:
        return self.function.compare("le", self, other)

    def __gt__(self, other: Operand) -> Value:
        return self.function.compare("gt", self, other)

    def __ge__(self, other: Operand) -> Value:
        return self.function.compare("ge", self, other)

    def equals(self, other: Operand) -> Value:
        """Whether both are equal; False for nan."""
        return self.function.compare("eq", self, other)

    def differs(self, other: Operand) -> Value:
        """Whether both differ; True for nan."""
        return self.function.compare("ne", self, other)


Operand: TypeAlias = Value | float
"""A value, or a number of Python that becomes a literal."""


class Array:
    """Elements of one type in memory, from a pointer on."""

    def __init__(self, pointer: Value, type_: Type) -> None:
        self.function, self.pointer, self.type = pointer.function, pointer, type_

    def address(self, index: Operand) -> Value:
        """Pointer to an element."""
        if index == 0 and not isinstance(index, Value):
            return self.pointer
        i = self.function.coerce(index, INT)
        text = f"getelementptr {self.type}, ptr {self.pointer.name}, i64 {i.name}"
        return self.function.instruction(text, POINTER)

    def __getitem__(self, index: Operand) -> Value:
        place = self.address(index).name
        text = f"load {self.type}, ptr {place}, align {self._alignment}"
        return self.function.instruction(text, self.type)

    def __setitem__(self, index: Operand, value: Operand) -> None:
        kept = self.function.coerce(value, self.type)
        place = self.address(index).name
        self.function.line(f"store {self.type} {kept.name}, ptr {place}, align {self._alignment}")

    @property
    def _alignment(self) -> int:
        return 1 if self.type.element == "i8" else 8  # buffers of callers hold no wider one

    def shifted(self, index: Operand) -> Array:
        """The elements from ``index`` on."""
        return Array(self.address(index), self.type)

    def cast(self, type_: Type) -> Array:
        """The same memory with elements of another type."""
        return Array(self.pointer, type_)


class Variable:
    """A local variable."""

    def __init__(self, memory: Array) -> None:
        self._memory = memory

    def get(self) -> Value:
        """Its value here."""
        return self._memory[0]

    def set(self, value: Operand) -> None:
        """Change its value."""
        self._memory[0] = value


class Loop:
    """The way out of the body of `Function.forever`."""

    def __init__(self, function: Function, after: str) -> None:
        self._function, self._after = function, after

    def stop_if(self, condition: Value) -> None:
        """Leave the loop."""
        (onward,) = self._function.new_labels("onward")
        self._function.line(f"br i1 {condition.name}, label %{self._after}, label %{onward}")
        self._function.label(onward)


class Module:
    """Functions of one text."""

    def __init__(self) -> None:
        self._functions: list[Function] = []
        self._declarations: dict[str, str] = {}

    def function(
        self,
        name: str,
        arguments: Mapping[str, Type],
        returns: Type | None = None,
        *,
        internal: bool = True,
        attributes: str = "",
    ) -> Function:
        """A new function; pointers among its arguments never overlap."""
        new = Function(self, name, arguments, returns, internal, attributes)
        self._functions.append(new)
        return new

    def shared(self, name: str, make: Callable[[], Function]) -> Function:
        """The function of that name, made where it is first asked for."""
        for function in self._functions:
            if function.name == name:
                return function
        return make()

    def declare(self, name: str, returns: Type, arguments: list[Type]) -> None:
        """Declare a function of the C library or of LLVM."""
        of = ", ".join(str(type_) for type_ in arguments)
        self._declarations[name] = f"declare {returns} @{name}({of})"

    def text(self) -> str:
        """The whole text."""
        parts = [*self._declarations.values(), *(f.text() for f in self._functions)]
        return "\n".join([*parts, '!0 = !{!"branch_weights", i32 1, i32 1048575}', ""])


class Function:
    """Instructions of one function; the methods append to them."""

    def __init__(
        self,
        module: Module,
        name: str,
        arguments: Mapping[str, Type],
        returns: Type | None,
        internal: bool,
        attributes: str,
    ) -> None:
        self.module, self.name, self.returns = module, name, returns
        of = ", ".join(
            f"{type_}{' noalias' if type_ == POINTER else ''} %{argument}"
            for argument, type_ in arguments.items()
        )
        scope = "internal " if internal else ""
        self._head = f"define {scope}{returns or 'void'} @{name}({of}) {attributes} {{"
        self.arguments = {key: Value(self, f"%{key}", type_) for key, type_ in arguments.items()}
        self._allocations: list[str] = []
        self._lines: list[str] = []
        self._count = 0

    def text(self) -> str:
        """The definition; a function without a result ends where its instructions end."""
        end = ["  ret void"] if self.returns is None else ["  unreachable"]
        if self._lines and self._lines[-1].startswith("  ret "):
            end = []
        return "\n".join([self._head, "entry:", *self._allocations, *self._lines, *end, "}"])

    # --------------------------------------------------------------------------- values

    def line(self, text: str) -> None:
        """Append an instruction without a result."""
        self._lines.append(f"  {text}")

    def instruction(self, text: str, type_: Type) -> Value:
        """Append an instruction; returns its result."""
        self._count += 1
        self._lines.append(f"  %v{self._count} = {text}")
        return Value(self, f"%v{self._count}", type_)

    def constant(self, value: float, type_: Type = DOUBLE) -> Value:
        """A literal, the same in all lanes."""
        if type_.element == "double":
            (bits,) = struct.unpack("<Q", struct.pack("<d", value))
            text = f"0x{bits:016X}"
        elif type_.element == "i1":
            text = "true" if value else "false"
        else:
            text = str(int(value))
        if type_.lanes > 1:
            text = "<" + ", ".join([f"{type_.element} {text}"] * type_.lanes) + ">"
        return Value(self, text, type_)

    def lane_numbers(self, lanes: int) -> Value:
        """The integers 0, 1, 2 …, one a lane."""
        text = "<" + ", ".join(f"i64 {lane}" for lane in range(lanes)) + ">"
        return Value(self, text if lanes > 1 else "0", INT.of(lanes))

    def coerce(self, value: Operand, type_: Type) -> Value:
        """The value in that type: a literal, or a scalar repeated in all lanes."""
        if not isinstance(value, Value):
            return self.constant(value, type_)
        if value.type == type_:
            return value
        assert value.type == type_.of(1), (value.type, type_)
        single = self.instruction(
            f"insertelement {type_} poison, {value.type} {value.name}, i64 0", type_
        )
        mask = f"<{type_.lanes} x i32> zeroinitializer"
        return self.instruction(
            f"shufflevector {type_} {single.name}, {type_} poison, {mask}", type_
        )

    def alike(self, *operands: Operand) -> list[Value]:
        """Operands in one type, that with the most lanes among them; numbers alone are doubles."""
        types = [operand.type for operand in operands if isinstance(operand, Value)]
        widest = max(types, key=lambda type_: type_.lanes, default=DOUBLE)
        return [self.coerce(operand, widest) for operand in operands]

    def binary(self, name: str, left: Operand, right: Operand) -> Value:
        """An arithmetic or bitwise operation."""
        a, b = self.alike(left, right)
        prefix = "f" if a.type.element == "double" else ""
        return self.instruction(f"{prefix}{name} {a.type} {a.name}, {b.name}", a.type)

    def compare(self, name: str, left: Operand, right: Operand) -> Value:
        """A condition: lt, le, gt, ge, eq or ne; with nan all but ne are False."""
        a, b = self.alike(left, right)
        if a.type.element == "double":
            code = "fcmp " + ("une" if name == "ne" else f"o{name}")
        else:
            code = "icmp " + (name if name in ("eq", "ne") else f"s{name}")
        return self.instruction(f"{code} {a.type} {a.name}, {b.name}", BOOL.of(a.type.lanes))

    def select(self, condition: Value, positive: Operand, otherwise: Operand) -> Value:
        """One of two values, lane by lane."""
        a, b = self.alike(positive, otherwise)
        lanes = max(condition.type.lanes, a.type.lanes)
        if condition.type.lanes > 1:
            a, b = (self.coerce(value, value.type.of(lanes)) for value in (a, b))
        text = f"select {condition.type} {condition.name}, {a.type} {a.name}, {b.type} {b.name}"
        return self.instruction(text, a.type)

    def _intrinsic(self, name: str, *operands: Operand) -> Value:
        values = self.alike(*operands)
        type_ = values[0].type
        full = f"llvm.{name}.{type_.suffix}"
        self.module.declare(full, type_, [type_] * len(values))
        of = ", ".join(f"{type_} {value.name}" for value in values)
        return self.instruction(f"call {type_} @{full}({of})", type_)

    def fma(self, factor: Operand, other: Operand, term: Operand) -> Value:
        """The sum factor · other + term, rounded once."""
        return self._intrinsic("fma", factor, other, term)

    def sqrt(self, value: Operand) -> Value:
        """Square root."""
        return self._intrinsic("sqrt", value)

    def absolute(self, value: Operand) -> Value:
        """Absolute value."""
        return self._intrinsic("fabs", value)

    def floor(self, value: Operand) -> Value:
        """Largest whole number that is not larger."""
        return self._intrinsic("floor", value)

    def ceil(self, value: Operand) -> Value:
        """Smallest whole number that is not smaller."""
        return self._intrinsic("ceil", value)

    def copysign(self, magnitude: Operand, sign: Operand) -> Value:
        """Magnitude of the one with the sign of the other."""
        return self._intrinsic("copysign", magnitude, sign)

    def minimum(self, first: Operand, second: Operand) -> Value:
        """The smaller one, as std::min: the first one when one is nan."""
        a, b = self.alike(first, second)
        return self.select(b < a, b, a)

    def maximum(self, first: Operand, second: Operand) -> Value:
        """The larger one, as std::max: the first one when one is nan."""
        a, b = self.alike(first, second)
        return self.select(a < b, b, a)

    def to_double(self, value: Value) -> Value:
        """Integers as doubles."""
        type_ = DOUBLE.of(value.type.lanes)
        return self.instruction(f"sitofp {value.type} {value.name} to {type_}", type_)

    def to_int(self, value: Value) -> Value:
        """Doubles without their fraction as integers; they must fit."""
        type_ = INT.of(value.type.lanes)
        return self.instruction(f"fptosi {value.type} {value.name} to {type_}", type_)

    def bits(self, value: Value) -> Value:
        """The 64 bits of doubles as integers."""
        type_ = INT.of(value.type.lanes)
        return self.instruction(f"bitcast {value.type} {value.name} to {type_}", type_)

    def from_bits(self, value: Value) -> Value:
        """Doubles from the integers of `bits`."""
        type_ = DOUBLE.of(value.type.lanes)
        return self.instruction(f"bitcast {value.type} {value.name} to {type_}", type_)

    def flags(self, condition: Value) -> Value:
        """A condition as integers 0 and 1."""
        type_ = INT.of(condition.type.lanes)
        return self.instruction(f"zext {condition.type} {condition.name} to {type_}", type_)

    def library(self, name: str, *operands: Operand) -> Value:
        """A function of the C library, one lane after the other."""
        values = self.alike(*operands)
        self.module.declare(name, DOUBLE, [DOUBLE] * len(values))

        def of_lane(lane: int) -> Value:
            of = ", ".join(f"double {self.lane(value, lane).name}" for value in values)
            return self.instruction(f"call double @{name}({of})", DOUBLE)

        return self.gathered(values[0].type.lanes, of_lane)

    def call(self, function: Function, *values: Value) -> Value:
        """Call a function of this module; without a result the value must not be used."""
        of = ", ".join(f"{value.type} {value.name}" for value in values)
        if function.returns is None:
            self.line(f"call void @{function.name}({of})")
            return Value(self, "", POINTER)
        return self.instruction(f"call {function.returns} @{function.name}({of})", function.returns)

    # ---------------------------------------------------------------------------- lanes

    def any_lane(self, condition: Value) -> Value:
        """Whether a condition holds in any lane."""
        lanes = condition.type.lanes
        if lanes == 1:
            return condition
        bits = self.instruction(
            f"bitcast {condition.type} {condition.name} to i{lanes}", Type(f"i{lanes}")
        )
        return self.instruction(f"icmp ne i{lanes} {bits.name}, 0", BOOL)

    def lane(self, value: Value, lane: int) -> Value:
        """One lane of a value."""
        if value.type.lanes == 1:
            return value
        text = f"extractelement {value.type} {value.name}, i64 {lane}"
        return self.instruction(text, value.type.of(1))

    def gathered(self, lanes: int, of_lane: Callable[[int], Value]) -> Value:
        """A value from the scalars of its lanes."""
        first = of_lane(0)
        if lanes == 1:
            return first
        total = Value(self, "poison", first.type.of(lanes))
        for lane in range(lanes):
            part = first if lane == 0 else of_lane(lane)
            total = self.instruction(
                f"insertelement {total.type} {total.name}, {part.type} {part.name}, i64 {lane}",
                total.type,
            )
        return total

    # --------------------------------------------------------------------------- memory

    def array(self, size: int, type_: Type = DOUBLE) -> Array:
        """Local memory for at least one element, not initialized."""
        self._count += 1
        name = f"%a{self._count}"
        count = f"[{max(size, 1)} x {type_}]"
        self._allocations.append(f"  {name} = alloca {count}, align {8 * type_.lanes}")
        return Array(Value(self, name, POINTER), type_)

    def variable(self, value: Value) -> Variable:
        """A local variable with a first value."""
        new = Variable(self.array(1, value.type))
        new.set(value)
        return new

    def pointer(self, address: Value) -> Value:
        """The pointer that an integer stands for."""
        return self.instruction(f"inttoptr i64 {address.name} to ptr", POINTER)

    # -------------------------------------------------------------------------- control

    def new_labels(self, *names: str) -> list[str]:
        """Names of new blocks."""
        self._count += 1
        return [f"{name}{self._count}" for name in names]

    def label(self, name: str) -> None:
        """Begin a block."""
        self._lines.append(f"{name}:")

    @contextmanager
    def when(self, condition: Value, *, rare: bool = False) -> Iterator[None]:
        """The body runs where a scalar condition holds.

        A ``rare`` one stays a branch: a select in its place would make what follows wait for the
        condition.
        """
        body, after = self.new_labels("then", "after")
        weights = ", !prof !0" if rare else ""
        self.line(f"br i1 {condition.name}, label %{body}, label %{after}{weights}")
        self.label(body)
        yield
        self.line(f"br label %{after}")
        self.label(after)

    @contextmanager
    def forever(self) -> Iterator[Loop]:
        """The body runs until `Loop.stop_if`."""
        head, after = self.new_labels("loop", "after")
        self.line(f"br label %{head}")
        self.label(head)
        yield Loop(self, after)
        self.line(f"br label %{head}")
        self.label(after)

    def each(self, count: int | Value) -> Iterator[Operand]:
        """0 … ``count`` - 1: numbers of Python when they are few, else a loop."""
        if isinstance(count, int) and count <= UNROLLED:
            yield from range(count)
            return
        number, end = self.variable(self.constant(0, INT)), self.coerce(count, INT)
        with self.forever() as loop:
            k = number.get()
            loop.stop_if(k >= end)
            yield k
            number.set(k + 1)

    def loop(self, count: int | Value) -> Iterator[Operand]:
        """The same, always as a loop: for code that runs rarely."""
        return self.each(self.coerce(count, INT))

    def give(self, value: Value | None = None) -> None:
        """Return from the function."""
        self.line("ret void" if value is None else f"ret {value.type} {value.name}")

    def give_if(self, condition: Value, value: Value | None = None) -> None:
        """Return from the function where a scalar condition holds."""
        leave, onward = self.new_labels("leave", "onward")
        self.line(f"br i1 {condition.name}, label %{leave}, label %{onward}")
        self.label(leave)
        self.give(value)
        self.label(onward)
