"""Right leaves pass, leaves with one mistake each are found, and each finding is one line."""

import math
import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pydrake.math as drake_math
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common.value import AbstractValue
from pydrake.examples import PendulumPlant
from pydrake.math import RigidTransform
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, DiagramBuilder, LeafSystem, LeafSystem_
from pydrake.systems.primitives import Gain
from pydrake.systems.scalar_conversion import TemplateSystem

from diagramc.testing import check_leaf

# ----------------------------------------------- right leaves, in the style of Drake's tutorials


class SimpleContinuousTimeSystem(LeafSystem):
    """x' = −x + x³, y = x."""

    def __init__(self):
        LeafSystem.__init__(self)
        self.DeclareStateOutputPort("y", self.DeclareContinuousState(1))

    def DoCalcTimeDerivatives(self, context, derivatives):
        x = context.get_continuous_state_vector().GetAtIndex(0)
        derivatives.get_mutable_vector().SetAtIndex(0, -x + x**3)


class SimpleDiscreteTimeSystem(LeafSystem):
    """x[n+1] = x³[n], y = x, every second from 0.5 s on."""

    def __init__(self):
        LeafSystem.__init__(self)
        self.DeclareStateOutputPort("y", self.DeclareDiscreteState(1))
        self.DeclarePeriodicDiscreteUpdateEvent(1.0, 0.5, self.update)

    def update(self, context, discrete_state):
        x = context.get_discrete_state_vector().GetAtIndex(0)
        discrete_state.get_mutable_vector().SetAtIndex(0, x**3)


class MyAdder(LeafSystem):
    """Sum of two inputs, with Drake's default prerequisites."""

    def __init__(self):
        LeafSystem.__init__(self)
        self.a, self.b = (self.DeclareVectorInputPort(name, 2) for name in "ab")
        self.DeclareVectorOutputPort("sum", 2, self.calc)

    def calc(self, context, output):
        output.SetFromVector(self.a.Eval(context) + self.b.Eval(context))


class Pose(LeafSystem):
    """A pose at an abstract input port, moved along x; its position and itself are outputs."""

    def __init__(self):
        LeafSystem.__init__(self)
        self.pose = self.DeclareAbstractInputPort("pose", AbstractValue.Make(RigidTransform()))
        self.by = self.DeclareVectorInputPort("by", 1)
        model = partial(AbstractValue.Make, RigidTransform())
        self.DeclareAbstractOutputPort("moved", model, self.calc)
        self.DeclareVectorOutputPort("position", 3, self.calc_position)

    def moved(self, context):
        return RigidTransform([self.by.Eval(context)[0], 0.0, 0.0]) @ self.pose.Eval(context)

    def calc(self, context, output):
        output.set_value(self.moved(context))

    def calc_position(self, context, output):
        output.SetFromVector(self.moved(context).translation())


FLOATS = (SimpleContinuousTimeSystem, SimpleDiscreteTimeSystem, MyAdder, Pose)


@pytest.mark.parametrize("kind", FLOATS)
def test_leaves_of_floats_as_in_the_tutorials_pass_unless_a_conversion_is_asked_for(kind):
    system = kind()
    assert f"{kind.__name__}: does not convert to Expression" in "\n".join(check_leaf(system))
    with pytest.raises(AssertionError, match=r"^\w+: does not convert to AutoDiffXd \([^\n]*$"):
        check_leaf(system, scalars="AutoDiffXd")


# ------------------------------------------------------------------- leaves with one mistake each

AGAIN = "a second call gives other values: the leaf keeps a state outside the Context, reads a c"
GRADIENT = r"derivative with respect to \w+ \S+ by AutoDiffXd, \S+ by differences at time = "
CALL = "changes in a call"


def is_dual(value):
    return isinstance(value, AutoDiffXd)


def counter(leaf, context, y):
    leaf.calls += 1
    return y + 1e-6 * leaf.calls


def once_a_time(leaf, context, y):
    if not isinstance(y, float):
        return y
    if leaf.before is None or leaf.before[0] != context.get_time():
        leaf.before = context.get_time(), y
    return leaf.before[1]


def sets_its_state(leaf, context, y):
    set_state(context)
    return y


def sets_a_parameter(leaf, context, y):
    context.get_mutable_numeric_parameter(0).SetAtIndex(0, leaf.T(4.0))
    return y


def set_state(context):
    state = context.get_mutable_discrete_state_vector()
    state.SetFromVector(1.0 + state.CopyToVector())


