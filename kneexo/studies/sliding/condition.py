"""The sliding condition s·ds/dt ≤ −η|s| in one run, and the bounds on the error.

Symbols are those of Eq. 15–27: x is the rod's position in m, e = x − x_d its error, Φ the width of
the boundary layer, b the gain from motor speed to x⃛ and b̂ the controller's value of b, ω̂ the
hydraulic natural frequency of the nominal plant.

The true s is ë + 2λė + λ²e, so ds/dt = x⃛ − x⃛_d + 2λë + λ²ė. AutoDiff differentiates the rod's
acceleration along the flow of the plant's equations; this gives x⃛ exactly at each logged state.
Whether the condition holds at a state thus does not depend on the solver.

On a plant with another loaded area A_i, gain b and a motor without lag, outside the layer,

    ds/dt = (b/b̂)[ω̂²(1 − A_i/Ā) ẋ − k sgn s] + (b/b̂ − 1)(x⃛_d − 2λë − λ²ė),

so the condition requires k ≥ ω̂²|1 − A_i/Ā||ẋ| + |1 − b̂/b||x⃛_d − 2λë − λ²ė| + (b̂/b) η. Eq. 27
lacks the first term, and bounds b̂/b by the masses alone. In full order one chamber is stiff and its
volume V_i follows the rod. Then b̂/b = (m/m̂)(Ā/A_i)(4V_i/V_t), as if the mass changed.

Inside the layer, |s| ≤ Φ implies |e| ≤ Φ/λ² after the initial transient (Slotine). `error_bounds`
includes the initial transient.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from pydrake.autodiffutils import AutoDiffXd

from kneexo.analysis.hardware import sliding_mode
from kneexo.diagrams import SIGNALS, make_plant
from kneexo.diagrams.plant import plant_parts
from kneexo.errors import SimulationError
from kneexo.parameters import (
    PlantParameters,
    Scenario,
)
from kneexo.parameters.paths import changed
from kneexo.result import Array
from kneexo.rod_polynomial import controller_polynomial
from kneexo.simulation import Run, awaitable, needs_runs, simulate
from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings
from kneexo.systems.sliding_mode_controller import sliding_variable

_ROUNDING = 1e-6
"""Relative tolerance of the checks, for conditions that hold with equality."""


_TRACE_POINTS = 600


_SHORTEST = 20
"""Number of samples of the shortest run that is evaluated."""


@dataclass(frozen=True)
class SlidingTrace:
    """Signals of a run for figures, thinned to at most 600 samples each."""

    time_s: Sequence[float]
    """Times in s of ``s_m_s2``, ``error_m`` and ``bound_m``."""
    s_m_s2: Sequence[float]
    """The sliding variable s in m/s²."""
    error_m: Sequence[float]
    """The rod's error e in m."""
    bound_m: Sequence[float]
    """The bound on |e| in m by `error_bounds`; nan where ``bounded_share`` does not count."""
    outside_time_s: Sequence[float]
    """Times in s of ``reaching_rate_m_s3``; empty if no sample is outside the layer."""
    reaching_rate_m_s3: Sequence[float]
    """sgn(s)·ds/dt in m/s³ of the samples outside the layer."""


@dataclass(frozen=True)
class SlidingMeasurement:
    """How far one run keeps the sliding condition and the bounds on the error.

    With a sampled law ds/dt is that just after an update of the command, if a field does not say
    otherwise.
    """

    outside_share: float
    """Share of the samples outside the layer, |s| > Φ."""
    holding_share: float
    """Share of the samples outside that fulfil s·ds/dt ≤ −η|s|; nan without such samples."""
    attracting_share: float
    """Share of the samples outside that fulfil s·ds/dt < 0; nan without such samples."""
    worst_rate_m_s3: float
    """Largest sgn(s)·ds/dt in m/s³ of the samples outside; nan without such samples."""
    held_share: float
    """``holding_share`` with ds/dt just before the next update; nan also for a continuous law."""
    mean_share: float
    """``holding_share`` with the mean of ds/dt up to the next update.

    It is nan also for a continuous law.
    """
    reaching_s: float
    """Time in s at which |s| ≤ Φ for the first time; nan if s does not reach the layer."""
    left_share: float
    """Share of samples outside from ``reaching_s`` on; nan if s does not reach the layer."""
    largest_s: float
    """Largest |s|/Φ from ``reaching_s`` on; nan if s does not reach the layer."""
    error_share: float
    """Largest |e| after the initial transient, relative to Φ/λ²; nan if the run ends before."""
    rate_share: float
    """Largest |ė| after the initial transient, relative to 2Φ/λ; nan if the run ends before."""
    acceleration_share: float
    """Largest |ë| after the initial transient, relative to 4Φ; nan if the run ends before."""
    bounded_share: float
    """Share of the samples with |e| within `error_bounds`, from ``reaching_s`` until s leaves.

    It is nan if s does not reach the layer.
    """
    largest_error_mm: float
    """Largest |e| in mm after the initial transient; nan if the run ends before."""
    failure: str
    """Reason why the run failed over its whole duration; empty if the run did not fail."""
    duration_s: float
    """Duration in s of the measured run: the scenario's, halved until the run does not fail."""
    promised_s: float
    """Time in s until s reaches the layer at the latest if the condition holds; 0 for η = 0."""
    trace: SlidingTrace
    """Signals for figures."""

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Return the measurement whose ``dataclasses.asdict`` is ``data``."""
        return cls(**{**data, "trace": SlidingTrace(**data["trace"])})


def plant_state_columns(plant: PlantParameters) -> tuple[tuple[str, float], ...]:
    """Return a pair for each continuous state of the plant, in the Context's order.

    The pair has the name of the run's column and the factor from its unit to the Context's unit.
    """
    states = (state for part in plant_parts(plant) for state in part.states)
    return tuple((state.column, 1.0 / state.factor) for state in states)


def sliding_signals(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the signals that `sliding_rates` needs."""
    states = {column for column, _ in plant_state_columns(scenario.plant)}
    return (
        *("rod_reference", "sliding_variable", "motor_speed_command"),
        *(name for name, columns in SIGNALS.items() if states.intersection(columns)),
    )


