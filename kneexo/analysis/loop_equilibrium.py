"""Equilibria of sampled loops at a constant reference, where a loop can be linearized.

Loops of the same structure differ only in Context parameters and initial state. These loops share
one diagram, because Python 3.11 never frees a LeafSystem. So a sweep does not fill the memory with
a diagram for each scenario.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from kneexo.analysis.plant_linearization import MID_RANGE_DEG
from kneexo.compiler import newton, newton_failure, truth_of_scalars
from kneexo.diagrams import make_closed_loop
from kneexo.diagrams.closed_loop import loop_values, plant_start
from kneexo.diagrams.controller import has_unknown_parts
from kneexo.diagrams.law import known_to_controller, remembered, runs_as_python, users_law
from kneexo.diagrams.wearer import moment_of
from kneexo.errors import LinearizationError, shortened
from kneexo.parameters import LawParameters, PlantParameters, Scenario, StepReference
from kneexo.result import Array
from kneexo.simulation.compiled import Recent, structure_key
from kneexo.systems.function_law import hides_state

_NO_LIMIT = 1e12
"""A speed or an acceleration that no motor reaches, in rad/s or rad/s²."""


@dataclass(frozen=True)
class Equilibrium:
    """Equilibrium of a sampled loop at a constant reference, with a diagram for derivatives.

    ``diagram`` has the scalar type AutoDiffXd, and ``float_diagram`` is the same diagram of floats.
    Loops that differ only in numbers share them. ``context`` belongs to ``float_diagram`` and holds
    the parameters and the state of this loop. ``point`` contains the states x of the plant and
    then the discrete states z of the controller, in the units of the Context. The number of states
    x is ``continuous_states``. ``reference`` (4,) is θ_d in rad and its three derivatives.
    """

    diagram: Any
    float_diagram: Any
    context: Any
    point: Array
    continuous_states: int
    reference: Array
    sample_time_s: float
    knee_angle_rad: float = math.nan

    def autodiff_context(self, state: Any, reference: Any) -> Any:
        """Return a new Context of ``diagram`` at a state (x, z) and reference r (4,)."""
        context = self.diagram.CreateDefaultContext()
        context.SetTimeStateAndParametersFrom(self.context)
        _set_point(self.diagram, context, state, reference, self.continuous_states)
        return context

    def rates(self, context: Any) -> Any:
        """Return an array of dx/dt and the updated discrete state z⁺, evaluated at ``context``."""
        with truth_of_scalars():
            updated = self.diagram.EvalUniquePeriodicDiscreteUpdate(context)
            rates = self.diagram.EvalTimeDerivatives(context).CopyToVector()
        groups = [updated.get_vector(i).CopyToVector() for i in range(updated.num_groups())]
        return np.concatenate([rates, *groups])

    def gradients(self, point: Array, reference: Array, output: str) -> tuple[Array, ...]:
        """Return `rates` at a point, their gradients in (x, z, r), and the gradient of a port in x.

        ``point`` is (x, z) with n states x and m states z, and ``reference`` is r (4,). The output
        port ``output`` has one element. The three results have the shapes (n + m,),
        (n + m, n + m + 4) and (1, n).
        """
        seeded = InitializeAutoDiff(np.append(point, reference).reshape(-1, 1)).reshape(-1)
        context = self.autodiff_context(seeded[: point.size], seeded[point.size :])
        port = self.diagram.GetOutputPort(output).Eval(context)
        values = np.append(self.rates(context), port[0]).reshape(-1, 1)
        number, gradient = ExtractValue(values).reshape(-1), ExtractGradient(values)
        return number[:-1], gradient[:-1], gradient[-1:, : self.continuous_states]


_PASSIVE_STARTS = (0.05, 0.3, 0.6, 0.95)
"""Shares of the range of motion at which the search for the rest of a passive leg starts again.