ANYWHERE = {
    "counter": (counter, AGAIN),
    "memo": (once_a_time, AGAIN),
    "clock": (lambda leaf, context, y: y + 1e-9 * time.perf_counter(), AGAIN),
    "random": (lambda leaf, context, y: y + np.random.default_rng().normal(), AGAIN),
    "no slope": (lambda leaf, context, y: leaf.T(y.value()) if is_dual(y) else y, GRADIENT),
    "a slope of another function": (
        lambda leaf, context, y: leaf.T(y.value(), 1.01 * y.derivatives()) if is_dual(y) else y,
        GRADIENT,
    ),
    "other dual": (lambda leaf, context, y: y + 1e-3 if is_dual(y) else y, r"\S+ by AutoDiffXd, "),
    "other symbol": (
        lambda leaf, context, y: 1.001 * y if isinstance(y, Expression) else y,
        r"\S+ by Expression, ",
    ),
    "branch": (
        lambda leaf, context, y: y if y > 0.0 else 2.0 * y,
        r"outputs, derivatives, update: has no Expression form \(the code branches on a symbolic "
        r"value; test_testing.py, line",
    ),
    "its state": (sets_its_state, f"discrete_state: {CALL}"),
    "a parameter": (sets_a_parameter, f"parameters: {CALL}"),
}
"""Mistakes that an output, the time derivatives and the update can have, with their findings."""


def raised(vector):
    vector.SetFromVector(1.0 + vector.CopyToVector())


EVENTS = {
    "PerStepPublish": set_state,
    "PerStepDiscreteUpdate": lambda _, x: raised(x.get_mutable_vector()),
}
"""Updates of the discrete state at the end of each step of an integrator."""
VALUES = {"gain": 2.0, "initial": 0.1, "period": 0.1, "parameter": 3.0, "name": "y"}
OTHER = {"gain": 5.0, "initial": 0.4, "period": 0.2, "parameter": 2.0, "name": "z"}
KEPT = {
    "gain": "attribute gain is 2.0, not 5.0",
    "initial": "default of continuous_state is 0.1, not 0.4",
    "period": r"sample time is \[0.1, 0.0\], not \[0.2, 0.0\]",
    "parameter": "default of parameters is 3.0, not 2.0",
    "name": "output z is missing, not 1",
}
"""Arguments that a conversion can forget, with their findings."""
SOURCES = "time", "parameters", "continuous_state", "discrete_state", "u"


@TemplateSystem.define("Leaf_")
def Leaf_(T):
    class Impl(LeafSystem_[T]):
        """Output, time derivative and update are all a sin x + p u + d + t."""

        def _construct(self, mistake="", place="", converter=None, **values):
            LeafSystem_[T].__init__(self, converter)
            values = VALUES | values
            self.T, self.gain, self.arguments = T, values["gain"], (mistake, place, values)
            self.calls, self.before = 0, None
            self.u = self.DeclareVectorInputPort("u", 1)
            self.DeclareContinuousState(BasicVector_[T]([values["initial"]]))
            self.DeclareDiscreteState(1)
            self.DeclareNumericParameter(BasicVector_[T]([values["parameter"]]))
            parts = self.time_ticket(), self.all_parameters_ticket(), self.xc_ticket()
            tickets = dict(zip(SOURCES, [*parts, self.xd_ticket(), self.u.ticket()], strict=True))
            tickets.pop(place if mistake == "ticket" else None, None)
            output = partial(self.calc, "output")
            self.DeclareVectorOutputPort(values["name"], 1, output, {*tickets.values()})
            self.DeclarePeriodicDiscreteUpdateEvent(values["period"], 0.0, self.update)
            if mistake == "event":
                getattr(self, f"Declare{place}Event")(EVENTS[place])

        def _construct_copy(self, other, converter=None):
            mistake, place, values = other.arguments
            kept = {k: v for k, v in values.items() if (mistake, place) != ("copy", k)}
            Impl._construct(self, mistake, place, converter, **kept)

        def calc(self, place, context, output):
            x = context.get_continuous_state_vector()[0]
            p = context.get_numeric_parameter(0)[0]
            d = context.get_discrete_state_vector().CopyToVector()[0]
            y = self.gain * drake_math.sin(x) + p * self.u.Eval(context)[0] + d
            y = y + context.get_time()
            mistake, where, _ = self.arguments
            output.SetAtIndex(0, ANYWHERE[mistake][0](self, context, y) if where == place else y)

        def update(self, context, state):
            self.calc("update", context, state.get_mutable_vector())

        def DoCalcTimeDerivatives(self, context, derivatives):
            self.calc("derivatives", context, derivatives.get_mutable_vector())

    return Impl


STALE = "output z: its stored value stays after a change of {}; add "
PLACES = "output", "derivatives", "update"
MISTAKES = [
    *((name, place, text) for name, (_, text) in ANYWHERE.items() for place in PLACES),
    *(("ticket", source, STALE.format(source)) for source in SOURCES),
    *(("copy", name, f"as AutoDiffXd, {text}") for name, text in KEPT.items()),
    *(("event", kind, "discrete_state: jumps between samples") for kind in EVENTS),
]