def sliding_rates(
    scenario: Scenario, run: Run, rows: Any, commands_rad_s: Array
) -> tuple[Array, Array]:
    """Return the true s in m/s² and ds/dt in m/s³, each (n,), at n ``rows`` of a run.

    ``commands_rad_s`` (n,) are the motor speed commands at these rows. The run must have the
    signals of `sliding_signals`. Raises `ParameterError` if the controller is no sliding mode.
    """
    lambda_ = sliding_mode(scenario).lambda_per_s
    plant: Any = make_plant(scenario.plant, table_1=controller_polynomial(scenario))
    automatic = plant.ToAutoDiffXd()
    context, seeded = plant.CreateDefaultContext(), automatic.CreateDefaultContext()
    rod_state = automatic.GetOutputPort("rod_state")
    state_columns = plant_state_columns(scenario.plant)
    states = np.stack([factor * run[name] for name, factor in state_columns], axis=1)
    reference = np.stack(
        [
            run[f"rod_reference_{name}"]
            for name in ("m", "velocity_m_s", "acceleration_m_s2", "jerk_m_s3")
        ]
    )
    s, s_rate = np.empty(len(rows)), np.empty(len(rows))
    for index, (row, command) in enumerate(zip(rows, commands_rad_s, strict=True)):
        time, state = float(run.time_s[row]), states[row]
        context.SetTime(time)
        context.SetContinuousState(state)
        plant.GetInputPort("motor_speed_command").FixValue(context, [command])
        rates = plant.EvalTimeDerivatives(context).CopyToVector()
        # One direction is enough: along the flow, time included.
        seeded.SetTime(AutoDiffXd(time, [1.0]))
        seeded.SetContinuousState(
            [AutoDiffXd(x, [rate]) for x, rate in zip(state, rates, strict=True)]
        )
        motion = rod_state.Eval(seeded)
        here, there = reference[:, row], reference[1:, row]
        s[index] = sliding_variable([x.value() for x in motion], here, lambda_)
        s_rate[index] = sliding_variable([x.derivatives()[0] for x in motion], there, lambda_)
    return s, s_rate


def error_bounds(
    time_s: Array, error_m: float, rate_m_s: float, *, lambda_per_s: float, phi_m_s2: float
) -> tuple[Array, Array]:
    """Return bounds on |e| in m and on |ė| in m/s at ``time_s``, each (n,), while |s| ≤ Φ.

    ``error_m`` and ``rate_m_s`` are e and ė at the first time. The bounds follow from
    (d/dt + λ)² e = s. Each bound is the free motion plus Φ times the integral of the absolute
    impulse response. This integral part tends to Φ/λ² for e and to 2Φ/(exp(1)·λ) for ė. For
    comparison, Slotine's bound on ė is 2Φ/λ.
    """
    z = lambda_per_s * (time_s - time_s[0])
    decay, slope = np.exp(-z), rate_m_s / lambda_per_s + error_m
    free = np.abs(decay * (error_m + slope * z))
    free_rate = lambda_per_s * np.abs(decay * (slope - error_m - slope * z))
    rise = 1.0 - decay * (1.0 + z)
    rate_rise = np.where(z < 1.0, z * decay, 2.0 / math.e - z * decay)
    return (
        np.asarray(free + phi_m_s2 / lambda_per_s**2 * rise),
        np.asarray(free_rate + phi_m_s2 / lambda_per_s * rate_rise),
    )


