"""The functions of an exported model: equations of an instant as C."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..equations.equations import Update
from .printer import CPrinter

if TYPE_CHECKING:
    from .source import CSource

Lines = list[str]
"""Lines of C."""

_MEMORY = {"constant": "c", "state": "x", "discrete": "d"}
_INSTANT = {
    "p": "const NAME_params_t *",
    "in": "const NAME_inputs_t *",
    "c": "const real *",
    "x": "const real *",
    "d": "const real *",
    "t": "const real ",
}


class Functions:
    """The source file: each function, and how often a step computes what."""

    def __init__(self, model: CSource) -> None:
        self.model, self.equations = model, model.equations
        self.printer = CPrinter(self.equations.graph, model.real, self.equations.sections)
        self.printer.tables = {table.node: number for number, table in enumerate(model.tables)}
        self.printer.collect_fixed([*model.roots(), *self.equations.initial_discrete])
        self.operations: Counter[str] = Counter()
        self.lines = self._lines()

    # ------------------------------------------------------------------------- equations

    def _load(self, kind: str, index: int) -> str:
        model = self.model
        if kind == "parameter":
            return f"p->{model.parameter_fields[index]}"
        if kind == "input":
            port, of = model.input_fields[index]
            return f"(real)in->{of}" if port in model.interface.integers else f"in->{of}"
        if kind == "table":
            table = model.tables[index]
            _, of = model.input_fields[table.element]
            place = f"in->{of} {'+' if table.first < 0 else '-'} {abs(table.first)}"
            return f"{model.name}_table_{index}[{place}]"
        if kind == "time":
            return "t"
        return f"{_MEMORY[kind]}[{index}]"

    def _block(self, targets: Sequence[tuple[str, int]], times: int = 1, depth: int = 1) -> Lines:
        """Statements; ``times``: how often a step executes them."""
        self.printer.operations.clear()
        lines = self.printer.block(targets, self._load, indent="    " * depth)
        for operation, count in self.printer.operations.items():
            self.operations[operation] += times * count
        return lines

    def _updates(self) -> Lines:
        """Statements that put the next values of discrete states into ``next``."""
        _, periods, offsets = self.model.timing
        lines = []
        for update, period, offset in zip(self.equations.updates, periods, offsets, strict=True):
            if period == 1 and offset == 0:
                lines += self._update(update, 1)
                continue
            due = f"((tick - {offset}U) % {period}U) == 0U"
            if offset:
                due = f"(tick >= {offset}U) && ({due})"
            lines += [f"    if ({due}) {{", *self._update(update, 2), "    }"]
        return lines

    def _update(self, update: Update, depth: int) -> Lines:
        accumulators = self.model.accumulators
        order = {state: number for number, state in enumerate(accumulators)}
        targets, after = [], []
        indent = "    " * depth
        for state, node in update.values:
            if state not in accumulators:
                targets.append((f"next[{state}]", node))
                continue
            number = order[state]
            targets.append((f"next[{state}]", self.equations.graph.add(*accumulators[state])))
            after.append(
                f"{indent}next[{state}] = sum(d[{state}], next[{state}], &lost[{number}]);"
            )
            self.operations["+"] += 4
        return [*self._block(targets, depth=depth), *after]

    # ------------------------------------------------------------------------- functions

    def _lines(self) -> Lines:
        model, equations, name = self.model, self.equations, self.model.name
        constants = [(f"c[{number}]", node) for node, number in self.printer.fixed.items()]
        initial = [(f"next[{i}]", node) for i, node in enumerate(equations.initial_discrete)]
        rates = [(f"rate[{i}]", node) for i, node in enumerate(equations.derivatives)]
        margins = [(f"margin[{i}]", limit.margin) for i, limit in enumerate(equations.limits)]
        fields = (f"out->{of}" for _, of in model.output_fields)
        outputs = list(zip(fields, model.output_nodes, strict=True))
        lost = ", real *lost" if model.accumulators else ""
        ticks = ", uint32_t tick" if model.counts_ticks else ""
        lines: Lines = []
        if constants:
            block = self.printer.block(constants, self._load, fixed={})
            unused = [] if "p->" in "".join(block) else ["    (void)p;"]
            head = f"static void constants_of(const {name}_params_t *p, real *c)"
            lines += [head, "{", *unused, *block, "}", ""]
        if rates:
            lines += self._function("rate_at", ", real *rate", self._block(rates, 4 * model.steps))
        if margins:
            lines += self._function("margins_at", ", real *margin", self._block(margins))
        if initial:
            block = self.printer.block(initial, self._load)
            lines += self._function("initial_at", ", real *next", block)
        if equations.discrete:
            lines += self._function("update_at", f"{ticks}{lost}, real *next", self._updates())
        if outputs:
            lines += self._function("outputs_at", f", {name}_outputs_t *out", self._block(outputs))
        return lines

    def _function(self, called: str, arguments: str, block: Lines) -> Lines:
        """A function of an instant."""
        text = re.sub(r"/\*.*?\*/", "", "\n".join(block), flags=re.DOTALL)
        name = self.model.name
        locals_ = [
            f"    {kind.replace('NAME', name)}{of} = at->{of};"
            for of, kind in _INSTANT.items()
            if re.search(rf"(?<![\w>.]){of}\b", text)
        ]
        return [
            f"static void {called}(const instant *at{arguments})",
            "{",
            *(locals_ or ["    (void)at;"]),
            "",
            *block,
            "}",
            "",
        ]
