"""Emits LLVM IR as text while Python code runs.

A `Function` collects instructions. The operators of a `Value` and the items of an `Array` append
instructions to their function. The same Python code emits scalar code, and code for vectors, whose
elements are called lanes. No floating-point flag is used, and only `Function.fma` is fused. So
scalar and vector code give the same bits on every processor.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeAlias

from .types import BOOL, DOUBLE, INT, POINTER, Type

UNROLLED = 8
"""Largest number of passes of a loop that `Function.each` unrolls.

With 4, runs of preset ``leg`` take about a tenth longer. With 16 they take the same time.
"""


_BinaryOperator: TypeAlias = "Callable[[Value, Operand], Value]"


def _operators(name: str) -> tuple[_BinaryOperator, _BinaryOperator]:
    """Return the methods that emit the operation ``name`` for ``a ∘ b`` and reflected ``b ∘ a``."""

    def operate(self: Value, other: Operand) -> Value:
        return self.function.binary(name, self, other)

    def operate_reflected(self: Value, other: Operand) -> Value:
        return self.function.binary(name, other, self)

    return operate, operate_reflected


class Value:
    """A register or literal of the emitted code. Python's operators emit instructions."""

    __slots__ = ("function", "name", "type")

    def __init__(self, function: Function, name: str, type_: Type) -> None:
        self.function, self.name, self.type = function, name, type_

    __add__, __radd__ = _operators("add")
    __sub__, __rsub__ = _operators("sub")
    __mul__, __rmul__ = _operators("mul")
    __truediv__, __rtruediv__ = _operators("div")
    __mod__ = _operators("srem")[0]
    __lshift__ = _operators("shl")[0]
    __rshift__ = _operators("lshr")[0]
    __and__ = _operators("and")[0]
    __or__ = _operators("or")[0]
    __xor__ = _operators("xor")[0]

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
        """Emit the comparison "equal". Return the condition, which is false for nan."""
        return self.function.compare("eq", self, other)

    def differs(self, other: Operand) -> Value:
        """Emit the comparison "not equal". Return the condition, which is true for nan."""
        return self.function.compare("ne", self, other)


Operand: TypeAlias = Value | float
"""An operand of an instruction: a `Value`, or a Python number, which becomes a literal."""


class Array:
    """Elements of one type in the memory of the emitted code.

    Reading an item emits a load, and setting an item emits a store.
    """

    def __init__(self, pointer: Value, type_: Type) -> None:
        self.function, self.pointer, self.type = pointer.function, pointer, type_

    def address(self, index: Operand) -> Value:
        """Emit the computation of the address of element ``index``; return the pointer."""
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
        stored = self.function.coerce(value, self.type)
        place = self.address(index).name
        self.function.line(f"store {self.type} {stored.name}, ptr {place}, align {self._alignment}")

    @property
    def _alignment(self) -> int:
        return 1 if self.type.element == "i8" else 8  # callers align their buffers to 8 bytes

    def shifted(self, index: Operand) -> Array:
        """Emit the address of element ``index``; return the array that begins at this element."""
        return Array(self.address(index), self.type)

    def cast(self, type_: Type) -> Array:
        """Return an array of elements of another type in the memory of this array."""
        return Array(self.pointer, type_)


class Variable:
    """A local variable of the emitted code."""

    def __init__(self, memory: Array) -> None:
        self._memory = memory

    def get(self) -> Value:
        """Emit a load of the variable; return the loaded value."""
        return self._memory[0]

    def set(self, value: Operand) -> None:
        """Emit a store of ``value`` to the variable."""
        self._memory[0] = value


class Loop:
    """A loop that `Function.forever` emits. `stop_if` emits a jump out of the loop."""

    def __init__(self, function: Function, after: str) -> None:
        self._function, self._after = function, after

    def stop_if(self, condition: Value) -> None:
        """Emit a jump out of the loop under a scalar condition."""
        (onward,) = self._function.new_labels("onward")
        self._function.line(f"br i1 {condition.name}, label %{self._after}, label %{onward}")
        self._function.label(onward)


