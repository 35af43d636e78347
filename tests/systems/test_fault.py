"""Faults of signals and parameters against sequences that are computed by hand."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from kneexo.parameters import BldcPumpParameters, FaultParameters
from kneexo.systems import BldcPump, FaultySignal, ParameterFault

T = 0.002


def fault(kind="offset", size=2.0, **values):
    return FaultParameters(**{"place": "load_cell", "kind": kind, "size": size} | values)


def outputs(system, values, trigger=None, port="signal"):
    """The output at each sample, before the update, as a controller reads it."""
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    found = []
    for tick, value in enumerate(values):
        if tick > 0:
            simulator.AdvanceTo(tick * T)
        if system.HasInputPort("signal"):
            system.GetInputPort("signal").FixValue(context, np.atleast_1d(value))
        if trigger is not None:
            system.GetInputPort("trigger").FixValue(context, np.atleast_1d(trigger[tick]))
        if tick == 0:
            simulator.Initialize()
        found.append(system.GetOutputPort(port).Eval(context).copy())
    return np.array(found)


class SampledSteps(LeafSystem):
    """The number of samples so far."""

    def __init__(self):
        super().__init__()
        index = self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(T, 0.0, self._count)
        self.DeclareStateOutputPort("count", index)

    def _count(self, context, state):
        state.get_mutable_vector().SetAtIndex(0, 1.0 + context.get_discrete_state_vector()[0])


SIGNAL = np.array([1.0, 2.0, 4.0, 7.0, 11.0, 16.0])


@pytest.mark.parametrize(
    ("kind", "size", "expected"),
    [
        ("frozen", 0.0, [1, 2, 2, 2, 11, 16]),
        ("offset", 0.5, [1, 2, 4.5, 7.5, 11, 16]),
        ("drift", 3.0, [1, 2, 4.0, 7.0 + 3.0 * T, 11, 16]),
        ("scale", -2.0, [1, 2, -8, -14, 11, 16]),
        ("value", -3.0, [1, 2, -3, -3, 11, 16]),
        ("dropped", 1.0, [1, 2, 2, 2, 11, 16]),
        ("late", 1.0, [1, 2, 2, 4, 11, 16]),
        ("late", 2.0, [1, 2, 1, 2, 11, 16]),
    ],
)
def test_a_reading_is_wrong_while_the_fault_is_active(kind, size, expected):
    parameters = fault(kind, size, start_s=2 * T, duration_s=2 * T)
    system = FaultySignal(parameters, T, lead_s=T, size=2)
    found = outputs(system, np.column_stack([SIGNAL, -SIGNAL]))
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-12)
    np.testing.assert_array_equal(found[:, 1], -SIGNAL)  # the age of a reading stays
    active = outputs(system, np.column_stack([SIGNAL, -SIGNAL]), port="active")
    np.testing.assert_array_equal(active[:, 0], [0, 0, 1, 1, 0, 0])


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("frozen", [1, 2, 2, 2, 5, 6]), ("dropped", [1, 2, 2, 2, 5, 6]), ("late", [1, 2, 2, 3, 5, 6])],
)
def test_a_held_command_repeats_those_of_samples_before(kind, expected):
    """A command is held between two samples, and changes together with the state of the fault."""
    builder = DiagramBuilder()
    steps = builder.AddNamedSystem("steps", SampledSteps())
    size = 0.0 if kind == "frozen" else 1.0
    parameters = fault(kind, size, start_s=2 * T, duration_s=2 * T)
    system = builder.AddNamedSystem("fault", FaultySignal(parameters, T))
    builder.Connect(steps.get_output_port(), system.GetInputPort("signal"))
    builder.ExportOutput(system.GetOutputPort("signal"), "signal")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    found = []
    for tick in range(6):
        simulator.AdvanceTo((tick + 0.5) * T)
        found.append(diagram.GetOutputPort("signal").Eval(simulator.get_context())[0])
    assert found == expected


@pytest.mark.parametrize("bit", [0, 3, 11])
def test_a_bit_of_the_count_flips(bit):
    resolution = 2.0 * np.pi / 4096
    counts = np.array([0, 1, 7, 8, 9, -1, -8, 4095])
    parameters = FaultParameters(kind="bit_flip", size=bit, start_s=0.0)
    system = FaultySignal(parameters, T, resolution=resolution)
    found = outputs(system, resolution * counts)[1:, 0] / resolution
    np.testing.assert_allclose(found, (counts ^ (1 << bit))[1:], atol=1e-9)


def test_noise_and_dropped_samples_have_their_statistics_and_depend_on_the_seed():
    zeros = np.zeros(400)
    noise = outputs(FaultySignal(fault("noise", 3.0, start_s=0.0), T), zeros)[1:, 0]
    assert abs(noise.mean()) < 5 * 3.0 / np.sqrt(400)
    assert noise.std() == pytest.approx(3.0, rel=5 / np.sqrt(2 * 400))
    other = outputs(FaultySignal(fault("noise", 3.0, start_s=0.0, seed=1), T), zeros)[1:, 0]
    assert not np.array_equal(noise, other)
    ramp = np.arange(400.0)
    dropped = outputs(FaultySignal(fault("dropped", 0.3, start_s=0.0), T), ramp)[:, 0]
    lost = dropped != ramp
    assert lost[1:].mean() == pytest.approx(0.3, abs=5 * np.sqrt(0.21 / 400))
    held = np.maximum.accumulate(np.where(lost, -1.0, ramp))  # the last value that came
    np.testing.assert_array_equal(dropped, held)
    told = outputs(FaultySignal(fault("dropped", 0.3, start_s=0.0), T), ramp, port="lost")[:, 0]
    np.testing.assert_array_equal(told, lost)


def test_a_frozen_signal_is_lost_while_the_fault_is_active():
    system = FaultySignal(fault("frozen", 0.0, start_s=2 * T, duration_s=2 * T), T, lead_s=T)
    np.testing.assert_array_equal(outputs(system, SIGNAL, port="lost")[:, 0], [0, 0, 1, 1, 0, 0])
    assert not FaultySignal(fault(), T).HasOutputPort("lost")


@pytest.mark.parametrize(("given", "sign"), [("above", 1.0), ("below", -1.0)])
def test_a_signal_triggers_the_fault_once(given, sign):
    parameters = fault(start_s=2 * T, signal="rod_force_n", duration_s=2 * T, **{given: sign * 5.0})
    system = FaultySignal(parameters, T, trigger=(2, 1))
    trigger = np.array([6, 0, 4, 6, 0, 0, 6, 6], dtype=float)  # the first is before start_s
    column = np.column_stack([0 * trigger, sign * trigger])
    active = outputs(system, np.zeros(8), column, port="active")[:, 0]
    np.testing.assert_array_equal(active, [0, 0, 0, 0, 1, 1, 0, 0])


def test_a_fault_changes_parameters_of_another_system():
    system = ParameterFault(fault(start_s=T), {"gear_ratio": -2.0, "lag_s": 0.5}, T)
    changes = outputs(system, [0, 0, 0], port="offsets")
    np.testing.assert_array_equal(changes, [[0, 0], [0, 0], [-2, 0.5]])
    pump = BldcPump(BldcPumpParameters(), False, fault_names=("gear_ratio",))
    healthy = BldcPump(BldcPumpParameters())
    for other in (pump, pump.ToAutoDiffXd()):
        context = other.CreateDefaultContext()
        other.GetInputPort("fault").FixValue(context, [2.0])
        values = other.parameters(context)
        assert values.gear_ratio == BldcPumpParameters().gear_ratio + 2.0
    assert not healthy.HasInputPort("fault")


def test_an_output_follows_a_changed_parameter():
    """The port of the changes is a source of each output, so that no old value is kept."""
    pump = BldcPump(BldcPumpParameters(), True, fault_names=("gear_ratio",))
    context = pump.CreateDefaultContext()
    pump.GetInputPort("motor_speed_command").FixValue(context, [100.0])
    pump.GetInputPort("load_pressure").FixValue(context, [0.0])
    flows = []
    for change in (0.0, BldcPumpParameters().gear_ratio):
        pump.GetInputPort("fault").FixValue(context, [change])
        flows.append(pump.GetOutputPort("load_flow").Eval(context)[0])
    assert flows[0] == pytest.approx(2.0 * flows[1], rel=1e-12)