@needs_runs
async def check_sliding(
    settings: SlidingSettings, scenario: Scenario = SLIDING_LAW
) -> dict[str, Any]:
    """Run a scenario; return its `SlidingMeasurement` as plain data, which a checkpoint can store.

    A run that fails is repeated over half the time until it does not fail.
    """
    law = sliding_mode(scenario)
    run, failure = await _longest_run(scenario)
    command = run["motor_speed_command_rad_s"]
    if not law.continuous:
        command = command[1:]  # a sample's log has the command that was held before the sample
    rows = np.arange(command.size)
    if scenario.estimator.kind == "exact":
        s = run["sliding_variable_m_s2"][rows]
    else:
        s, _ = sliding_rates(scenario, run, rows, command)
    error = (run["rod_extension_m"] - run["rod_reference_m"])[rows]
    rate = (run["rod_velocity_m_s"] - run["rod_reference_velocity_m_s"])[rows]
    time, phi, lambda_ = run.time_s[rows], law.phi_m_s2, law.lambda_per_s
    outside = np.abs(s) > phi

    chosen = _thinned(np.flatnonzero(outside), settings.rated_samples)
    eta = law.eta_m_s3 * (1.0 - _ROUNDING)
    reaching_rate = _reaching_rate(scenario, run, chosen, command[chosen])
    # Only a sampled law has updates, thus a rate before the next update.
    inner = chosen[:0] if law.continuous else chosen[chosen < rows.size - 1]
    held_rate = _reaching_rate(scenario, run, inner + 1, command[inner])
    mean_rate = np.sign(s[inner]) * (s[inner + 1] - s[inner]) / law.sample_time_s

    reached = time.size if outside.all() else int(np.argmin(outside))
    again = outside[reached:]
    left = reached + int(np.argmax(again)) if again.any() else time.size
    inside = slice(reached, left)
    reaching_s, bound = math.nan, np.full(time.size, math.nan)
    if reached < time.size:
        reaching_s = float(time[reached])
        bound[inside], _ = error_bounds(
            time[inside],
            float(error[reached]),
            float(rate[reached]),
            lambda_per_s=lambda_,
            phi_m_s2=phi,
        )
    late = time >= reaching_s + settings.settling_factor / lambda_
    acceleration = s[late] - 2.0 * lambda_ * rate[late] - lambda_**2 * error[late]
    largest_error = _largest(np.abs(error[late]))

    points = _thinned(rows, _TRACE_POINTS)
    shown = np.linspace(0, chosen.size - 1, min(chosen.size, _TRACE_POINTS)).astype(int)
    measurement = SlidingMeasurement(
        outside_share=_share(outside),
        holding_share=_share(reaching_rate <= -eta),
        attracting_share=_share(reaching_rate < 0.0),
        worst_rate_m_s3=_largest(reaching_rate),
        held_share=_share(held_rate <= -eta),
        mean_share=_share(mean_rate <= -eta),
        reaching_s=reaching_s,
        left_share=_share(again),
        largest_s=_largest(np.abs(s[reached:])) / phi,
        error_share=largest_error * lambda_**2 / phi,
        rate_share=_largest(np.abs(rate[late])) * lambda_ / (2.0 * phi),
        acceleration_share=_largest(np.abs(acceleration)) / (4.0 * phi),
        bounded_share=_share(np.abs(error[inside]) <= bound[inside] * (1.0 + _ROUNDING)),
        largest_error_mm=1e3 * largest_error,
        failure=failure,
        duration_s=float(run.time_s[-1]),
        promised_s=max(0.0, float(abs(s[0]) - phi)) / law.eta_m_s3 if law.eta_m_s3 else 0.0,
        trace=SlidingTrace(
            time_s=time[points].tolist(),
            s_m_s2=s[points].tolist(),
            error_m=error[points].tolist(),
            bound_m=bound[points].tolist(),
            outside_time_s=time[chosen[shown]].tolist(),
            reaching_rate_m_s3=reaching_rate[shown].tolist(),
        ),
    )
    return asdict(measurement)


async def _longest_run(scenario: Scenario) -> tuple[Run, str]:
    """Halve a run's duration until the run does not fail. Return the run and the first failure.

    The failure is an empty text if the first run succeeds.
    """
    failure, duration = "", scenario.duration_s
    while True:
        shortened = changed(scenario, {"simulation.duration_s": duration})
        try:
            run = await awaitable(simulate, shortened, signals=sliding_signals(scenario))
            return run, failure
        except SimulationError as error:
            failure = failure or str(error)
            duration *= 0.5
            if duration < _SHORTEST * scenario.controller.sample_time_s:
                raise


def _reaching_rate(scenario: Scenario, run: Run, rows: Array, command: Array) -> Array:
    """Return sgn(s)·ds/dt at rows outside the boundary layer |s| ≤ Φ.

    The sliding condition requires a value of at most −η.
    """
    s, s_rate = sliding_rates(scenario, run, rows, command)
    return np.asarray(np.sign(s) * s_rate)


def _share(fulfilled: Any) -> float:
    """Return the share of the true samples; nan without samples."""
    return float(np.mean(fulfilled)) if fulfilled.size else math.nan


def _largest(values: Array) -> float:
    """Return the largest value; nan without values."""
    return float(np.max(values)) if values.size else math.nan


def _thinned(rows: Any, largest: int) -> Any:
    """Return at most ``largest`` of the rows.

    Half of the result are the first rows. The other half is spread evenly over the other rows.
    """
    if rows.size <= largest:
        return rows
    half = largest // 2
    spread = np.linspace(half, rows.size - 1, largest - half).astype(int)
    return np.concatenate([rows[:half], rows[spread]])