def test_a_finding_tells_the_point_with_its_units():
    with pytest.raises(AssertionError, match=r" at time = 0 s, .*, u = -?2\.5 V$"):
        check_leaf(
            Leaf_[None]("other dual", "output"),
            {"u": (-2.5, -2.5), "time": (0, 0)},
            units={"u": "V", "time": "s"},
        )


def test_leaves_without_a_mistake_pass():
    assert check_leaf(Leaf_[None](**OTHER)) == ()
    assert check_leaf(PendulumPlant(), {"mass": (0.5, 2.0), "theta": (-3.0, 3.0)}) == ()


@pytest.mark.parametrize(
    ("mistake", "place", "text"), MISTAKES, ids=[f"{m}, {place}" for m, place, _ in MISTAKES]
)
def test_a_leaf_with_one_mistake_is_found(mistake, place, text):
    with pytest.raises(AssertionError, match=rf"^Leaf: (\w+ ?\w*: )?{text}") as caught:
        check_leaf(Leaf_[None](mistake, place, **OTHER), {"u": (-2.0, 2.0)})
    assert all(line.startswith("Leaf: ") for line in str(caught.value).split("\n"))


class Shared:
    """A count that Drake cannot copy, so that all Contexts share it."""

    count = 0

    def __deepcopy__(self, memo):
        return self


class Counter(LeafSystem):
    """Counts samples in an abstract state."""

    def __init__(self, state):
        LeafSystem.__init__(self)
        self.DeclareAbstractState(AbstractValue.Make(state))
        self.DeclareVectorOutputPort("count", 1, self.calc)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1e-3, 0.0, self.update)

    def calc(self, context, output):
        output.SetAtIndex(0, context.get_abstract_state(0).get_value().count)

    def update(self, context, state):
        state.get_mutable_abstract_state(0).get_mutable_value().count += 1


def test_a_state_that_clones_of_a_context_share_is_found():
    check_leaf(Counter(SimpleNamespace(count=0)))
    with pytest.raises(AssertionError, match=r"^Counter: runs of two clones of a Context differ: "):
        check_leaf(Counter(Shared()))


# ----------------------------------------------------------------------------------- messages


class Rough(LeafSystem):
    """y = f(u), with a port that has Drake's default name."""

    def __init__(self, function, name="y0"):
        LeafSystem.__init__(self)
        self.u = self.DeclareVectorInputPort("u", 1)
        calc = lambda context, y: y.SetAtIndex(0, function(self.u.Eval(context)[0]))  # noqa: E731
        self.DeclareVectorOutputPort(name, 1, calc)


def test_a_leaf_that_fails_or_is_not_finite_everywhere_is_found():
    with pytest.raises(
        AssertionError, match=r"^Rough: output y: is finite at no point; give other ranges$"
    ):
        check_leaf(Rough(lambda u: u + math.inf, "y"))
    text = r"^Rough: fails at 9 of 9 points: .*; test_testing.py, line \d+$"
    with pytest.raises(AssertionError, match=text):
        check_leaf(Rough(math.sqrt, "y"), {"u": (-3, -2)})
    assert check_leaf(Rough(math.sqrt, "y"), {"u": (0, 1)})


def test_a_port_without_a_name_is_a_note_and_one_without_a_value_is_found():
    with pytest.raises(AssertionError, match=r"^Rough: fails at 9 of 9 points: .*InputPort"):
        check_leaf(Rough(abs), {"u": None})
    assert "Rough: port y0 has only Drake's default name" in check_leaf(Rough(abs))


def test_a_leaf_with_branches_passes_if_only_duals_are_asked_for():
    assert not check_leaf(Leaf_[None]("branch", "output"), scalars="AutoDiffXd")


def diagram():
    builder = DiagramBuilder()
    builder.AddSystem(Gain(2.0, 1))
    return builder.Build()


BAD = {
    "system = .*: must be a leaf system": lambda: check_leaf(diagram()),
    "scalars: unknown 'float'; known: Auto": lambda: check_leaf(MyAdder(), scalars="float"),
    "ranges: unknown 'c'; known: a, b, time": lambda: check_leaf(MyAdder(), {"c": (0.0, 1.0)}),
    r"ranges: a = \(1, 0\): must be": lambda: check_leaf(MyAdder(), {"a": (1, 0)}),
    r"ranges: a = \(0, inf\): must be": lambda: check_leaf(MyAdder(), {"a": (0, math.inf)}),
    r"ranges: a = .*: must be .* list of 2": lambda: check_leaf(MyAdder(), {"a": [(0, 1)] * 3}),
}


@pytest.mark.parametrize("text", BAD)
def test_a_wrong_argument_is_refused_in_one_line(text):
    with pytest.raises(ValueError, match=rf"^{text}[^\n]*$"):
        BAD[text]()
