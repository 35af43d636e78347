"""Operating points of the plant and its linearization, in continuous time."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Diagram

from diagramc import DiagramEquations, Transfer, find_equilibrium, linearize, read_for_linearization
from kneexo.analysis.linear.shared_equations import context_with, recent_equations
from kneexo.analysis.signals import to_rpm
from kneexo.common.ports import input_ports
from kneexo.common.result import Array, Result
from kneexo.diagrams import SIGNALS, make_plant
from kneexo.diagrams.plant import plant_parts
from kneexo.errors import LinearizationError, NoEquilibriumError
from kneexo.parameters import PlantParameters, Scenario
from kneexo.parameters.fields.quantity import require_object
from kneexo.simulation.compiled import structure

Complex = NDArray[np.complex128]
"""Type of an array of complex numbers."""

MID_RANGE_DEG = 40.0
"""Default knee angle in deg, the middle of the paper's range 10…70°."""

_COMMAND = "motor_speed_command"


@dataclass(frozen=True, repr=False)
class OperatingPoint(Result):
    """Equilibrium of the plant under a load.

    ``state`` (n,) is in the units of the plant's Context. The motor runs at ``motor_speed_rad_s``
    to compensate the leakage under the load.
    """

    knee_angle_rad: float
    motor_speed_rad_s: float
    load_pressure_pa: float
    rod_force_n: float
    state: Array

    def __str__(self) -> str:
        """Return knee angle, motor speed, load pressure and rod force as one line of text."""
        return (
            f"knee at {math.degrees(self.knee_angle_rad):.4g} deg: motor "
            f"{_rounded(to_rpm(self.motor_speed_rad_s)):.4g} rpm, load pressure "
            f"{_rounded(1e-6 * self.load_pressure_pa):.4g} MPa, "
            f"rod force {_rounded(self.rod_force_n):.4g} N"
        )


def plant_at(scenario: Scenario, knee_angle_deg: float) -> PlantParameters | Diagram:
    """Return the plant of a scenario for `linearize_plant`: a diagram, if it has parts of the user.

    The diagram starts at a knee angle in deg. Raises the errors of `make_plant`.
    """
    if not scenario.parts.chosen():
        return scenario.plant
    angle_rad, parts = math.radians(knee_angle_deg), scenario.parts
    plant = scenario.plant.without_temperatures()
    return make_plant(plant, initial_knee_angle_rad=angle_rad, parts=parts, scenario=scenario)


def _rounded(value: float) -> float:
    """Return ``value``, or zero if its magnitude is below 1e-9 and so a rounding error."""
    return value if abs(value) > 1e-9 else 0.0


def find_operating_point(
    plant: PlantParameters | Diagram = PlantParameters(),
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
    knee_torque_n_m: float = 0.0,
    disturbance_n: float = 0.0,
) -> OperatingPoint:
    """Find the state and motor speed that hold a knee angle under load, by Newton's method.

    Parameters
    ----------
    plant
        The numbers of a plant, or a diagram with the ports of `make_plant`.
    knee_angle_deg
        The knee angle in deg.
    knee_torque_n_m
        External torque on the knee in N·m, for a plant with a load.
    disturbance_n
        Disturbance force on the rod in N.

    Raises
    ------
    LinearizationError
        There is no equilibrium, for example because the motor would exceed its speed limit.
    ParameterError, LinkageError
        The knee angle is impossible.
    """
    equations, rest = _at_rest(plant, (), knee_angle_deg, knee_torque_n_m, disturbance_n)
    return _operating_point(equations.diagram, rest)


