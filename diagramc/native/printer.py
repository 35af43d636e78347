"""Emits the nodes of a program's graph as instructions of a function, for one lane or several."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial, reduce
from typing import Any

from ..equations.graph import SOURCES, Graph
from ..equations.operations import OPERATIONS
from ..equations.partition import zero_factors
from ..equations.passes import ALWAYS, Group, Memo, Place, Program
from . import elementary
from .arguments import MEMO_LINES
from .ir import Array, Function, Module, Operand, Value
from .types import DOUBLE, POINTER, Type

_EMITTERS: dict[str, Callable[[Function, str, Sequence[Operand]], Operand]] = {
    "binary": lambda f, name, a: reduce(partial(f.binary, name), a[1:], a[0]),
    "compare": lambda f, name, a: f.compare(name, *a),
    "not": lambda f, _, a: ~_condition(f, a[0]),
    "instruction": lambda f, name, a: getattr(f, name)(*a),
    "elementary": lambda f, name, a: getattr(elementary, name)(f, *a),
    "library": lambda f, name, a: f.library(name, *a),
}
"""Dictionary from the text before the dot in `Operation.native` to a Python function.

The Python function emits the operation. Its arguments are the emitted function, the text after the
dot, and the emitted arguments of the operation.
"""


@dataclass(frozen=True)
class Nodes:
    """Nodes of a graph that a `Printer` computes, without values from look-up tables."""

    graph: Graph
    deciding: set[int]
    """Nodes that keep Drake's last bits: see `Program`."""
    hoisted: dict[int, int] = field(default_factory=dict)
    memos: tuple[Memo, ...] = ()


class Storage:
    """Where emitted code finds the sources of a graph, and where the code stores its results.

    The constructor takes the time and, by name, an array for each other kind of source (one of
    `graph.SOURCES`) and for each kind of `Place`. The kind ``constant`` has another meaning here
    than in a graph. Here ``constant`` stands for the values that depend on parameters alone, which
    are computed once a run. Subclasses store a result in another way, or emit conditions.
    """

    def __init__(self, time: Operand, **arrays: Array) -> None:
        self.time, self.arrays = time, arrays

    def load(self, kind: str, index: int) -> Operand:
        """Emit code that loads one element of a source, such as a state."""
        return self.time if kind == "time" else self.arrays[kind][index]

    def store(self, place: Place, value: Operand) -> None:
        """Emit code that stores a result."""
        kind, index = place
        self.arrays[kind][index] = value

    def condition(self, condition: tuple[str, int]) -> Value:
        """Emit the condition of a `Group`."""
        raise NotImplementedError


