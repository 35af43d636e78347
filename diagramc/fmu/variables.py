"""The variables of an FMU: inputs, parameters and outputs of a model, with value references."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Literal

from ..c.checks import require_type
from ..c.plan import Plan
from ..c.printer import DOUBLE
from ..equations.graph import Entry
from ..errors import CompilationError, shown
from .units import Unit, unit_of_name

Causality = Literal["independent", "input", "parameter", "output", "local"]
"""The role of a variable in the words of the FMI standard, such as ``input``."""

_PART = r"[A-Za-z_][A-Za-z0-9_]*(\[[0-9]+\])?"
_NAME = re.compile(rf"{_PART}(\.{_PART})*")
"""Pattern of the names of variables: the structured names of FMI without quotation marks."""


@dataclass(frozen=True)
class FmuParameter:
    """A parameter of an FMU, which sets members of the C parameter struct.

    Each member is set to the value of the parameter, divided by ``divisor``.
    """

    name: str
    start: float
    members: tuple[str, ...]
    """The members of the struct that the parameter sets: ``leaf.mass``, ``initial_x[1]``."""
    description: str = ""
    low: float = -DOUBLE.largest
    high: float = DOUBLE.largest
    divisor: float = 1.0
    tunable: bool = True
    """If False, the value cannot change after the initialization of a run."""


@dataclass(frozen=True)
class Variable:
    """A scalar variable of an FMU."""

    name: str
    causality: Causality
    variability: str
    """FMI's word for when the value can change, such as ``continuous`` or ``fixed``."""
    start: float | None = None
    description: str = ""
    low: float = -DOUBLE.largest
    high: float = DOUBLE.largest

    @property
    def unit(self) -> Unit | None:
        """The unit at the end of the name, or None without a unit. The unit of the time is s."""
        return unit_of_name("time_s" if self.causality == "independent" else self.name)


