"""Where a sampled loop rests at a constant reference: the point to linearize it at.

Loops of one structure differ in Context parameters and start alone, so one diagram serves them
all: a sweep builds none of its own (Python 3.11 never frees a Python LeafSystem).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from kneexo.analysis.newton import failure, newton
from kneexo.analysis.plant_linearization import MID_RANGE_DEG
from kneexo.diagrams import make_closed_loop
from kneexo.diagrams.closed_loop import loop_values, plant_start
from kneexo.diagrams.controller import known_to_controller
from kneexo.errors import LinearizationError
from kneexo.parameters import Scenario, StepReference
from kneexo.result import Array
from kneexo.simulation.compiled import structure_key


@dataclass(frozen=True)
class Equilibrium:
    """Where a loop rests at a constant reference, and the diagram to differentiate there.

    ``diagram`` (of AutoDiffXd) serves many loops; ``context`` holds the parameters of this one.
    ``point``: ``continuous_states`` states of the plant, then those of the controller.
    """

    diagram: Any
    context: Any
    point: Array
    continuous_states: int
    reference: Array
    sample_time_s: float
    knee_angle_rad: float = math.nan

    def autodiff_context(self, state: Any, reference: Any) -> Any:
        """Context of ``diagram`` at a state and reference that may be seeded."""
        context = self.diagram.CreateDefaultContext()
        context.SetTimeStateAndParametersFrom(self.context)
        _set_point(self.diagram, context, state, reference, self.continuous_states)
        return context

    def rates(self, context: Any) -> Any:
        """dx/dt and z⁺ at a Context of ``diagram``, as AutoDiffXd."""
        updated = self.diagram.EvalUniquePeriodicDiscreteUpdate(context)
        groups = [updated.get_vector(i).CopyToVector() for i in range(updated.num_groups())]
        return np.concatenate([self.diagram.EvalTimeDerivatives(context).CopyToVector(), *groups])

    def gradients(self, point: Array, reference: Array, output: str) -> tuple[Array, ...]:
        """Values and gradients in (x, z, r) of `rates`, and the row of ``output`` in x."""
        seeded = InitializeAutoDiff(np.append(point, reference).reshape(-1, 1)).reshape(-1)
        context = self.autodiff_context(seeded[: point.size], seeded[point.size :])
        port = self.diagram.GetOutputPort(output).Eval(context)
        values = np.append(self.rates(context), port[0]).reshape(-1, 1)
        number, gradient = ExtractValue(values).reshape(-1), ExtractGradient(values)
        return number[:-1], gradient[:-1], gradient[-1:, : self.continuous_states]


_built: dict[str, tuple[Any, Any]] = {}


def _diagrams(scenario: Scenario) -> tuple[Any, Any]:
    """Diagrams in float and AutoDiffXd for all loops of the scenario's structure."""
    key = structure_key(scenario)
    if scenario.controller.kind == "custom":  # its parameters cannot be set by their names
        key += known_to_controller(scenario).model_dump_json()
    if key not in _built:
        diagram = make_closed_loop(scenario, signals=(), external_reference=True)
        _built[key] = diagram, diagram.ToAutoDiffXd()
    return _built[key]


