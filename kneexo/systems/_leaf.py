"""Base class of the leaf systems: all scalar types of Drake, and named Context parameters."""

from __future__ import annotations

import math
import sys
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from inspect import signature
from numbers import Real
from typing import TYPE_CHECKING, Any, Self

from pydrake.math import max as _max, min as _min
from pydrake.symbolic import Expression, if_then_else, logical_and
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from diagramc import trust
from kneexo.common import PACKAGE
from kneexo.errors import SimulationError
from kneexo.parameters.fields.quantity import Parameters, require_object

if TYPE_CHECKING:
    from pydrake.systems.framework import LeafSystem
else:  # `leaf_template` adds Drake's class of the scalar
    LeafSystem = object


trust(PACKAGE)  # tests compare every leaf of kneexo for all scalar types


def clip(value: Any, lower: Any, upper: Any) -> Any:
    """Limit a float, AutoDiffXd or Expression to lower…upper; keep its derivative in between."""
    return _min(_max(value, lower), upper)


def smooth_step(value: Any, band: Any) -> Any:
    """Return a cubic step from exactly 0 at −``band`` to exactly 1 at ``band``."""
    z = clip(0.5 + 0.5 * value / band, 0.0, 1.0)
    return z * z * (3.0 - 2.0 * z)


def where_positive(condition: Any, positive: Any, otherwise: Any) -> Any:
    """Return ``positive`` if ``condition`` > 0, else ``otherwise``; any scalar type of Drake."""
    if isinstance(condition, Expression):
        return if_then_else(condition > 0.0, *_expressions(positive, otherwise))
    return positive if condition > 0.0 else otherwise


def where_within(value: Any, low: Any, high: Any, inside: Any, otherwise: Any) -> Any:
    """Return ``inside`` if ``low`` ≤ ``value`` ≤ ``high``, else ``otherwise``, also for nan."""
    if any(isinstance(number, Expression) for number in (value, low, high, inside, otherwise)):
        value, low, high, *branches = _expressions(value, low, high, inside, otherwise)
        return if_then_else(logical_and(value >= low, value <= high), *branches)
    return inside if low <= value <= high else otherwise


def _expressions(*values: Any) -> list[Expression]:
    return [value if isinstance(value, Expression) else Expression(value) for value in values]


def values_of(source: Any, *names: str) -> dict[str, float]:
    """Return a dictionary of the attributes ``names`` of the parameter object ``source``."""
    return {name: getattr(source, name) for name in names}


def fill(vector: Any, values: Sequence[Any]) -> None:
    """Set the elements of a Drake vector to ``values``."""
    for index, value in enumerate(values):
        vector.SetAtIndex(index, value)


@cache  # Python takes 0.1 ms to make a class
def _named_tuple(names: tuple[str, ...]) -> Any:
    return namedtuple("Values", names)