A passive leg rests far from the reference. A first step of Newton's method may leave the range of
motion, where the search gets stuck.
"""

_built = Recent()


def _diagrams(scenario: Scenario) -> tuple[Any, Any]:
    """Return the closed loop as a diagram of floats and as a diagram of AutoDiffXd.

    Scenarios that differ only in numbers share these two diagrams, unless the biological moment
    differs.
    """
    key = structure_key(scenario)
    if (moment := moment_of(scenario)) is not None:  # a source, which has no Context parameters
        key += moment.model_dump_json()

    def built() -> tuple[Any, Any]:
        diagram = make_closed_loop(scenario, signals=(), external_reference=True)
        return diagram, _autodiff(diagram)

    if has_unknown_parts(scenario):  # whose Context parameters cannot be set by name
        key += known_to_controller(scenario).model_dump_json()
        return remembered(users_law(scenario), key, built)
    law = scenario.controller
    if isinstance(law, LawParameters) and runs_as_python(scenario):  # such laws share a structure
        return remembered(law.function, key, built)
    return _built.of(key, built)


def _autodiff(diagram: Any) -> Any:
    """Return a diagram as AutoDiffXd. Raise `LinearizationError` if a system does not convert."""
    try:
        return diagram.ToAutoDiffXd()
    except RuntimeError as error:
        raise LinearizationError(
            f"{diagram.get_name()}: does not convert to AutoDiffXd "
            f"({shortened(str(error), 120)}); write the law as a function, "
            f"track(scenario, law=law), or as Drake's TemplateSystem"
        ) from None


def set_loop_parameters(diagram: Any, context: Any, scenario: Scenario) -> None:
    """Set the Context parameters of a closed loop to the values of a scenario.

    The scenario of ``diagram`` differs only in numbers. Parameters of systems that are not in
    ``diagram``, such as reference and quantizers, are ignored. The parameters of a Drake
    system of the user are not changed.
    """
    for path, values in loop_values(scenario):
        system = _system(diagram, path)
        if system is None:
            continue
        subcontext = system.GetMyMutableContextFromRoot(context)
        for name, value in values.items():
            if group := re.fullmatch(r"(\d+)\[(\d+)\]", name):
                vector = subcontext.get_mutable_numeric_parameter(int(group[1]))
                vector.SetAtIndex(int(group[2]), value)
            else:
                system.set_parameter(subcontext, name, value)


def _system(diagram: Any, path: str) -> Any:
    """Return the system at a path in ``diagram``.

    The result is None if there is no system at the path or if it has no named parameters.
    """
    for name in path.split("/"):
        if not diagram.HasSubsystemNamed(name):
            return None
        diagram = diagram.GetSubsystemByName(name)
    return diagram if hasattr(diagram, "set_parameter") else None


def start_state(scenario: Scenario, size: int) -> list[Any]:
    """Return the initial continuous states of the closed loop, (size,), in Context units.

    The states of the plant come first. The states of a Drake system of the user are zero.
    """
    plant = list(plant_start(scenario).values())
    return plant + [0.0] * (size - len(plant))


def _set_point(diagram: Any, context: Any, state: Any, reference: Any, n: int) -> None:
    """Set reference and state of ``context``.

    ``state`` contains n continuous states and then the discrete states.
    """
    context.SetContinuousState(state[:n])
    for index in range(context.num_discrete_state_groups()):
        size = context.get_discrete_state(index).size()
        context.SetDiscreteState(index, state[n : n + size])
        n += size
    diagram.GetInputPort("knee_reference").FixValue(context, reference)


def find_equilibrium(scenario: Scenario, *, knee_angle_deg: float = MID_RANGE_DEG) -> Equilibrium:
    """Find the equilibrium of the sampled loop of a scenario by Newton's method.

    The reference is the constant ``knee_angle_deg``, the initial offset is zero, and the
    quantizers are bypassed. The biological moment is that at t = 0. The search ignores the limits
    of the motor.

    Raises `LinearizationError` when there is no equilibrium, when the command there is at its
    limit, and when the sliding variable there is outside the boundary layer. Also raises it when
    the controller is continuous or switches by signum.
    """
    controller = scenario.controller
    if controller.kind == "smc" and (controller.continuous or controller.switching == "signum"):
        what = "continuous = true" if controller.continuous else "switching = signum"
        raise LinearizationError(f"controller.{what}: there is no linear sampled-data loop")
    if isinstance(controller, LawParameters) and not controller.function.is_system:
        law = controller.function
        if hides_state(law, len(controller.initial_state)):
            raise LinearizationError(
                f"law {law.short_name}: the object hides state, which no linear loop would have; "
                f"write the law as a function with the argument state"
            )
    scenario.plant.knee.require_posture(knee_angle_deg)
    fixed = scenario.without_quantizers().model_copy(
        update={
            "reference": StepReference(start_deg=knee_angle_deg, end_deg=knee_angle_deg),
            "initial_offset_m": 0.0,
        }
    )
    reference = np.array([math.radians(knee_angle_deg), 0.0, 0.0, 0.0])
    diagram, automatic = _diagrams(fixed)
    context = diagram.CreateDefaultContext()
    set_loop_parameters(diagram, context, _without_motor_limits(fixed))
    context.SetContinuousState(start_state(fixed, context.num_continuous_states()))
    period_s = _sample_time_s(diagram)
    x = context.get_continuous_state_vector().CopyToVector()
    diagram.GetInputPort("knee_reference").FixValue(context, reference)
    Simulator(diagram, context).Initialize()  # initializes the controller as in a run
    groups = range(context.num_discrete_state_groups())
    z = np.concatenate([context.get_discrete_state(i).CopyToVector() for i in groups])
    n, m = x.size, z.size
    point = np.concatenate([x, z])
    equilibrium = Equilibrium(automatic, diagram, context, point, n, reference, period_s)

    def changes(point: Array) -> tuple[Array, Array]:
        """Return dx/dt and z⁺ − z, and their Jacobian in (x, z)."""
        values, gradient, _ = equilibrium.gradients(point, reference, "knee_angle")
        jacobian = gradient[:, : n + m].copy()
        jacobian[n:, n:] -= np.eye(m)
        return np.concatenate([values[:n], values[n:] - point[n:]]), jacobian

    starts = [point]
    if getattr(fixed.wearer, "motion", "") == "passive":  # rests where its weight is
        knee = fixed.plant.knee
        for share in _PASSIVE_STARTS:
            angle = knee.flexion_min_deg + share * (knee.flexion_max_deg - knee.flexion_min_deg)
            posture = StepReference(start_deg=angle, end_deg=angle)
            at_rest = start_state(fixed.model_copy(update={"reference": posture}), n)
            starts.append(np.concatenate([at_rest, z]))
    for start in starts:
        point, residual = newton(changes, start, rank_tolerance=1e-14, relative=True)
        if residual < 1e-6:
            break
    else:
        remedy = "reduce the load"
        if isinstance(controller, LawParameters):
            remedy += ", or let the law act on the error without rounding"
        raise LinearizationError(
            f"the loop does not rest at knee angle {knee_angle_deg:g} deg: "
            f"{newton_failure(residual, 'residual')}; {remedy}"
        )
    set_loop_parameters(diagram, context, fixed)
    _set_point(diagram, context, point, reference, n)
    _require_linear(diagram, context, fixed)
    angle = float(diagram.GetOutputPort("knee_angle").Eval(context)[0])
    return replace(equilibrium, point=point, knee_angle_rad=angle)


def _without_motor_limits(scenario: Scenario) -> Scenario:
    """Return a scenario whose command and motor have no limits.

    While a command is clipped, it does not depend on the state, and Newton's method gets stuck.
    """

    def unlimited(plant: PlantParameters | None) -> PlantParameters | None:
        limits = {"speed_limit_rad_s": _NO_LIMIT, "acceleration_limit_rad_s2": _NO_LIMIT}
        return plant and plant.model_copy(update={"pump": plant.pump.model_copy(update=limits)})

    controller = scenario.controller.model_copy(update={"command_limit_rad_s": _NO_LIMIT})
    plants = {"plant": unlimited(scenario.plant), "nominal": unlimited(scenario.nominal)}
    return scenario.model_copy(update={**plants, "controller": controller})


def _sample_time_s(diagram: Any) -> float:
    """Return the sample time in s. Raise `LinearizationError` if there are none or several."""
    timing = diagram.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is None:
        raise LinearizationError(
            f"{diagram.get_name()}: has no single sample time: there is no linear sampled-data loop"
        )
    return float(timing.period_sec())


def _require_linear(diagram: Any, context: Any, scenario: Scenario) -> None:
    """Raise `LinearizationError` if there is no linear loop at the state of ``context``.

    The command is then at its limit, or the sliding variable is outside the boundary layer.
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


def command_and_live(gradient: Array, n: int) -> tuple[int, Array, Any]:
    """Return how the command depends on the states z of the controller, and which states change.

    ``gradient`` holds the gradients of dx/dt (the first n rows) and of the updated states z⁺ (m
    rows). Its columns belong to x (n columns), z (m columns) and further variables, if any. The
    controller acts on the plant only by its command k z. The three results are the index of the
    element of z with the largest influence on dx/dt, the row k (m,), scaled to 1 at this index,
    and a mask (m,) of the states that an update can change.
    """
    m = gradient.shape[0] - n
    influence = gradient[:n, n : n + m]
    command = int(np.argmax(np.max(np.abs(influence), axis=0)))
    row = int(np.argmax(np.abs(influence[:, command])))
    identity = np.eye(m, gradient.shape[1], k=n)
    # A state that keeps its value, or a constant one such as the integral of a PID without K_i, is
    # not live. The tolerance covers rounding of 1e-16.
    still = (gradient[n:] - identity, gradient[n:])
    live = np.all([np.any(np.abs(change) > 1e-12, axis=1) for change in still], axis=0)
    live[command] = True  # also of a law whose command is constant
    return command, influence[row] / influence[row, command], live
