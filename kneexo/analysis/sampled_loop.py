"""The sampled-data loop, linearized exactly: a continuous plant with a controller at 2 ms.

Drake's `Linearize` refuses a diagram that mixes continuous and discrete state. Here the two are
taken apart and put together again without approximation: the plant by AutoDiff and its exact
zero-order hold, the controller by AutoDiff through its own discrete update. The quantizer of the
encoder is bypassed (its derivative is zero) and the loop is the one inside the boundary layer and
the speed limit; where there is none, the functions say so.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import ArrayLike
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from scipy.linalg import expm
from scipy.optimize import brentq, minimize_scalar

from kneexo.analysis.frequency_response import MINUS_3_DB
from kneexo.analysis.plant_linearization import MID_RANGE_DEG, NEWTON_STEPS, Complex
from kneexo.analysis.simulation import Array
from kneexo.diagrams import make_closed_loop
from kneexo.errors import LinearizationError
from kneexo.parameters import Scenario, StepReference

_BESIDE_REST = 1e-12
_BESIDE_REST_RAD_S3 = 1e-3
"""Steps of the states (their share) and of the reference's jerk that tell the sides of a kink at
rest apart: above the rounding of the estimates, and nothing next to the boundary layer."""


@dataclass(frozen=True)
class Margins:
    """Stability margins of a sampled loop, broken at the motor speed command.

    ``stable`` says whether the closed loop is; if not, the numbers are distances to stability and
    no margins. Frequencies in Hz; ``gain_margin`` and ``disk_gain_margin`` are factors,
    ``disk_margin`` is that of the balanced disk (S − T)/2. inf where a crossing does not exist.
    """

    stable: bool
    gain_margin: float
    gain_margin_frequency_hz: float
    lower_gain_margin: float
    """Largest factor below 1 at which the loop loses stability; 0 where there is none."""
    phase_margin_deg: float
    phase_margin_frequency_hz: float
    delay_margin_s: float
    disk_margin: float
    disk_margin_frequency_hz: float
    disk_gain_margin: float
    disk_phase_margin_deg: float


@dataclass(frozen=True)
class SampledLoop:
    """Plant and controller, linearized and joined exactly at the sampling instants.

    Between samples dx/dt = A x + B u with u held. At a sample the controller maps its own state z,
    the plant's x and the reference r = (θ_d and three derivatives) to
    z⁺ = G_z z + G_x x + G_r r, and u = C_u z⁺ from then on. Units are those of the Contexts.
    ``output`` is the port whose row is C; T is ``sample_time_s``.
    """

    a: Array
    b: Array
    c: Array
    g_x: Array
    g_z: Array
    g_r: Array
    c_u: Array
    sample_time_s: float
    output: str
    knee_angle_rad: float
    scenario: Scenario

    def plant_step(self) -> tuple[Array, Array]:
        """Zero-order hold of the plant, x(t + T) = A_d x + B_d u, by one matrix exponential."""
        n = self.a.shape[0]
        block = np.zeros((n + 1, n + 1))
        block[:n, :n], block[:n, n:] = self.a, self.b
        step = expm(block * self.sample_time_s)
        return step[:n, :n], step[:n, n:]

    @property
    def monodromy(self) -> Array:
        """Map of (x, z) over one sample time, for a constant reference."""
        a_d, b_d = self.plant_step()
        feedback = np.hstack([self.g_x, self.g_z])
        return np.vstack([np.hstack([a_d, 0.0 * self.g_x.T]) + b_d @ self.c_u @ feedback, feedback])

    @property
    def eigenvalues(self) -> Complex:
        """Eigenvalues of `monodromy`, the largest first: the loop is stable when all are below 1.

        States that never change (a PID's integral without integral action) are left out.
        """
        values = np.linalg.eigvals(self.monodromy).astype(complex)
        return values[np.argsort(-np.abs(values))]

    def poles(self) -> Complex:
        """`eigenvalues` that the output sees, as ln(z)/T in 1/s; z = 0 is left out."""
        values = self.eigenvalues
        values = values[np.abs(values) > 1e-9]
        return np.asarray(np.log(values) / self.sample_time_s, dtype=complex)

    @property
    def stable(self) -> bool:
        """Whether every eigenvalue lies inside the unit circle."""
        return bool(np.abs(self.eigenvalues[0]) < 1.0)

    # The loop is broken at the held command: v drives the plant, −u is what comes back.

    def _loop_matrices(self) -> tuple[Array, Array, Array]:
        a_d, b_d = self.plant_step()
        n = a_d.shape[0]
        m = self.g_z.shape[0]
        a = np.block([[a_d, np.zeros((n, m))], [self.g_x, self.g_z]])
        b = np.vstack([b_d, np.zeros((m, 1))])
        c = -self.c_u @ np.hstack([self.g_x, self.g_z])
        return a, b, c

    def to_control(self) -> Any:
        """Loop transfer L(z) as `control.StateSpace` with dt = T; the feedback is negative."""
        import control

        return control.ss(*self._loop_matrices(), [[0.0]], self.sample_time_s)

    def loop_response(self, frequencies_hz: ArrayLike) -> Complex:
        """L(e^{j2πfT}) at frequencies in Hz, (n,); L is periodic in the sampling frequency."""
        a, b, c = self._loop_matrices()
        z = np.exp(2j * np.pi * _frequencies(frequencies_hz) * self.sample_time_s)
        shifted = z[:, None, None] * np.eye(a.shape[0]) - a
        return np.asarray(c @ np.linalg.solve(shifted, b[None, :, :]), dtype=complex)[:, 0, 0]

    def sensitivity(self, frequencies_hz: ArrayLike) -> Complex:
        """S = 1/(1 + L), (n,)."""
        return np.asarray(1.0 / (1.0 + self.loop_response(frequencies_hz)), dtype=complex)

    def complementary_sensitivity(self, frequencies_hz: ArrayLike) -> Complex:
        """T = L/(1 + L), (n,)."""
        loop = self.loop_response(frequencies_hz)
        return np.asarray(loop / (1.0 + loop), dtype=complex)

    def output_response(self, frequencies_hz: ArrayLike) -> Complex:
        """Response of the output to a sine in θ_d: the component at its own frequency, (n,).

        Exact between the samples, and past the Nyquist frequency, where the reference is seen
        folded. The held command U e^{jωkT} contains U (1 − e^{−jωT})/(jωT) at ω, which the plant
        turns into G(jω) times that; the other components lie at ω + 2πk/T.
        """
        f = _frequencies(frequencies_hz)
        if np.any(f <= 0.0):
            raise LinearizationError(f"frequency = {f.min():g} Hz: must be > 0")
        dt = self.sample_time_s
        n, size = self.a.shape[0], self.monodromy.shape[0]
        _, b_d = self.plant_step()
        drive = np.vstack([b_d @ self.c_u @ self.g_r, self.g_r])
        s = 2j * np.pi * f[:, None, None]
        z = np.exp(s * dt)
        reference = np.concatenate([np.ones_like(s), s, s * s, s * s * s], axis=1)
        state = np.linalg.solve(z * np.eye(size) - self.monodromy, drive @ reference)
        command = self.c_u @ (z * state[:, n:])  # what is held from t on is z⁺
        held = command * (1.0 - np.exp(-s * dt)) / (s * dt)
        plant = self.c @ np.linalg.solve(s * np.eye(n) - self.a, self.b[None])
        return np.asarray(plant * held, dtype=complex)[:, 0, 0]

    def bandwidth_hz(self) -> float:
        """Small-signal −3 dB bandwidth of `output_response` in Hz: its first fall below 1/√2.

        Relative to the gain at 0.01 Hz; searched up to the Nyquist frequency, nan when there is
        none. The gain may rise again beyond: the sliding-mode controller's does, because it feeds
        the reference's jerk forward. For an unstable loop it has no meaning: `LinearizationError`.
        """
        self._require_stable("bandwidth")
        grid = np.geomspace(1e-2, 0.5 / self.sample_time_s, 2000)
        gain = np.abs(self.output_response(grid))
        threshold = MINUS_3_DB * gain[0]
        low = gain < threshold
        if not low.any():
            return math.nan
        index = int(np.argmax(low))

        def excess(frequency: float) -> float:
            return float(np.abs(self.output_response(frequency)[0])) - threshold

        return float(brentq(excess, grid[index - 1], grid[index]))

    def _require_stable(self, what: str) -> None:
        if not self.stable:
            raise LinearizationError(
                f"the sampled loop is unstable (largest eigenvalue "
                f"{abs(self.eigenvalues[0]):.6g} > 1): it has no {what}; reduce the gain"
            )

    def margins(self) -> Margins:
        """Gain, phase, delay and disk margins up to the Nyquist frequency (`Margins`)."""
        grid = np.geomspace(1e-3, 0.5 / self.sample_time_s, 20_000)
        loop = self.loop_response(grid)

        def loop_at(frequency: float) -> complex:
            return complex(self.loop_response(frequency)[0])

        def imaginary(frequency: float) -> float:
            return loop_at(frequency).imag

        def level(frequency: float) -> float:
            return abs(loop_at(frequency)) - 1.0

        phase_crossings = [
            (-1.0 / loop_at(f).real, f)
            for f in _crossings(imaginary, grid, loop.imag)
            if loop_at(f).real < 0.0
        ]
        nyquist = float(grid[-1])
        if loop_at(nyquist).real < 0.0:  # L is real at the Nyquist frequency
            phase_crossings.append((-1.0 / loop_at(nyquist).real, nyquist))
        gain_crossings = [
            (180.0 + math.degrees(cmath.phase(loop_at(f))), f)
            for f in _crossings(level, grid, np.abs(loop) - 1.0)
        ]
        none = (math.inf, math.nan)
        upper = min((c for c in phase_crossings if c[0] > 1.0), default=none)
        lower = max((c for c in phase_crossings if c[0] < 1.0), default=(0.0, math.nan))
        phase = min(
            ((p if p <= 180.0 else p - 360.0, f) for p, f in gain_crossings),
            key=lambda c: abs(c[0]),
            default=none,
        )
        delay = min(
            (math.radians(p) / (2.0 * math.pi * f) for p, f in gain_crossings), default=none[0]
        )
        frequency = _minimum(self._disk_distance, grid)
        disk = self._disk_distance(frequency)
        reach = 0.5 * disk
        return Margins(
            stable=self.stable,
            gain_margin=upper[0],
            gain_margin_frequency_hz=upper[1],
            lower_gain_margin=lower[0],
            phase_margin_deg=phase[0],
            phase_margin_frequency_hz=phase[1],
            delay_margin_s=delay,
            disk_margin=disk,
            disk_margin_frequency_hz=frequency,
            disk_gain_margin=(1.0 + reach) / (1.0 - reach) if reach < 1.0 else math.inf,
            disk_phase_margin_deg=math.degrees(2.0 * math.atan(reach)),
        )

    def _disk_distance(self, frequency_hz: Any) -> Any:
        """1/|(S − T)/2|: the balanced disk margin at each frequency."""
        loop = self.loop_response(frequency_hz)
        distance = 2.0 * np.abs((1.0 + loop) / (1.0 - loop))
        return distance if np.ndim(frequency_hz) else float(distance[0])

    def __str__(self) -> str:
        """Stability, margins and bandwidth in words."""
        margins = self.margins()
        largest = abs(self.eigenvalues[0])
        head = (
            f"knee at {math.degrees(self.knee_angle_rad):.4g} deg, T = {self.sample_time_s:g} s: "
        )
        if not margins.stable:
            return head + f"unstable, largest eigenvalue {largest:.6g}; it has no margins"
        m = margins
        return (
            head + f"stable, largest eigenvalue {largest:.6g}\n"
            f"  gain margin {m.gain_margin:.4g} at {m.gain_margin_frequency_hz:.4g} Hz\n"
            f"  phase margin {m.phase_margin_deg:.4g} deg at {m.phase_margin_frequency_hz:.4g} Hz, "
            f"delay margin {1e3 * m.delay_margin_s:.4g} ms\n"
            f"  disk margin {m.disk_margin:.4g} at {m.disk_margin_frequency_hz:.4g} Hz: "
            f"gain {m.disk_gain_margin:.4g}, phase {m.disk_phase_margin_deg:.4g} deg\n"
            f"  small-signal bandwidth {self.bandwidth_hz():.4g} Hz"
        )

    def plot(self, ax: Any = None) -> Any:
        """Bode plot of the loop up to its Nyquist frequency; ``ax``: two axes."""
        if ax is None:
            ax = plt.subplots(2, 1, sharex=True, figsize=(7, 6), layout="constrained")[1]
        nyquist = 0.5 / self.sample_time_s
        f = np.geomspace(0.02, nyquist, 1500)
        loop = self.loop_response(f)
        ax[0].semilogx(f, 20.0 * np.log10(np.abs(loop)), "C0")
        ax[1].semilogx(f, np.degrees(np.unwrap(np.angle(loop))), "C0")
        ax[0].axhline(0.0, color="0.6", lw=0.8)
        for axis in ax:
            axis.axvline(nyquist, color="C3", ls="--", lw=1, label=f"Nyquist, {nyquist:g} Hz")
            axis.grid(alpha=0.3)
        ax[0].set(ylabel="loop magnitude (dB)")
        ax[1].set(xlabel="frequency (Hz)", ylabel="loop phase (deg)")
        ax[0].legend()
        return ax


def _frequencies(frequencies_hz: ArrayLike) -> Array:
    return np.atleast_1d(np.asarray(frequencies_hz, dtype=float))


def _crossings(function: Callable[[float], float], grid: Array, values: Array) -> list[float]:
    """Zeros of ``function``, whose ``values`` on ``grid`` are known."""
    changes = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
    return [float(brentq(function, grid[i], grid[i + 1], xtol=1e-14)) for i in changes]


def _minimum(function: Callable[[Any], Any], grid: Array) -> float:
    """Argument of the smallest value of ``function``: best of ``grid``, then refined."""
    index = int(np.argmin(function(grid)))
    bounds = (grid[max(index - 1, 0)], grid[min(index + 1, grid.size - 1)])
    return float(minimize_scalar(function, bounds=bounds, options={"xatol": 1e-12}).x)


def linearize_loop(
    scenario: Scenario = Scenario(),
    knee_angle_deg: float = MID_RANGE_DEG,
    *,
    output: str = "knee_angle",
) -> SampledLoop:
    """Linearize the sampled-data loop of a scenario where it rests at a constant reference.

    Its reference and initial offset are replaced, its quantizer is bypassed. ``output``: the
    port of the plant whose response is asked for.

    Raises `LinearizationError` when the controller is continuous, when the loop has no rest there,
    when the rest lies outside the boundary layer or at the speed limit (there is no linear loop),
    or for a signum controller, which has none at all.
    """
    controller = scenario.controller
    if controller.kind == "smc" and (controller.continuous or controller.switching == "signum"):
        what = "continuous = true" if controller.continuous else "switching = signum"
        raise LinearizationError(f"controller.{what}: there is no linear sampled-data loop")
    fixed = scenario.model_copy(
        update={
            "encoder": scenario.encoder.model_copy(update={"quantized": False}),
            "reference": StepReference(start_deg=knee_angle_deg, end_deg=knee_angle_deg),
            "initial_offset_m": 0.0,
        }
    )
    diagram = make_closed_loop(fixed, signals=(), external_reference=True)
    automatic = diagram.ToAutoDiffXd()
    reference = np.array([math.radians(knee_angle_deg), 0.0, 0.0, 0.0])
    context = diagram.CreateDefaultContext()
    x = np.asarray(context.get_continuous_state_vector().CopyToVector())
    # Start the controller's states as a run does.
    diagram.GetInputPort("knee_reference").FixValue(context, reference)
    z = _initial_discrete(diagram, context)
    n, m = x.size, z.size
    point = np.concatenate([x, z])
    residual = math.inf
    for _ in range(NEWTON_STEPS):
        values, gradient, _, _ = _loop_gradients(automatic, point, n, reference, output)
        values = np.concatenate([values[:n], values[n:] - point[n:]])
        jacobian = gradient[:, : n + m].copy()
        jacobian[n:, n:] -= np.eye(m)
        residual = float(np.max(np.abs(values)))
        if not (np.isfinite(jacobian).all() and math.isfinite(residual)):
            break
        # Minimum norm: a state without influence (an unused integral) stays where it is.
        step = np.linalg.lstsq(jacobian, values, rcond=1e-14)[0]
        point = point - step
        if np.max(np.abs(step) / (1.0 + np.abs(point))) < 1e-13:
            break
    if not residual < 1e-6:
        raise LinearizationError(
            f"the loop does not rest at knee angle {knee_angle_deg:g} deg: the largest residual "
            f"left is {residual:.3g}; reduce the load"
        )
    # The absolute values of Eq. 27 have their kinks at rest. A small motion sees the mean of both
    # sides; at the rest itself rounding would choose one.
    _, _, c, angle = _loop_gradients(automatic, point, n, reference, output)
    jerk = np.array([0.0, 0.0, 0.0, _BESIDE_REST_RAD_S3])
    beside = _BESIDE_REST * (1.0 + np.abs(point))
    both = [
        _loop_gradients(automatic, point + side * beside, n, reference + side * jerk, output)[1]
        for side in (-1.0, 1.0)
    ]
    gradient = 0.5 * (both[0] + both[1])
    _require_linear(diagram, fixed, point, n, reference)
    # The plant sees the controller's state through the held command alone.
    held = gradient[:n, n : n + m]
    column = int(np.argmax(np.max(np.abs(held), axis=0)))
    update = gradient[n:]
    identity = np.hstack([np.zeros((m, n)), np.eye(m), np.zeros((m, reference.size))])
    # Not merely identical: rounding leaves 1e-16 in the integral of a PID that has no K_i.
    live = np.any(np.abs(update - identity) > 1e-12, axis=1)
    return SampledLoop(
        a=gradient[:n, :n],
        b=held[:, [column]],
        c=c,
        g_x=update[live, :n],
        g_z=update[live, n : n + m][:, live],
        g_r=update[live, n + m :],
        c_u=np.eye(m)[[column]][:, live],
        sample_time_s=controller.sample_time_s,
        output=output,
        knee_angle_rad=angle,
        scenario=scenario,
    )


def _initial_discrete(diagram: Any, context: Any) -> Array:
    """Discrete state after initialization, all groups in one vector."""
    from pydrake.systems.analysis import Simulator

    simulator = Simulator(diagram, context)
    simulator.Initialize()
    groups = context.num_discrete_state_groups()
    return np.concatenate([context.get_discrete_state(i).CopyToVector() for i in range(groups)])


def _loop_context(diagram: Any, point: Any, n: int) -> Any:
    """Context of the loop at ``point``: n continuous states, all discrete ones, the reference."""
    context = diagram.CreateDefaultContext()
    context.SetContinuousState(point[:n])
    for index in range(context.num_discrete_state_groups()):
        size = context.get_discrete_state(index).size()
        context.SetDiscreteState(index, point[n : n + size])
        n += size
    diagram.GetInputPort("knee_reference").FixValue(context, point[n:])
    return context


def _loop_gradients(
    diagram: Any, point: Array, n: int, reference: Array, output: str
) -> tuple[Array, Array, Array, float]:
    """Values and gradients of dx/dt and z⁺ in (x, z, r); row of the output in x; knee angle."""
    seeded = InitializeAutoDiff(np.append(point, reference).reshape(-1, 1)).reshape(-1)
    context = _loop_context(diagram, seeded, n)
    updated = diagram.EvalUniquePeriodicDiscreteUpdate(context)
    values = np.concatenate(
        [
            diagram.EvalTimeDerivatives(context).CopyToVector(),
            *(updated.get_vector(i).CopyToVector() for i in range(updated.num_groups())),
            diagram.GetOutputPort(output).Eval(context)[:1],
        ]
    ).reshape(-1, 1)
    number, gradient = ExtractValue(values).reshape(-1), ExtractGradient(values)
    angle = float(diagram.GetOutputPort("knee_angle").Eval(context)[0].value())
    return number[:-1], gradient[:-1], gradient[-1:, :n], angle


def _require_linear(diagram: Any, scenario: Scenario, point: Array, n: int, reference: Any) -> None:
    """Refuse a rest at the speed limit or outside the boundary layer."""
    context = _loop_context(diagram, np.append(point, reference), n)
    command = abs(float(diagram.GetOutputPort("motor_speed_command").Eval(context)[0]))
    limit = scenario.command_limit_rad_s
    if command >= limit * (1.0 - 1e-9):
        raise LinearizationError(
            f"motor_speed_command = {command:.4g} rad/s is at its limit of {limit:.4g} rad/s: "
            f"there is no linear loop; reduce the load"
        )
    if scenario.controller.kind == "smc":
        s = abs(float(diagram.GetOutputPort("sliding_variable").Eval(context)[0]))
        if s >= scenario.controller.phi_m_s2:
            raise LinearizationError(
                f"|s| = {s:.4g} m/s² lies outside the boundary layer phi_m_s2 = "
                f"{scenario.controller.phi_m_s2:g} m/s²: there is no linear loop; increase Φ"
            )