def set_loop_parameters(diagram: Any, context: Any, scenario: Scenario) -> None:
    """Set the Context parameters of a closed loop to those of a scenario of its structure.

    Those of systems that ``diagram`` does not have (reference, quantizers) are passed over, and so
    are those of a custom controller.
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
    for name in path.split("/"):
        if not diagram.HasSubsystemNamed(name):
            return None
        diagram = diagram.GetSubsystemByName(name)
    return diagram if hasattr(diagram, "set_parameter") else None


def start_state(scenario: Scenario, size: int) -> list[Any]:
    """Return the continuous states of the closed loop at its start, (size,), as in its Context.

    Those of the plant come first; those of a custom controller are zero.
    """
    plant = list(plant_start(scenario).values())
    return plant + [0.0] * (size - len(plant))


def _set_point(diagram: Any, context: Any, state: Any, reference: Any, n: int) -> None:
    """Set n continuous states, all discrete ones and the reference."""
    context.SetContinuousState(state[:n])
    for index in range(context.num_discrete_state_groups()):
        size = context.get_discrete_state(index).size()
        context.SetDiscreteState(index, state[n : n + size])
        n += size
    diagram.GetInputPort("knee_reference").FixValue(context, reference)


def find_equilibrium(
    scenario: Scenario, knee_angle_deg: float = MID_RANGE_DEG, diagram: Any = None
) -> Equilibrium:
    """Find where the sampled loop of a scenario rests, by Newton's method.

    Its reference and initial offset are replaced, its quantizers are bypassed. ``diagram``: see
    `kneexo.analysis.linearize_loop`. Raises
    `LinearizationError` when it does not rest there, at the speed limit, outside the boundary
    layer, and when there is no sampled loop that could be linearized.
    """
    controller = scenario.controller
    if controller.kind == "smc" and (controller.continuous or controller.switching == "signum"):
        what = "continuous = true" if controller.continuous else "switching = signum"
        raise LinearizationError(f"controller.{what}: there is no linear sampled-data loop")
    fixed = scenario.without_quantizers().model_copy(
        update={
            "reference": StepReference(start_deg=knee_angle_deg, end_deg=knee_angle_deg),
            "initial_offset_m": 0.0,
        }
    )
    fixed.plant.knee.require_in_range(*fixed.reference.range_deg)
    reference = np.array([math.radians(knee_angle_deg), 0.0, 0.0, 0.0])
    if diagram is None:
        diagram, automatic = _diagrams(fixed)
        context = diagram.CreateDefaultContext()
        set_loop_parameters(diagram, context, fixed)
        context.SetContinuousState(start_state(fixed, context.num_continuous_states()))
    else:
        if not diagram.HasInputPort("knee_reference"):
            raise LinearizationError(
                f"{diagram.get_name()}: has no input port knee_reference; leave the reference open"
            )
        automatic, context = diagram.ToAutoDiffXd(), diagram.CreateDefaultContext()
    period_s = _sample_time_s(diagram)
    x = context.get_continuous_state_vector().CopyToVector()
    diagram.GetInputPort("knee_reference").FixValue(context, reference)
    Simulator(diagram, context).Initialize()  # starts the controller's states as a run does
    groups = range(context.num_discrete_state_groups())
    z = np.concatenate([context.get_discrete_state(i).CopyToVector() for i in groups])
    n, m = x.size, z.size
    point = np.concatenate([x, z])
    equilibrium = Equilibrium(automatic, context, point, n, reference, period_s)

    def changes(point: Array) -> tuple[Array, Array]:
        """Return dx/dt and z⁺ − z, and their Jacobian in (x, z)."""
        values, gradient, _ = equilibrium.gradients(point, reference, "knee_angle")
        jacobian = gradient[:, : n + m].copy()
        jacobian[n:, n:] -= np.eye(m)
        return np.concatenate([values[:n], values[n:] - point[n:]]), jacobian

    point, residual = newton(changes, point, rank_tolerance=1e-14, relative=True)
    if not residual < 1e-6:
        raise LinearizationError(
            f"the loop does not rest at knee angle {knee_angle_deg:g} deg: "
            f"{failure(residual, 'residual')}; reduce the load"
        )
    _set_point(diagram, context, point, reference, n)
    _require_linear(diagram, context, fixed)
    angle = float(diagram.GetOutputPort("knee_angle").Eval(context)[0])
    return replace(equilibrium, point=point, knee_angle_rad=angle)


def _sample_time_s(diagram: Any) -> float:
    """Period of the discrete updates; `LinearizationError` when there is no single one."""
    timing = diagram.GetUniquePeriodicDiscreteUpdateAttribute()
    if timing is None:
        raise LinearizationError(
            f"{diagram.get_name()}: has no single sample time: there is no linear sampled-data loop"
        )
    return float(timing.period_sec())


def _require_linear(diagram: Any, context: Any, scenario: Scenario) -> None:
    """Refuse a rest at the speed limit or outside the boundary layer."""
    command = abs(float(diagram.GetOutputPort("motor_speed_command").Eval(context)[0]))
    limit = scenario.command_limit_rad_s
    if command >= limit * (1.0 - 1e-9):
        raise LinearizationError(
            f"motor_speed_command = {command:.4g} rad/s is at its limit of {limit:.4g} rad/s: "
            f"there is no linear loop; reduce the load"
        )
    if scenario.controller.kind == "smc" and diagram.HasOutputPort("sliding_variable"):
        s = abs(float(diagram.GetOutputPort("sliding_variable").Eval(context)[0]))
        if s >= scenario.controller.phi_m_s2:
            raise LinearizationError(
                f"|s| = {s:.4g} m/s² lies outside the boundary layer phi_m_s2 = "
                f"{scenario.controller.phi_m_s2:g} m/s²: there is no linear loop; increase Φ"
            )


def command_and_live(gradient: Array, n: int) -> tuple[int, Array, Any]:
    """How the command follows from the controller's states, and which of these ever change.

    ``gradient`` of dx/dt (the first n rows) and z⁺ in x, z (m) and perhaps more. The plant sees z
    through the command k z alone, a state that is held or a sum of such. Returns the index of the
    state with the most influence, k (m,) relative to it, and the mask of live states.
    """
    m = gradient.shape[0] - n
    influence = gradient[:n, n : n + m]
    held = int(np.argmax(np.max(np.abs(influence), axis=0)))
    row = int(np.argmax(np.abs(influence[:, held])))
    identity = np.eye(m, gradient.shape[1], k=n)
    # Not merely identical: rounding leaves 1e-16 in the integral of a PID that has no K_i.
    live = np.any(np.abs(gradient[n:] - identity) > 1e-12, axis=1)
    return held, influence[row] / influence[row, held], live
