"""The closed loop over a CANopen bus: a master, a CiA 402 drive, and frames between them.

The drive is a node of `canopen` on the virtual bus of python-can, with an object dictionary of its
own; motor, cylinder and knee hang on it as Drake's Simulator of the plant. The master configures it
by SDO. Each sample it sends SYNC, waits for the drive's PDO, reads the encoder, calls the
controller as ``step(counts, reference) -> command_rad_s`` and sends the command as PDO. Nothing
here uses `Cia402Drive`: its integers must be those on the bus.
"""

import math
import struct
import threading
from collections.abc import Callable
from itertools import count

import numpy as np
import pytest
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

from kneexo.diagrams import make_controller, make_plant
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import simulate
from kneexo.systems import make_knee_reference
from kneexo.systems.knee_reference import start_angle_rad

canopen = pytest.importorskip("canopen", reason="needs canopen: pip install '.[canopen]'")
od = canopen.objectdictionary

NODE, TIMEOUT_S = 5, 10.0
CONTROLWORD, STATUSWORD, MODE, MODE_DISPLAY = 0x6040, 0x6041, 0x6060, 0x6061
ACTUAL_VELOCITY, SI_UNIT_VELOCITY, TARGET_VELOCITY = 0x606C, 0x60A9, 0x60FF
SYNCHRONOUS, EVENT_DRIVEN = 1, 255
CYCLIC_SYNCHRONOUS_VELOCITY = 9

Step = Callable[[int, np.ndarray], float]
"""The controller on the target: counts of the encoder and the reference (4,) to rad/s."""


def drake_step(scenario: Scenario) -> Step:
    """Our controller, by the discrete update of its diagram in Drake."""
    controller = make_controller(scenario)
    context = controller.CreateDefaultContext()
    resolution = 2.0 * math.pi / scenario.encoder.counts_per_revolution
    samples = count()

    def step(counts: int, reference: np.ndarray) -> float:
        controller.GetInputPort("encoder_reading").FixValue(context, [counts * resolution])
        controller.GetInputPort("knee_reference").FixValue(context, reference)
        if next(samples) == 0:
            Simulator(controller, context).Initialize()  # estimator and filter begin at rest
        updated = controller.EvalUniquePeriodicDiscreteUpdate(context)
        context.get_mutable_discrete_state().SetFrom(updated)
        return float(controller.GetOutputPort("motor_speed_command").Eval(context)[0])

    return step


# ---------------------------------------------------------------------------------- the knee


class Knee:
    """Motor, cylinder and knee as hardware: a speed in, an encoder to read."""

    def __init__(self, scenario: Scenario) -> None:
        self._plant = make_plant(
            scenario.plant, initial_knee_angle_rad=start_angle_rad(scenario.reference)
        )
        self._simulator = Simulator(self._plant)
        ResetIntegratorFromFlags(
            self._simulator, scenario.simulation.integrator, scenario.simulation.step_s
        )
        self._simulator.get_mutable_integrator().set_fixed_step_mode(True)
        self._counts = scenario.encoder.counts_per_revolution
        self._hold(0.0)
        self._simulator.Initialize()

    def _hold(self, speed_rad_s: float) -> None:
        context = self._simulator.get_mutable_context()
        self._plant.GetInputPort("motor_speed_command").FixValue(context, [speed_rad_s])

    def _value(self, port: str) -> float:
        return float(self._plant.GetOutputPort(port).Eval(self._simulator.get_context())[0])

    def run(self, until_s: float, speed_rad_s: float) -> None:
        self._hold(speed_rad_s)
        self._simulator.AdvanceTo(until_s)

    def counts(self) -> int:
        return math.floor(self._value("encoder_angle") * self._counts / (2.0 * math.pi))

    def motor_speed_rad_s(self) -> float:
        return self._value("motor_speed")


# --------------------------------------------------------------------------------- the drive


def variable(name, index, kind, default=0, subindex=0):
    entry = od.ODVariable(name, index, subindex)
    entry.data_type, entry.default, entry.access_type = kind, default, "rw"
    return entry


def record(name, index, *members):
    entry = od.ODRecord(name, index)
    for subindex, (member, kind, default) in enumerate(members):
        entry.add_member(variable(member, index, kind, default, subindex))
    return entry


