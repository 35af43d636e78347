"""Supervisor that stops the motor after a fault, by the table of the safety state machine."""

from __future__ import annotations

from functools import reduce
from typing import Any

import pydrake.math as drake_math
from pydrake.math import max as _max, min as _min

from kneexo.parameters import ProtectionParameters
from kneexo.parameters.device.plant import RPM
from kneexo.parameters.device.safety_states import (
    DETECTORS,
    EMERGENCY_STOP,
    LAW_ACTS,
    NOT_HEALTHY,
    STATES,
    transitions,
)
from kneexo.systems._leaf import (
    NamedLeaf,
    clip,
    discrete_state,
    leaf_template,
    value_or_zero,
    where_positive,
    where_within,
)

_NUMBERS = {state: float(number) for number, state in enumerate(STATES)}


def context_values(parameters: ProtectionParameters) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `SafetySupervisor`."""
    return {
        "healthy_s": parameters.healthy_s,
        "overdue_s": parameters.overdue_s,
        "stop_rad_s2": parameters.stop_rad_s2,
        "standstill_rad_s": parameters.standstill_rpm * RPM,
    }


class SafetySupervisor(NamedLeaf):
    """State machine between law and drive: passes the command of the law, or stops the motor.

    `kneexo.parameters.device.safety_states` has the table of states, events and transitions. A stop
    keeps its first reason until a reset.

    ===================  ====  =====  ===========================================================
    input port           size  unit
    ===================  ====  =====  ===========================================================
    motor_speed_command  1     rad/s  of the law
    motor_speed          1     rad/s  as the drive reports it; no standstill if not finite
    detected             6     1      of `FaultDetectors`
    emergency_stop       1     1      0: not pressed; 0 if unconnected
    reset                1     1      its rise from 0 to 1 is the reset; 0 if unconnected
    **output port**
    motor_speed_command  1     rad/s  for the drive
    safety_state         1     1      number of the state in `STATES`, from 0
    safety_reason        1     1      number of the reason in `REASONS`; 0 without a stop
    release              1     1      1 in the state ``released``, else 0
    ===================  ====  =====  ===========================================================

    A button is a wire that can break. The emergency stop is pressed by all values outside ±0.5,
    also by those that are not finite. A reset is a rise from a value within ±0.5 to a finite value
    above 0.5.

    Discrete states, updated every ``sample_time_s``: state, reason, own command, number of samples
    in this state, number of samples without a detected fault, and 0 if ``reset`` was within ±0.5 in
    the sample before, else 1.
    Context parameters by name: ``healthy_s``, ``overdue_s``, ``stop_rad_s2`` and
    ``standstill_rad_s``. Source: an assumption. Lee et al. 2020 have no supervisor.
    """

    def __init__(
        self,
        parameters: ProtectionParameters = ProtectionParameters(),
        sample_time_s: float = 0.002,
    ) -> None:
        self._declare_parameters(context_values(parameters))
        self._sample_time = sample_time_s
        self._transitions = transitions(parameters.safe_state)
        self._law = self.DeclareVectorInputPort("motor_speed_command", 1)
        self._speed = self.DeclareVectorInputPort("motor_speed", 1)
        self._detected = self.DeclareVectorInputPort("detected", len(DETECTORS))
        self._emergency = self.DeclareVectorInputPort("emergency_stop", 1)
        self._reset = self.DeclareVectorInputPort("reset", 1)
        self._declare_update(sample_time_s, 6, self._update)
        declare, state = self._declare_output, self.xd_ticket()
        self._command = declare(
            "motor_speed_command", 1, lambda c: [self._calc_command(c)], self._law, state
        )
        declare("safety_state", 1, lambda c: discrete_state(c)[:1], state)
        declare("safety_reason", 1, lambda c: discrete_state(c)[1:2], state)
        declare("release", 1, self._calc_release, state)

    def _calc_release(self, context: Any) -> list[Any]:
        return [where_positive(_is(discrete_state(context)[0], "released"), 1.0, 0.0)]

    def _calc_command(self, context: Any) -> Any:
        state, _, own, *_ = discrete_state(context)
        return where_positive(_law_acts(state), self._law.Eval(context)[0], own)

    def _update(self, context: Any) -> list[Any]:
        p, dt = self.parameters(context), self._sample_time
        state, reason, own, samples, clear, reset_before = discrete_state(context)
        detected = self._detected.Eval(context).tolist()
        emergency = where_within(value_or_zero(self._emergency, context), -0.5, 0.5, 0.0, 1.0)
        reset = value_or_zero(self._reset, context)
        # 1/x is positive for each finite x, and zero for an infinite one.
        is_on = where_positive(_min(reset - 0.5, 1.0 / _max(reset, 0.5)), 1.0, 0.0)
        clear = where_positive(_largest(detected), 0.0, clear + 1.0)
        samples = samples + 1.0
        speed = drake_math.abs(self._speed.Eval(context)[0])
        still = where_positive(p.standstill_rad_s - speed, 1.0, 0.0)  # no number of an event is nan
        # An event happens if its number is positive. Half a sample keeps rounded times from
        # deciding.
        events = {
            "emergency": emergency,
            # Only after the ramp of the command: a motor that passes zero speed on its way does not
            # stand.
            "standstill": where_positive(drake_math.abs(own), 0.0, still),
            "healthy": (clear + 0.5) * dt - p.healthy_s,
            "overdue": (samples + 0.5) * dt - p.overdue_s,
            "reset": _min(is_on, 0.5 - reset_before),
        }
        causes: dict[str, list[Any]] = {}
        for detector, value in zip(DETECTORS.values(), detected, strict=True):
            causes.setdefault(detector.event, []).append(value)
        events |= {event: _largest(values) for event, values in causes.items()}
        following = state
        for row in reversed(self._transitions):  # the first row decides, so it comes last
            taken = _min(_is(state, row.state), events[row.event])
            following = where_positive(taken, _NUMBERS[row.next_state], following)
        # The last assignment wins: the emergency stop before the detectors, and these in their
        # order.
        cause: Any = float(NOT_HEALTHY)
        for number, value in reversed(list(enumerate(detected, 1))):
            cause = where_positive(value, float(number), cause)
        cause = where_positive(emergency, float(EMERGENCY_STOP), cause)
        cause = where_positive(_law_acts(state), cause, reason)
        command = self._command.Eval(context)[0]
        step = p.stop_rad_s2 * dt
        slower = command - clip(command, -step, step)
        return [
            following,
            where_positive(_law_acts(following), 0.0, cause),
            where_positive(_is(following, "stopping"), slower, 0.0),
            where_positive(drake_math.abs(following - state), 0.0, samples),
            clear,
            where_within(reset, -0.5, 0.5, 0.0, 1.0),
        ]


def _is(state: Any, name: str) -> Any:
    """Return a positive number if ``state`` is the number of the state ``name``."""
    return 0.5 - drake_math.abs(state - _NUMBERS[name])


def _law_acts(state: Any) -> Any:
    """Return a positive number if ``state`` is one of `LAW_ACTS`, which have the first numbers."""
    return len(LAW_ACTS) - 0.5 - state


def _largest(values: list[Any]) -> Any:
    return reduce(_max, values)


SafetySupervisor_ = leaf_template(SafetySupervisor)
"""Template of `SafetySupervisor` classes by scalar type of Drake."""
