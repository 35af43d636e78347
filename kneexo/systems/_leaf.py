"""What every leaf system shares: all scalars of Drake, and Context parameters by name."""

from __future__ import annotations

import math
import sys
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from numbers import Real
from typing import TYPE_CHECKING, Any, Self

from pydrake.math import max as _max, min as _min
from pydrake.symbolic import Expression, if_then_else
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from kneexo.errors import SimulationError

if TYPE_CHECKING:
    from pydrake.systems.framework import LeafSystem
else:  # `leaf_template` adds Drake's class of the scalar
    LeafSystem = object


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


def fill(vector: Any, values: Sequence[Any]) -> None:
    """Set the elements of a vector of Drake."""
    for index, value in enumerate(values):
        vector.SetAtIndex(index, value)


def _named_values(names: Sequence[str]) -> Any:
    return namedtuple("Values", names)


class NamedLeaf(LeafSystem):
    """Base of a component: a leaf system for all scalars of Drake, with named Context parameters.

    A subclass declares ports, state and Context parameters in ``__init__``. ``Component(…)`` makes
    its system for float, which converts to AutoDiffXd and Expression: `leaf_template` has the class
    for each scalar. All these systems are instances of ``Component``.
    """

    _scalar: Any = None
    _values: Any = _named_values(())
    check: Callable[[Any], None]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the Context parameters; the compiler reads them."""
        names: tuple[str, ...] = self._values._fields
        return names

    def __new__(cls, *_: Any, **__: Any) -> Self:
        """Drake's leaf system of float, where no scalar is chosen."""
        system: Any = cls
        if cls._scalar is None:
            system = leaf_template(system)[None]
        return super(NamedLeaf, system).__new__(system)

    def _declare_parameters(self, values: Mapping[str, float]) -> None:
        """Declare one vector of numeric parameters, by name."""
        self._values = _named_values(tuple(values))
        self.DeclareNumericParameter(
            BasicVector_[self._scalar]([float(value) for value in values.values()])
        )

    def _declare_output(
        self, name: str, size: int, calc: Callable[[Any], Sequence[Any]], *sources: Any
    ) -> Any:
        """Declare an output of ``calc(context)`` that reads ``sources``: ports or tickets."""
        tickets = {s.ticket() if hasattr(s, "ticket") else s for s in sources}
        return self.DeclareVectorOutputPort(
            name,
            size,
            lambda context, output: fill(output, calc(context)),
            tickets or {self.nothing_ticket()},
        )

    def _declare_update(
        self, period: float, size: int, update: Callable[[Any], Sequence[Any]]
    ) -> None:
        """Declare one discrete state of ``size`` with x⁺ = ``update(context)`` every ``period``."""
        self.DeclareDiscreteState(size)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period, 0.0, lambda context, state: fill(state.get_mutable_vector(0), update(context))
        )

    def _declare_initialization(self, initialize: Callable[[Any], Sequence[Any]]) -> None:
        """Declare x = ``initialize(context)``, which ``Simulator.Initialize()`` applies once."""
        self.DeclareInitializationDiscreteUpdateEvent(
            lambda context, state: fill(state.get_mutable_vector(0), initialize(context))
        )

    def _declare_check(self, check: Callable[[Any], None]) -> None:
        """Call ``check(context)`` after each step of a simulation in floats.

        As the method ``check`` it also explains a compiled run that ends outside the limits.
        """
        self.check = check
        if self._scalar is float:
            self.DeclarePerStepPublishEvent(check)

    def parameters(self, context: Any) -> Any:
        """All named Context parameters of this system, as a named tuple of scalars."""
        return self._values._make(context.get_numeric_parameter(0).CopyToVector().tolist())

    def set_parameter(self, context: Any, name: str, value: Any) -> None:
        """Set one Context parameter by its name.

        Raises `ValueError` for an unknown name or a number that is not finite.
        """
        names = self.parameter_names
        if name not in names:
            raise ValueError(
                f"{self.get_name()}: unknown parameter {name!r}; known: {', '.join(names)}"
            )
        if isinstance(value, Real) and not math.isfinite(value):
            raise ValueError(f"{self.get_name()}: {name} = {value}: must be finite")
        context.get_mutable_numeric_parameter(0).SetAtIndex(names.index(name), value)


@cache
def leaf_template(component: type[NamedLeaf]) -> Any:
    """Drake's template of a component: its leaf system for each scalar, made when asked for.

    Each takes Drake some milliseconds, and what runs compiled needs none. An explicit scope avoids
    40 ms of stack inspection.
    """

    @TemplateSystem.define(f"{component.__name__}_", scope=sys.modules[component.__module__])
    def template(scalar: Any) -> Any:
        # mypy knows no base class that is a value.
        class Impl(component, LeafSystem_[scalar]):  # type: ignore[misc, valid-type]
            __doc__ = component.__doc__
            _scalar = scalar

            def _construct(self, *values: Any, converter: Any = None, **named: Any) -> None:
                LeafSystem_[scalar].__init__(self, converter)
                self._arguments = values, named
                component.__init__(self, *values, **named)

            def _construct_copy(self, other: Any, converter: Any = None) -> None:
                values, named = other._arguments
                Impl._construct(self, *values, converter=converter, **named)

        return Impl

    return template


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