class VariableTable:
    """All variables of an FMU. The value reference of a variable is its index in ``variables``.

    The order is: time, inputs, tunable parameters, fixed parameters, outputs, sample time.

    Parameters
    ----------
    plan
        The model.
    parameters
        Parameters of the FMU, in any order. The attribute has the tunable parameters first.
    starts
        Start values of inputs by name; every other input starts at zero.

    Raises `CompilationError` if two variables have the same name, if two parameters set the same
    member of the C parameter struct, or if the struct lacks a member. Raises `CompilationError` if
    the name of a parameter is no structured name of FMI, if a start value is outside its range or
    not finite, or if ``starts`` has a name that is no input.
    """

    def __init__(
        self, plan: Plan, parameters: Iterable[FmuParameter], starts: Mapping[str, float]
    ) -> None:
        self._plan = plan
        self._states = start_members("x", len(plan.equations.states))
        self._discrete = start_members("d", len(plan.equations.discrete))
        # The C code tells by one comparison of the value reference whether a variable is tunable.
        self.parameters = sorted(parameters, key=lambda parameter: not parameter.tunable)
        self._require_members()
        self._require_names_and_starts(starts)
        inputs = [
            Variable(field.name, "input", "continuous", starts.get(field.name, 0.0))
            for field in plan.inputs
        ]
        settable = [
            Variable(
                parameter.name,
                "parameter",
                "tunable" if parameter.tunable else "fixed",
                parameter.start,
                parameter.description,
                parameter.low,
                parameter.high,
            )
            for parameter in self.parameters
        ]
        outputs = [Variable(field.name, "output", "continuous") for field in plan.outputs]
        time = Variable("time", "independent", "continuous")
        sample_time = Variable(
            "sample_time_s",
            "local",
            "constant",
            plan.schedule.tick_s,
            "every communication step is a whole multiple of it",
        )
        self.variables = [time, *inputs, *settable, *outputs, sample_time]
        roles: dict[str, str] = {}
        for variable in self.variables:
            name, role = variable.name, variable.causality
            if name in roles:
                raise CompilationError(
                    f"{name}: the {roles[name]} and the {role} of the FMU have this name; rename "
                    f"one of them"
                )
            roles[name] = role

    def _require_members(self) -> None:
        for parameter in self.parameters:
            what = f"members of {parameter.name!r:.60}"
            require_type(what, parameter.members, (tuple, list), "a tuple of names")
        known = {*self._plan.members, *self._states, *self._discrete}
        members = [member for parameter in self.parameters for member in parameter.members]
        for member in members:
            if member not in known or members.count(member) > 1:
                reason = "is unknown" if member not in known else "is set by two parameters"
                raise CompilationError(
                    f"{self._plan.name}: the parameter {shown(member)} in C {reason}"
                )

    def _require_names_and_starts(self, starts: Mapping[str, float]) -> None:
        for parameter in self.parameters:
            require_type("name of a parameter", parameter.name, str, "a text")
            for key in ("start", "low", "high", "divisor"):
                value = getattr(parameter, key)
                require_type(f"{key} of {parameter.name!r:.60}", value, Real, "a number")
            if not (math.isfinite(parameter.divisor) and parameter.divisor):
                raise CompilationError(
                    f"divisor of {parameter.name!r:.60} = {parameter.divisor:g}: must be finite, "
                    f"and not 0"
                )
            require_type(
                f"description of {parameter.name!r:.60}", parameter.description, str, "a text"
            )
            if not _NAME.fullmatch(parameter.name):
                raise CompilationError(
                    f"parameter {shown(repr(parameter.name))}: must be a name such as leaf.mass or "
                    f"gains[2], of letters, digits and _"
                )
            if not parameter.low <= parameter.start <= parameter.high:
                raise CompilationError(
                    f"{parameter.name} = {parameter.start:g}: must be {parameter.low:g} … "
                    f"{parameter.high:g}"
                )
        inputs = [field.name for field in self._plan.inputs]
        for name in starts:
            if name not in inputs:
                raise CompilationError(
                    f"starts: {shown(repr(name))} is no input; inputs: "
                    f"{', '.join(inputs) or 'none'}"
                )
            require_type(f"start value {name}", starts[name], Real, "a finite number")
            if not math.isfinite(starts[name]):
                raise CompilationError(f"{name} = {starts[name]:g}: must be finite at the start")

    def references(self, causality: Causality) -> list[int]:
        """Return the value references of all variables with a role, such as ``input``."""
        return [i for i, v in enumerate(self.variables) if v.causality == causality]

    def assignments(self) -> list[tuple[str, int, FmuParameter]]:
        """Return (C struct member, value reference, parameter) for each member that is set."""
        pairs = zip(self.references("parameter"), self.parameters, strict=True)
        return [(member, i, parameter) for i, parameter in pairs for member in parameter.members]

    def initial_dependencies(self) -> list[list[int]]:
        """Return, for each output, the value references of what its start value depends on.

        That are inputs and parameters of the FMU. They also act through initialization events.
        """
        graph = self._plan.equations.graph
        initial_nodes = self._plan.equations.initial_discrete
        members = {"parameter": self._plan.members, "state": self._states}
        earlier_members = members | {"discrete": self._discrete}
        dependencies = []
        for node in self._plan.output_nodes:
            operations = [graph.nodes[n] for n in graph.reachable([node])]
            initial = [initial_nodes[i] for kind, i in sources(operations) if kind == "discrete"]
            earlier = [graph.nodes[n] for n in graph.reachable(initial)]
            references = self._setters(operations, members)
            dependencies.append(sorted(references | self._setters(earlier, earlier_members)))
        return dependencies

    def _setters(
        self, operations: Sequence[Entry], members: Mapping[str, Sequence[str]]
    ) -> set[int]:
        """Return value references of the FMU's inputs and parameters that graph entries read.

        ``members`` maps a kind of graph entry to the members of the C parameter struct by index.
        """
        inputs = self.references("input")
        setters = {member: reference for member, reference, _ in self.assignments()}
        references: set[int] = set()
        for kind, index in sources(operations):
            if kind == "input":
                references.add(inputs[index])
            elif kind in members and (member := members[kind][index]) in setters:
                references.add(setters[member])
        return references


def start_members(vector: Literal["x", "d"], size: int) -> list[str]:
    """Return the members of the C parameter struct with the start values of the states.

    ``vector`` is ``x`` for the continuous states and ``d`` for the discrete states.
    """
    return [f"initial_{vector}[{i}]" for i in range(size)]


def sources(operations: Iterable[Entry]) -> Iterator[tuple[str, int]]:
    """Yield kind and index of each graph entry that reads an input, a parameter or a state."""
    for kind, *rest in operations:
        if kind in ("input", "parameter", "state", "discrete"):
            yield str(kind), int(rest[0])
