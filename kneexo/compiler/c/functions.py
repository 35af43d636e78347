"""Builds the C functions that evaluate the equations of a model at one instant."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

from ..equations.equations import Update
from .interface import signal_names
from .plan import Plan
from .printer import CPrinter
from .template import words

_ARRAYS = {"constant": "c", "state": "x", "discrete": "d"}


@dataclass(frozen=True)
class Function:
    """A C function as text: name, statements, and all arguments except the first."""

    name: str
    arguments: str
    statements: Sequence[str]

    @property
    def text(self) -> str:
        """The statements, joined by line breaks."""
        return "\n".join(self.statements)

    def reads(self, variable: str) -> bool:
        """Return whether the statements use ``variable``, not only as a struct member."""
        code = re.sub(r"/\*.*?\*/", "", self.text, flags=re.DOTALL)
        return re.search(rf"(?<![\w>.]){variable}\b", code) is not None


class Functions:
    """The C functions that evaluate a ``Plan``, and the operations that one step executes.

    Attributes
    ----------
    constants
        ``constants_of``: computes the values that depend on parameters alone.
    of_an_instant
        The other functions. The first argument of each function is the struct ``instant``, from
        which the function reads. A function without results is left out, for example ``rate_at`` if
        there are no continuous states.
    constant_count
        Number of values that ``constants_of`` computes.
    operations
        Dictionary from an operator or function, such as ``+`` or ``sqrt``, to its number of
        executions in a step in which all updates are due.
    library
        Names of the functions of the C library that the code calls.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        equations = plan.equations
        self._printer = CPrinter(equations.graph, plan.real, equations.sections)
        self._printer.names = signal_names(equations.sections, plan.name, _taken(plan))
        self._printer.tables = {table.node: number for number, table in enumerate(plan.tables)}
        self._printer.collect_fixed([*plan.step_nodes, *equations.initial_discrete])
        self.operations: Counter[str] = Counter()
        targets = [(f"c[{number}]", node) for node, number in self._printer.fixed.items()]
        block = self._printer.block(targets, self._load, fixed={})
        self.constants = Function("constants_of", "", block)
        self.of_an_instant = self._of_an_instant()
        self.constant_count = len(self._printer.fixed)
        self.library = sorted(self._printer.functions)

    def call(self, name: str) -> bool:
        """Return whether any of the C functions calls the function ``name``."""
        return any(f"{name}(" in f.text for f in (self.constants, *self.of_an_instant))

    def _of_an_instant(self) -> list[Function]:
        plan, equations = self._plan, self._plan.equations
        rates = [(f"rate[{i}]", node) for i, node in enumerate(equations.derivatives)]
        margins = [(f"margin[{i}]", limit.margin) for i, limit in enumerate(equations.limits)]
        initial = [(f"next[{i}]", node) for i, node in enumerate(equations.initial_discrete)]
        fields = (f"out->{field.name}" for field in plan.outputs)
        outputs = list(zip(fields, plan.output_nodes, strict=True))
        ticks = ", uint32_t tick" if plan.schedule.counts_ticks else ""
        lost = ", real *lost" if plan.sums else ""
        functions = [
            # RK4 evaluates the derivatives four times in each of its steps.
            Function("rate_at", ", real *rate", self._block(rates, 4 * plan.schedule.steps)),
            Function("margins_at", ", real *margin", self._block(margins)),
            Function("initial_at", ", real *next", self._printer.block(initial, self._load)),
            Function("update_at", f"{ticks}{lost}, real *next", self._updates()),
            Function("outputs_at", f", {plan.name}_outputs_t *out", self._block(outputs)),
        ]
        are_needed = map(bool, (rates, margins, initial, equations.discrete, outputs))
        return list(compress(functions, are_needed))

    def _load(self, kind: str, index: int) -> str:
        """Return C text that reads element ``index`` of the source ``kind``.

        ``kind`` is a source of the graph (``input``, ``state``, …), ``constant`` or ``table``.
        """
        plan = self._plan
        if kind == "parameter":
            return f"p->{plan.members[index]}"
        if kind == "input":
            field = plan.inputs[index]
            return f"{'(real)' if field.is_integer else ''}in->{field.name}"
        if kind == "table":
            table = plan.tables[index]
            sign = "+" if table.first < 0 else "-"
            place = f"in->{plan.inputs[table.element].name} {sign} {abs(table.first)}"
            return f"{plan.name}_table_{index}[{place}]"
        if kind == "time":
            return "t"
        return f"{_ARRAYS[kind]}[{index}]"

    def _block(
        self, targets: Sequence[tuple[str, int]], times: int = 1, depth: int = 1
    ) -> list[str]:
        """Return C statements that compute ``targets``, pairs of a C variable and a node.

        One step executes the statements ``times`` times. The method adds that many executions to
        the attribute ``operations``.
        """
        self._printer.operations.clear()
        lines = self._printer.block(targets, self._load, indent="    " * depth)
        for operation, count in self._printer.operations.items():
            self.operations[operation] += times * count
        return lines

    def _updates(self) -> list[str]:
        """Return C statements that execute the updates of a tick.

        The statements write the new discrete states to the array ``next``.
        """
        schedule, updates = self._plan.schedule, self._plan.equations.updates
        lines = []
        for update, period, offset in zip(updates, schedule.periods, schedule.offsets, strict=True):
            if period == 1 and offset == 0:
                lines += self._update(update, 1)
                continue
            due = f"((tick - {offset}U) % {period}U) == 0U"
            if offset:
                due = f"(tick >= {offset}U) && ({due})"
            lines += [f"    if ({due}) {{", *self._update(update, 2), "    }"]
        return lines

    def _update(self, update: Update, depth: int) -> list[str]:
        sums = self._plan.sums
        numbers = {state: number for number, state in enumerate(sums)}
        indent = "    " * depth
        targets, additions = [], []
        for state, node in update.values:
            target = f"next[{state}]"
            if state not in sums:
                targets.append((target, node))
                continue
            targets.append((target, self._plan.equations.graph.add(*sums[state])))
            call = f"sum(d[{state}], {target}, &lost[{numbers[state]}])"
            additions.append(f"{indent}{target} = {call};")
            self.operations["+"] += 4  # of the function `sum`
        return [*self._block(targets, depth=depth), *additions]


def _taken(plan: Plan) -> set[str]:
    """Return the names that the source of a model has beside the names of its signals."""
    taken = words(__package__, "model.h") | words(__package__, "model.c")
    tables = {f"{plan.name}_table_{number}" for number in range(len(plan.tables))}
    return tables | taken | {f"{plan.name}{word}" for word in taken}
