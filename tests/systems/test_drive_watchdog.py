"""The watchdog of the drive against sequences that are computed by hand."""

from pydrake.systems.analysis import Simulator

from kneexo.parameters import ProtectionParameters
from kneexo.systems import DriveWatchdog

T = 0.002
PARAMETERS = ProtectionParameters(watchdog_s=3 * T, stop_rad_s2=1000.0)  # 2 rad/s each sample


def commands(values, lost):
    """The command of the drive after the update at each sample."""
    system = DriveWatchdog(PARAMETERS, T)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    found = []
    for tick, (value, now) in enumerate(zip(values, lost, strict=True)):
        system.GetInputPort("motor_speed_command").FixValue(context, [value])
        system.GetInputPort("lost").FixValue(context, [now])
        simulator.AdvanceTo((tick + 0.5) * T)
        found.append(system.get_output_port().Eval(context)[0])
    return found


def test_the_drive_stops_after_three_samples_and_stays_stopped():
    """The last command is 5 rad/s. From the third lost sample on it falls by 2 in a sample."""
    values = [4.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 9.0, 9.0]
    lost = [0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]
    assert commands(values, lost) == [4.0, 5.0, 5.0, 5.0, 3.0, 1.0, 0.0, 0.0, 0.0]


def test_two_lost_samples_are_no_loss():
    values = [-4.0, -4.0, -4.0, -6.0, -6.0, -6.0]
    lost = [0.0, 1.0, 1.0, 0.0, 1.0, 1.0]
    assert commands(values, lost) == values


def test_a_sample_that_two_faults_lose_counts_once():
    assert commands([-6.0] * 5, [0.0, 1.0, 2.0, 1.0, 0.0]) == [-6.0, -6.0, -6.0, -4.0, -2.0]