class Printer:
    """Emits code that computes nodes of a graph, as instructions of one emitted function."""

    def __init__(
        self,
        function: Function,
        program: Program | Nodes,
        storage: Storage,
        *,
        hoisted: Mapping[int, int] | None = None,
        memory: Sequence[Array] | None = None,
        known: Mapping[int, Operand] | None = None,
    ) -> None:
        """Make a printer.

        Parameters
        ----------
        function, program, storage
            The function that gets the instructions, the program that has the nodes, and the place
            of the sources and results.
        hoisted
            Dictionary from each node that the code loads as a constant to its index among the
            constants; by default ``program.hoisted``.
        memory
            Two arrays for each `Memo` of the program: the whole numbers (tags) of the rows of its
            look-up table, and the values in the rows. If None, the code looks up nothing.
        known
            Dictionary from each node whose value is emitted already to this value.
        """
        self.function, self.program, self.graph = function, program, program.graph
        self.storage = storage
        self.hoisted = program.hoisted if hoisted is None else hoisted
        self.memory = memory
        self.known = known or {}
        self.memo_of: dict[int, tuple[int, Memo]] = {}
        if memory is not None:
            for number, memo in enumerate(program.memos):
                self.memo_of |= dict.fromkeys(memo.nodes, (number, memo))
        self._zero_factors: dict[int, frozenset[int]] = {}
        self._emitted: dict[Any, Any] = {}  # pairs of sine and cosine, and rows of tables

    def _arguments(self, node: int) -> tuple[int, ...]:
        if node in self.hoisted or node in self.known:
            return ()
        if node in self.memo_of:
            return (self.memo_of[node][1].count,)
        return self.graph.arguments(node)

    def _reachable(self, roots: Iterable[int]) -> set[int]:
        return set(self.graph.reachable(roots, self._arguments))

    def emit_groups(self, groups: Sequence[Group]) -> None:
        """Emit code that computes and stores each group of nodes if the group's condition holds.

        Nodes that several groups need are computed first, without a condition.
        """
        groups_of: dict[int, set[int]] = {}  # indices of the groups that need a node
        without_condition: set[int] = set()
        for index, group in enumerate(groups):
            for node in self._reachable(node for _, node in group.targets):
                groups_of.setdefault(node, set()).add(index)
                if group.condition == ALWAYS:
                    without_condition.add(node)
        fused = self._fused(groups, groups_of)
        roots = (node for group in groups for _, node in group.targets)
        self._zero_factors = zero_factors(self.graph, roots, self.hoisted, self._arguments)
        values: dict[int, Operand] = {}
        shared = (node for node, users in groups_of.items() if len(users) > 1)
        self._compute(sorted(without_condition.union(shared)), values, fused)
        for index, group in enumerate(groups):
            if group.condition == ALWAYS:
                for place, node in group.targets:
                    self.storage.store(place, values[node])
            elif group.targets:
                condition = self.storage.condition(group.condition)
                with self.function.when(condition), self._block():
                    values_in_block = dict(values)
                    alone = (node for node, users in groups_of.items() if users == {index})
                    self._compute(sorted(alone), values_in_block, fused)
                    for place, node in group.targets:
                        self.storage.store(place, values_in_block[node])

    def _fused(self, groups: Sequence[Group], needed: Iterable[int]) -> set[int]:
        """Return the products whose only use is in a sum, as part of a fused multiply-add."""
        uses: dict[int, list[str]] = {}
        for group in groups:
            for _, node in group.targets:
                uses.setdefault(node, []).append("target")
        for node in needed:
            kind = "memo" if node in self.memo_of else self.graph.nodes[node][0]
            for argument in self._arguments(node):
                uses.setdefault(argument, []).append(kind)
        products = {
            node
            for node, kinds in uses.items()
            if kinds == ["add"] and self._operation(node) == "multiply"
        }
        # A fused product is not rounded as Drake's product is, so that a decision could change.
        return products - self.program.deciding

    def emit(self, targets: Iterable[tuple[Place, int]]) -> None:
        """Emit code that computes and stores the values of ``targets`` without a condition."""
        self.emit_groups([Group(ALWAYS, tuple(targets))])

    @contextmanager
    def _block(self) -> Iterator[None]:
        """Context manager around the code of a conditional block.

        The values that the block computes are forgotten at its end, because code after the block
        must not use them.
        """
        before = dict(self._emitted)
        yield
        self._emitted = before

    def _operation(self, node: int) -> str:
        """Return the name of the operation that is emitted for a node.

        The name is empty if the code loads the value as a constant, finds it in a look-up table, or
        has computed it before.
        """
        is_loaded = node in self.hoisted or node in self.known or node in self.memo_of
        return "" if is_loaded else str(self.graph.nodes[node][0])

    def _compute(self, nodes: Iterable[int], values: dict[int, Operand], fused: set[int]) -> None:
        for node in nodes:
            if node not in fused:
                values[node] = self._value(node, values, fused)

    def _value(self, node: int, values: Mapping[int, Operand], fused: set[int]) -> Operand:
        f = self.function
        if node in self.known:
            return self.known[node]
        if node in self.hoisted:
            return self.storage.load("constant", self.hoisted[node])
        if node in self.memo_of:
            return self._looked_up(values[self.memo_of[node][1].count], *self.memo_of[node])[node]
        kind, *_ = self.graph.nodes[node]
        if kind == "constant":
            return float(self.graph.nodes[node][1])
        if kind in SOURCES:
            return self.storage.load(kind, self.graph.nodes[node][1])
        arguments = self.graph.arguments(node)
        emitter, _, name = OPERATIONS[kind].native.partition(".")
        if emitter == "sum":
            return self._sum(arguments, values, fused)
        if emitter == "product":
            sign, factors = self._factors(node, values)
            total = self._product(factors)
            return total if sign > 0 else -total
        operands: list[Operand] = [values[argument] for argument in arguments]
        if emitter == "select":
            return f.select(_condition(f, operands[0]), *operands[1:])
        if not any(isinstance(operand, Value) for operand in operands):
            # LLVM folds constants, as the processor would.
            operands[0] = f.coerce(operands[0], DOUBLE)
        if emitter == "sincos":
            pair = ("sin and cos", arguments[0])
            if pair not in self._emitted:
                self._emitted[pair] = elementary.sincos(f, *f.alike(operands[0]))
            return self._emitted[pair][int(name)]
        emit = partial(_EMITTERS[emitter], f, name, operands)
        # The powers for air in the oil took 60 % of the rates, and by default there is no air. Each
        # run has parameters of its own, so the code asks. Exported C knows its parameters, and has
        # another analysis: `rates._ZeroFactors`.
        if emitter == "elementary" and self._zero_factors[node]:
            # One of several factors is enough for the condition.
            return self._unless_zero(min(self._zero_factors[node]), emit)
        return emit()

    def _unless_zero(self, factor: int, emit: Callable[[], Operand]) -> Value:
        """Emit a costly function that the code skips if it is multiplied by zero in all lanes.

        ``emit`` emits the function. ``factor`` is a node that multiplies the function and that
        depends on parameters alone. In lanes where the factor is zero, the result is 0, which gives
        the right product.
        """
        f, number = self.function, self.storage.load("constant", self.hoisted[factor])
        assert isinstance(number, Value)
        matters = number.differs(0.0)
        result = f.variable(f.constant(0.0, number.type))
        with f.when(f.any_lane(matters)):
            result.set(f.select(matters, f.coerce(emit(), number.type), 0.0))
        return result.get()

    def _sum(self, terms: Sequence[int], values: Mapping[int, Operand], fused: set[int]) -> Operand:
        """Emit the sum of the nodes ``terms``; return the sum.

        ``values``: emitted value of each term; ``fused``: products that a fused multiply-add
        computes and adds.
        """
        total: Operand | None = None
        # Products come last, so that a fused multiply-add can add each of them to the rest.
        for term in terms:
            if term not in fused:
                total = values[term] if total is None else total + values[term]
        for term in terms:
            if term not in fused:
                continue
            sign, factors = self._factors(term, values)
            *most, last = factors or [1.0]
            if most:
                first = self._product(most)
                first = first if sign > 0 else -first
                total = first * last if total is None else self.function.fma(first, last, total)
            elif total is None:
                total = last if sign > 0 else -last
            else:
                total = total + last if sign > 0 else total - last
        assert total is not None
        return total

    def _factors(self, node: int, values: Mapping[int, Operand]) -> tuple[int, list[Operand]]:
        """Separate the factors -1 from the product ``node``.

        Return the sign of their product, 1 or -1, and the values of the other factors.
        """
        sign, factors = 1, []
        for argument in self.graph.arguments(node):
            if self.graph.value(argument) == -1.0:
                sign = -sign
            else:
                factors.append(values[argument])
        return sign, factors

    @staticmethod
    def _product(factors: Sequence[Operand]) -> Operand:
        total = factors[0] if factors else 1.0
        for factor in factors[1:]:
            total = total * factor
        return total

    # ------------------------------------------------------------------- whole-number functions

    def _looked_up(self, count: Operand, number: int, memo: Memo) -> dict[int, Operand]:
        """Emit code that looks up the nodes of ``memo`` at the whole number ``count``.

        ``number``: index of the look-up table. If the table has no row for ``count``, the code
        computes and stores the row. Returns a dictionary from node to emitted value.
        """
        if ("row", number) in self._emitted:
            values: dict[int, Operand] = self._emitted["row", number]
            return values
        f = self.function
        assert self.memory is not None
        assert isinstance(count, Value)
        lanes, width = count.type.lanes, len(memo.nodes)
        tags, rows = self.memory[2 * number], self.memory[2 * number + 1]
        # Beyond 64 bits the conversion to an integer is undefined.
        small = f.absolute(count) < 2.0**31
        index = f.to_int(f.select(small, count, 0.0)) & (MEMO_LINES - 1)
        place = index * lanes + f.lane_numbers(lanes)
        places = [f.lane(place, lane) for lane in range(lanes)]
        tag = f.gathered(lanes, lambda lane: tags[places[lane]])
        row = _Row(self.storage, count, rows, [place * width for place in places])
        is_stored = tag.equals(count) & f.bits(tag).equals(f.bits(count))  # 0 is not -0
        with f.when(f.any_lane(~is_stored)):
            for lane in range(lanes):
                tags[places[lane]] = f.lane(count, lane)
            inner = Printer(f, self.program, row, known={memo.count: count})
            inner.emit((("memo", i), node) for i, node in enumerate(memo.nodes))
        values = {node: row.value(i) for i, node in enumerate(memo.nodes)}
        self._emitted["row", number] = values
        return values


