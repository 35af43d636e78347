"""What every leaf system of kneexo shares: named Context parameters and three-scalar helpers."""

from __future__ import annotations

import math
import sys
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Any

from pydrake.math import max as _max
from pydrake.math import min as _min
from pydrake.symbolic import Expression, if_then_else
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from kneexo.errors import SimulationError


def leaf_template(module: str, name: str) -> Any:
    """Drake's decorator for a leaf system of all scalars, told where it is: looking takes 40 ms."""
    return TemplateSystem.define(name, scope=sys.modules[module])


def instances_of_float(module: str) -> Callable[[str], Any]:
    """Module ``__getattr__`` that makes ``Name`` from ``Name_`` when it is first asked for.

    Drake takes 0.1 s for each instance, and what runs compiled needs none.
    """

    def instance(name: str) -> Any:
        template = vars(sys.modules[module]).get(f"{name}_")
        if not isinstance(template, TemplateSystem):
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return template[None]

    return instance


def clip(value: Any, lower: Any, upper: Any) -> Any:
    """Limit a float, AutoDiffXd or Expression to lower…upper, keeping its derivative inside."""
    return _min(_max(value, lower), upper)


def where_positive(condition: Any, positive: Any, otherwise: Any) -> Any:
    """``positive`` where ``condition`` > 0, else ``otherwise``; for all three scalars."""
    if isinstance(condition, Expression):
        branches = (
            v if isinstance(v, Expression) else Expression(v) for v in (positive, otherwise)
        )
        return if_then_else(condition > 0.0, *branches)
    return positive if condition > 0.0 else otherwise


def values_of(source: Any, *names: str) -> dict[str, float]:
    """The named attributes of a parameter object."""
    return {name: getattr(source, name) for name in names}


def _named_values(names: Sequence[str]) -> Any:
    return namedtuple("Values", names)


class NamedLeaf:
    """Mixin for ``LeafSystem_[T]``: scalar conversion and Context parameters by name."""

    def _begin(self: Any, scalar: Any, converter: Any, *arguments: Any) -> None:
        """Initialize the LeafSystem; ``arguments`` are kept for the conversion to other scalars."""
        LeafSystem_[scalar].__init__(self, converter)
        self._scalar = scalar
        self._values = _named_values(())
        self._arguments = arguments

    def _declare_parameters(self: Any, source: Any, names: Sequence[str] = ()) -> None:
        """Declare one numeric parameter vector: a mapping, or ``names`` of another object."""
        values = source if isinstance(source, Mapping) else values_of(source, *names)
        self._values = _named_values(tuple(values))
        self.DeclareNumericParameter(
            BasicVector_[self._scalar]([float(value) for value in values.values()])
        )

    def _declare_output(
        self: Any,
        name: str,
        size: int,
        calc: Callable[[Any], Sequence[Any]],
        *sources: Any,
    ) -> Any:
        """Declare an output of ``calc(context)`` that reads ``sources``: ports or tickets."""

        def copy(context: Any, out: Any) -> None:
            for index, value in enumerate(calc(context)):
                out.SetAtIndex(index, value)

        tickets = {s.ticket() if hasattr(s, "ticket") else s for s in sources}
        return self.DeclareVectorOutputPort(name, size, copy, tickets or {self.nothing_ticket()})

    def _declare_update(
        self: Any, period: float, size: int, update: Callable[[Any], Sequence[Any]]
    ) -> None:
        """Declare one discrete state of ``size`` with x⁺ = ``update(context)`` every ``period``."""

        def copy(context: Any, discrete_state: Any) -> None:
            vector = discrete_state.get_mutable_vector(0)
            for index, value in enumerate(update(context)):
                vector.SetAtIndex(index, value)

        self.DeclareDiscreteState(size)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, copy)

    def _declare_initialization(self: Any, initialize: Callable[[Any], Sequence[Any]]) -> None:
        """Declare x = ``initialize(context)``, which ``Simulator.Initialize()`` applies once."""

        def copy(context: Any, discrete_state: Any) -> None:
            vector = discrete_state.get_mutable_vector(0)
            for index, value in enumerate(initialize(context)):
                vector.SetAtIndex(index, value)

        self.DeclareInitializationDiscreteUpdateEvent(copy)

    def parameters(self: Any, context: Any) -> Any:
        """All named Context parameters of this system, as a named tuple of scalars."""
        return self._values._make(context.get_numeric_parameter(0).CopyToVector().tolist())

    def set_parameter(self: Any, context: Any, name: str, value: Any) -> None:
        """Set one Context parameter by its name.

        Raises `ValueError` for an unknown name or a number that is not finite.
        """
        names = self._values._fields
        if name not in names:
            raise ValueError(
                f"{self.get_name()}: unknown parameter {name!r}; known: {', '.join(names)}"
            )
        if isinstance(value, Real) and not math.isfinite(value):
            raise ValueError(f"{self.get_name()}: {name} = {value}: must be finite")
        context.get_mutable_numeric_parameter(0).SetAtIndex(names.index(name), value)


def require_finite(system: Any, context: Any, **values: Any) -> None:
    """Raise `SimulationError` when one of the floats ``values`` is not finite.

    A NaN derivative would hang Drake's error-controlled integrators and pass silently through the
    others. AutoDiffXd and Expression are not checked.
    """
    for name, value in values.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise SimulationError(
                f"t = {context.get_time():.6g} s: {system.get_name()}: {name} = {value} is not "
                f"finite; reduce the step or check the inputs"
            )


def discrete_state(context: Any) -> list[Any]:
    """The first discrete state group as scalars."""
    values: list[Any] = context.get_discrete_state(0).CopyToVector().tolist()
    return values


def value_or_zero(port: Any, context: Any) -> Any:
    """The scalar at an input port that may be left unconnected: then zero."""
    return port.Eval(context)[0] if port.HasValue(context) else 0.0