def _at_rest(
    plant: PlantParameters | Diagram,
    outputs: tuple[str, ...],
    knee_angle_deg: float,
    knee_torque_n_m: float,
    disturbance_n: float,
) -> tuple[DiagramEquations, Any]:
    """Return the equations of the plant with the ports ``outputs``, and a Context at rest."""
    if isinstance(plant, PlantParameters):
        # A cold motor: temperatures would be slow poles, beside which the integrator of the rod is
        # not seen.
        plant = plant.without_temperatures()
        plant.knee.require_posture(knee_angle_deg)
        angle_rad = math.radians(knee_angle_deg)
        equations = recent_equations.of(
            ("plant", structure(plant), outputs),
            lambda: _read(make_plant(plant, initial_knee_angle_rad=angle_rad), outputs),
        )
        diagram, parts = equations.diagram, plant_parts(plant, angle_rad)
        values = ((part.name, part.values()) for part in parts)
        start = [value for part in parts for value in part.start_state()]
        context = context_with(equations, values, start)
    else:
        if not isinstance(plant, Diagram):
            require_object("plant", plant, PlantParameters, 'Scenario.preset("leg").plant')
        equations, diagram, context = _read(plant, outputs), plant, plant.CreateDefaultContext()
    if knee_torque_n_m and not diagram.HasInputPort("knee_torque"):
        raise LinearizationError(
            f"knee_torque = {knee_torque_n_m:g} N·m: the plant has no load to apply it to; give it "
            f"one (plant.load.kind = knee)"
        )
    for name, value in (("knee_torque", knee_torque_n_m), ("disturbance_force", disturbance_n)):
        if diagram.HasInputPort(name):
            diagram.GetInputPort(name).FixValue(context, [value])
    try:
        rest = find_equilibrium(
            equations,
            context,
            free_inputs=[_COMMAND],
            outputs={"knee_angle": math.radians(knee_angle_deg)},
        )
    except NoEquilibriumError as error:
        raise LinearizationError(
            f"no equilibrium at knee angle {knee_angle_deg:g} deg with knee_torque = "
            f"{knee_torque_n_m:g} N·m and disturbance = {disturbance_n:g} N: where the search "
            f"ends, {error.fault}; reduce the load or the leakage"
        ) from None
    return equations, rest


def _operating_point(diagram: Any, context: Any) -> OperatingPoint:
    """Return the operating point of the plant at a Context in which it rests."""

    def output(name: str) -> float:
        return float(diagram.GetOutputPort(name).Eval(context)[0])

    return OperatingPoint(
        knee_angle_rad=output("knee_angle"),
        motor_speed_rad_s=output("motor_speed"),
        load_pressure_pa=output("load_pressure"),
        rod_force_n=output("rod_force"),
        state=context.get_continuous_state_vector().CopyToVector(),
    )


def _read(diagram: Any, outputs: Sequence[str]) -> DiagramEquations:
    """Return the equations of a plant with open inputs, first the motor speed command."""
    inputs = [*input_ports(diagram)]
    return read_for_linearization(
        diagram, inputs=dict.fromkeys([_COMMAND, *inputs]), outputs=outputs
    )


