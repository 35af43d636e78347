"""Writes header, source and parameter file in C99 for any diagram that compiles.

``NAME_init`` computes the values that depend on parameters alone, and the discrete state after the
initialization events. ``NAME_step`` simulates one tick, from t to t + T. The step executes the
updates at t with the inputs of the call, integrates the continuous states, and computes the outputs
just before the next updates, at t + T. So the call for a tick returns the command that a controller
holds over this tick. The integrator is the classical fourth-order Runge-Kutta method with fixed
steps, or a Rosenbrock method with error control, which is for stiff equations.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from numbers import Real
from types import NoneType
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from ..diagram_equations import DiagramEquations
from ..equations.equations import Equations
from ..equations.gradients import gradients, time_derivatives
from ..errors import CompilationError, shown
from ..root import TOOL
from ..rosenbrock import CONTROL, MOST_SUBSTEPS, RODAS, TOLERANCE_RANGES, TOLERANCES
from ..run_data import Array, State
from .checks import distinct_names, require_type
from .functions import Functions
from .interface import Interface, parameter_members, require_model_name
from .manifest import checksums, manifest_in_c
from .plan import Plan, compensated_sums, step_nodes
from .printer import PRECISIONS, literal, plain_line
from .rates import fast_rates
from .schedule import schedule_of
from .tables import Table, tables_of
from .template import rendered

INTEGRATORS = ("rk4", "rosenbrock")
"""Names of the methods that integrate the continuous states in C."""

STABILITY = 1.8
"""Product h |λ| from which the C code calls a step of RK4 unstable.

