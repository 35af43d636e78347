import math

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem_

from diagramc.testing import check_leaf
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    leaf_template,
    smooth_step,
    value_or_zero,
    where_positive,
)

SOURCE = {"gain": 2.0, "offset": 0.5}


class Sample(NamedLeaf):
    """y = gain·u + offset; x⁺ = [x_1 + u, x_0]; starts at [u, −1]."""

    def __init__(self, source=SOURCE, period=0.25):
        self._declare_parameters(source)
        self._u = self.DeclareVectorInputPort("u", 1)
        self._declare_update(period, 2, self._update)
        self._declare_initialization(lambda c: [value_or_zero(self._u, c), -1.0])
        self._declare_output("y", 1, self._calc, self._u)
        self._declare_output("held", 2, discrete_state, self.xd_ticket())
        self._declare_output("constant", 2, lambda c: [3.0, 4.0])

    def _calc(self, context):
        p = self.parameters(context)
        return [p.gain * value_or_zero(self._u, context) + p.offset]

    def _update(self, context):
        x_0, x_1 = discrete_state(context)
        return [x_1 + value_or_zero(self._u, context), x_0]


# ------------------------------------------------------------------------------ structure


def test_outputs_depend_on_their_sources_only():
    system = Sample()
    assert [system.HasDirectFeedthrough(0, output) for output in range(3)] == [True, False, False]


def test_output_without_sources_is_computed_once():
    calls = []

    class Constant(NamedLeaf):
        def __init__(self):
            self.DeclareVectorInputPort("u", 1)
            self._declare_output("y", 1, lambda c: calls.append(c) or [3.0])

    system = Constant()
    context = system.CreateDefaultContext()
    for value in (1.0, 2.0):
        system.GetInputPort("u").FixValue(context, value)
        context.SetTime(value)
        assert system.GetOutputPort("y").Eval(context) == [3.0]
    assert len(calls) == 1


# ----------------------------------------------------------------------------- conversion


def test_conversions_agree_and_keep_arguments():
    check_leaf(Sample({"gain": 5.0, "offset": -3.0}))


def test_a_component_is_a_leaf_system_of_float_and_has_a_class_for_each_scalar():
    system, template = Sample(), leaf_template(Sample)
    assert type(system) is template[None] is template[float]
    for scalar, same in ((float, system), (AutoDiffXd, system.ToAutoDiffXd())):
        assert isinstance(same, LeafSystem_[scalar])
        assert isinstance(same, Sample)
        assert type(same) is template[scalar]
    assert template[float].__doc__ == Sample.__doc__
    assert "test_leaf.Sample_" in repr(system)


def test_a_subclass_of_a_component_converts_to_itself():
    class Twice(Sample):
        def __init__(self, *, gain):
            super().__init__(SOURCE | {"gain": 2.0 * gain})

    converted = Twice(gain=3.0).ToAutoDiffXd()
    assert isinstance(converted, Twice)
    assert converted.parameters(converted.CreateDefaultContext()).gain.value() == 6.0


# -------------------------------------------------------------------------------- helpers


@pytest.mark.parametrize(
    ("value", "expected", "slope"), [(-3.0, -2.0, 0.0), (0.5, 0.5, 1.0), (7.0, 5.0, 0.0)]
)
def test_clip_limits_all_scalars_and_keeps_the_derivative_inside(value, expected, slope):
    x = Variable("x")
    dual = clip(AutoDiffXd(value, [1.0]), -2.0, 5.0)
    dual = dual if isinstance(dual, AutoDiffXd) else AutoDiffXd(dual)
    assert clip(value, -2.0, 5.0) == expected
    assert dual.value() == expected
    assert dual.derivatives().sum() == slope
    assert clip(Expression(x), -2.0, 5.0).Evaluate({x: value}) == expected


@pytest.mark.parametrize(
    ("value", "expected"), [(-9.0, 0.0), (-2.0, 0.0), (0.0, 0.5), (2.0, 1.0), (9.0, 1.0)]
)
def test_the_smooth_step_is_exact_at_both_ends(value, expected):
    assert smooth_step(value, 2.0) == expected


def test_clip_does_not_hide_nan():
    assert math.isnan(clip(math.nan, -1.0, 1.0))


@pytest.mark.parametrize(("condition", "expected"), [(1e-9, 2.0), (0.0, 3.0), (-1.0, 3.0)])
def test_where_positive_chooses_in_all_scalars_and_zero_is_not_positive(condition, expected):
    x, y = Variable("x"), Variable("y")
    assert where_positive(condition, 2.0, 3.0) == expected
    dual = where_positive(AutoDiffXd(condition, [1.0]), AutoDiffXd(2.0, [4.0]), 3.0)
    assert (dual.value() if isinstance(dual, AutoDiffXd) else dual) == expected
    chosen = where_positive(Expression(x), Expression(y), 3.0)
    assert chosen.Evaluate({x: condition, y: 2.0}) == expected


def test_unconnected_input_counts_as_zero():
    system = Sample()
    context = system.CreateDefaultContext()
    assert system.GetOutputPort("y").Eval(context) == [0.5]
    system.GetInputPort("u").FixValue(context, 1.5)
    assert value_or_zero(system.GetInputPort("u"), context) == 1.5


def test_discrete_state_is_a_list_of_the_scalars_of_the_context():
    symbolic = Sample().ToSymbolic()
    assert all(isinstance(v, Expression) for v in discrete_state(symbolic.CreateDefaultContext()))
    system = Sample()
    context = system.CreateDefaultContext()
    context.SetDiscreteState(0, [1.0, 2.0])
    assert discrete_state(context) == [1.0, 2.0]


def test_initialization_sets_the_state_once_and_updates_follow_every_period():
    system = Sample()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("u").FixValue(context, 10.0)
    simulator.Initialize()
    x = np.array([10.0, -1.0])
    assert discrete_state(context) == list(x)
    simulator.AdvanceTo(0.6)  # updates at 0, 0.25 and 0.5 s
    for _ in range(3):
        x = np.array([x[1] + 10.0, x[0]])
    assert discrete_state(context) == list(x)


# ------------------------------------------------------------------------------ bad input


def test_set_parameter_changes_one_value_in_one_context():
    system = Sample()
    context, untouched = system.CreateDefaultContext(), system.CreateDefaultContext()
    system.set_parameter(context, "offset", 9.0)
    assert system.parameters(context)._asdict() == {"gain": 2.0, "offset": 9.0}
    assert system.parameters(untouched)._asdict() == SOURCE


def test_set_parameter_takes_the_scalar_of_the_system():
    system = Sample().ToAutoDiffXd()
    context = system.CreateDefaultContext()
    system.set_parameter(context, "gain", AutoDiffXd(3.0, [1.0, 0.0]))
    assert system.parameters(context).gain.derivatives() == pytest.approx([1.0, 0.0])