class NamedLeaf(LeafSystem):
    """Base of a component: a leaf system for all scalars of Drake, with named Context parameters.

    A subclass declares ports, state and Context parameters in ``__init__``. For a subclass
    ``Component``, ``Component(…)`` makes a system of floats, which converts to AutoDiffXd and
    Expression. `leaf_template` makes a class for each scalar type. The systems of all scalar types
    are instances of ``Component``.

    ``Component(…, fault_names=("gear_ratio",))`` has an input port ``fault`` with a change of each
    of the named Context parameters, so that a fault can change them during a run.
    """

    _scalar: Any = None  # Drake's scalar type, set by `leaf_template`
    _parameter_class: Any = _named_tuple(())  # named tuple of the Context parameters
    _fault_names: tuple[str, ...] = ()  # Context parameters that a fault can change
    _fault: Any = None  # input port of the changes of these parameters
    check: Callable[[Any], None]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the Context parameters; the compiler reads them."""
        names: tuple[str, ...] = self._parameter_class._fields
        return names

    def __new__(cls, *_: Any, **__: Any) -> Self:
        """Create a system of the scalar type of ``cls``, or of floats if ``cls`` has none."""
        system: Any = cls
        if cls._scalar is None:
            system = leaf_template(system)[None]
        return super(NamedLeaf, system).__new__(system)

    def _declare_parameters(self, values: Mapping[str, float]) -> None:
        """Declare a vector of numeric Context parameters with their names and values."""
        self._parameter_class = _named_tuple(tuple(values))
        self.DeclareNumericParameter(
            BasicVector_[self._scalar]([float(value) for value in values.values()])
        )
        if self._fault_names:
            self._fault = self.DeclareVectorInputPort("fault", len(self._fault_names))

    def _declare_output(
        self, name: str, size: int, calc: Callable[[Any], Sequence[Any]], *sources: Any
    ) -> Any:
        """Declare an output port with the value ``calc(context)``.

        ``sources`` are the ports and dependency tickets that ``calc`` reads, except the Context
        parameters.
        """
        if self._fault is not None:
            sources = (*sources, self._fault)
        tickets = {s.ticket() if hasattr(s, "ticket") else s for s in sources}
        return self.DeclareVectorOutputPort(
            name,
            size,
            lambda context, output: fill(output, calc(context)),
            tickets | {self.all_parameters_ticket()},
        )

    def _declare_update(
        self, period: float, size: int, update: Callable[[Any], Sequence[Any]]
    ) -> None:
        """Declare a discrete state (size,) that becomes ``update(context)`` every ``period`` s."""
        self.DeclareDiscreteState(size)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period, 0.0, lambda context, state: fill(state.get_mutable_vector(0), update(context))
        )

    def _declare_command(self) -> None:
        """Declare the output port of a command that is the first discrete state."""
        self._declare_output(
            "motor_speed_command", 1, lambda c: discrete_state(c)[:1], self.xd_ticket()
        )

    def _declare_initialization(self, initialize: Callable[[Any], Sequence[Any]]) -> None:
        """Let ``Simulator.Initialize()`` set the discrete state to ``initialize(context)``."""
        self.DeclareInitializationDiscreteUpdateEvent(
            lambda context, state: fill(state.get_mutable_vector(0), initialize(context))
        )

    def _declare_check(self, check: Callable[[Any], None]) -> None:
        """Declare ``check(context)``, which raises an error outside the limits of the system.

        Drake's Simulator calls ``check`` after each step of a system of floats. If a compiled run
        ends outside the limits, it calls the attribute ``check`` to get the error message.
        """
        self.check = check
        if self._scalar is float:
            self.DeclarePerStepPublishEvent(check)

    def parameters(self, context: Any) -> Any:
        """Return the named Context parameters of this system, as a named tuple of scalars.

        A fault changes them by the values of the port ``fault``.
        """
        values = context.get_numeric_parameter(0).CopyToVector().tolist()
        if self._fault is not None:
            for name, change in zip(self._fault_names, self._fault.Eval(context), strict=True):
                values[self.parameter_names.index(name)] += change
        return self._parameter_class._make(values)

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


# Not at import: the templates of all systems would take 35 to 107 ms.
@cache
def leaf_template(component: type[NamedLeaf]) -> Any:
    """Return Drake's template of a component: a table of its classes by scalar type.

    The template is made at the first call, because it costs some milliseconds and compiled runs
    need no template. An explicit scope avoids 40 ms of stack inspection.
    """

    _, *parameters = signature(component.__init__).parameters.values()

    @TemplateSystem.define(f"{component.__name__}_", scope=sys.modules[component.__module__])
    def template(scalar: Any) -> Any:
        # mypy does not accept a base class that is a variable.
        class Impl(component, LeafSystem_[scalar]):  # type: ignore[misc, valid-type]
            __doc__ = component.__doc__
            _scalar = scalar

            def _construct(
                self,
                *values: Any,
                converter: Any = None,
                fault_names: tuple[str, ...] = (),
                **named: Any,
            ) -> None:
                for expected, value in zip(parameters, values, strict=False):
                    if isinstance(expected.default, Parameters) and not isinstance(
                        value, Parameters
                    ):
                        require_object(expected.name, value, type(expected.default))
                LeafSystem_[scalar].__init__(self, converter)
                self._arguments = values, named | {"fault_names": fault_names}
                self._fault_names = fault_names
                component.__init__(self, *values, **named)

            def _construct_copy(self, other: Any, converter: Any = None) -> None:
                values, named = other._arguments
                Impl._construct(self, *values, converter=converter, **named)

        return Impl

    return template


def require_finite(system: Any, context: Any, **values: Any) -> None:
    """Raise `SimulationError` if a float among ``values`` is not finite; name the first.

    A NaN derivative would hang Drake's error-controlled integrators, and Drake's other integrators
    would ignore the NaN. Values of AutoDiffXd and Expression are not checked.
    """
    for name, value in values.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise SimulationError(
                f"t = {context.get_time():.6g} s: {system.get_name()}: {name} = {value} is not "
                f"finite; reduce the step or check the inputs"
            )


def discrete_state(context: Any) -> list[Any]:
    """Return the first group of discrete states of ``context`` as a list of scalars."""
    values: list[Any] = context.get_discrete_state(0).CopyToVector().tolist()
    return values


def value_or_zero(port: Any, context: Any) -> Any:
    """Return the scalar at an input port, or zero if the port is not connected."""
    return port.Eval(context)[0] if port.HasValue(context) else 0.0
