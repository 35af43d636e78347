"""Events of leaves: sampled ones are read, others are refused."""

import subprocess
import sys

import pytest
from pydrake.symbolic import Expression
from pydrake.systems.framework import (
    EventStatus,
    LeafSystem_,
    PublishEvent_,
    UnrestrictedUpdateEvent_,
)

from diagramc.equations.reader import read_equations
from diagramc.errors import CompilationError


def nothing(*_):
    return EventStatus.Succeeded()


def by_method(name, *arguments):
    """Declares an event by the method ``name`` that takes a callback."""
    return lambda self, T: getattr(self, name)(*arguments, nothing)


def by_event(name, event_type, **arguments):
    """Declares an event by the method ``name`` that takes an event, here by keyword."""
    return lambda self, T: getattr(self, name)(
        event=event_type[T](system_callback=nothing), **arguments
    )


PERIODIC = by_method("DeclarePeriodicDiscreteUpdateEvent", 0.1, 0.0)

UPDATES = {
    "per-step discrete": by_method("DeclarePerStepDiscreteUpdateEvent"),
    "per-step unrestricted": by_method("DeclarePerStepUnrestrictedUpdateEvent"),
    "periodic unrestricted": by_method("DeclarePeriodicUnrestrictedUpdateEvent", 0.1, 0.03),
    "per-step unrestricted, event": by_event("DeclarePerStepEvent", UnrestrictedUpdateEvent_),
    "periodic unrestricted, event": by_event(
        "DeclarePeriodicEvent", UnrestrictedUpdateEvent_, period_sec=0.1, offset_sec=0.03
    ),
}


@pytest.mark.parametrize("case", UPDATES)
def test_updates_that_are_not_sampled_are_refused(case, diagram_of, leaf):
    def construct(self, T):
        self.DeclareStateOutputPort("out", self.DeclareDiscreteState(1))
        PERIODIC(self, T)  # alone it compiles
        UPDATES[case](self, T)

    diagram = diagram_of(leaf("Restless", construct))
    declare = LeafSystem_[Expression].DeclarePerStepEvent
    words = (
        rf"^block: Restless has a {case.partition(',')[0]} update; of updates only periodic disc"
    )
    with pytest.raises(CompilationError, match=words):
        read_equations(diagram)
    assert LeafSystem_[Expression].DeclarePerStepEvent is declare


def test_periodic_and_publish_events_are_not_refused(diagram_of, leaf):
    def update(context, values):
        values.get_mutable_vector(0).SetAtIndex(0, context.get_discrete_state(0)[0] + 1.0)

    def construct(self, T):
        self.DeclareStateOutputPort("out", self.DeclareDiscreteState(1))
        self.DeclarePeriodicDiscreteUpdateEvent(0.1, 0.03, update)
        self.DeclarePerStepPublishEvent(nothing)
        self.DeclarePeriodicPublishEvent(0.1, 0.0, nothing)
        by_event("DeclarePeriodicEvent", PublishEvent_, period_sec=0.1, offset_sec=0.0)(self, T)
        by_event("DeclarePerStepEvent", PublishEvent_)(self, T)

    equations = read_equations(diagram_of(leaf("Sampled", construct)))
    (sampled,) = equations.updates
    assert (sampled.period_s, sampled.offset_s) == (0.1, 0.03)
    graph = equations.graph
    assert sampled.values == ((0, graph.add(graph.one, graph.source("discrete", 0))),)


WITNESSES = """
import gc
from pydrake.examples import CompassGait, RimlessWheel
from pydrake.systems.framework import (
    DiagramBuilder, LeafSystem, UnrestrictedUpdateEvent, WitnessFunctionDirection)
from diagramc import compile_diagram
from diagramc.errors import CompilationError

class Ball(LeafSystem):
    def __init__(self):
        LeafSystem.__init__(self)
        self.DeclareContinuousState(1)
        self._witness = self.MakeWitnessFunction(
            "ground", WitnessFunctionDirection.kCrossesZero, lambda context: 1.0)
    def DoGetWitnessFunctions(self, context):
        return [self._witness]

words = set()
gc.freeze()  # so that a search for garbage does not go through the modules
for _ in range(20):
    for make in (RimlessWheel, CompassGait, Ball):
        builder = DiagramBuilder()
        builder.AddNamedSystem("walker", make())
        diagram = builder.Build()
        try:
            compile_diagram(diagram)
        except CompilationError as error:
            words.add(str(error))
        del builder, diagram
        gc.collect()
print(*sorted(words), sep=chr(10))
"""


@pytest.mark.slow
def test_witness_functions_are_refused_without_a_crash():
    # In a process of its own: pydrake frees witness functions of C++ twice, and crashes later.
    run = subprocess.run(
        [sys.executable, "-c", WITNESSES], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == [
        f"walker: {name} has a witness function; only sampled events compile"
        for name in ("Ball", "CompassGait", "RimlessWheel")
    ]


@pytest.mark.parametrize(
    "branch", [lambda x: 1.0 if x else 2.0, lambda x: x and 2.0, lambda x: 1.0 if x > 0.0 else 2.0]
)
def test_a_branch_on_a_value_is_refused_with_its_line(branch, diagram_of, leaf):
    def construct(self, T):
        u = self.DeclareVectorInputPort("u", 1)
        self.DeclareVectorOutputPort(
            "y", 1, lambda c, y: y.SetAtIndex(0, T(branch(u.Eval(c)[0]))), {u.ticket()}
        )

    line = branch.__code__.co_firstlineno
    expected = (
        f"block: output port y: has no symbolic form (the code branches on a symbolic value; "
        f"test_events.py, line {line})"
    )
    with pytest.raises(CompilationError) as caught:
        read_equations(diagram_of(leaf("Branch", construct)), ["u"])
    assert str(caught.value) == expected