def object_dictionary():
    dictionary = od.ObjectDictionary()
    mapping = [
        ("count", od.UNSIGNED8, 0),
        *((f"object {n}", od.UNSIGNED32, 0) for n in range(1, 9)),
    ]
    for entry in (
        variable("Controlword", CONTROLWORD, od.UNSIGNED16),
        variable("Statusword", STATUSWORD, od.UNSIGNED16, 0x40),
        variable("Modes of operation", MODE, od.INTEGER8),
        variable("Modes of operation display", MODE_DISPLAY, od.INTEGER8),
        variable("Velocity actual value", ACTUAL_VELOCITY, od.INTEGER32),
        variable("SI unit velocity", SI_UNIT_VELOCITY, od.UNSIGNED32, 0x00B44700),
        variable("Target velocity", TARGET_VELOCITY, od.INTEGER32),
        *(
            record(
                name,
                index,
                ("count", od.UNSIGNED8, 2),
                ("COB-ID", od.UNSIGNED32, cob_id + NODE),
                ("transmission type", od.UNSIGNED8, EVENT_DRIVEN),
            )
            for name, index, cob_id in (("RPDO 1", 0x1400, 0x200), ("TPDO 1", 0x1800, 0x180))
        ),
        record("RPDO 1 mapping", 0x1600, *mapping),
        record("TPDO 1 mapping", 0x1A00, *mapping),
    ):
        dictionary.add_object(entry)
    return dictionary


class Drive:
    """A drive of CiA 402 at the shaft of the knee's motor; ``received``: each target velocity."""

    def __init__(self, network, knee: Knee, period_s: float) -> None:
        self.received: list[int] = []
        self._knee, self._period_s, self._syncs = knee, period_s, count()
        self._target = self._pending = 0
        self.node = canopen.LocalNode(NODE, object_dictionary())
        network.add_node(self.node)
        self.node.add_write_callback(self._written)
        network.subscribe(0x80, self._sync)
        network.subscribe(0x200 + NODE, self._command)

    def _written(self, index, subindex, od, data) -> None:
        if index == CONTROLWORD:
            status = {0x06: 0x21, 0x07: 0x23, 0x0F: 0x27}.get(od.decode_raw(data) & 0x0F, 0x40)
            self.node.sdo[STATUSWORD].raw = status
        if index == MODE:  # of those that drives know, this one does
            mode = od.decode_raw(data)
            self.node.sdo[MODE_DISPLAY].raw = mode if mode == CYCLIC_SYNCHRONOUS_VELOCITY else 0

    def _unit_rad_s(self) -> float:
        """Decode 0x60A9: reserved, denominator, numerator, exponent as the drive stores them."""
        reserved, denominator, numerator, exponent = struct.unpack(
            "<BBBb", self.node.get_data(SI_UNIT_VELOCITY, 0)
        )
        assert (reserved, denominator, numerator) == (0, 0x47, 0xB4)  # minute, revolution
        return 2.0 * math.pi / 60.0 * 10.0**exponent

    def _mapped(self, index) -> list[int]:
        """The objects of a PDO, as its mapping has been written."""
        entries = self.node.sdo[index]
        return [entries[n].raw >> 16 for n in range(1, entries[0].raw + 1)]

    def _command(self, can_id, data, timestamp) -> None:
        assert self._mapped(0x1600) == [CONTROLWORD, TARGET_VELOCITY]
        controlword, self._pending = struct.unpack("<Hi", data)
        if self.node.sdo[CONTROLWORD].raw != controlword:
            self.node.sdo[CONTROLWORD].raw = controlword
        self.received.append(self._pending)
        if self.node.sdo[0x1400][2].raw == EVENT_DRIVEN:
            self._act()

    def _act(self) -> None:
        enabled = self.node.sdo[STATUSWORD].raw == 0x27
        speed_mode = self.node.sdo[MODE_DISPLAY].raw == CYCLIC_SYNCHRONOUS_VELOCITY
        self._target = self._pending if enabled and speed_mode else 0

    def _sync(self, can_id, data, timestamp) -> None:
        unit = self._unit_rad_s()
        # Until now the shaft has turned as commanded before.
        self._knee.run(next(self._syncs) * self._period_s, self._target * unit)
        if self.node.sdo[0x1400][2].raw <= 240:
            self._act()
        velocity = round(self._knee.motor_speed_rad_s() / unit)
        self.node.sdo[ACTUAL_VELOCITY].raw = velocity
        assert self._mapped(0x1A00) == [STATUSWORD, ACTUAL_VELOCITY]
        status = self.node.sdo[STATUSWORD].raw
        self.node.network.send_message(0x180 + NODE, struct.pack("<Hi", status, velocity))


# -------------------------------------------------------------------------------- the master


