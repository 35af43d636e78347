"""Whether a law of the user is compiled, and which inputs it reads."""

import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder

from kneexo.common.ports import input_ports, sizes
from kneexo.errors import ParameterError
from kneexo.law import FunctionLaw
from kneexo.law.decision import held_command, law_inputs, makers_called_once, why_python
from kneexo.parameters import LawParameters, Scenario


def law(knee_angle, knee_reference, gain=1e3):
    return gain * (knee_angle - knee_reference[0])


def system():
    return FunctionLaw(LawParameters(function=law))


class FloatsOnly(LeafSystem):
    def __init__(self):
        LeafSystem.__init__(self)
        self.DeclareVectorInputPort("estimated_state", 3)
        self.DeclareVectorOutputPort("motor_speed_command", 1, lambda context, output: None)


@pytest.mark.parametrize("form", [law, system])
def test_a_law_that_converts_is_compiled(form) -> None:
    scenario = Scenario().with_law(form)
    assert why_python(scenario) == ""
    assert held_command(scenario) is None
    assert law_inputs(scenario) == ("knee_angle", "knee_reference")


@pytest.mark.parametrize(
    ("form", "reason"),
    [
        (lambda estimated_state: float(estimated_state[0]), "needs plain numbers"),
        (FloatsOnly, "does not convert to symbolic Expression"),
        (FloatsOnly(), "Drake cannot clone this system"),
    ],
)
def test_another_law_is_replaced_by_its_held_command(form, reason: str) -> None:
    scenario = Scenario().with_law(form, sample_time_s=0.004)
    assert reason in why_python(scenario)
    assert why_python(scenario)
    held = held_command(scenario)
    assert sizes(input_ports(held)) == {"estimated_state": 3, "law_command": 1}
    assert held.GetUniquePeriodicDiscreteUpdateAttribute().period_sec() == 0.004


def by_estimator(scenario):
    def exact(rod_state):
        return 0.0

    function = exact if scenario.estimator.kind == "exact" else law
    return FunctionLaw(LawParameters(function=function))


def test_what_is_known_of_a_system_belongs_to_the_scenario_that_it_is_made_for() -> None:
    scenario = Scenario().with_law(by_estimator)
    with makers_called_once():
        assert law_inputs(scenario) == ("knee_angle", "knee_reference")
        assert law_inputs(scenario.changed({"estimator": {"kind": "exact"}})) == ("rod_state",)


def test_kneexos_controllers_are_compiled() -> None:
    assert not why_python(Scenario())


def test_a_law_that_cannot_begin_anew_is_refused() -> None:
    calls = []

    def counting(rod_extension):
        calls.append(rod_extension)
        return len(calls)

    with pytest.raises(ParameterError, match="hides state"):
        why_python(Scenario().with_law(counting))


def held(*periods, offset=0.0):
    """Return a system of floats whose command is the sum of holds with these periods."""

    class Hold(LeafSystem):
        def __init__(self, period):
            LeafSystem.__init__(self)
            self.rod = self.DeclareVectorInputPort("rod_extension", 1)
            self.DeclareStateOutputPort("held", self.DeclareDiscreteState(1))
            self.DeclarePeriodicDiscreteUpdateEvent(
                period, offset, lambda c, state: state.set_value(0, self.rod.Eval(c))
            )

    builder = DiagramBuilder()
    adder = builder.AddSystem(Adder(len(periods), 1))
    for index, period in enumerate(periods):
        hold = builder.AddNamedSystem(f"hold{index}", Hold(period))
        builder.Connect(hold.get_output_port(), adder.get_input_port(index))
        if index:
            builder.ConnectInput("rod_extension", hold.get_input_port())
        else:
            builder.ExportInput(hold.get_input_port(), "rod_extension")
    builder.ExportOutput(adder.get_output_port(), "motor_speed_command")
    return builder.Build()


@pytest.mark.parametrize("periods", [(0.002,), (0.002, 0.01), (0.006, 0.002)])
def test_a_system_may_have_slower_parts(periods) -> None:
    assert why_python(Scenario().with_law(lambda: held(*periods)))


@pytest.mark.parametrize(
    ("periods", "offset", "message"),
    [
        ((0.01,), 0.0, "sample_time_s = 0.002 s: must be 0.01 s, at which law"),
        ((0.001,), 0.0, "sample_time_s = 0.002 s: must be 0.001 s, at which law"),
        ((0.002, 0.007), 0.0, "hold1 updates every 0.007 s from 0 s on; must"),
        ((0.002,), 0.001, "hold0 updates every 0.002 s from 0.001 s on; must"),
    ],
)
def test_a_system_with_other_samples_is_refused(periods, offset, message: str) -> None:
    for form in (lambda: held(*periods, offset=offset), held(*periods, offset=offset)):
        with pytest.raises(ParameterError, match=message):
            why_python(Scenario().with_law(form, sample_time_s=0.002))
