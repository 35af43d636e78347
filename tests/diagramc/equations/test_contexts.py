"""Parameters and states of a Context as vectors, against the Context itself."""

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, FirstOrderLowPassFilter

from diagramc.equations.contexts import parameters_of, set_parameters, set_state, state_of
from diagramc.equations.reader import read_equations
from diagramc.equations.tree import Node
from diagramc.run_data import State


def test_vectors_have_the_order_of_the_names(multirate):
    """Each element is set in the Context by Drake alone."""
    root, context = Node(multirate), multirate.CreateDefaultContext()
    for name, value in (("hold", 2.0), ("sampler", 3.0)):
        leaf = multirate.GetMutableSubsystemContext(multirate.GetSubsystemByName(name), context)
        leaf.get_mutable_discrete_state(0).SetAtIndex(0, value)
    inner = multirate.GetSubsystemByName("inner")
    plant = inner.GetSubsystemByName("plant")
    plant.GetMyMutableContextFromRoot(context).SetContinuousState([4.0, 5.0])
    equations, state = read_equations(multirate, ()), state_of(root, context)
    assert dict(zip(equations.states, state.continuous, strict=True)) == {
        "inner/plant.x[0]": 4.0,
        "inner/plant.x[1]": 5.0,
    }
    assert dict(zip(equations.discrete, state.discrete, strict=True)) == {
        "hold.0[0]": 2.0,
        "sampler.0[0]": 3.0,
    }


def test_a_state_that_was_set_is_returned(multirate):
    root, context = Node(multirate), multirate.CreateDefaultContext()
    state = State(np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    set_state(root, context, state)
    again = state_of(root, context)
    np.testing.assert_array_equal(again.continuous, state.continuous)
    np.testing.assert_array_equal(again.discrete, state.discrete)
    np.testing.assert_array_equal(state.continuous, [1.0, 2.0])


def test_parameters_that_were_set_act_in_their_leaves():
    builder = DiagramBuilder()
    first = builder.AddNamedSystem("first", ConstantVectorSource([1.0, 2.0]))
    lag = builder.AddNamedSystem("lag", FirstOrderLowPassFilter(0.5, 2))
    second = builder.AddNamedSystem("second", ConstantVectorSource([3.0]))
    builder.Connect(first.get_output_port(), lag.get_input_port())
    builder.ExportOutput(lag.get_output_port(), "y")
    builder.ExportOutput(second.get_output_port(), "z")
    diagram = builder.Build()
    root, context = Node(diagram), diagram.CreateDefaultContext()
    np.testing.assert_array_equal(parameters_of(root, context), [1.0, 2.0, 3.0])
    values = np.array([7.0, 8.0, 9.0])
    set_parameters(root, context, values)
    np.testing.assert_array_equal(parameters_of(root, context), values)
    leaf_context = first.GetMyContextFromRoot(context)
    np.testing.assert_array_equal(first.get_output_port().Eval(leaf_context), [7.0, 8.0])
    np.testing.assert_array_equal(diagram.GetOutputPort("z").Eval(context), [9.0])