class Master:
    """The controller's side of the bus."""

    def __init__(self, network, scenario: Scenario, transmission_type: int) -> None:
        self._network = network
        self._drive = network.add_node(NODE, object_dictionary())
        self._drive.sdo.RESPONSE_TIMEOUT = TIMEOUT_S
        self._reported = threading.Semaphore(0)
        self._configure(scenario, transmission_type)

    def _configure(self, scenario: Scenario, transmission_type: int) -> None:
        sdo = self._drive.sdo
        sdo[MODE].raw = CYCLIC_SYNCHRONOUS_VELOCITY
        assert sdo[MODE_DISPLAY].raw == CYCLIC_SYNCHRONOUS_VELOCITY
        sdo[SI_UNIT_VELOCITY].raw = scenario.bus.si_unit_velocity
        self._drive.rpdo.read()
        self._drive.tpdo.read()
        self.command, report = self._drive.rpdo[1], self._drive.tpdo[1]
        for pdo, objects, kind in (
            (self.command, (CONTROLWORD, TARGET_VELOCITY), transmission_type),
            (report, (STATUSWORD, ACTUAL_VELOCITY), SYNCHRONOUS),
        ):
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.trans_type, pdo.enabled = kind, True
            pdo.save()
        report.add_callback(lambda _: self._reported.release())
        self._report = report
        for controlword, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            sdo[CONTROLWORD].raw = controlword
            assert sdo[STATUSWORD].raw == state

    def sync(self) -> tuple[int, int]:
        """Start a cycle; returns statusword and velocity that the drive reports."""
        self._network.sync.transmit()
        assert self._reported.acquire(timeout=TIMEOUT_S), "the drive did not answer SYNC"
        return self._report[STATUSWORD].raw, self._report[ACTUAL_VELOCITY].raw

    def send(self, target_velocity: int, controlword: int = 0x0F) -> None:
        self.command[CONTROLWORD].raw = controlword
        self.command[TARGET_VELOCITY].raw = target_velocity
        self.command.transmit()


@pytest.fixture
def networks(request):
    """Both ends of a virtual bus, one for the master and one for the drive."""
    ends = [canopen.Network(), canopen.Network()]
    for end in ends:
        end.NOTIFIER_CYCLE = 0.02  # how long its thread may listen on when it disconnects
        end.connect(interface="virtual", channel=request.node.name)
    yield ends
    for end in ends:
        end.disconnect()


SAMPLES = 400
LOOPS = {
    "smc, 1 rpm": ({"kind": "smc"}, 1.0, SYNCHRONOUS),
    "smc, 0.1 rpm, event-driven": ({"kind": "smc"}, 0.1, EVENT_DRIVEN),
    "pid, 0.001 rpm": ({"kind": "pid", "integral_per_s2": 30.0}, 0.001, SYNCHRONOUS),
}


@pytest.mark.slow
@pytest.mark.parametrize("loop", LOOPS)
def test_the_drive_receives_the_integers_of_the_simulated_loop(loop, networks):
    controller, unit_rpm, transmission_type = LOOPS[loop]
    latency = 0 if transmission_type == EVENT_DRIVEN else 1
    scenario = changed(
        Scenario(),
        {
            "controller": controller,
            "bus": {"kind": "cia402", "velocity_unit_rpm": unit_rpm, "latency_samples": latency},
            "reference.frequency_hz": 0.2,
            "simulation.integrator": "radau3",
            "simulation.duration_s": SAMPLES * 0.002,
        },
    )
    period_s = scenario.controller.sample_time_s
    source = make_knee_reference(scenario.reference)
    clock = source.CreateDefaultContext()
    step, knee = drake_step(scenario), Knee(scenario)
    drive = Drive(networks[1], knee, period_s)
    master = Master(networks[0], scenario, transmission_type)
    reported = []
    for sample in range(SAMPLES + 1):
        status, velocity = master.sync()
        assert status == 0x27  # operation enabled
        reported.append(velocity)
        clock.SetTime(sample * period_s)
        command_rad_s = step(knee.counts(), source.get_output_port().Eval(clock))
        command_rpm = command_rad_s * 60.0 / (2.0 * math.pi)
        master.send(round(command_rpm / unit_rpm))
    master.sync()  # the last command has arrived
    run = simulate(scenario)
    # The log shows the integer that is held up to its time: the one of the sample before.
    expected = run["target_velocity_units"][1:].astype(int).tolist()
    assert drive.received[:SAMPLES] == expected
    assert len(set(expected)) > 150
    speed = run["motor_speed_rad_s"] * 60.0 / (2.0 * math.pi) / unit_rpm
    assert np.max(np.abs(np.array(reported) - speed)) <= 0.5 + 1e-6
    assert np.ptp(run["knee_angle_rad"]) > 0.1


def test_a_drive_that_is_not_enabled_does_not_turn(networks):
    scenario = changed(Scenario(), {"bus": {"kind": "cia402"}, "simulation.integrator": "radau3"})
    Drive(networks[1], Knee(scenario), scenario.controller.sample_time_s)
    master = Master(networks[0], scenario, SYNCHRONOUS)
    master.sync()
    master.send(1000)
    assert master.sync() == (0x27, 0)  # the command acts from here on
    status, velocity = master.sync()
    assert (status, velocity > 100) == (0x27, True)
    for _ in range(100):  # 0.2 s, twenty times the motor's lag
        master.send(1000, controlword=0x06)
        status, velocity = master.sync()
    assert (status, velocity) == (0x21, 0)
