"""Sample periods of leaf systems, and what holds an output."""

import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, Gain, ZeroOrderHold

from diagramc import CompilationError, sampled_leaves


def two_rates():
    """The sum of a fast and a slow hold; a third hold feeds the slow one."""
    builder = DiagramBuilder()
    periods = {"fast": 0.002, "slow": 0.01, "before": 0.004}
    holds = {name: builder.AddNamedSystem(name, ZeroOrderHold(p, 1)) for name, p in periods.items()}
    adder, gain = builder.AddSystem(Adder(2, 1)), builder.AddSystem(Gain(2.0, 1))
    builder.Connect(holds["before"].get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), holds["slow"].get_input_port())
    for index, name in enumerate(("fast", "slow")):
        builder.Connect(holds[name].get_output_port(), adder.get_input_port(index))
    for name in ("fast", "before"):
        builder.ExportInput(holds[name].get_input_port(), name)
    builder.ExportOutput(adder.get_output_port(), "sum")
    return builder.Build()


def test_each_leaf_has_its_period_and_the_nearest_leaves_hold_the_output() -> None:
    leaves = sampled_leaves(two_rates(), "sum")
    assert {(n, t.period_sec(), t.offset_sec(), holds) for n, t, holds in leaves} == {
        ("fast", 0.002, 0.0, True),
        ("slow", 0.01, 0.0, True),
        ("before", 0.004, 0.0, False),
    }
    assert sampled_leaves(Gain(1.0, 1), "y0") == []


@pytest.mark.parametrize("periods", [(), (0.1, 0.2)])
def test_a_state_without_a_single_period_is_refused(periods) -> None:
    class Leaf(LeafSystem):
        def __init__(self):
            LeafSystem.__init__(self)
            self.DeclareStateOutputPort("y", self.DeclareDiscreteState(1))
            for period in periods:
                self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, lambda context, state: None)

    with pytest.raises(CompilationError, match="Leaf: has a discrete state but not exactly one"):
        sampled_leaves(Leaf(), "y")
