"""Leaves written in Python against the equations that were read off."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pydrake.math as drake_math
import pytest
from pydrake.symbolic import Expression, if_then_else
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.primitives import Gain
from pydrake.systems.scalar_conversion import TemplateSystem

from diagramc import DifferenceError, read_diagram, trust
from diagramc.equations import comparison
from diagramc.equations.comparison import differ, is_compared


def by_type(numbers, symbols):
    """A function that computes ``numbers`` of a float, and ``symbols`` of an Expression."""

    def function(x):
        try:
            return numbers(float(x)) if not isinstance(x, Expression) else symbols(x)
        except TypeError:
            return symbols(x)

    return function


def sine_where_possible(x):
    try:
        return math.sin(x)
    except TypeError:
        return drake_math.sin(x)


RIGHT = {
    "two ways": sine_where_possible,
    "type": by_type(math.sin, drake_math.sin),
    "choice": lambda x: if_then_else(x > 0.5, x, 2.0 * x) if isinstance(x, Expression) else (
        x if x > 0.5 else 2.0 * x),
    "fails for many numbers": lambda x: drake_math.sqrt(x - 0.5),
    "warns of nan": by_type(lambda x: np.sqrt(x - 0.5), lambda x: drake_math.sqrt(x - 0.5)),
    "nan": by_type(lambda x: math.nan, lambda x: x),
}  # fmt: skip
WRONG = {
    "slip": by_type(math.sin, drake_math.cos),
    "beyond a tenth": by_type(lambda x: min(x, 0.1), lambda x: x),
    "constant": by_type(lambda x: 1.0, lambda x: Expression(2.0)),
    "hidden counter": lambda x: x,
    "random": lambda x: x + float(np.random.default_rng().normal()),
}


@TemplateSystem.define("Leaf_")
def Leaf_(T):
    class Impl(LeafSystem_[T]):
        """One part is a function of a state and the input; all other parts are zero."""

        def _construct(self, part, function, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.arguments, self.calls = (part, function), 0
            self.DeclareContinuousState(1)
            self.DeclareDiscreteState(1)
            self.port = self.DeclareVectorInputPort("u", 1)
            self.DeclareVectorOutputPort("y", 1, partial(self.set, "output port y"))
            self.DeclarePeriodicDiscreteUpdateEvent(0.1, 0.0, self.update)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, *other.arguments, converter=converter)

        def set(self, part, context, vector):
            value = T(0.0)
            if part == self.arguments[0]:
                self.calls += 1
                state = context.get_discrete_state(0)[0]
                value = self.arguments[1](state + self.port.Eval(context)[0])
            if self.arguments[1] is WRONG["hidden counter"] and part == self.arguments[0]:
                value = T(float(self.calls))
            vector.SetAtIndex(0, value)

        def update(self, context, state):
            self.set("discrete update", context, state.get_mutable_vector(0))

        def DoCalcTimeDerivatives(self, context, derivatives):
            self.set("time derivatives", context, derivatives.get_mutable_vector())

    return Impl


PARTS = "output port y", "discrete update", "time derivatives"


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("function", RIGHT.values(), ids=RIGHT)
def test_a_right_leaf_compiles(part, function, recwarn):
    read_diagram(Leaf_[None](part, function), inputs=["u"])
    assert [str(warning.message) for warning in recwarn] == []


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("function", WRONG.values(), ids=WRONG)
def test_a_wrong_leaf_is_refused_by_its_port(part, function):
    with pytest.raises(DifferenceError, match=f"Leaf.*: {part}: the equations that were read"):
        read_diagram(Leaf_[None](part, function), inputs=["u"])


def test_leaves_of_drake_and_of_trusted_folders_are_not_compared(monkeypatch):
    leaf = Leaf_[None](PARTS[0], WRONG["slip"])
    assert is_compared(leaf)
    assert not is_compared(Gain(1.0, 1))
    monkeypatch.setattr(comparison, "_trusted", [])
    trust(Path(__file__).parent)
    assert not is_compared(leaf)
    read_diagram(leaf, inputs=["u"])


def test_rounding_at_a_branch_is_no_difference_but_a_flag_is_exact():
    def step(row):
        return np.array([1.0 if row[0] - 0.1 > 0.0 else -1.0, row[1]])

    points = np.array([[0.1, 3.0], [0.2, 4.0]])
    numbers = np.array([step(point) for point in points])
    assert not differ(step, points, numbers, numbers)
    assert not differ(step, points, numbers * [[-1.0, 1.0], [1.0, 1.0]], numbers)
    assert differ(step, points, numbers * [[1.0, 1.0], [-1.0, 1.0]], numbers)
    assert differ(step, points, numbers + np.array([0.0, 2e-8]), numbers)
    points[1, 1] = 4.1
    numbers = np.array([step(point) for point in points])
    assert not differ(step, points, numbers + np.array([0.0, 3e-9]), numbers)
