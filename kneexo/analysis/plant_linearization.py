"""Operating points of the plant and its linearization by AutoDiff, in continuous time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.framework import Diagram

from kneexo.analysis.signals import to_rpm
from kneexo.compiler import newton, newton_failure
from kneexo.diagrams import SIGNALS, make_plant
from kneexo.errors import LinearizationError
from kneexo.parameters import PlantParameters
from kneexo.result import Array, Result

Complex = NDArray[np.complex128]
"""Type of an array of complex numbers."""

MID_RANGE_DEG = 40.0
"""Default knee angle in deg, the middle of the paper's range 10…70°."""


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


def _rounded(value: float) -> float:
    """Return ``value``, or zero if its magnitude is below 1e-9 and so a rounding error."""
    return value if abs(value) > 1e-9 else 0.0


def _fix_load(diagram: Any, context: Any, knee_torque: float, disturbance: float) -> None:
    """Fix the knee torque in N·m and the disturbance in N at the input ports of ``diagram``.

    A value without a port is ignored.
    """
    for name, value in (("knee_torque", knee_torque), ("disturbance_force", disturbance)):
        if diagram.HasInputPort(name):
            diagram.GetInputPort(name).FixValue(context, [value])


def _plant_gradients(
    plant: Any, point: Array, outputs: tuple[str, ...], knee_torque: float, disturbance: float
) -> tuple[Array, Array]:
    """Return state derivatives and output ports ``outputs`` at a point, and their gradients.

    ``point`` (n + 1,) contains the n states and the motor speed command in rad/s. The first result
    contains the n derivatives and then the elements of the outputs. The second result has a row
    for each element of the first result and n + 1 columns.
    """
    context = plant.CreateDefaultContext()
    seeded = InitializeAutoDiff(point.reshape(-1, 1)).reshape(-1)
    context.SetContinuousState(seeded[:-1])
    plant.GetInputPort("motor_speed_command").FixValue(context, seeded[-1:])
    _fix_load(plant, context, knee_torque, disturbance)
    values = np.concatenate(
        [
            plant.EvalTimeDerivatives(context).CopyToVector(),
            *(plant.GetOutputPort(name).Eval(context) for name in outputs),
        ]
    ).reshape(-1, 1)
    return ExtractValue(values).reshape(-1), ExtractGradient(values)


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
    diagram = _plant(plant, knee_angle_deg)
    if knee_torque_n_m and not diagram.HasInputPort("knee_torque"):
        raise LinearizationError(
            f"knee_torque = {knee_torque_n_m:g} N·m: the plant has no load to apply it to; give it "
            f"one (plant.load.kind = knee)"
        )
    automatic = diagram.ToAutoDiffXd()
    start = diagram.CreateDefaultContext().get_continuous_state_vector().CopyToVector()

    def derivatives(point: Array) -> tuple[Array, Array]:
        """Return the array of state rates and knee angle error at a point, and its gradients."""
        values, gradient = _plant_gradients(
            automatic, point, ("knee_angle",), knee_torque_n_m, disturbance_n
        )
        values[-1] -= math.radians(knee_angle_deg)
        return values, gradient

    point, residual = newton(derivatives, np.append(start, 0.0))
    if not residual < 1e-8:
        raise LinearizationError(
            f"no equilibrium at knee angle {knee_angle_deg:g} deg with knee_torque = "
            f"{knee_torque_n_m:g} N·m and disturbance = {disturbance_n:g} N: "
            f"{newton_failure(residual, 'derivative')}; reduce the load or the leakage"
        )
    context = diagram.CreateDefaultContext()
    context.SetContinuousState(point[:-1])
    diagram.GetInputPort("motor_speed_command").FixValue(context, point[-1:])
    _fix_load(diagram, context, knee_torque_n_m, disturbance_n)

    def output(name: str) -> float:
        return float(diagram.GetOutputPort(name).Eval(context)[0])

    return OperatingPoint(
        knee_angle_rad=output("knee_angle"),
        motor_speed_rad_s=output("motor_speed"),
        load_pressure_pa=output("load_pressure"),
        rod_force_n=output("rod_force"),
        state=point[:-1],
    )


def _plant(plant: PlantParameters | Diagram, knee_angle_deg: float) -> Any:
    """Return ``plant`` if it is a diagram, else a new plant that starts at ``knee_angle_deg``."""
    if isinstance(plant, PlantParameters):
        plant.knee.require_posture(knee_angle_deg)
        return make_plant(plant, initial_knee_angle_rad=math.radians(knee_angle_deg))
    return plant


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
        s = 2j * np.pi * frequency_array(frequencies_hz)
        eye = np.eye(self.a.shape[0])
        return np.array(
            [(self.c[0] @ np.linalg.solve(v * eye - self.a, self.b) + self.d[0])[0] for v in s]
        )

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
    """Linearize the plant at the operating point of a knee angle under load, by AutoDiff.

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
    diagram = _plant(plant, knee_angle_deg)
    point = find_operating_point(
        diagram,
        knee_angle_deg=knee_angle_deg,
        knee_torque_n_m=knee_torque_n_m,
        disturbance_n=disturbance_n,
    )
    n = point.state.size
    _, gradient = _plant_gradients(
        diagram.ToAutoDiffXd(),
        np.append(point.state, point.motor_speed_rad_s),
        outputs,
        knee_torque_n_m,
        disturbance_n,
    )
    require_finite(gradient, n, knee_angle_deg)
    return PlantLinearization(
        a=gradient[:n, :n],
        b=gradient[:n, n:],
        c=gradient[n:, :n],
        d=gradient[n:, n:],
        outputs=outputs,
        operating_point=point,
        states=tuple(_state_names(diagram)),
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


def require_finite(gradient: Array, states: int, knee_angle_deg: float) -> None:
    """Raise `LinearizationError` for a gradient that is not finite.

    The first ``states`` rows are gradients of the state rates. The other rows are gradients of the
    outputs. The message names the row and the knee angle.
    """
    finite = np.isfinite(gradient).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        name = f"the rate of state {row}" if row < states else f"output {row - states}"
        raise LinearizationError(
            f"the derivative of {name} is not finite at knee angle {knee_angle_deg:g} deg: there "
            f"is no linear model"
        )


def _state_names(system: Any, path: str = "") -> Iterator[str]:
    """Yield names of the continuous states, such as ``motor.x[0]``, in the order of the Context."""
    if isinstance(system, Diagram):
        for part in system.GetSystems():
            yield from _state_names(part, f"{path}{part.get_name()}.")
    else:
        count = system.CreateDefaultContext().num_continuous_states()
        yield from (f"{path}x[{i}]" for i in range(count))
