"""Calls the user's control laws as Python once a sample, beside a compiled plant."""

from __future__ import annotations

import math
import multiprocessing
import sys
from collections.abc import Mapping
from functools import partial

import numpy as np
from pydrake.systems.analysis import Simulator

from kneexo.common.result import Array
from kneexo.common.user_code import user_code
from kneexo.errors import KneexoError
from kneexo.geometry.linkage import encoder_angle, polynomial
from kneexo.geometry.rod_polynomial import controller_polynomial
from kneexo.law.call import call_law, require_finite_result
from kneexo.law.decision import law_inputs, users_system, why_python
from kneexo.parameters import LAW_INPUTS, Law, LawParameters, Scenario
from kneexo.systems.knee_reference import start_angle_rad

SIGNAL_OF = {name: name for name in LAW_INPUTS} | {
    "rod_extension": "measured_rod_extension",
    "knee_angle": "measured_knee_angle",
    "rod_state": "estimated_state",  # with the estimator exact, the only one with rod_state
}
"""For each input of a law the output port of the closed loop with the same value."""


class PythonLaw:
    """The law of a scenario for one run: a function of time and signals that returns the command.

    The first call of a law prints one line on stderr, which says why the law runs as Python and how
    to get the law compiled.
    """

    def __init__(self, scenario: Scenario, *, announce: bool = True) -> None:
        """Start the law anew. ``announce``: whether the line may be printed."""
        law = scenario.with_loaded_law().controller
        assert isinstance(law, LawParameters)
        self._law = law
        self._limit = scenario.command_limit_rad_s
        self._inputs = law_inputs(scenario)
        self.signals = tuple(SIGNAL_OF[name] for name in self._inputs)
        """Names of the output ports of the closed loop that the law reads."""
        self._reason = why_python(scenario) if announce else ""
        if law.function.is_system:
            self._simulator = Simulator(users_system(scenario))
            self._command = self._system_command
            return
        self._command = self._function_command
        self._function = law.function.copy_of_target()
        self._state = np.array(law.initial_state)
        self._gains = {name: np.array([value]) for name, value in law.values.items()}

    def __call__(self, time_s: float, signals: Mapping[str, Array]) -> float:
        """Return the limited command in rad/s at a sample."""
        command = self._command(time_s, {n: signals[SIGNAL_OF[n]] for n in self._inputs})
        if self._reason:  # after the first call, because an error says more
            _announce(self._law.function, self._reason)
            self._reason = ""
        return min(max(command, -self._limit), self._limit)

    def _function_command(self, time_s: float, values: dict[str, Array]) -> float:
        law = self._law.function
        values |= self._gains | {"time_s": np.array([time_s]), "state": self._state}
        command, *state = call_law(law, self._function, values)
        require_finite_result(law, time_s, [command, *state])
        self._state = np.array(state)
        return float(command)

    def _system_command(self, time_s: float, values: dict[str, Array]) -> float:
        """Return the motor speed that the user's Drake system commands at a sample.

        The system is advanced to ``time_s``. Its inputs get the measurements ``values``, by port.
        """
        system, context = self._simulator.get_system(), self._simulator.get_mutable_context()
        with user_code(f"law {self._law.function.short_name}: the system fails"):
            is_first = time_s == context.get_time()
            if not is_first:
                self._simulator.AdvanceTo(time_s)
            for name, value in values.items():
                system.GetInputPort(name).FixValue(context, value)
            if is_first:
                self._simulator.Initialize()
            self._simulator.AdvancePendingEvents()
            command = float(system.GetOutputPort("motor_speed_command").Eval(context)[0])
        require_finite_result(self._law.function, time_s, [command])
        return command


_announced: set[str] = set()


def _announce(law: Law, reason: str) -> None:
    """Print once for each law that it runs as Python, unless this is a worker process."""
    line = (
        f"kneexo: law {law.short_name} runs as Python; a sample costs 0.1 ms and its time: "
        f"{reason}; docs/your_controller.md says how to get it compiled\n"
    )
    if line in _announced or multiprocessing.parent_process() is not None:
        return
    _announced.add(line)
    sys.stderr.write(line)


def commands_at_points(scenario: Scenario) -> list[float]:
    """Return the commands in rad/s of a law at some samples, from its first sample on.

    The knee is within a degree of its reference, which is anywhere in the range of motion.
    """
    random = np.random.default_rng(0)
    knee = scenario.believed_plant.knee
    ends = math.radians(knee.flexion_min_deg), math.radians(knee.flexion_max_deg)
    references = random.uniform(*ends, _POINTS)
    knees = references + _DISPLACEMENT_RAD * random.uniform(-1.0, 1.0, _POINTS)
    knees = np.clip(knees, *ends)
    return _commands(scenario, knees, references, random.uniform(-0.1, 0.1, (_POINTS, 3)))


_POINTS = 16  # some of which reach no limit of the command


def _commands(scenario: Scenario, knees: Array, references: Array, rates: Array) -> list[float]:
    """Call the law at n successive samples; return its commands in rad/s, after the limit.

    ``knees`` and ``references`` (n,) are angles in rad. ``rates`` (n, 3) are three derivatives,
    which serve for the reference of the knee and for that of the rod.
    """
    extension_at = partial(polynomial, controller_polynomial(scenario).p_si)
    encoder_at = partial(encoder_angle, scenario.believed_plant.linkage)
    call, commands = PythonLaw(scenario, announce=False), []
    for sample, (knee, reference, rate) in enumerate(zip(knees, references, rates, strict=True)):
        values = {
            "rod_extension": [extension_at(knee)],
            "knee_angle": [knee],
            "rod_reference": [extension_at(reference), *rate],
            "knee_reference": [reference, *rate],
            "estimated_state": [extension_at(knee), 0.0, 0.0],
            "encoder_reading": [float(encoder_at(knee)) - scenario.encoder.offset_rad],
        }
        signals = {SIGNAL_OF[name]: np.array(value) for name, value in values.items()}
        commands.append(call(sample * scenario.controller.sample_time_s, signals))
    return commands


_CALLS = 50  # enough for an integral to act
_DISPLACEMENT_RAD = 0.02  # about a degree, many counts of the encoder


def sign_hint(scenario: Scenario) -> str:
    """Return a remedy if the law of a scenario drives the rod away from its reference.

    The law is called with the knee a degree above and a degree below a constant reference. With the
    knee above the reference the rod is too short, and the command must be larger than with the knee
    below. The text is empty if the sign is right, for a law that fails, and without a law of the
    user.
    """
    law = scenario.controller
    if not isinstance(law, LawParameters):
        return ""
    angle = start_angle_rad(scenario.reference)
    references, rates = np.full(_CALLS, angle), np.zeros((_CALLS, 3))
    try:
        below, above = (
            _commands(scenario, references + displacement, references, rates)[-1]
            for displacement in (-_DISPLACEMENT_RAD, _DISPLACEMENT_RAD)
        )
    except KneexoError:
        return ""
    if not above < below:  # also for nan
        return ""
    return (
        f"law {law.function.short_name} has the wrong sign: a positive command drives the rod out "
        f"and lowers the knee angle, so the command must rise with rod_reference[0] - "
        f"rod_extension, or with knee_angle - knee_reference[0]"
    )
