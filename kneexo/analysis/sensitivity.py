"""Derivatives of tracking error and stability margins of one scenario by AutoDiff.

The values of the plant vary, and the controller keeps its nominal plant. The quantizers of encoder
and bus are bypassed, because their derivatives are zero. The root mean square of the error is
differentiated, because the largest error has no derivative where it jumps from one peak to another.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator_, SimulatorConfig

from kneexo.analysis.assessment import MARGIN_METRICS
from kneexo.analysis.loop_equilibrium import (
    command_and_live,
    find_equilibrium,
    set_loop_parameters,
    start_state,
)
from kneexo.analysis.sampled_loop import SampledLoop, linearize_loop
from kneexo.analysis.signals import period_s, rms
from kneexo.diagrams import make_closed_loop
from kneexo.errors import LinearizationError, ParameterError, SimulationError
from kneexo.parameters import Scenario
from kneexo.parameters.paths import value_at
from kneexo.parameters.quantity import Parameters
from kneexo.result import Array, Result
from kneexo.systems.knee_reference import run_middle_deg

_DIFFERENTIABLE = (
    "plant.pump.",
    "plant.cylinder.",
    "plant.load.",
    "plant.full_order.",
    "encoder.mounting_error_rad",
)
_STATE_STEP = 3e-7
"""Relative step of the states in the finite differences of `loop_sensitivities`."""


@dataclass(frozen=True, repr=False)
class Sensitivities(Result):
    """Metrics of a scenario and their gradients with respect to its values at ``paths``.

    ``metrics`` and ``gradients`` map the name of a metric to its value and its gradient.
    """

    paths: tuple[str, ...]
    metrics: dict[str, float]
    gradients: dict[str, Array]

    def of(self, metric: str) -> dict[str, float]:
        """Return a dictionary from the path of a value to the derivative of a metric.

        The unit of a derivative is the unit of the metric per unit of the value.
        """
        return dict(zip(self.paths, self.gradients[metric].tolist(), strict=True))


def differentiable(scenario: Scenario, path: str) -> bool:
    """Whether AutoDiff can differentiate with respect to the scenario's value at ``path``.

    True for real numbers of pump, cylinder (also of full order) and load, and for the mounting
    error of the encoder. False for choices, for whole numbers and for the linkage. The linkage
    enters the equations by a fit, which AutoDiff cannot differentiate.
    """
    return path.startswith(_DIFFERENTIABLE) and isinstance(value_at(scenario, path), float)


def _fixed(scenario: Scenario) -> Scenario:
    """Return the scenario without quantizers and with an explicit nominal plant.

    An explicit nominal plant of the controller does not change when the plant varies.
    """
    nominal = {"nominal": scenario.believed_plant}
    return scenario.without_quantizers().model_copy(update=nominal)


def _seeded(scenario: Scenario, paths: Sequence[str], columns: int, first: int) -> Scenario:
    """Return the scenario with AutoDiffXd numbers as values at ``paths``.

    The gradient of each number has ``columns`` elements. For path i it is 1 at the index
    ``first`` + i and 0 elsewhere. The scenario is not validated. Raises `ParameterError` when
    ``paths`` is empty or a value is not `differentiable`.
    """
    if not paths:
        raise ParameterError("paths: there are none; a sensitivity needs at least one value")
    for path in paths:
        if not differentiable(scenario, path):
            raise ParameterError(
                f"{path}: has no derivative by AutoDiff; known: numbers below "
                f"{', '.join(_DIFFERENTIABLE)}"
            )
    seeded = scenario
    for index, path in enumerate(paths):
        gradient = np.zeros(columns)
        gradient[first + index] = 1.0
        seeded = _with(seeded, path.split("."), AutoDiffXd(value_at(scenario, path), gradient))
    return seeded


def _with(holder: Any, names: Sequence[str], value: Any) -> Any:
    """Return a copy of nested parameters with ``value`` at the path ``names``; skip validation."""
    if not names:
        return value
    inner = _with(getattr(holder, names[0]), names[1:], value)
    assert isinstance(holder, Parameters)
    return holder.model_copy(update={names[0]: inner})


def _gradients(values: Iterable[Any], columns: int) -> Array:
    """Return the gradients (n, columns) of n AutoDiffXd numbers or floats; zero for floats."""
    zero = AutoDiffXd(0.0, np.zeros(columns))
    return np.asarray(ExtractGradient(np.array([[zero + value] for value in values])))


def tracking_sensitivities(
    scenario: Scenario,
    paths: Sequence[str],
    *,
    duration_s: float | None = None,
    step_s: float | None = None,
) -> Sensitivities:
    """Return the RMS tracking error ``rms_error_deg`` and its gradient, by a run with AutoDiffXd.

    The first period of a sinusoidal reference is left out, unless the run is shorter. The
    computation of one simulated second takes 1.5 s, or 25 s for a plant of full order.

    Parameters
    ----------
    scenario
        Plant, controller and reference.
    paths
        Dotted names of values of the plant, for which `differentiable` holds.
    duration_s
        Duration of the run. None: the duration in the scenario.
    step_s
        Step of the third-order Runge-Kutta method, for which the gradient is exact. None: 0.5 ms,
        or 0.05 ms in full order, because the valves are stiff. Drake's implicit integrators cannot
        be used, because their Newton's method loses the derivatives.

    Raises
    ------
    ParameterError
        A path has no derivative.
    SimulationError
        The run leaves the range of motion.
    """
    fixed = _fixed(scenario)
    seeded = _seeded(fixed, paths, len(paths), 0)
    diagram = make_closed_loop(fixed, signals=("knee_reference", "knee_angle")).ToAutoDiffXd()
    simulator = Simulator_[AutoDiffXd](diagram)
    context = simulator.get_mutable_context()
    set_loop_parameters(diagram, context, seeded)
    start = start_state(seeded, context.num_continuous_states())
    context.SetContinuousState(np.array([AutoDiffXd(0.0) + value for value in start]))
    if step_s is None:
        step_s = 5e-4 if scenario.plant.full_order is None else 5e-5
    ApplySimulatorConfig(
        SimulatorConfig(
            integration_scheme="runge_kutta3", max_step_size=step_s, use_error_control=False
        ),
        simulator,
    )
    end = scenario.duration_s if duration_s is None else duration_s
    for time in np.append(np.arange(0.25, end, 0.25), end):
        simulator.AdvanceTo(AutoDiffXd(time))
    data = diagram.GetSubsystemByName("log").FindLog(context).data()
    settled = round(period_s(scenario) / scenario.controller.sample_time_s)
    reference, angle = data[0], data[4]
    knee = np.degrees(ExtractValue(angle.reshape(-1, 1)).reshape(-1))
    low, high = scenario.plant.knee.flexion_min_deg, scenario.plant.knee.flexion_max_deg
    over = scenario.plant.knee.overshoot_deg
    inside = (knee >= low - over) & (knee <= high + over)
    if not inside.all():
        raise SimulationError(
            f"the run with AutoDiffXd leaves the range of motion {low:g} … {high:g} deg after "
            f"sample {int(np.argmin(inside))}; reduce step_s = {step_s:g} s"
        )
    error = (reference - angle)[settled if settled + 1 < angle.size else 0 :]
    value = np.degrees(ExtractValue(error.reshape(-1, 1)).reshape(-1))
    gradient = np.degrees(_gradients(error, len(paths)))
    size = rms(value)
    return Sensitivities(
        paths=tuple(paths),
        metrics={"rms_error_deg": size},
        gradients={"rms_error_deg": value @ gradient / (value.size * size)},
    )


def loop_sensitivities(scenario: Scenario, paths: Sequence[str]) -> Sensitivities:
    """Return margins of the sampled loop and their gradients in the values at ``paths``.

    The metrics are ``largest_eigenvalue``, the largest magnitude of an eigenvalue, and, for a
    stable loop, `MARGIN_METRICS`. The gradient of a margin that does not exist is nan. The loop is
    linearized in the middle of the reference's range.

    The values at ``paths`` shift the equilibrium. AutoDiff and the implicit function theorem give
    this shift. AutoDiff then gives the gradients of dx/dt and of the controller's update with
    respect to the values, along this shift, at points on each side of the equilibrium. Differences
    between these gradients are the derivatives of the loop's Jacobian. Finally the chain rule gives
    the derivatives of the zero-order hold (by the derivative of the matrix exponential) and of each
    margin at its frequency.

    Raises `ParameterError` for a path that has no derivative. Also raises the errors of
    `linearize_loop`.
    """
    fixed = _fixed(scenario)
    knee_angle_deg = run_middle_deg(scenario)
    equilibrium = find_equilibrium(fixed, knee_angle_deg=knee_angle_deg)
    n, size, count = equilibrium.continuous_states, equilibrium.point.size, len(paths)
    reference = equilibrium.reference

    def rates(point: Array, columns: int, gradient: Array, seeded: Scenario) -> Array:
        """Return the gradients of dx/dt and z⁺ at ``point``, whose own gradient is ``gradient``."""
        state = InitializeAutoDiff(point.reshape(-1, 1), gradient).reshape(-1)
        context = equilibrium.autodiff_context(state, reference)
        set_loop_parameters(equilibrium.diagram, context, seeded)
        return _gradients(equilibrium.rates(context), columns)

    both = size + count
    joint = rates(equilibrium.point, both, np.eye(size, both), _seeded(fixed, paths, both, size))
    stays = np.diag(np.repeat([0.0, 1.0], [n, size - n]))
    solved = np.linalg.lstsq(joint[:, :size] - stays, joint[:, size:], rcond=1e-14)[0]
    moves = np.asarray(-solved, dtype=float)
    seeded = _seeded(fixed, paths, count, 0)
    change = np.zeros((size, size, count))
    for index, step in enumerate(_STATE_STEP * (1.0 + np.abs(equilibrium.point))):
        aside = step * np.eye(size)[index]
        # Extrapolation to a step of zero: a kink at the equilibrium causes an error linear in the
        # step, the remaining error is quadratic.
        for steps, weight in ((1.0, 8.0 / 3.0), (2.0, -2.0), (4.0, 1.0 / 3.0)):
            ends = (equilibrium.point + sign * steps * aside for sign in (1.0, -1.0))
            above, below = (rates(end, count, moves, seeded) for end in ends)
            change[:, index] += weight * (above - below) / (2.0 * steps * step)
    loop = linearize_loop(fixed, knee_angle_deg=knee_angle_deg)
    index, command, live = command_and_live(joint[:, :size], n)
    if np.count_nonzero(command) > 1:
        raise LinearizationError("controller: must hold its command in one discrete state")
    metrics = {"largest_eigenvalue": float(abs(loop.eigenvalues[0]))}
    if loop.stable:
        margins = loop.margins()
        metrics |= {name: getattr(margins, name) for name in MARGIN_METRICS}
    columns = [_metric_changes(loop, change[..., i], index, live) for i in range(count)]
    return Sensitivities(
        paths=tuple(paths),
        metrics=metrics,
        gradients={name: np.array([column[name] for column in columns]) for name in metrics},
    )


def _metric_changes(loop: SampledLoop, change: Array, index: int, live: Any) -> dict[str, float]:
    """Return the derivatives of the loop's metrics with respect to one value of the scenario.

    ``change`` is the derivative of the Jacobian with respect to this value. The Jacobian is the
    gradient of (dx/dt, z⁺) in (x, z). ``index`` is the index of the command in z. ``live`` is a
    mask of the states z that an update can change.
    """
    n = loop.a.shape[0]
    block, change_of_block = np.zeros((2, n + 1, n + 1))
    block[:n, :n], block[:n, n:] = loop.a, loop.b
    change_of_block[:n, :n], change_of_block[:n, n] = change[:n, :n], change[:n, n + index]
    dt = loop.sample_time_s
    step = scipy.linalg.expm_frechet(block * dt, change_of_block * dt, compute_expm=False)
    update = change[n:][live]
    feedback = np.hstack([update[:, :n], update[:, n:][:, live]])
    a, b, c = (np.zeros_like(matrix) for matrix in loop.loop_matrices)
    a[:n, :n], b[:n], a[n:] = step[:n, :n], step[:n, n:], feedback
    c[:] = -loop.c_u @ feedback
    opened, drive, row = loop.loop_matrices
    values, left, right = scipy.linalg.eig(loop.monodromy, left=True)
    largest = int(np.argmax(np.abs(values)))
    value, w, v = values[largest], left[:, largest].conj(), right[:, largest]
    # The closed loop is A − b c.
    moved = w @ (a - b @ row - drive @ c) @ v / (w @ v)
    changes = {"largest_eigenvalue": float((np.conj(value) * moved).real / abs(value))}
    if not loop.stable:
        return changes

    def response(frequency: float) -> tuple[complex, complex, complex]:
        """Return L at a frequency in Hz, and dL/d(value) and dL/d(frequency)."""
        z = np.exp(2j * np.pi * frequency * dt)
        inverse = np.linalg.inv(z * np.eye(opened.shape[0]) - opened)
        forth, back = inverse @ drive, row @ inverse
        in_value = (c @ forth + back @ a @ forth + back @ b)[0, 0]
        return (row @ forth)[0, 0], in_value, loop.loop.slope(frequency)

    m = loop.margins()
    changes |= dict.fromkeys(MARGIN_METRICS, math.nan)
    if math.isfinite(m.gain_margin):
        at, in_value, in_frequency = response(m.gain_margin_frequency_hz)
        if m.gain_margin_frequency_hz < 0.5 / dt:  # at the Nyquist frequency L is always real
            in_value -= in_frequency * in_value.imag / in_frequency.imag
        changes["gain_margin"] = in_value.real / at.real**2
    for name, frequency in (
        ("phase_margin_deg", m.phase_margin_frequency_hz),
        ("delay_margin_s", m.delay_margin_frequency_hz),
    ):
        if not math.isfinite(frequency):
            continue
        at, in_value, in_frequency = response(frequency)
        # The crossing frequency shifts such that |L| = 1.
        shift = -(in_value / at).real / (in_frequency / at).real
        turn = ((in_value + in_frequency * shift) / at).imag
        if name == "delay_margin_s":
            turn = (turn / (2.0 * np.pi) - m.delay_margin_s * shift) / frequency
        changes[name] = turn if name == "delay_margin_s" else math.degrees(turn)
    at, in_value, _ = response(
        m.disk_margin_frequency_hz
    )  # at a minimum a shift of the frequency has no effect
    changes["disk_margin"] = m.disk_margin * (2.0 * in_value / (1.0 - at * at)).real
    return {name: float(value) for name, value in changes.items()}