class _Row(Storage):
    """Row of the look-up table of a `Memo` in each lane, for one whole number ``count``."""

    def __init__(self, sources: Storage, count: Value, rows: Array, first: Sequence[Value]) -> None:
        """``rows``: values of the tables of all lanes; ``first``: index of each lane's row."""
        super().__init__(sources.time, **sources.arrays)
        self.count, self.rows, self.first = count, rows, first

    def store(self, place: Place, value: Operand) -> None:
        f = self.count.function
        value = f.coerce(value, self.count.type)
        for lane, first in enumerate(self.first):
            self.rows[first + place[1]] = f.lane(value, lane)

    def value(self, column: int) -> Value:
        """Emit code that loads a value of the row, for all lanes."""
        f = self.count.function
        return f.gathered(len(self.first), lambda lane: self.rows[self.first[lane] + column])


def _condition(function: Function, value: Operand) -> Value:
    return value if isinstance(value, Value) else function.constant(value, Type("i1"))


# ------------------------------------------------------------------ functions without events


def define_constants(module: Module, program: Program) -> None:
    """Define the emitted function ``constants(p, c)``.

    The function computes all values that depend on the parameters ``p`` alone, and writes these
    values to ``c``.
    """
    f = module.function("constants", dict.fromkeys(("p", "c"), POINTER), internal=False)
    parameters, c = (Array(f.arguments[name], DOUBLE) for name in ("p", "c"))
    storage = Storage(0.0, parameter=parameters, constant=c)
    targets = [(("constant", number), node) for node, number in program.hoisted.items()]
    Printer(f, program, storage, hoisted={}).emit(targets)