RK4 is unstable from 2.6 … 2.83 on. Where the rates have a corner, such as at a valve that opens, an
unstable mode oscillates about the corner, and the product that the code estimates is about 2.
"""


@dataclass(frozen=True)
class CSource:
    """A model in C: its options, its plan and its files.

    Parameters
    ----------
    equations
        Equations of the diagram: see `read_equations`.
    name
        Prefix of all C names and file names, a C identifier of up to 31 characters.
    parameters, state
        Values of the Context parameters, and the state before the initialization events.
    precision
        ``double`` or ``float``.
    outputs
        Names of the output ports to export; all by default.
    interface
        Names, types and ranges of the ports in C.
    tick_s
        Time in s that a step covers. ``tick_s`` is required for a diagram without a sample time.
        Otherwise a step covers the longest time that divides all sample times, and ``tick_s`` too
        if ``tick_s`` is not None.
    integrator
        ``rk4``, the classical Runge-Kutta method with fixed steps, or ``rosenbrock``, the method of
        `rosenbrock.RODAS`, which is for stiff equations and chooses its substeps by ``tolerance``.
    tolerance
        Largest error estimate of a substep of ``rosenbrock``; by default `rosenbrock.TOLERANCES`.
    step_s
        Largest step of the Runge-Kutta method in s. By default, `rk4_step_s` computes the step from
        the fastest mode at the start.
    look_up
        If True, the code looks up a costly value in a table if the value depends only on one
        integer input that has a range. The table is computed at export. A parameter that is used
        only for the table therefore cannot be changed in C.
    subject
        Short description of the model, part of the first line of each file.
    checks_steps
        If True, a tick returns an error if its last step of RK4 seems to be unstable. The
        Rosenbrock method has no such check, because it is stable with every step.
    origin
        Name and text of the file from which the diagram was made. The export gets a copy of the
        text, in which ``#`` begins a comment.
    beside
        Other files that the file ``origin`` refers to: a dictionary from name to content. They are
        copied into the export.
    tool
        Names and versions of the programs that make the code, such as ``kneexo 0.3.0, diagramc
        0.3.0``. The first line of each file has the first name, the manifest has all.

    Raises
    ------
    CompilationError
        An argument has the wrong type, ``name`` is no identifier, ``precision`` or a name in
        ``outputs`` is unknown, ``outputs`` has a name twice, ``interface`` does not fit the ports,
        `schedule_of` refuses the times, or ``look_up`` is True without a value to look up.
    """

    equations: Equations
    name: str
    parameters: Array
    state: State
    precision: str = "double"
    outputs: Sequence[str] | None = None
    interface: Interface = field(default_factory=Interface)
    tick_s: float | None = None
    integrator: str = "rk4"
    tolerance: float | None = None
    step_s: float | None = None
    look_up: bool = False
    subject: str = ""
    checks_steps: bool = True
    origin: tuple[str, str] | None = None
    beside: Mapping[str, bytes] = field(default_factory=dict)
    tool: str = TOOL

    def __post_init__(self) -> None:
        """Check the options."""
        require_model_name(self.name)
        if self.precision not in tuple(PRECISIONS):
            raise CompilationError(
                f"precision = {shown(f'{self.precision!r:.60}')}: must be one of "
                f"{', '.join(PRECISIONS)}"
            )
        if self.integrator not in INTEGRATORS:
            raise CompilationError(
                f"integrator = {shown(f'{self.integrator!r:.60}')}: must be one of "
                f"{', '.join(INTEGRATORS)}"
            )
        unused = "tolerance" if self.integrator == "rk4" else "step_s"
        if getattr(self, unused) is not None:
            raise CompilationError(
                f"{unused} = {shown(f'{getattr(self, unused)!r:.60}')}: integrator = "
                f"{self.integrator!r} has none; leave it out or choose another integrator"
            )
        if self.tolerance is not None:
            low, high = TOLERANCE_RANGES[self.precision]
            words = f"a number in {low:g} … {high:g} in {self.precision} precision"
            require_type("tolerance", self.tolerance, Real, words)
            if not low <= self.tolerance <= high:
                raise CompilationError(f"tolerance = {self.tolerance:g}: must be {words}")
        for option in ("look_up", "checks_steps"):
            require_type(option, getattr(self, option), bool, "True or False")
        require_type("subject", self.subject, str, "a text")
        require_type("tool", self.tool, str, "a text")
        if self.origin is not None:
            words = "a pair of texts (file name, text)"
            require_type("origin", self.origin, tuple, words)
            if [type(part) for part in self.origin] != [str, str]:
                raise CompilationError(f"origin = {shown(f'{self.origin!r:.60}')}: must be {words}")
        require_type("interface", self.interface, Interface, "an Interface")
        for port in self.output_ports:
            if port not in self.equations.outputs:
                raise CompilationError(
                    f"output {shown(repr(port))} is unknown; known: "
                    f"{', '.join(self.equations.outputs)}"
                )
        sizes = {port: len(nodes) for port, nodes in self.equations.outputs.items()}
        self.interface.require_ports(self.equations.inputs, sizes)
        _ = self.plan

    @property
    def output_ports(self) -> Sequence[str]:
        """Names of the exported output ports."""
        if self.outputs is None:
            return tuple(self.equations.outputs)
        return distinct_names("outputs", self.outputs)

    @property
    def rosenbrock_tolerance(self) -> float | None:
        """Tolerance of the Rosenbrock method; None for RK4 and without continuous states."""
        if self.plan.integrator == "rk4":
            return None
        return TOLERANCES[self.precision] if self.tolerance is None else self.tolerance

    @property
    def rk4_steps(self) -> int:
        """Number of steps of RK4 in a tick; 0 with another method or without continuous states."""
        has_steps = self.equations.states and self.plan.integrator == "rk4"
        return self.plan.schedule.steps if has_steps else 0

    @cached_property
    def plan(self) -> Plan:
        """The data from which the files are printed."""
        real = PRECISIONS[self.precision]
        # The printers add nodes of their own, and the key of machine code depends on all nodes.
        graph = self.equations.graph.copy()
        faster = fast_rates(graph, self.equations.derivatives, self.parameters)
        rates = [faster[node] for node in self.equations.derivatives]
        equations = replace(self.equations, graph=graph, derivatives=rates)
        partials: list[dict[int, int]] = []
        by_time: list[int] = []
        if self.integrator == "rosenbrock":
            # Of the faster nodes, so that rates and derivatives share them.
            partials = gradients(graph, rates)
            by_time = time_derivatives(graph, rates, {graph.source("time"): graph.one})
        nodes = {port: equations.outputs[port] for port in self.output_ports}
        output_nodes = tuple(node for port_nodes in nodes.values() for node in port_nodes)
        inputs = self.interface.members(equations.inputs)
        ranges = {
            element: (int(ends[0]), int(ends[1]))
            for element, member in enumerate(inputs)
            if member.is_integer
            and not self.interface.accepts_inputs
            and (ends := member.limits(real))
        }  # a table has no row for an input out of its range, which `accepts_inputs` lets pass
        tables: list[Table] = []
        if self.look_up:
            roots = [*step_nodes(equations, output_nodes), *equations.initial_discrete]
            tables = tables_of(equations.graph, roots, ranges, self.parameters)
            if not tables:
                raise CompilationError(
                    f"{self.name}: look_up: nothing depends on an integer input with a range alone"
                )
        sizes = {port: len(elements) for port, elements in nodes.items()}
        return Plan(
            name=self.name,
            real=real,
            equations=equations,
            parameters=self.parameters,
            state=self.state,
            members=parameter_members(equations.parameters, self.name),
            inputs=inputs,
            outputs=self.interface.members(sizes),
            output_nodes=output_nodes,
            schedule=schedule_of(
                self.name,
                equations,
                self.parameters,
                self.state,
                self.tick_s,
                self.step_s,
                self.integrator if equations.states else "rk4",
            ),
            tables=tuple(tables),
            sums=compensated_sums(equations, real),
            faster=faster,
            gradients=tuple(partials),
            by_time=tuple(by_time),
        )

    @cached_property
    def functions(self) -> Functions:
        """The C functions that evaluate the equations."""
        return Functions(self.plan)

    @property
    def operations(self) -> Counter[str]:
        """Number of executions in a step, by operator or C library function."""
        return self.functions.operations

    @property
    def state_bytes(self) -> int:
        """Size of the C struct ``NAME_state_t`` in bytes."""
        plan, real_bytes = self.plan, 8 if self.precision == "double" else 4
        groups = (self.equations.states, self.equations.discrete, plan.sums, plan.outputs)
        numbers = sum(map(len, groups)) + self.functions.constant_count
        numbers += plan.integrator == "rosenbrock"  # the length of the next substep
        counter_bytes = 4 * (1 + plan.counts_steps)  # started, tick
        # The struct is padded to a multiple of the size of a floating-point number.
        return real_bytes * (numbers + math.ceil(counter_bytes / real_bytes))

    @property
    def first_line(self) -> str:
        """Text of the comment in the first line of each file."""
        maker = self.tool.partition(" ")[0]
        return plain_line(f"Made by {maker} from a Drake diagram. {self.subject}")

    @property
    def origin_text(self) -> str | None:
        """Text of the exported file that records what the code was generated from.

        An example of such a file is scenario.yaml. ``origin[0]`` is the name of the file, and
        ``origin[1]`` is what follows the first line, which all exported files share. None if the
        caller gave no ``origin``.
        """
        return f"# {self.first_line}\n{self.origin[1]}" if self.origin else None

    @cached_property
    def checksums(self) -> dict[str, str]:
        """Checksums of equations, parameters and ``origin``; see `manifest.checksums`."""
        groups = (self.parameters, self.state.continuous, self.state.discrete)
        numbers = np.concatenate(groups) if any(map(len, groups)) else np.zeros(1)  # member `none`
        real = np.float64 if self.precision == "double" else np.float32
        return checksums(self.equations, numbers.astype(real), self.origin_text)

    @property
    def template_data(self) -> dict[str, Any]:
        """Dictionary of the variables that every template of the model uses."""
        return {
            "name": self.name,
            "NAME": self.name.upper(),
            "real": self.plan.real,
            "first_line": self.first_line,
            "inputs": self.plan.inputs,
            "outputs": self.plan.outputs,
            "accepts_inputs": self.interface.accepts_inputs,
            "failing": [output for output in self.plan.outputs if output.failed is not None],
            "schedule": self.plan.schedule,
            "sums": len(self.plan.sums),
            "checks_steps": self.checks_steps and self.rk4_steps > 0,
            "method": RODAS if self.plan.integrator == "rosenbrock" else None,
            "control": CONTROL,
            "most_substeps": MOST_SUBSTEPS,
            "stability": STABILITY,
            # Below, differences of rates are rounding errors, as in the compiled integrators.
            "smallest_change": 1e-9 if self.precision == "double" else 1e-4,
        }

    def files(self) -> dict[str, str]:
        """Return a dictionary from file name to text, for header, source and parameter file."""
        plan, equations, start = self.plan, self.equations, self._start()
        data = self.template_data | {
            "leaves": self._leaves(),
            "start": start,
            "numbers": [*plan.members]
            + [f"initial_{key}[{i}]" for key, texts in start.items() for i in range(len(texts))],
            "state": self._state_members(),
            "tables": plan.tables,
            "functions": self.functions,
            "states": len(equations.states),
            "discrete": len(equations.discrete),
            "constants": self.functions.constant_count,
            "depends_on_time": plan.depends_on_time,
            "error_tolerance": self.rosenbrock_tolerance,
            "limits": len(equations.limits),
            "needs_time": plan.needs_time,
            "counts_steps": plan.counts_steps,
            "manifest": manifest_in_c(self.checksums, self.tool),
            "tool": self.tool,
        }
        templates = {f"{self.name}{end}": f"model{end}" for end in (".h", ".c")}
        templates[f"{self.name}_params.c"] = "params.c"
        return {file: rendered(__package__, name, **data) for file, name in templates.items()}

    @property
    def struct_values(self) -> dict[str, str]:
        """Members of the C parameter struct in their order in memory, with values as C text."""
        values = {}
        for leaf, members in self._leaves().items():
            for member in members:
                for i, text in enumerate(member.values):
                    end = f"[{i}]" if member.is_array else ""
                    values[f"{leaf}.{member.name}{end}"] = text
        for key, texts in self._start().items():
            values |= {f"initial_{key}[{i}]": text for i, text in enumerate(texts)}
        return values

    def _start(self) -> dict[str, list[str]]:
        """Return the initial states as C text.

        Key ``x`` has the continuous states, key ``d`` the discrete states. A key is missing if the
        model has no such states.
        """
        vectors = {"x": self.state.continuous, "d": self.state.discrete}
        return {
            key: [literal(value, self.plan.real, f"initial {key}") for value in vector.tolist()]
            for key, vector in vectors.items()
            if vector.size
        }

    def _leaves(self) -> dict[str, list[_Member]]:
        """Return the members of the C parameter struct, in a list for each leaf's C name."""
        leaves: dict[str, dict[str, _Member]] = {}
        names, values = self.equations.parameters, self.parameters.tolist()
        for member, name, value in zip(self.plan.members, names, values, strict=True):
            leaf, _, text = member.partition(".")
            array, bracket, _ = text.partition("[")
            group = leaves.setdefault(leaf, {})
            group.setdefault(array, _Member(array, bool(bracket), [])).values.append(
                literal(value, self.plan.real, name)
            )
        return {leaf: list(members.values()) for leaf, members in leaves.items()}

    def _state_members(self) -> list[tuple[str, int, str]]:
        """Return name, size and meaning of each array in the C struct ``NAME_state_t``."""
        states, discrete = self.equations.states, self.equations.discrete
        rows = [
            ("x", len(states), f"continuous: {', '.join(states)}"),
            ("d", len(discrete), f"discrete: {', '.join(discrete)}"),
            ("lost", len(self.plan.sums), "rounding errors of the sums among d"),
            ("c", self.functions.constant_count, "values that depend on parameters alone"),
        ]
        return [row for row in rows if row[1]]


