"""Linear models of diagrams: matrices from one sample to the next, and the motion in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..arguments import quoted
from ..errors import LinearizationError, ParameterError
from ..run_data import Array
from .zeros import invariant_zeros

Complex: TypeAlias = NDArray[np.complex128]
"""An array of complex numbers."""

BOUNDARY_TOLERANCE = 1e-12
"""An eigenvalue is on the boundary of stability up to this distance, see `distance_inside`.

Rounding moves a simple eigenvalue by some 1e-15 of the largest one, times its condition number,
and condition numbers up to a few hundred are usual. An eigenvalue that is slower than 1e12 periods,
or 1e12 times slower than the fastest eigenvalue, hence counts as an eigenvalue without decay.
"""

_MOST_HZ = 1e300  # 2π times a larger frequency overflows
_MOST_PERIODS = 1e9
"""Largest frequency in multiples of 1/P. Rounding errors of the phase are 1e-15 times as large."""


@dataclass(frozen=True, repr=False)
class TickModel:
    """The updates at one time within the period, and the motion until the next such time.

    At ``time_s`` after the begin of the period the updates change the state z to
    z⁺ = J z + K u. Then dz/dt = F z + G u holds for ``duration_s``. The rows of F and G that belong
    to discrete states are zero.
    """

    time_s: float
    duration_s: float
    jump_state: Array
    """J (n, n), the identity where no update occurs."""
    jump_input: Array
    """K (n, m)."""
    rate_state: Array
    """F (n, n) in 1/s."""
    rate_input: Array
    """G (n, m) in 1/s."""

    def __repr__(self) -> str:
        """Return a text with the time and the duration."""
        return f"TickModel(time_s={self.time_s:g}, duration_s={self.duration_s:g})"


@dataclass(frozen=True, repr=False)
class OperatingPoint:
    """The values around which a linear model holds.

    ``state`` (n,), ``inputs`` (m,) and ``outputs`` (p,) have the order of the names of the model.
    """

    time_s: float
    state: Array
    inputs: Array
    outputs: Array

    def __repr__(self) -> str:
        """Return a text with the time and the numbers of values."""
        return (
            f"OperatingPoint(time_s={self.time_s:g}, {self.state.size} states, "
            f"{self.inputs.size} inputs, {self.outputs.size} outputs)"
        )


@dataclass(frozen=True, repr=False)
class LinearModel:
    """State space of a diagram around an operating point, made by `linearize`.

    All quantities are deviations from the operating point, in the units of the diagram. The state z
    has the continuous states first and then the discrete states.

    - If ``period_s`` is None, the model is continuous, dz/dt = A z + B u, y = C z + D u.
    - Otherwise z(t + P) = A z(t) + B u, y(t) = C z(t) + D u at t = 0, P, 2P … with the period P.
      The input u is constant from t to t + P. As in Drake, z(t) is the state before the updates
      at t, the updates at t see the input u, and y(t) is the output before these updates.

    For a diagram with several sample periods P is their least common multiple. The model is exact
    for the linearized diagram, without integration error and without approximate holds or delays.
    """

    a: Array
    """A (n, n)."""
    b: Array
    """B (n, m)."""
    c: Array
    """C (p, n)."""
    d: Array
    """D (p, m)."""
    period_s: float | None
    state_names: tuple[str, ...]
    """Names of the states from path and element, such as ``pendulum.theta`` or ``hold.0[0]``."""
    input_names: tuple[str, ...]
    """Names of the elements of the input ports: ``port``, or ``port[i]`` of several elements."""
    output_names: tuple[str, ...]
    """Names of the elements of the output ports."""
    operating_point: OperatingPoint
    ticks: tuple[TickModel, ...] = ()
    """Updates and motion within the period, in the order of time; empty for a continuous model."""

    def __repr__(self) -> str:
        """Return a text with the kind of the model and the numbers of states, inputs, outputs."""
        kind = "continuous" if self.period_s is None else f"period_s={self.period_s:g}"
        inputs, outputs = (
            ", ".join(names) or "none" for names in (self.input_names, self.output_names)
        )
        return (
            f"LinearModel({kind}, {len(self.state_names)} states, inputs: {inputs}, "
            f"outputs: {outputs})"
        )

    @property
    def eigenvalues(self) -> Complex:
        """Eigenvalues of A, by falling real part if the model is continuous, else by magnitude.

        In a conjugate pair, the eigenvalue with positive imaginary part comes first.
        """
        values = np.linalg.eigvals(self.a).astype(complex)
        key = values.real if self.period_s is None else np.abs(values)
        return values[np.argsort(-key, kind="stable")]

    @property
    def stable(self) -> bool:
        """Whether all deviations tend to zero.

        A continuous model is stable if Re λ < −ε max|λ|, a sampled one if |λ| < 1 − ε, for all
        `eigenvalues` λ. The tolerance ε = 1e-12 exceeds rounding errors. So a model with a free
        mode, such as the angle of a motor without position control, is not stable. A model without
        states is stable.
        """
        return bool((distance_inside(self.eigenvalues, self.period_s) > BOUNDARY_TOLERANCE).all())

    def poles(self) -> Complex:
        """Return the poles in 1/s.

        The poles of a continuous model are its `eigenvalues` λ. A sampled model of the period P has
        the poles ln(λ)/P. Eigenvalues below 1e-9, such as the eigenvalues of a delay, are left out.
        """
        values = self.eigenvalues
        if self.period_s is None:
            return values
        return np.asarray(np.log(values[np.abs(values) > 1e-9]) / self.period_s, dtype=complex)

    def zeros(self) -> Complex:
        """Return the finite invariant zeros, as values of s, or of z if the model is sampled.

        At a zero λ the matrix [[A − λI, B], [C, D]] loses rank.
        """
        return invariant_zeros(self.a, self.b, self.c, self.d)

    def after_updates(self) -> LinearModel:
        """Return the same model with the outputs after the updates at the multiples of P.

        The output of a hold after its update is the value that it holds until the next update.
        Raises `LinearizationError` for a continuous model.
        """
        if not self.ticks:
            raise LinearizationError("a continuous model has no updates")
        first = self.ticks[0]
        c, d = self.c @ first.jump_state, self.d + self.c @ first.jump_input
        return replace(self, c=c, d=d)

    def prescribed(self, states: Sequence[str]) -> LinearModel:
        """Return the model with the motion of some continuous states as inputs.

        The new inputs have the names of the states, and follow the inputs of this model. The new
        outputs ``rate of STATE`` follow the outputs of this model. Each is the rate that the
        equations give the state, so a caller can compute the input that causes the prescribed
        motion. The caller is responsible for consistent states, such as a position and its rate.

        Raises `ParameterError` for a name that is no continuous state of the model, and for a name
        that occurs twice.
        """
        fixed = [self._continuous_index(name) for name in states]
        if len(set(fixed)) < len(fixed):
            raise ParameterError(f"states = {quoted(states)}: names a state twice")
        free = [index for index in range(len(self.a)) if index not in fixed]
        rates = (self.ticks[0].rate_state, self.ticks[0].rate_input) if self.ticks else ()
        rate_state, rate_input = rates or (self.a, self.b)
        ticks = tuple(
            replace(
                tick,
                jump_state=tick.jump_state[np.ix_(free, free)],
                jump_input=np.hstack([tick.jump_input, tick.jump_state[:, fixed]])[free],
                rate_state=tick.rate_state[np.ix_(free, free)],
                rate_input=np.hstack([tick.rate_input, tick.rate_state[:, fixed]])[free],
            )
            for tick in self.ticks
        )
        a = rate_state[np.ix_(free, free)]
        b = np.hstack([rate_input, rate_state[:, fixed]])[free]
        if ticks:
            a, b = over_period(ticks)
        point, names = self.operating_point, tuple(self.state_names[index] for index in fixed)
        return replace(
            self,
            a=a,
            b=b,
            c=np.vstack([self.c, rate_state[fixed]])[:, free],
            d=np.vstack(
                [
                    np.hstack([self.d, self.c[:, fixed]]),
                    np.hstack([rate_input, rate_state[:, fixed]])[fixed],
                ]
            ),
            state_names=tuple(self.state_names[index] for index in free),
            input_names=self.input_names + names,
            output_names=self.output_names + tuple(f"rate of {name}" for name in names),
            operating_point=OperatingPoint(
                point.time_s,
                point.state[free],
                np.append(point.inputs, point.state[fixed]),
                np.append(point.outputs, np.zeros(len(fixed))),
            ),
            ticks=ticks,
        )

    def _continuous_index(self, name: str) -> int:
        """Return the index of a continuous state; raise `ParameterError` if there is none."""
        index = self.state_names.index(name) if name in self.state_names else -1
        unit = np.eye(len(self.a), self.a.shape[1] + self.b.shape[1])
        moves = any(
            (np.hstack([tick.jump_state, tick.jump_input])[index] != unit[index]).any()
            for tick in self.ticks
        )
        if index < 0 or moves:
            raise ParameterError(
                f"states: {quoted(name)} is no continuous state; states: "
                f"{', '.join(self.state_names)}"
            )
        return index

    def to_control(self) -> Any:
        """Return the model as a `control.StateSpace` with named states, inputs and outputs.

        The attribute ``dt`` is the period, or 0 for a continuous model. Dots in names of ports
        become underscores, because python-control refuses dots. Raises `LinearizationError` for a
        model without inputs or outputs.
        """
        import control

        for what, ports in (("input", self.input_names), ("output", self.output_names)):
            if not ports:
                raise LinearizationError(
                    f"{what}s: is empty; python-control requires at least one {what}"
                )
        return control.ss(
            *(self.a, self.b, self.c, self.d, self.period_s or 0),
            inputs=[name.replace(".", "_") for name in self.input_names],
            outputs=[name.replace(".", "_") for name in self.output_names],
            states=list(self.state_names),
        )

    def frequency_response(self, frequencies_hz: ArrayLike) -> Complex:
        """Return C (λI − A)⁻¹ B + D at frequencies f in Hz, (frequencies, outputs, inputs).

        λ is j2πf for a continuous model and e^{j2πfP} for a sampled model. A sampled model holds
        the inputs over the period P, and its outputs are those at t = 0, P, 2P … For inputs and
        outputs in continuous time see `sine_response`.

        Raises `LinearizationError` for a frequency that is not finite, is a pole, or exceeds 1e9/P.
        """
        frequencies = _frequencies(frequencies_hz, self.period_s)
        s = 2j * np.pi * frequencies
        points = s if self.period_s is None else np.exp(s * self.period_s)
        shifted = points[:, None, None] * np.eye(len(self.a)) - self.a
        state = _solution(shifted, self.b[None], frequencies)
        return np.asarray(self.c @ state + self.d, dtype=complex)

    def sine_response(self, frequencies_hz: ArrayLike) -> Complex:
        r"""Return the steady response to a continuous sine, (frequencies, outputs, inputs).

        The input is e^{jωt} at all times with ω = 2πf. The steady output of a sampled diagram has
        components at ω + 2πk/P for all integers k. The result is the component at ω,
        (1/P) ∫ y(t) e^{−jωt} dt over a period. A measured sinestream gives this number. The result
        is exact above the Nyquist frequency too, except at multiples of 1/(2P), where components of
        ω and −ω have the same frequency.

        For a continuous model the result is `frequency_response`. Raises `LinearizationError` for a
        frequency that is not finite, is a pole, or exceeds 1e9/P.
        """
        if self.period_s is None:
            return self.frequency_response(frequencies_hz)
        frequencies = _frequencies(frequencies_hz, self.period_s)
        omega = 2.0 * np.pi * frequencies
        n, m = self.b.shape
        # With w = z e^{−jωt} the input is the constant 1, and the steady w has the period P.
        transition, drive = _unit(omega.size, n, n), _unit(omega.size, n, m, 0.0)
        integral = _unit(omega.size, n, n, 0.0), _unit(omega.size, n, m, 0.0)
        steps: dict[tuple[float, int, int], tuple[Complex, Complex, Complex, Complex]] = {}
        for tick in self.ticks:
            transition = tick.jump_state @ transition
            drive = tick.jump_state @ drive + tick.jump_input
            # Ticks share the arrays of equal dynamics, so the same array means the same dynamics.
            key = (tick.duration_s, id(tick.rate_state), id(tick.rate_input))
            if key not in steps:
                steps[key] = _rotating_step(tick, omega)
            flow, flow_drive, mean, mean_drive = steps[key]
            integral = (
                integral[0] + mean @ transition,
                integral[1] + mean @ drive + mean_drive,
            )
            transition, drive = flow @ transition, flow @ drive + flow_drive
        start = _solution(np.eye(n) - transition, drive, frequencies)
        average = (integral[0] @ start + integral[1]) / self.period_s
        return np.asarray(self.c @ average + self.d, dtype=complex)


def distance_inside(eigenvalues: Complex, period_s: float | None) -> Array:
    """Return −Re λ/max|λ| of a continuous model, or 1 − |λ| of a sampled one, for eigenvalues λ.

    The result is negative outside the region of stability, and 0 on its boundary.
    """
    if period_s is not None:
        return np.asarray(1.0 - np.abs(eigenvalues))
    return np.asarray(-eigenvalues.real / (np.max(np.abs(eigenvalues), initial=0.0) or 1.0))


def _unit(count: int, rows: int, columns: int, diagonal: float = 1.0) -> Complex:
    return np.broadcast_to(diagonal * np.eye(rows, columns), (count, rows, columns)).astype(complex)


def _rotating_step(tick: TickModel, omega: Array) -> tuple[Complex, Complex, Complex, Complex]:
    """Return the motion and the integral of w = z e^{−jωt} over the duration of a tick.

    dw/dt = (F − jωI) w + G, q(t) = ∫ w dt. The results E, e, Q, q of shapes (frequencies, n, n or
    m) give w at the end E w + e, and the integral Q w + q, from w at the begin.
    """
    n, m = tick.rate_input.shape
    block = np.zeros((omega.size, 2 * n + m, 2 * n + m), dtype=complex)
    block[:, :n, :n] = tick.rate_state - 1j * omega[:, None, None] * np.eye(n)
    block[:, :n, 2 * n :] = tick.rate_input
    block[:, n : 2 * n, :n] = np.eye(n)
    step = np.asarray(scipy.linalg.expm(block * tick.duration_s), dtype=complex)
    return (
        step[:, :n, :n],
        step[:, :n, 2 * n :],
        step[:, n : 2 * n, :n],
        step[:, n : 2 * n, 2 * n :],
    )


def _solution(matrices: Any, right: Any, frequencies_hz: Array) -> Complex:
    """Solve linear equations at each frequency.

    Raises `LinearizationError` if the matrix of a frequency is singular.
    """
    try:
        return np.asarray(np.linalg.solve(matrices, right), dtype=complex)
    except np.linalg.LinAlgError:
        smallest = np.linalg.svd(matrices, compute_uv=False)[:, -1]
        raise LinearizationError(
            f"frequency = {frequencies_hz[np.argmin(smallest)]:g} Hz: is a pole of the model, "
            f"where the response is infinite; leave it out"
        ) from None


def _frequencies(frequencies_hz: ArrayLike, period_s: float | None) -> Array:
    """Return frequencies as an array (n,), and check their range.

    Raises `LinearizationError` for a frequency that is not finite or exceeds the range, and
    `ParameterError` for what is not a number.
    """
    try:
        frequencies = np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
    except (TypeError, ValueError):
        raise ParameterError(
            f"frequencies_hz = {quoted(frequencies_hz)}: must be numbers in Hz"
        ) from None
    most = _MOST_HZ if period_s is None else _MOST_PERIODS / period_s
    wrong = ~(np.abs(frequencies) <= most)
    if wrong.any():
        raise LinearizationError(
            f"frequency = {frequencies[wrong][0]:g} Hz: must be finite, and at most {most:.3g} Hz"
        )
    return frequencies


def over_period(ticks: Sequence[TickModel]) -> tuple[Array, Array]:
    """Return A and B of the motion over all ticks together, x⁺ = A x + B u with a constant u."""
    n, m = ticks[0].jump_input.shape
    a, b = np.eye(n), np.zeros((n, m))
    steps: dict[tuple[float, int, int], Array] = {}
    for tick in ticks:
        a, b = tick.jump_state @ a, tick.jump_state @ b + tick.jump_input
        # Ticks share the arrays of equal dynamics, so the same array means the same dynamics.
        key = (tick.duration_s, id(tick.rate_state), id(tick.rate_input))
        if key not in steps:
            block = np.zeros((n + m, n + m))
            block[:n] = np.hstack([tick.rate_state, tick.rate_input])
            with np.errstate(all="ignore"):  # the caller checks that A and B are finite
                steps[key] = scipy.linalg.expm(block * tick.duration_s)
        step = steps[key]
        a, b = step[:n, :n] @ a, step[:n, :n] @ b + step[:n, n:]
    return a, b