class Module:
    """A text of LLVM IR: its functions, and declarations of the external functions they call."""

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
        """Return a new function. Memory behind different pointer arguments must not overlap."""
        new = Function(self, name, arguments, returns, internal, attributes)
        self._functions.append(new)
        return new

    def shared(self, name: str, make: Callable[[], Function]) -> Function:
        """Return the function ``name`` of this module; call ``make`` to add it if it is missing."""
        for function in self._functions:
            if function.name == name:
                return function
        return make()

    def declare(self, name: str, returns: Type, arguments: list[Type]) -> None:
        """Declare a function of the C library or an intrinsic of LLVM, so that code can call it."""
        types = ", ".join(str(type_) for type_ in arguments)
        self._declarations[name] = f"declare {returns} @{name}({types})"

    def text(self) -> str:
        """Return the IR text of all declarations and functions."""
        parts = [*self._declarations.values(), *(f.text() for f in self._functions)]
        return "\n".join([*parts, '!0 = !{!"branch_weights", i32 1, i32 1048575}', ""])


class Function:
    """An emitted function. Its methods append instructions; most methods return the result."""

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
        parameters = ", ".join(
            f"{type_}{' noalias' if type_ == POINTER else ''} %{argument}"
            for argument, type_ in arguments.items()
        )
        scope = "internal " if internal else ""
        self._head = f"define {scope}{returns or 'void'} @{name}({parameters}) {attributes} {{"
        self.arguments = {key: Value(self, f"%{key}", type_) for key, type_ in arguments.items()}
        self._allocations: list[str] = []
        self._lines: list[str] = []
        self._count = 0

    def text(self) -> str:
        """Return the IR text of the function, with a return at the end if it has no result."""
        end = ["  ret void"] if self.returns is None else ["  unreachable"]
        if self._lines and self._lines[-1].startswith("  ret "):
            end = []
        return "\n".join([self._head, "entry:", *self._allocations, *self._lines, *end, "}"])

    # --------------------------------------------------------------------------- values

    def line(self, text: str) -> None:
        """Append the text of an instruction that has no result."""
        self._lines.append(f"  {text}")

    def instruction(self, text: str, type_: Type) -> Value:
        """Append the text of an instruction; return its result, which has the type ``type_``."""
        self._count += 1
        self._lines.append(f"  %v{self._count} = {text}")
        return Value(self, f"%v{self._count}", type_)

    def constant(self, value: float, type_: Type = DOUBLE) -> Value:
        """Return a literal of a type that has ``value`` in each lane."""
        if type_.element == "double":  # all 64 bits, as decimal digits would be rounded
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
        """Return the literal that holds the integers 0, 1, 2 …, one in each lane."""
        text = "<" + ", ".join(f"i64 {lane}" for lane in range(lanes)) + ">"
        return Value(self, text if lanes > 1 else "0", INT.of(lanes))

    def coerce(self, value: Operand, type_: Type) -> Value:
        """Convert a Python number to a literal, or a scalar to a vector with the same lanes."""
        if not isinstance(value, Value):
            return self.constant(value, type_)
        if value.type == type_:
            return value
        assert value.type == type_.of(1), (value.type, type_)
        text = f"insertelement {type_} poison, {value.type} {value.name}, i64 0"
        single, mask = self.instruction(text, type_), f"<{type_.lanes} x i32> zeroinitializer"
        text = f"shufflevector {type_} {single.name}, {type_} poison, {mask}"
        return self.instruction(text, type_)

    def alike(self, *operands: Operand) -> list[Value]:
        """Convert operands to the type of the operand with the most lanes.

        If all operands are Python numbers, they become doubles.
        """
        types = [operand.type for operand in operands if isinstance(operand, Value)]
        widest = max(types, key=lambda type_: type_.lanes, default=DOUBLE)
        return [self.coerce(operand, widest) for operand in operands]

    def binary(self, name: str, left: Operand, right: Operand) -> Value:
        """Emit an arithmetic or bitwise instruction.

        ``name`` is LLVM's name for integers, such as ``add``. Doubles get ``fadd``.
        """
        a, b = self.alike(left, right)
        prefix = "f" if a.type.element == "double" else ""
        return self.instruction(f"{prefix}{name} {a.type} {a.name}, {b.name}", a.type)

    def compare(self, name: str, left: Operand, right: Operand) -> Value:
        """Emit the comparison lt, le, gt, ge, eq or ne; nan makes ne true and all others false."""
        a, b = self.alike(left, right)
        if a.type.element == "double":
            code = "fcmp " + ("une" if name == "ne" else f"o{name}")
        else:
            code = "icmp " + (name if name in ("eq", "ne") else f"s{name}")
        return self.instruction(f"{code} {a.type} {a.name}, {b.name}", BOOL.of(a.type.lanes))

    def select(self, condition: Value, positive: Operand, otherwise: Operand) -> Value:
        """Emit a choice: in each lane ``positive`` if the condition holds, else ``otherwise``."""
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
        arguments = ", ".join(f"{type_} {value.name}" for value in values)
        return self.instruction(f"call {type_} @{full}({arguments})", type_)

    def fma(self, factor: Operand, other: Operand, term: Operand) -> Value:
        """Emit factor · other + term, rounded only once (fused multiply-add)."""
        return self._intrinsic("fma", factor, other, term)

    def sqrt(self, value: Operand) -> Value:
        """Emit the square root."""
        return self._intrinsic("sqrt", value)

    def absolute(self, value: Operand) -> Value:
        """Emit the absolute value."""
        return self._intrinsic("fabs", value)

    def floor(self, value: Operand) -> Value:
        """Emit the largest whole number that is not larger than ``value``."""
        return self._intrinsic("floor", value)

    def ceil(self, value: Operand) -> Value:
        """Emit the smallest whole number that is not smaller than ``value``."""
        return self._intrinsic("ceil", value)

    def copysign(self, magnitude: Operand, sign: Operand) -> Value:
        """Emit the absolute value of ``magnitude`` with the sign of ``sign``."""
        return self._intrinsic("copysign", magnitude, sign)

    def minimum(self, first: Operand, second: Operand) -> Value:
        """Emit the smaller operand, or ``first`` if an operand is nan, like std::min."""
        a, b = self.alike(first, second)
        return self.select(b < a, b, a)

    def maximum(self, first: Operand, second: Operand) -> Value:
        """Emit the larger operand, or ``first`` if an operand is nan, like std::max."""
        a, b = self.alike(first, second)
        return self.select(a < b, b, a)

    def _converted(self, conversion: str, value: Value, element: Type) -> Value:
        type_ = element.of(value.type.lanes)
        return self.instruction(f"{conversion} {value.type} {value.name} to {type_}", type_)

    def to_double(self, value: Value) -> Value:
        """Emit the conversion of integers to doubles."""
        return self._converted("sitofp", value, DOUBLE)

    def to_int(self, value: Value) -> Value:
        """Emit the conversion of doubles to integers, towards zero; undefined beyond 64 bits."""
        return self._converted("fptosi", value, INT)

    def bits(self, value: Value) -> Value:
        """Emit the bit patterns of doubles as 64-bit integers."""
        return self._converted("bitcast", value, INT)

    def from_bits(self, value: Value) -> Value:
        """Emit the doubles that have these 64-bit patterns; the inverse of `bits`."""
        return self._converted("bitcast", value, DOUBLE)

    def flags(self, condition: Value) -> Value:
        """Emit a condition as 64-bit integers: 1 where the condition holds, 0 elsewhere."""
        return self._converted("zext", condition, INT)

    def library(self, name: str, *operands: Operand) -> Value:
        """Emit a call of the C library's function ``name`` for each lane; return the results."""
        values = self.alike(*operands)
        self.module.declare(name, DOUBLE, [DOUBLE] * len(values))

        def of_lane(lane: int) -> Value:
            arguments = ", ".join(f"double {self.lane(value, lane).name}" for value in values)
            return self.instruction(f"call double @{name}({arguments})", DOUBLE)

        return self.gathered(values[0].type.lanes, of_lane)

    def call(self, function: Function, *values: Value) -> Value:
        """Emit a call of ``function``; return its result, or a dummy if it returns nothing."""
        arguments = ", ".join(f"{value.type} {value.name}" for value in values)
        if function.returns is None:
            self.line(f"call void @{function.name}({arguments})")
            return Value(self, "", POINTER)
        text = f"call {function.returns} @{function.name}({arguments})"
        return self.instruction(text, function.returns)

    # ---------------------------------------------------------------------------- lanes

    def any_lane(self, condition: Value) -> Value:
        """Emit a scalar condition that is true if ``condition`` is true in at least one lane."""
        lanes = condition.type.lanes
        if lanes == 1:
            return condition
        text = f"bitcast {condition.type} {condition.name} to i{lanes}"
        bits = self.instruction(text, Type(f"i{lanes}"))
        return self.instruction(f"icmp ne i{lanes} {bits.name}, 0", BOOL)

    def lane(self, value: Value, lane: int) -> Value:
        """Emit the scalar in one lane of a vector, or return ``value`` itself if it is a scalar."""
        if value.type.lanes == 1:
            return value
        text = f"extractelement {value.type} {value.name}, i64 {lane}"
        return self.instruction(text, value.type.of(1))

    def gathered(self, lanes: int, of_lane: Callable[[int], Value]) -> Value:
        """Emit a vector whose lanes are the scalars that ``of_lane(lane)`` returns."""
        first = of_lane(0)
        if lanes == 1:
            return first
        total = Value(self, "poison", first.type.of(lanes))
        for lane in range(lanes):
            part = first if lane == 0 else of_lane(lane)
            text = f"insertelement {total.type} {total.name}, {part.type} {part.name}, i64 {lane}"
            total = self.instruction(text, total.type)
        return total

    # --------------------------------------------------------------------------- memory

    def array(self, size: int, type_: Type = DOUBLE) -> Array:
        """Return local memory of this function for ``size`` elements, without initial values."""
        self._count += 1
        name = f"%a{self._count}"
        count = f"[{max(size, 1)} x {type_}]"
        # At the head of the function: LLVM makes registers of such memory only, and in a loop each
        # pass would take new memory.
        self._allocations.append(f"  {name} = alloca {count}, align {8 * type_.lanes}")
        return Array(Value(self, name, POINTER), type_)

    def variable(self, value: Value) -> Variable:
        """Return a new local variable of this function; emit the store of its first value."""
        new = Variable(self.array(1, value.type))
        new.set(value)
        return new

    def pointer(self, address: Value) -> Value:
        """Emit the conversion of an address, which is an integer, to a pointer."""
        return self.instruction(f"inttoptr i64 {address.name} to ptr", POINTER)

    # -------------------------------------------------------------------------- control

    def new_labels(self, *names: str) -> list[str]:
        """Return a unique label for each name: the name, followed by a new number."""
        self._count += 1
        return [f"{name}{self._count}" for name in names]

    def label(self, name: str) -> None:
        """Begin the basic block with this label: jumps to the label lead here."""
        self._lines.append(f"{name}:")

    @contextmanager
    def when(self, condition: Value, *, rare: bool = False) -> Iterator[None]:
        """Context manager: the code that its body emits runs only if a scalar condition holds.

        ``rare``: tell LLVM that the condition seldom holds, so that LLVM keeps the branch. LLVM can
        replace another branch by a select instruction, and later code waits for the condition.
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
        """Context manager that emits a loop. `Loop.stop_if` ends the loop.

        The loop repeats the code that the body of the ``with`` statement emits.
        """
        head, after = self.new_labels("loop", "after")
        self.line(f"br label %{head}")
        self.label(head)
        yield Loop(self, after)
        self.line(f"br label %{head}")
        self.label(after)

    def each(self, count: int | Value) -> Iterator[Operand]:
        """Yield the indices 0 … ``count`` - 1 to a Python loop whose body emits code.

        If ``count`` is a Python number up to `UNROLLED`, the indices are Python numbers, so the
        code is unrolled. Otherwise one pass of the Python loop emits the body of an emitted loop.
        """
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
        """Like `each`, but never unroll. The code is short, which suits loops that run rarely."""
        return self.each(self.coerce(count, INT))

    def return_(self, value: Value | None = None) -> None:
        """Emit a return from the function, with ``value`` as result."""
        self.line("ret void" if value is None else f"ret {value.type} {value.name}")

    def return_if(self, condition: Value, value: Value | None = None) -> None:
        """Emit code that returns ``value`` from the function if a scalar condition holds."""
        leave, onward = self.new_labels("leave", "onward")
        self.line(f"br i1 {condition.name}, label %{leave}, label %{onward}")
        self.label(leave)
        self.return_(value)
        self.label(onward)
