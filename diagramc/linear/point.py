"""The equations of a diagram, and their derivatives at a state, inputs, parameters and a time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..arguments import number
from ..diagram_equations import DiagramEquations
from ..errors import LinearizationError
from ..native.runner import element_name
from ..run_data import Array
from .jacobian import Derivatives

EQUILIBRIUM_TOLERANCE = 1e-6
"""Default of the largest rate or change of a state at an equilibrium, as in Drake."""


VARIABLES = ("state", "discrete", "input")
"""Kinds of sources by which the equations are differentiated, in the order of the columns."""


@dataclass(frozen=True)
class Slopes:
    """Values and derivatives of a diagram at a point.

    ``rates`` (n,) has the rates of the continuous states, and then the values of the discrete
    states after their updates. The columns of the Jacobians belong to the n states and then to the
    elements of all open inputs.
    """

    rates: Array
    rates_jacobian: Array
    outputs: Array
    outputs_jacobian: Array


@dataclass(frozen=True)
class Obstacle:
    """What prevents a useful linear model at an operating point: block, reason and remedy."""

    path: str
    """Path of the leaf system."""
    port: str
    """The output port, update or state, such as ``output port y0``."""
    reason: str
    remedy: str

    def __str__(self) -> str:
        """Return the obstacle as one line."""
        return f"{self.path}: {self.port}: {self.reason}; {self.remedy}"


def mean_slopes(slopes: Sequence[Slopes]) -> Slopes:
    """Return the mean of values and derivatives at several points."""
    values = ([getattr(each, field.name) for each in slopes] for field in fields(Slopes))
    return Slopes(*(np.mean(value, axis=0) for value in values))


@dataclass(frozen=True)
class Point:
    """Equations of a diagram, and the time, parameters, state and inputs at which they are read."""

    read: DiagramEquations
    time_s: float
    parameters: Array
    state: Array
    """Continuous and then discrete states (n,)."""
    inputs: Array
    """Values of the elements of all open inputs, in the order of the equations."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the continuous and then the discrete states, such as ``pendulum.theta``.

        The name has no path if the diagram is a single leaf system.
        """
        names = self.read.state_names + self.read.discrete_names
        return tuple(name.removeprefix(".") for name in names)

    def element_names(self, ports: Iterable[str]) -> tuple[str, ...]:
        """Return the names of the elements of ports, which are open inputs or outputs."""
        equations = self.read.equations
        sizes = {name: len(nodes) for name, nodes in equations.outputs.items()} | equations.inputs
        return tuple(element_name(p, i, sizes[p]) for p in ports for i in range(sizes[p]))

    def at(self, state: Array, inputs: Array | None = None) -> Point:
        """Return the point with another state, and with other inputs unless they are None."""
        return replace(self, state=state, inputs=self.inputs if inputs is None else inputs)

    def slopes(self, outputs: Sequence[str] = ()) -> Slopes:
        """Return values and derivatives of the equations at the point.

        The values are dx/dt, the next discrete states, and the elements of the ports ``outputs``.
        The derivatives are with respect to states and inputs.
        """
        derivatives = self.derivatives(outputs)
        of_nodes, rows = derivatives.at(self.sources)
        values, jacobian = of_nodes[derivatives.roots], rows[derivatives.roots]
        size = self.state.size
        return Slopes(values[:size], jacobian[:size], values[size:], jacobian[size:])

    def derivatives(self, outputs: Iterable[str] = ()) -> Derivatives:
        """Return the machine code for rates, updates and the ports ``outputs``.

        All points of a diagram share the code.
        """
        roots = tuple(self.roots(outputs))
        known = self.read.derivatives
        if roots not in known:
            known[roots] = Derivatives(self.read.equations.graph, roots, VARIABLES)
        return known[roots]

    def time_varying(self, outputs: Sequence[str] = ()) -> list[str]:
        """Return the names of rates, updates and outputs whose derivatives depend on the time."""
        varies = self.derivatives(outputs).time_varying
        names = (*self.rate_names, *self.element_names(outputs))
        return [name for name, does in zip(names, varies, strict=True) if does]

    def roots(self, outputs: Iterable[str] = ()) -> list[int]:
        """Return the nodes of derivatives, updates, and elements of the output ports."""
        equations = self.read.equations
        updated = {index: node for update in equations.updates for index, node in update.values}
        roots = [*equations.derivatives, *(updated[i] for i in range(len(updated)))]
        return roots + [node for name in outputs for node in equations.outputs[name]]

    @property
    def sources(self) -> dict[str, Array]:
        """Dictionary from each kind of source of the graph to the values of its elements."""
        count = len(self.read.state_names)
        return {
            "time": np.array([self.time_s]),
            "parameter": self.parameters,
            "state": self.state[:count],
            "discrete": self.state[count:],
            "input": self.inputs,
        }

    def residual(self, rates: Array) -> Array:
        """Return the rates of the continuous states and the changes of the discrete states (n,)."""
        held = self.state.copy()
        held[: len(self.read.state_names)] = 0.0
        return rates - held

    def residual_jacobian(self, slopes: Slopes) -> Array:
        """Return the Jacobian of `residual`, with the columns of ``slopes``."""
        jacobian = slopes.rates_jacobian.copy()
        for index in range(len(self.read.state_names), self.state.size):
            jacobian[index, index] -= 1.0
        return jacobian

    def require_finite(self, slopes: Slopes, outputs: Sequence[str]) -> None:
        """Raise `LinearizationError` for a value or derivative that is not finite."""
        names = (*self.rate_names, *self.element_names(outputs))
        values = np.append(slopes.rates, slopes.outputs)
        jacobian = np.vstack([slopes.rates_jacobian, slopes.outputs_jacobian])
        for what, finite in (
            ("", np.isfinite(values)),
            ("the derivative of ", np.isfinite(jacobian).all(axis=1)),
        ):
            if not finite.all():
                raise LinearizationError(
                    f"{what}{names[int(np.argmin(finite))]} is not finite at this operating point: "
                    f"there is no linear model"
                )

    @property
    def rate_names(self) -> tuple[str, ...]:
        """Names of the elements of `residual`."""
        count = len(self.read.state_names)
        return tuple(
            f"the {'rate' if number < count else 'update'} of {name}"
            for number, name in enumerate(self.state_names)
        )

    def motion(self, slopes: Slopes, tolerance: float) -> str:
        """Return a text that names the state that moves most, or an empty text at an equilibrium.

        A state moves if its element of `residual` exceeds ``tolerance`` and the effect of rounding
        errors. Rounding of the rate rᵢ counts as 1e-13 ∑ⱼ |∂rᵢ/∂zⱼ| |zⱼ| over all states and inputs
        zⱼ.
        """
        if tolerance == math.inf:
            return ""
        residual = self.residual(slopes.rates)
        values = np.concatenate([self.state, self.inputs])
        with np.errstate(invalid="ignore", over="ignore"):
            rounding = 1e-13 * (np.abs(slopes.rates_jacobian) @ np.abs(values))
        moves = ~(np.abs(residual) <= tolerance + rounding)
        if not moves.any():
            return ""
        index = int(np.argmax(np.where(moves, np.nan_to_num(np.abs(residual), nan=np.inf), -1.0)))
        if index < len(self.read.state_names):
            return f"d({self.state_names[index]})/dt = {residual[index]:.6g} per s"
        return f"an update changes {self.state_names[index]} by {residual[index]:.6g}"


def require_tolerance(equilibrium_tolerance: float) -> None:
    """Raise `ParameterError` for a tolerance that is no number, is below zero, or is nan."""
    number("equilibrium_tolerance", equilibrium_tolerance, "", ">= 0", lambda x: x >= 0.0)
