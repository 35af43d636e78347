"""Equilibria of sampled loops at a constant reference, where a loop can be linearized."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator

import diagramc
from diagramc import DiagramEquations, read_for_linearization
from kneexo.analysis.linear.plant_linearization import MID_RANGE_DEG
from kneexo.analysis.linear.shared_equations import context_with, recent_equations, set_parameters
from kneexo.common.result import Array
from kneexo.diagrams import make_closed_loop
from kneexo.diagrams.closed_loop import loop_values, plant_start
from kneexo.diagrams.wearer import moment_of, moment_spline
from kneexo.errors import LinearizationError, NoEquilibriumError
from kneexo.law.decision import law_inputs, makers_called_once, why_python
from kneexo.law.leaves import HeldCommand
from kneexo.law.tangent import LawTangent
from kneexo.law.trace import HIDES_STATE
from kneexo.parameters import (
    LawParameters,
    LegParameters,
    PlantParameters,
    Scenario,
    StepReference,
)
from kneexo.parameters.device.parts import PartsParameters
from kneexo.parameters.fields.replaced import believed
from kneexo.parameters.scenario import require_scenario
from kneexo.simulation.compiled import structure_key, why_not_compiled

_NO_LIMIT = 1e12
"""A speed or an acceleration that no motor reaches, in rad/s or rad/s²."""

_TANGENTS = 20
"""Most linear forms of a law that runs as Python, until the loop rests where the last one holds."""


@dataclass(frozen=True)
class Equilibrium:
    """Equilibrium of a sampled loop at a constant reference.

    ``equations`` are the equations of the closed loop with two open inputs, ``reference`` and
    ``command``. Loops that differ only in numbers share the equations. ``context`` is a Context of
    the diagram of the equations, with the parameters, the reference and the state of this loop.
    ``reference`` names the port by which the reference reaches the controller alone. ``command``
    names the port of the motor speed command that the plant reads.
    """

    equations: DiagramEquations
    context: Any
    reference: str
    command: str
    knee_angle_rad: float

    def beside(self, state_step: float, reference_step: Array) -> Any:
        """Return a Context near the equilibrium.

        Each state x is changed by ``state_step`` (1 + |x|), and the reference by
        ``reference_step``.
        """
        context, diagram = self.context.Clone(), self.equations.diagram
        x = context.get_continuous_state_vector().CopyToVector()
        context.SetContinuousState(x + state_step * (1.0 + np.abs(x)))
        for index in range(context.num_discrete_state_groups()):
            z = context.get_discrete_state(index).CopyToVector()
            context.SetDiscreteState(index, z + state_step * (1.0 + np.abs(z)))
        reference = diagram.GetInputPort("knee_reference")
        reference.FixValue(context, reference.Eval(context) + reference_step)
        return context


_PASSIVE_STARTS = (0.05, 0.3, 0.6, 0.95)
"""Shares of the range of motion at which the search for the rest of a passive leg starts again.