@dataclass(frozen=True, repr=False)
class PlantLinearization(Result):
    """Linear plant around an operating point: dx/dt = A x + B u, y = C x + D u.

    u is the motor speed command in rad/s, so that B and D have one column. y contains the elements
    of the ports ``outputs``.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    outputs: tuple[str, ...]
    operating_point: OperatingPoint
    states: tuple[str, ...] = ()
    """Names of the states x, each with subsystem and index, such as ``motor.x[0]``."""

    @property
    def poles(self) -> Complex:
        """Eigenvalues of A in 1/s, by magnitude.

        In a conjugate pair, the eigenvalue with positive imaginary part comes first.
        """
        values = np.linalg.eigvals(self.a).astype(complex)
        # A pair has equal magnitudes, so a stable sort keeps LAPACK's order of it. With another
        # sort this order depended on the processor.
        return values[np.argsort(np.abs(values), kind="stable")]

    @property
    def zeros(self) -> Complex:
        """Transmission zeros from the command to the first output, in 1/s."""
        import control

        return np.asarray(control.zeros(self.to_control()[0, 0]), dtype=complex)

    @property
    def damping(self) -> tuple[Array, Array]:
        """Natural frequencies in rad/s and damping ratios of `poles`; a pole at 0 has ratio 1."""
        poles = self.poles
        frequency = np.abs(poles)
        ratio = np.ones_like(frequency)
        moving = frequency > 1e-9
        ratio[moving] = -poles.real[moving] / frequency[moving]
        return frequency, ratio

    @property
    def velocity_gain(self) -> float:
        """Steady rate of the first output per motor speed command: lim s·G(s) for s → 0.

        The gain is the residue of the integrating pole. Leakage under a load shifts this pole away
        from zero. The slowest pole counts as integrating if it is at least a hundred times slower
        than the next pole. Otherwise, for example with a spring, the gain is zero.
        """
        pole, following = self.poles[:2]
        if abs(pole) > 1e-2 * abs(following):
            return 0.0
        # The eigenvectors are computed as null vectors. `eig` would balance A, which amplifies the
        # rounding errors in the column of the rod's position, zero in exact arithmetic.
        left, _, right = np.linalg.svd(self.a - pole.real * np.eye(len(self.a)))
        v, w = right[-1], left[:, -1]
        return float((self.c[0] @ v) * (w @ self.b[:, 0]) / (w @ v))

    def to_control(self) -> Any:
        """Return a `control.StateSpace` in continuous time with named inputs, outputs and states.

        The input is ``motor_speed_command_rad_s``. An output has the name of its column in a run,
        or the name of its port if runs have no such column. The names of the states are `states`.
        """
        import control

        outputs = [label for port in self.outputs for label in SIGNALS.get(port, (port,))]
        return control.ss(
            *(self.a, self.b, self.c, self.d),
            name="plant",
            inputs=["motor_speed_command_rad_s"],
            outputs=outputs if len(outputs) == len(self.c) else None,
            states=list(self.states) or None,
        )

    def response(self, frequencies_hz: ArrayLike) -> Complex:
        """Return the response G(j2πf) of the first output to the command, (n,), at f in Hz."""
        first = Transfer(self.a, self.b, self.c[:1], self.d[0, 0], None)
        return first.response(frequency_array(frequencies_hz))

    def __str__(self) -> str:
        """Return operating point, poles with damping, and velocity gain as text."""
        frequency, ratio = self.damping
        rows = [str(self.operating_point)]
        rows += [
            f"  pole {p.real:.5g} {p.imag:+.5g}j 1/s: "
            f"{f / (2 * np.pi):.4g} Hz, damping ratio {z:.4g}"
            for p, f, z in zip(self.poles, frequency, ratio, strict=True)
        ]
        rows.append(f"  velocity gain of {self.outputs[0]}: {self.velocity_gain:.6g}")
        return "\n".join(rows)


def linearize_plant(
    plant: PlantParameters | Diagram = PlantParameters(),
    *,
    knee_angle_deg: float = MID_RANGE_DEG,
    outputs: tuple[str, ...] = ("knee_angle",),
    knee_torque_n_m: float = 0.0,
    disturbance_n: float = 0.0,
) -> PlantLinearization:
    """Linearize the plant at the operating point of a knee angle under load.

    Parameters
    ----------
    plant, knee_angle_deg, knee_torque_n_m, disturbance_n
        As in `find_operating_point`.
    outputs
        Names of output ports of the plant.

    Raises
    ------
    LinearizationError
        There is no equilibrium, or a derivative is not finite.
    ParameterError, LinkageError
        The knee angle is impossible.
    """
    equations, rest = _at_rest(plant, outputs, knee_angle_deg, knee_torque_n_m, disturbance_n)
    with warnings.catch_warnings():
        # Of corners, such as that of the friction at rest, but not of a leaf without equations.
        warnings.simplefilter("ignore")
        warnings.filterwarnings("default", ".*central differences|.* no derivative near this point")
        model = linearize(equations, rest, inputs=[_COMMAND], outputs=outputs)
    return PlantLinearization(
        a=model.a,
        b=model.b,
        c=model.c,
        d=model.d,
        outputs=outputs,
        operating_point=_operating_point(equations.diagram, rest),
        states=model.state_names,
    )


def frequency_array(frequencies_hz: ArrayLike) -> Array:
    """Return frequencies in Hz as an array (n,).

    Raises `LinearizationError` for a frequency that is not finite.
    """
    frequencies = np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
    finite = np.isfinite(frequencies)
    if not finite.all():
        raise LinearizationError(f"frequency = {frequencies[~finite][0]:g} Hz: must be finite")
    return frequencies