def source_of(diagram: DiagramEquations, name: str, context: Any = None, **options: Any) -> CSource:
    """Return the model in C of a diagram that `read_diagram` has read.

    Parameters
    ----------
    diagram
        The diagram and its equations.
    name
        Prefix of all C names and file names, a C identifier of up to 31 characters.
    context
        Context with the parameters and the state. None: the default Context of the diagram.
    options
        Further arguments of `CSource`.

    Raises
    ------
    CompilationError
        An option is unknown, the Context belongs to another system, or for the reasons of
        `CSource`.
    """
    known = [field.name for field in fields(CSource)][4:]
    if unknown := sorted(options.keys() - set(known)):
        raise CompilationError(
            f"option {shown(repr(unknown[0]))}: is unknown; known: {', '.join(known)}"
        )
    problem = (
        f"context = {shown(f'{context!r:.60}')}: must be a Context of the diagram; create it by "
        f"CreateDefaultContext() of the diagram"
    )
    if not isinstance(context, (Context, NoneType)):
        raise CompilationError(problem)
    try:  # a Context of an equal diagram has the same values
        values = diagram.parameters(context), diagram.state(context)
    except (RuntimeError, TypeError):
        raise CompilationError(problem) from None
    sizes = len(values[0]), len(values[1].continuous), len(values[1].discrete)
    equations = diagram.equations
    if sizes != (len(equations.parameters), len(equations.states), len(equations.discrete)):
        raise CompilationError(problem)
    return CSource(diagram.equations, name, *values, **options)


@dataclass(frozen=True)
class _Member:
    """A member of a leaf system's C parameter struct, and the values of the member as C text."""

    name: str
    is_array: bool
    values: list[str]
