"""Watchdog of the drive: stops the motor if no new speed command arrives."""

from __future__ import annotations

from functools import reduce
from typing import Any

from pydrake.math import max as _max

from kneexo.parameters import ProtectionParameters
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    leaf_template,
    values_of,
    where_positive,
)

_SAME = 0.01
"""Part of a sample by which a time may be early, because times are rounded in single precision."""


def context_values(parameters: ProtectionParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `DriveWatchdog`."""
    return values_of(parameters, "watchdog_s", "stop_rad_s2")


class DriveWatchdog(NamedLeaf):
    """The speed command that the drive obeys: the last one, or its own after a loss.

    With the number c of samples since the last new command, the drive stops the motor once
    c T ≥ T_w, and for the rest of the run. Its own command then falls to zero by at most a T in a
    sample.

    ===================  ====  =====  ===================================================
    input port           size  unit
    ===================  ====  =====  ===================================================
    motor_speed_command  1     rad/s  of the bus; an old one if the new one is lost
    lost                 n     1      of `FaultySignal`: positive if a fault loses it
    **output port**
    motor_speed_command  1     rad/s  for the motor
    ===================  ====  =====  ===================================================

    Discrete states, updated every ``sample_time_s``: c and the drive's own command. Context
    parameters by name: ``watchdog_s`` (T_w) and ``stop_rad_s2`` (a). Source: the loss of a
    heartbeat in CiA 301 and the quick stop of CiA 402. Lee et al. 2020 have no watchdog.

    Parameters
    ----------
    parameters
        Time without a command, and rate of the stop.
    sample_time_s
        Time T between two samples in s.
    losses
        Number n of faults that can lose a command.
    """

    def __init__(
        self,
        parameters: ProtectionParameters = ProtectionParameters(),
        sample_time_s: float = 0.002,
        losses: int = 1,
    ) -> None:
        self._declare_parameters(context_values(parameters))
        self._sample_time = sample_time_s
        self._command = self.DeclareVectorInputPort("motor_speed_command", 1)
        self._lost = self.DeclareVectorInputPort("lost", losses)
        self._declare_update(sample_time_s, 2, self._update)
        self._output = self._declare_output(
            "motor_speed_command", 1, self._calc_command, self._command, self.xd_ticket()
        )

    def _late(self, context: Any, samples: Any) -> Any:
        """Return a positive number if the last new command is so many samples too old."""
        return (samples + _SAME) * self._sample_time - self.parameters(context).watchdog_s

    def _calc_command(self, context: Any) -> list[Any]:
        samples, own = discrete_state(context)
        return [where_positive(self._late(context, samples), own, self._command.Eval(context)[0])]

    def _update(self, context: Any) -> list[Any]:
        samples, _ = discrete_state(context)
        lost = reduce(_max, self._lost.Eval(context).tolist())
        kept = where_positive(self._late(context, samples), samples, 0.0)
        command = self._output.Eval(context)[0]
        step = self.parameters(context).stop_rad_s2 * self._sample_time
        return [where_positive(lost, samples + 1.0, kept), command - clip(command, -step, step)]


DriveWatchdog_ = leaf_template(DriveWatchdog)
"""Template of `DriveWatchdog` classes by scalar type of Drake."""
