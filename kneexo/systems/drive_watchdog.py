"""Watchdog of the drive: stops the motor if no new speed command arrives."""

from __future__ import annotations

from typing import Any

from kneexo.parameters import ProtectionParameters
from kneexo.systems._leaf import NamedLeaf, clip, discrete_state, leaf_template, where_positive


def context_values(parameters: ProtectionParameters, sample_time_s: float) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `DriveWatchdog`."""
    return {
        "watchdog_samples": float(max(1, round(parameters.watchdog_s / sample_time_s))),
        "stop_rad_s2": parameters.stop_rad_s2,
    }


# In `kneexo study faults` a stale command that the drive obeyed for ever was the worst case.
class DriveWatchdog(NamedLeaf):
    """Stops the motor when the drive has not got a new speed command for n samples in a row.

    The counter c is the number of samples in a row without a new command. Below n the drive obeys
    the last command that it got. At c = n the drive ignores the bus for the rest of the run, and
    its own command falls to zero at the rate a, by at most a·T in a sample.

    ===================  ====  =====  ===================================================
    input port           size  unit
    ===================  ====  =====  ===================================================
    motor_speed_command  1     rad/s  of the bus; an old one if the new one is lost
    lost                 1     1      number of active faults that lose the new command
    **output port**
    motor_speed_command  1     rad/s  for the motor
    ===================  ====  =====  ===================================================

    Discrete states, updated every ``sample_time_s``: c and the drive's own command. Context
    parameters by name: ``watchdog_samples`` (n) and ``stop_rad_s2`` (a). Source: the loss of a
    heartbeat in CiA 301 and the quick stop of CiA 402. Lee et al. 2020 have no watchdog.

    Parameters
    ----------
    parameters
        Time without a command, and rate of the stop.
    sample_time_s
        Time T between two samples in s.
    """

    def __init__(
        self,
        parameters: ProtectionParameters = ProtectionParameters(),
        sample_time_s: float = 0.002,
    ) -> None:
        self._declare_parameters(context_values(parameters, sample_time_s))
        self._sample_time = sample_time_s
        self._command = self.DeclareVectorInputPort("motor_speed_command", 1)
        self._lost = self.DeclareVectorInputPort("lost", 1)
        self._declare_update(sample_time_s, 2, self._update)
        self._output = self._declare_output(
            "motor_speed_command", 1, self._calc_command, self._command, self.xd_ticket()
        )

    def _has_stopped(self, context: Any) -> Any:
        """Return a positive number once the drive stops the motor."""
        return discrete_state(context)[0] - self.parameters(context).watchdog_samples + 0.5

    def _calc_command(self, context: Any) -> list[Any]:
        own = discrete_state(context)[1]
        return [where_positive(self._has_stopped(context), own, self._command.Eval(context)[0])]

    def _update(self, context: Any) -> list[Any]:
        lost_samples = discrete_state(context)[0]
        kept = where_positive(self._has_stopped(context), lost_samples, 0.0)
        lost_samples = where_positive(self._lost.Eval(context)[0], lost_samples + 1.0, kept)
        command = self._output.Eval(context)[0]
        step = self.parameters(context).stop_rad_s2 * self._sample_time
        return [lost_samples, command - clip(command, -step, step)]


DriveWatchdog_ = leaf_template(DriveWatchdog)
"""Template of `DriveWatchdog` classes by scalar type of Drake."""
