"""A compiled model wrapped as a leaf system: what Drake sees is what was compiled."""

import numpy as np
import pytest
from pydrake.symbolic import Variable, sqrt
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Gain,
    Integrator,
    LogVectorOutput,
    SymbolicVectorSystem,
    ZeroOrderHold,
)

from diagramc import State, compile_diagram
from diagramc.errors import ParameterError, SimulationError

SIGNALS = ("position", "command", "force")


def run_logged(system, names, duration_s, period_s, value=None):
    """Logs of the ``names``d outputs of a system alone in a diagram, and the final Context."""
    builder = DiagramBuilder()
    builder.AddSystem(system)
    for index in range(system.num_input_ports()):
        source = builder.AddSystem(ConstantVectorSource([value]))
        builder.Connect(source.get_output_port(), system.get_input_port(index))
    logs = [LogVectorOutput(system.GetOutputPort(name), builder, period_s) for name in names]
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(duration_s)
    context = simulator.get_context()
    return [log.FindLog(context) for log in logs], diagram.GetSubsystemContext(system, context)


@pytest.mark.parametrize("integrator", ["exact_hold", pytest.param("rk4", marks=pytest.mark.slow)])
def test_logs_are_the_records_of_a_direct_run_bit_by_bit(servo, integrator):
    model, parameters, state = servo
    direct = model.simulate(parameters, state, 0.5, outputs=SIGNALS, integrator=integrator)
    system = model.as_system(parameters, state, integrator=integrator)
    logs, context = run_logged(system, SIGNALS, 0.5, 0.002)
    for name, log in zip(SIGNALS, logs, strict=True):
        np.testing.assert_allclose(log.sample_times(), direct.time_s, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(log.data().T, direct[name])
    final = np.concatenate((direct.final.continuous, direct.final.discrete))
    np.testing.assert_array_equal(context.get_discrete_state(0).value(), final)


def counter(period_s):
    """A diagram that counts its updates."""
    builder = DiagramBuilder()
    one = builder.AddSystem(ConstantVectorSource([1.0]))
    total = builder.AddNamedSystem("total", Adder(2, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(period_s, 1))
    builder.Connect(one.get_output_port(), total.get_input_port(0))
    builder.Connect(hold.get_output_port(), total.get_input_port(1))
    builder.Connect(total.get_output_port(), hold.get_input_port())
    builder.ExportOutput(hold.get_output_port(), "count")
    return builder.Build()


@pytest.mark.parametrize("tick_s", [None, 0.05])
def test_a_log_with_the_sample_time_sees_the_values_before_each_update(tick_s):
    """3 · 0.1 is 0.30000000000000004: an event at 150 · 0.002 comes before it."""
    model = compile_diagram(counter(0.1))
    system = model.as_system(model.parameters(), model.state(), tick_s=tick_s)
    (log,), _ = run_logged(system, ["count"], 3.0, 0.1)
    np.testing.assert_array_equal(log.data()[0], np.arange(31))


def test_structure(servo):
    model, parameters, state = servo
    system = model.as_system(parameters, state)
    assert system.num_continuous_states() == 0
    assert system.num_input_ports() == 0
    names = [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]
    assert {name: system.GetOutputPort(name).size() for name in names} == model.outputs
    context = system.CreateDefaultContext()
    np.testing.assert_array_equal(context.get_numeric_parameter(0).value(), parameters)
    assert system.GetUniquePeriodicDiscreteUpdateAttribute().period_sec() == 0.002


def test_a_parameter_of_the_context_takes_effect(servo):
    model, parameters, state = servo
    system = model.as_system(parameters, state)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    simulator.AdvanceTo(0.1)
    before = system.GetOutputPort("velocity").Eval(context)
    index = model.parameter_names.index("arm.mass_kg")
    context.get_mutable_numeric_parameter(0).SetAtIndex(index, 2.0 * parameters[index])
    simulator.AdvanceTo(0.2)
    after = system.GetOutputPort("velocity").Eval(context)
    same = model.simulate(parameters, state, 0.2, outputs=["velocity"])["velocity"]
    assert before == same[50]
    assert 1e-9 < abs(after - same[100]) < 1e-3
    context.get_mutable_numeric_parameter(0).SetAtIndex(index, np.nan)
    with pytest.raises(ParameterError, match=r"arm\.mass_kg = nan: must be finite"):
        simulator.AdvanceTo(0.3)


def test_several_sample_periods_and_an_input_are_those_of_the_diagram(multirate):
    model = compile_diagram(multirate)
    options = {"integrator": "runge_kutta3", "step_s": 1e-3}
    names = ("y", "sampled", "held")
    system = model.as_system(model.parameters(), model.state(), **options)
    logs, _ = run_logged(system, names, 0.2, 0.002)
    simulator = Simulator(multirate)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 1e-3)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.AdvanceTo(0.2)
    for name, log in zip(names, logs, strict=True):
        drake = multirate.GetSubsystemByName(f"log_{name}").FindLog(simulator.get_context())
        at = np.isin(np.round(drake.sample_times(), 9), np.round(log.sample_times(), 9))
        np.testing.assert_allclose(log.data(), drake.data()[:, at], rtol=0, atol=1e-12)


def test_an_open_input_is_a_port(multirate):
    inner = multirate.GetSubsystemByName("inner")
    model = compile_diagram(inner, inputs=["u"])
    system = model.as_system(model.parameters(), model.state(), tick_s=0.01)
    assert system.GetInputPort("u").size() == 1
    logs, _ = run_logged(system, ["y"], 4.0, 0.01, value=0.5)
    assert logs[0].data()[0, 0] == 0.0
    assert logs[0].data()[0, -1] == pytest.approx(0.5, abs=1e-3)  # settled: e^(−2·4)


def test_a_failed_run_raises_what_a_direct_one_raises(servo):
    model, parameters, state = servo
    narrow = parameters.copy()
    narrow[model.parameter_names.index("arm.limit_m")] = 0.04
    with pytest.raises(SimulationError, match="arm: position = ") as direct:
        model.simulate(narrow, state, 5.0)
    with pytest.raises(SimulationError) as wrapped:
        Simulator(model.as_system(narrow, state)).AdvanceTo(5.0)
    assert str(wrapped.value) == str(direct.value)


def test_a_port_that_is_not_finite_raises_where_it_is_read():
    """Ports with t and √(0.015 − t), and with t: a port that nobody reads may be anything."""
    t = Variable("t")
    builder = DiagramBuilder()
    for name, output in (("roots", [t, sqrt(0.015 - t)]), ("clock", [t])):
        part = builder.AddNamedSystem(name, SymbolicVectorSystem(time=t, output=output))
        builder.ExportOutput(part.get_output_port(), name)
    model = compile_diagram(builder.Build())
    nothing = State(np.zeros(0), np.zeros(0))
    (clock,), _ = run_logged(model.as_system([], nothing, tick_s=0.01), ["clock"], 0.05, 0.01)
    np.testing.assert_allclose(clock.data()[0], clock.sample_times(), atol=1e-15)
    with pytest.raises(SimulationError, match=r"^t = 0\.02 s: roots\[1\] is not finite"):
        run_logged(model.as_system([], nothing, tick_s=0.01), ["roots"], 0.05, 0.01)


def test_feedback_around_a_plant_is_no_algebraic_loop():
    model = compile_diagram(Integrator(1), inputs=["u0"])
    assert model.feedthrough == frozenset()
    builder = DiagramBuilder()
    plant = builder.AddSystem(model.as_system(model.parameters(), State([1.0], []), tick_s=0.002))
    gain = builder.AddSystem(Gain(-1.0, 1))
    builder.Connect(plant.get_output_port(), gain.get_input_port())
    builder.Connect(gain.get_output_port(), plant.get_input_port())
    log = LogVectorOutput(plant.get_output_port(), builder, 0.002)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    decay = log.FindLog(simulator.get_context()).data()[0]
    np.testing.assert_allclose(
        decay, 0.998 ** np.arange(decay.size), rtol=1e-9
    )  # held over each tick


def test_between_the_ticks_stands_the_next_one_and_a_context_can_be_copied(servo):
    model, parameters, state = servo
    direct = model.simulate(parameters, state, 0.1, outputs=["velocity"])["velocity"]
    system = model.as_system(parameters, state)
    simulator = Simulator(system)
    simulator.AdvanceTo(0.021)
    port = system.GetOutputPort("velocity")
    assert port.Eval(simulator.get_context())[0] == direct[11, 0]
    reference = system.GetOutputPort("reference").Eval(simulator.get_context())
    expected = model.simulate(parameters, state, 0.1, outputs=["reference"])
    np.testing.assert_array_equal(reference, expected["reference"][11])  # of time alone
    copy = simulator.get_context().Clone()
    other = Simulator(system, copy)
    for one in (simulator, other):
        one.AdvanceTo(0.1)
        # What the integrator remembers is not copied: equal within its tolerance.
        assert port.Eval(one.get_context())[0] == pytest.approx(direct[50, 0], abs=1e-7)