def define_initialize(module: Module, program: Program) -> None:
    """Define the emitted function ``initialize(x, d, u, c, after)``, for the time 0.

    The function writes the discrete states after the initialization events to ``after``. ``x`` and
    ``d`` are the continuous and discrete states before these events, ``u`` are the open inputs, and
    ``c`` are the values that `define_constants` computes.
    """
    names = ("x", "d", "u", "c", "after")
    f = module.function("initialize", dict.fromkeys(names, POINTER), internal=False)
    x, d, u, c, after = (Array(f.arguments[name], DOUBLE) for name in names)
    storage = Storage(0.0, state=x, discrete=d, input=u, constant=c, after=after)
    targets = [(("after", i), node) for i, node in enumerate(program.initial_discrete)]
    Printer(f, program, storage).emit(targets)


def define_derivatives(module: Module, program: Program, lanes: int, attributes: str) -> Function:
    """Define the emitted function ``derivatives(t, x, d, u, c, out)``.

    The function writes dx/dt at the time ``t`` in s to ``out``; x, d, u, c: see
    `define_initialize`. ``attributes``: LLVM's attributes of the function.
    """
    f, storage = _of_state(module, "derivatives", lanes, attributes)
    targets = [(("out", i), node) for i, node in enumerate(program.derivatives)]
    Printer(f, program, storage).emit(targets)
    return f