A passive leg rests far from the reference. A first step of Newton's method may leave the range of
motion, where the search gets stuck.
"""


def _shared_equations(scenario: Scenario, law: LawTangent | None) -> DiagramEquations:
    """Return the equations of the closed loop of a scenario, with an open input for the reference.

    Reading equations takes long, so scenarios that differ only in numbers share the equations.
    ``law`` replaces a law that runs as Python, or is None.
    """
    key = structure_key(scenario)

    def read() -> DiagramEquations:
        diagram = make_closed_loop(
            scenario,
            signals=(),
            external_reference=True,
            external_moment=True,
            law=None if law is None else law.linear_law(),
        )
        command = _command_port(diagram)
        inputs = [_reference_port(diagram), command, "knee_reference"]
        if diagram.HasInputPort("biological_moment"):
            inputs.append("biological_moment")
        return read_for_linearization(diagram, inputs=dict.fromkeys(inputs), outputs=[command])

    # Parts without equations can differ in more than Context parameters, so their loops share
    # nothing.
    if why_not_compiled(scenario):
        return read()
    if law is not None:  # loops with such laws are alike, except for the laws' numbers of states
        return recent_equations.of(f"{key} {law.sizes}", read)
    return recent_equations.of(key, read)


def _reference_port(diagram: Any) -> str:
    """Return the name of the port by which the reference reaches the controller.

    A wearer's leg that follows the reference does not read this port. If the controller has no such
    port, the result is the port of the whole loop.
    """
    if diagram.GetSubsystemByName("controller").HasInputPort("knee_reference"):
        return "controller:knee_reference"
    return "knee_reference"


def _command_port(diagram: Any) -> str:
    """Return the name of the port inside a closed loop whose signal is the motor speed command.

    The closed loop only exports this signal. A loop can be broken at the port inside.
    """
    port = diagram.GetOutputPort("motor_speed_command")
    system, index = diagram.get_output_port_locator(port.get_index())
    return f"{system.get_name()}:{system.get_output_port(index).get_name()}"


@makers_called_once()
def find_equilibrium(scenario: Scenario, *, knee_angle_deg: float = MID_RANGE_DEG) -> Equilibrium:
    """Find the equilibrium of the sampled loop of a scenario by Newton's method.

    The reference is the constant ``knee_angle_deg``, the initial offset is zero, and the quantizers
    are bypassed. The biological moment has its value at t = 0. The search ignores the limits of the
    motor.

    Raises `LinearizationError` when there is no equilibrium, or when at the equilibrium the command
    is at its limit or the sliding variable is outside the boundary layer. The error is also raised
    when the controller is continuous or switches by signum.
    """
    require_scenario(scenario)
    controller = scenario.controller
    if controller.kind == "smc" and (controller.continuous or controller.switching == "signum"):
        what = "continuous = true" if controller.continuous else "switching = signum"
        raise LinearizationError(f"controller.{what}: there is no linear sampled-data loop")
    scenario.plant.knee.require_posture(knee_angle_deg)
    fixed = scenario.without_quantizers().model_copy(
        update={
            "reference": StepReference(start_deg=knee_angle_deg, end_deg=knee_angle_deg),
            "initial_offset_m": 0.0,
        }
    )
    reason = why_python(fixed)
    if isinstance(controller, LawParameters) and reason == HIDES_STATE:
        raise LinearizationError(
            f"law {controller.function.short_name}: the object hides state, which no linear loop "
            f"would have; write the law as a function with the argument state"
        )
    unlimited = _without_motor_limits(fixed)
    law = LawTangent(unlimited) if reason else None
    equations = _shared_equations(fixed, law)
    loop = equations.diagram
    _require_one_sample_time(loop)
    replaced = None if law is None else law.linear_law()
    own, stand_in = dict(loop_values(fixed, replaced)), replaced
    users = {f"plant/{place}" for place in fixed.parts.chosen()} | {"controller/estimator"}
    if isinstance(controller, LawParameters) and controller.function.is_system:
        stand_in = HeldCommand(controller.sample_time_s, law_inputs(fixed))
        users.add("controller/law")
    # A system of the user may compute its numbers from the limits, so it keeps them.
    without = {"parts": PartsParameters(), "plant": believed(unlimited.plant)}
    values = dict(loop_values(unlimited.model_copy(update=without), stand_in))
    values = own | {path: named for path, named in values.items() if path not in users}
    context = context_with(equations, values.items(), [*plant_start(fixed).values()])
    reference = [math.radians(knee_angle_deg), 0.0, 0.0, 0.0]
    loop.GetInputPort("knee_reference").FixValue(context, reference)
    if (moment := moment_of(fixed)) is not None:
        at_start = moment_spline(moment).value(0.0).reshape(-1)
        loop.GetInputPort("biological_moment").FixValue(context, at_start)
    Simulator(loop, context).Initialize()  # initializes the controller as in a run
    if law is not None:
        law.start_in(loop, context)
    postures_deg = [knee_angle_deg]
    if isinstance(fixed.wearer, LegParameters) and fixed.wearer.motion == "passive":
        least, most = fixed.plant.knee.flexion_min_deg, fixed.plant.knee.flexion_max_deg
        postures_deg += [least + share * (most - least) for share in _PASSIVE_STARTS]
    for posture_deg in postures_deg:
        posture = {"reference": StepReference(start_deg=posture_deg, end_deg=posture_deg)}
        at_rest = [*plant_start(fixed.model_copy(update=posture)).values()]
        state = context.get_continuous_state_vector().CopyToVector()
        state[: len(at_rest)] = at_rest
        context.SetContinuousState(state)
        try:
            context = _rest(equations, context, law)
            break
        except NoEquilibriumError as error:
            fault = error.fault
    else:
        remedy = "reduce the load"
        if isinstance(controller, LawParameters):
            remedy += ", or let the law act on the error without rounding"
        raise LinearizationError(
            f"the loop does not rest at knee angle {knee_angle_deg:g} deg: where the search ends, "
            f"{fault}; {remedy}"
        )
    set_parameters(equations, context, own.items())
    _require_linear(loop, context, fixed)
    angle = float(loop.GetOutputPort("knee_angle").Eval(context)[0])
    ports = _reference_port(loop), _command_port(loop)
    return Equilibrium(equations, context, *ports, angle)


def _rest(equations: DiagramEquations, start: Any, law: LawTangent | None) -> Any:
    """Return a Context in which a loop rests. Raise `NoEquilibriumError` if there is none.

    The linear form ``law`` replaces a law that runs as Python. The linear form is computed anew at
    each state at which the loop rests with it, until the state no longer changes.
    """
    if law is None:
        return diagramc.find_equilibrium(equations, start)
    for _ in range(_TANGENTS):
        law.set(equations.diagram, start)
        rest = diagramc.find_equilibrium(equations, start)
        before, after = (equations.state(context) for context in (start, rest))
        if np.allclose(before.continuous, after.continuous, rtol=1e-9, atol=1e-9) and np.allclose(
            before.discrete, after.discrete, rtol=1e-9, atol=1e-9
        ):
            return rest
        start = rest
    raise NoEquilibriumError("no equilibrium", "the law still moves the loop")


def _without_motor_limits(scenario: Scenario) -> Scenario:
    """Return a scenario without limits of command, motor speed and motor acceleration.

    A clipped command does not depend on the state of the loop, so Newton's method would get stuck.
    """

    def unlimited(plant: PlantParameters | None) -> PlantParameters | None:
        limits = {"speed_limit_rad_s": _NO_LIMIT, "acceleration_limit_rad_s2": _NO_LIMIT}
        return plant and plant.model_copy(update={"pump": plant.pump.model_copy(update=limits)})

    controller = scenario.controller.model_copy(update={"command_limit_rad_s": _NO_LIMIT})
    plants = {"plant": unlimited(scenario.plant), "nominal": unlimited(scenario.nominal)}
    return scenario.model_copy(update={**plants, "controller": controller})


def _require_one_sample_time(diagram: Any) -> None:
    """Raise `LinearizationError` if a diagram has no sample time, or several."""
    if diagram.GetUniquePeriodicDiscreteUpdateAttribute() is None:
        raise LinearizationError(
            f"{diagram.get_name()}: has no single sample time: there is no linear sampled-data loop"
        )


def _require_linear(diagram: Any, context: Any, scenario: Scenario) -> None:
    """Raise `LinearizationError` if there is no linear loop at the state of ``context``.

    There is no linear loop if the command is at its limit, or if the sliding variable is outside
    the boundary layer.
    """
    command = abs(float(diagram.GetOutputPort("motor_speed_command").Eval(context)[0]))
    limit = scenario.command_limit_rad_s
    if command >= limit * (1.0 - 1e-9):
        raise LinearizationError(
            f"motor_speed_command = {command:.4g} rad/s is at or above its limit of "
            f"{limit:.4g} rad/s: there is no linear loop; reduce the load"
        )
    if scenario.controller.kind == "smc" and diagram.HasOutputPort("sliding_variable"):
        s = abs(float(diagram.GetOutputPort("sliding_variable").Eval(context)[0]))
        if s >= scenario.controller.phi_m_s2:
            raise LinearizationError(
                f"|s| = {s:.4g} m/s² lies outside the boundary layer phi_m_s2 = "
                f"{scenario.controller.phi_m_s2:g} m/s²: there is no linear loop; increase Φ"
            )
