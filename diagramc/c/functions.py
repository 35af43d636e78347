"""Builds the C functions that evaluate the equations of a model at one instant."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress

from ..equations.equations import Update
from ..rosenbrock import RODAS, Elimination
from .interface import signal_names
from .plan import Plan
from .printer import CPrinter, section_comment
from .rosenbrock import factorization, solution
from .template import words

_MOST_TERMS = 2000
"""Largest number of terms and arguments of the derivatives that are printed inside the loops of
RK4.

Compilers move all constants of such a loop before it. Many constants fill the stack, and the
compilation takes long: 6 s for 60 dense states, with twice the code.
"""

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
        """Return whether the statements use ``variable``.

        A struct member with this name, such as ``p->x``, does not count, nor does a comment.
        """
        code = re.sub(r"/\*.*?\*/", "", self.text, flags=re.DOTALL)
        return re.search(rf"(?<![\w>.]){variable}\b", code) is not None


class Functions:
    """The C functions that evaluate a ``Plan``, and the operations that one step executes.

    Attributes
    ----------
    constants
        ``constants_of``: computes the values that depend on parameters alone.
    elimination
        Solver of the linear equations of the Rosenbrock method, or None for RK4.
    factorization, solution
        Statements of ``elimination``; none for RK4.
    is_large
        Whether RK4 calls a function for the derivatives, ``rate_at``. The Rosenbrock method always
        does, and calls ``linear_at`` for the derivatives and their gradients.
    tick_values, rates
        Statements of ``integrate``, which has RK4: before the loops, the values that are constant
        over a tick; in the loop of the stages, the derivatives.
    stage_states
        Indices of the continuous states that ``rates`` reads.
    of_an_instant
        The other functions. The first argument of each function is the struct ``instant``, from
        which the function reads. A function without results is left out, for example ``margins_at``
        if there are no limits.
    constant_count
        Number of values that ``constants_of`` computes.
    operations
        Dictionary from an operator or function, such as ``+`` or ``sqrt``, to its number of
        executions in a step in which all updates are due, with one substep of the Rosenbrock
        method.
    library
        Names of the functions of the C library that the code calls.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        equations = plan.equations
        names = signal_names(equations.sections, plan.name, _taken(plan))
        added_terms = {
            node: equations.graph.add(*plan.sums[state])
            for update in equations.updates
            for state, node in update.values
            if state in plan.sums
        }
        # A node that the code computes in the place of another node belongs to the same section.
        sections = []
        for section in equations.sections:
            nodes = list(section.nodes)
            for substitutes in (plan.faster, added_terms):
                nodes += [substitutes[node] for node in section.nodes if node in substitutes]
            sections.append(replace(section, nodes=tuple(nodes)))
        self._section_of = {node: s for s in reversed(sections) for node in s.nodes}
        self._printer = CPrinter(equations.graph, plan.real, sections)
        self._printer.names = names
        self._printer.tables = {table.node: number for number, table in enumerate(plan.tables)}
        self._printer.collect_fixed([*plan.step_nodes, *equations.initial_discrete])
        self.operations: Counter[str] = Counter()
        targets = [(f"c[{number}]", node) for node, number in self._printer.fixed.items()]
        block = self._printer.block(targets, self._load, fixed={})
        self.constants = Function("constants_of", "", block)
        self.of_an_instant = self._of_an_instant()
        nodes = equations.graph.reachable(equations.derivatives)
        terms = sum(len(equations.graph.arguments(node)) for node in nodes)
        self.is_large = terms > _MOST_TERMS
        self.elimination: Elimination | None = None
        self.factorization, self.solution = list[str](), list[str]()
        if plan.integrator == "rosenbrock":
            self._add_rosenbrock()
            self.tick_values = self.rates = Function("integrate", "", [])
        else:
            self.tick_values, self.rates = self._integration()
        indices = range(len(equations.states))
        self.stage_states = [i for i in indices if self.rates.reads(f"z{i}")]
        self.constant_count = len(self._printer.fixed)
        library = {*self._printer.functions}
        if self.elimination:
            library.add(f"sqrt{plan.real.suffix}")  # of the length of a substep
        self.library = sorted(library)

    def calls(self, name: str) -> bool:
        """Return whether any of the C functions calls the function ``name``."""
        functions = self.constants, self.tick_values, self.rates, *self.of_an_instant
        return any(f"{name}(" in function.text for function in functions)

    def integration_reads(self, *variables: str) -> bool:
        """Return whether the statements of RK4 use any of ``variables``; see `Function.reads`."""
        parts = self.tick_values, self.rates
        return any(part.reads(variable) for part in parts for variable in variables)

    def _of_an_instant(self) -> list[Function]:
        plan, equations = self._plan, self._plan.equations
        margins = [(f"margin[{i}]", limit.margin) for i, limit in enumerate(equations.limits)]
        initial = [(f"next[{i}]", node) for i, node in enumerate(equations.initial_discrete)]
        fields = (f"out->{field.name}" for field in plan.outputs)
        outputs = list(zip(fields, plan.output_nodes, strict=True))
        ticks = ", uint32_t tick" if plan.schedule.counts_ticks else ""
        lost = ", real *lost" if plan.sums else ""
        functions = [
            Function("margins_at", ", real *margin", self._block(margins)),
            Function("initial_at", ", real *next", self._printer.block(initial, self._load)),
            Function("update_at", f"{ticks}{lost}, real *next", self._updates()),
            Function("outputs_at", f", {plan.name}_outputs_t *out", self._block(outputs)),
        ]
        are_needed = map(bool, (margins, initial, equations.discrete, outputs))
        return list(compress(functions, are_needed))

    def _integration(self) -> tuple[Function, Function]:
        """Return the statements of ``integrate`` before its loops, and in the loop of the stages.

        The statements before the loops compute the values that are constant over a tick. The
        statements in the loop compute the derivatives ``rate0``, ``rate1`` … of the states ``z0``,
        ``z1`` … If the model is large, both are empty, and the function ``rate_at`` is added to
        `of_an_instant`.
        """
        derivatives = self._plan.equations.derivatives
        self._name_faster_nodes()
        stages = 4 * self._plan.schedule.steps
        if self.is_large:
            rates = [(f"rate[{i}]", node) for i, node in enumerate(derivatives)]
            evaluation = Function("rate_at", ", real *rate", self._block(rates, stages))
            self.of_an_instant.append(evaluation)
            derivatives = []
        held = self._printer.constant_in_a_tick(derivatives)
        before = [(f"const real held{number}", node) for node, number in held.items()]
        rates = [(f"rate{i}", node) for i, node in enumerate(derivatives)]
        return (
            Function("integrate", ", real *x", self._block(before)),
            Function("integrate", ", real *x", self._block(rates, stages, depth=3, held=held)),
        )

    def _add_rosenbrock(self) -> None:
        """Add the functions of the Rosenbrock method to `of_an_instant`, and set `elimination`."""
        plan, calls = self._plan, len(RODAS.nodes) - 1
        self._name_faster_nodes()
        rates = [(f"rate[{i}]", node) for i, node in enumerate(plan.equations.derivatives)]
        zero = plan.equations.graph.zero
        self.elimination = Elimination(plan.gradients, len(RODAS.nodes))
        self.factorization = factorization(self.elimination, plan.real)
        self.solution = solution(self.elimination, plan.real)
        partials = [
            (f"jacobian[{place}]", plan.gradients[row].get(column, zero))
            for place, (row, column) in enumerate(self.elimination.entries)
        ]
        arguments = ", real *rate, real *jacobian"
        if plan.depends_on_time:
            arguments += ", real *by_time"
            partials += [(f"by_time[{i}]", node) for i, node in enumerate(plan.by_time)]
        self.of_an_instant += [
            Function("rate_at", ", real *rate", self._block(rates, calls)),
            Function("linear_at", arguments, self._block([*rates, *partials])),
        ]
        self.operations.update(self.elimination.operations)

    def _name_faster_nodes(self) -> None:
        """Give the names of signals to the nodes that `fast_rates` computes in their place."""
        faster, names = self._plan.faster, self._printer.names.items()
        self._printer.names = {faster.get(node, node): name for node, name in names}

    def _load_at_stage(self, kind: str, index: int) -> str:
        """Return C text that reads an element at a stage of RK4. ``kind``: `_load`, or ``held``."""
        names = {"state": f"z{index}", "held": f"held{index}"}
        return names.get(kind) or self._load(kind, index)

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
        self,
        targets: Sequence[tuple[str, int]],
        times: int = 1,
        depth: int = 1,
        held: Mapping[int, int] | None = None,
    ) -> list[str]:
        """Return C statements that compute ``targets``, pairs of a C variable and a node.

        One step executes the statements ``times`` times. The method adds that many executions to
        the attribute ``operations``. ``held`` maps the nodes that are constant over a tick to their
        numbers, if the statements belong to a stage of RK4.
        """
        self._printer.operations.clear()
        load = self._load if held is None else self._load_at_stage
        lines = self._printer.block(targets, load, held=held, indent="    " * depth)
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
        targets: list[tuple[str, int]] = []
        additions: list[str] = []
        for state, node in update.values:
            target = f"next[{state}]"
            if state not in sums:
                targets.append((target, node))
                continue
            targets.append((target, self._plan.equations.graph.add(*sums[state])))
            if node in self._section_of:
                additions += section_comment(self._section_of[node], indent)
            call = f"sum(d[{state}], {target}, &lost[{numbers[state]}])"
            additions.append(f"{indent}{target} = {call};")
            self.operations["+"] += 4  # of the function `sum`
        return [*self._block(targets, depth=depth), *additions]


def _taken(plan: Plan) -> set[str]:
    """Return the names that the source of a model has beside the names of its signals."""
    templates = ("model.h", "model.c", "rosenbrock.c")
    taken = frozenset[str]().union(*(words(__package__, template) for template in templates))
    tables = {f"{plan.name}_table_{number}" for number in range(len(plan.tables))}
    return tables | taken | {f"{plan.name}{word}" for word in taken}