def define_second_derivatives(module: Module, program: Program, lanes: int) -> Function:
    """Define the emitted function ``second_derivatives(t, x, d, u, c, out)``.

    The function writes dx/dt and then d²x/dt² along a solution to ``out``. ``u`` has the open
    inputs and then their rates. The other arguments are those of `define_derivatives`.
    """
    f, storage = _of_state(module, "second_derivatives", lanes, "noinline")
    Printer(f, program, storage).emit(
        (("out", i), node) for i, node in enumerate(program.second_derivatives)
    )
    return f


def define_jacobian(module: Module, program: Program) -> Function:
    """Define the emitted function ``jacobian(t, x, d, u, c, out)``, which serves one lane.

    The function writes the derivatives of dx/dt by the states ``x`` to ``out``, column by column.
    """
    f, storage = _of_state(module, "jacobian", 1, "noinline")
    for i in f.loop(program.size**2):
        storage.arrays["out"][i] = 0.0
    Printer(f, program, storage).emit((("out", at), node) for at, node in program.jacobian)
    return f


def define_linear(
    module: Module, program: Program, lanes: int, entries: Sequence[tuple[int, int]]
) -> Function:
    """Define the emitted function ``linear(t, x, d, u, c, out)``.

    The function writes to ``out``: dx/dt; its partial derivatives by the time, if there are any;
    and the elements ``entries`` (row, column) of the Jacobian of dx/dt by the states ``x``. ``u``
    has the open inputs and then their rates. The other arguments are those of `define_derivatives`.
    """
    f, storage = _of_state(module, "linear", lanes, "noinline")
    rows, zero = program.jacobian_rows, program.graph.zero
    elements = [rows[row].get(column, zero) for row, column in entries]
    targets = enumerate([*program.derivatives, *program.by_time, *elements])
    Printer(f, program, storage).emit((("out", i), node) for i, node in targets)
    return f


def define_rates(module: Module, program: Program) -> None:
    """Define the emitted function ``rates(t, x, d, u, c, rates, jacobian)`` for a single lane.

    The function writes dx/dt to ``rates``, and the Jacobian of dx/dt, column by column, to
    ``jacobian``. ``t`` is the address of the time in s.
    """
    parts = define_derivatives(module, program, 1, "noinline"), define_jacobian(module, program)
    shared = ("t", "x", "d", "u", "c")
    names = (*shared, "rates", "jacobian")
    f = module.function("rates", dict.fromkeys(names, POINTER), internal=False)
    time, *rest = (f.arguments[name] for name in shared)
    for part, out in zip(parts, names[-2:], strict=True):
        f.call(part, Array(time, DOUBLE)[0], *rest, f.arguments[out])


def _of_state(module: Module, name: str, lanes: int, attributes: str) -> tuple[Function, Storage]:
    """Return a new emitted function of the time and the states, and the storage of its arrays."""
    type_ = DOUBLE.of(lanes)
    names = ("x", "d", "u", "c", "out")
    arguments = {"t": type_} | dict.fromkeys(names, POINTER)
    f = module.function(name, arguments, attributes=attributes)
    x, d, u, c, out = (Array(f.arguments[key], type_) for key in names)
    return f, Storage(f.arguments["t"], state=x, discrete=d, input=u, constant=c, out=out)
