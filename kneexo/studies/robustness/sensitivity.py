"""Derivatives of tracking error and stability margins of one scenario by central differences.

The values of the plant vary, and the controller keeps its nominal plant. The quantizers of encoder
and bus are bypassed, because a rounded number jumps or does not change at all. The root mean square
of the error is differentiated, because the largest error has no derivative where it jumps from one
peak to another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.signals import rms, settled_s
from kneexo.common.result import Array, Result
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.parameters.fields.fields import limits_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.paths import value_at
from kneexo.simulation import simulate
from kneexo.simulation.lockstep import map_in_lockstep
from kneexo.studies.assessment import MARGIN_METRICS
from kneexo.systems.knee_reference import run_middle_deg

_DIFFERENTIABLE = (
    "plant.pump.",
    "plant.cylinder.",
    "plant.load.",
    "plant.full_order.",
    "encoder.mounting_error_rad",
)

# The differences of a step of 1e-4 lose 1e-8 of the metric by curvature and 1e-8 by rounding.
_RELATIVE_STEP = 1e-4
_LEAST_STEP = 1e-6
"""Smallest step as a share of the largest allowed value, for a value that is zero or tiny."""
_AGREEMENT = 0.01
_NOISE = 1e-10
"""Relative error of a metric by rounding, far below the effect of a value that matters."""


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
    """Whether there are sensitivities with respect to the scenario's value at ``path``.

    True for real numbers of pump, cylinder (also of full order) and load, and for the mounting
    error of the encoder. False for choices, for whole numbers and for the linkage. The numbers of a
    linkage were fitted together, so no number of it changes alone.
    """
    return path.startswith(_DIFFERENTIABLE) and isinstance(value_at(scenario, path), float)


def tracking_sensitivities(
    scenario: Scenario, paths: Sequence[str], *, duration_s: float | None = None
) -> Sensitivities:
    """Return the RMS tracking error ``rms_error_deg`` and its gradient.

    The error counts as in ``rms_error_deg`` of `TrackingMetrics`. The engine of
    ``scenario.simulation`` runs the scenario once, and four times for each path.

    Parameters
    ----------
    scenario
        Plant, controller and reference.
    paths
        Dotted names of values of the plant, for which `differentiable` holds. A derivative is nan
        if two step sizes disagree by more than 1 %, for example where the metric jumps.
    duration_s
        Duration of a run. None: the duration in the scenario.

    Raises
    ------
    ParameterError
        A path has no derivative.
    SimulationError
        A run diverges or leaves its range.
    """
    if duration_s is not None:
        scenario = scenario.changed({"simulation.duration_s": duration_s})
    settled = round(settled_s(scenario) / scenario.controller.sample_time_s)
    run = partial(simulate, signals=("knee_reference", "knee_angle"))

    def measure(scenarios: Sequence[Scenario]) -> list[dict[str, float]]:
        sizes = [math.nan] * len(scenarios)
        for index, signals in map_in_lockstep(run, scenarios):
            error = np.degrees(signals["knee_reference_rad"] - signals["knee_angle_rad"])
            sizes[index] = rms(error[settled:])
        return [{"rms_error_deg": size} for size in sizes]

    return _sensitivities(scenario, paths, measure)


def loop_sensitivities(scenario: Scenario, paths: Sequence[str]) -> Sensitivities:
    """Return margins of the sampled loop and their gradients in the values at ``paths``.

    The metrics are ``largest_eigenvalue``, the largest magnitude of an eigenvalue, and, for a
    stable loop, `MARGIN_METRICS`. The loop is linearized in the middle of the reference's range, at
    the equilibrium of each changed plant. A derivative is nan if its margin does not exist, or if
    two step sizes disagree by more than 1 %, for example where the metric jumps.

    Raises `ParameterError` for a path that has no derivative. Also raises the errors of
    `linearize_loop`.
    """

    def measure(scenarios: Sequence[Scenario]) -> list[dict[str, float]]:
        return [_loop_metrics(changed) for changed in scenarios]

    return _sensitivities(scenario, paths, measure)


def _loop_metrics(scenario: Scenario) -> dict[str, float]:
    loop = linearize_loop(scenario, knee_angle_deg=run_middle_deg(scenario))
    metrics = {"largest_eigenvalue": float(abs(loop.eigenvalues[0]))}
    if loop.stable:
        margins = loop.margins()
        metrics |= {name: getattr(margins, name) for name in MARGIN_METRICS}
    return metrics


def _sensitivities(
    scenario: Scenario,
    paths: Sequence[str],
    measure: Callable[[Sequence[Scenario]], list[dict[str, float]]],
) -> Sensitivities:
    """Return the sensitivities of the metrics that ``measure`` returns for each scenario.

    The quantizers are bypassed. An explicit nominal plant of the controller does not change when
    the plant varies. Raises `ParameterError` when ``paths`` is empty or a value is not
    `differentiable`.
    """
    if not paths:
        raise ParameterError("paths: there are none; a sensitivity needs at least one value")
    nominal = {"nominal": scenario.believed_plant}
    fixed = scenario.without_quantizers().model_copy(update=nominal)
    steps, around = [], []
    for path in paths:
        if not differentiable(fixed, path):
            raise ParameterError(
                f"{path}: has no derivative; known: numbers below {', '.join(_DIFFERENTIABLE)}"
            )
        names, value = path.split("."), value_at(fixed, path)
        holder = type(value_at(fixed, ".".join(names[:-1])))
        largest = limits_of(holder.model_fields[names[-1]])[1]
        step = max(_RELATIVE_STEP * abs(value), _LEAST_STEP * largest)
        steps.append(step)
        # Not validated, because a value at the end of its range also moves out of the range.
        around += [_with(fixed, names, value + count * step) for count in (1, -1, 2, -2)]
    metrics, *others = measure([fixed, *around])
    gradients = {}
    for name, size in metrics.items():
        values = np.array([other.get(name, math.nan) for other in others])
        gradients[name] = _derivatives(values.reshape(-1, 4), np.array(steps), size)
    return Sensitivities(paths=tuple(paths), metrics=metrics, gradients=gradients)


def _derivatives(values: Array, steps: Array, size: float) -> Array:
    """Return the derivatives (n,) of a metric, nan where two step sizes disagree.

    ``values`` (n, 4) has the metric after one step up, one step down, two steps up and two steps
    down. The two central differences are extrapolated to a step of zero (Richardson). ``size`` is
    the metric without a step.
    """
    with np.errstate(invalid="ignore"):  # an infinite margin has no derivative
        fine = (values[:, 0] - values[:, 1]) / (2.0 * steps)
        coarse = (values[:, 2] - values[:, 3]) / (4.0 * steps)
        allowed = np.maximum(_AGREEMENT * np.abs(fine), _NOISE * abs(size) / steps)
        return np.where(np.abs(fine - coarse) <= allowed, (4.0 * fine - coarse) / 3.0, math.nan)


def _with(holder: Any, names: Sequence[str], value: Any) -> Any:
    """Return a copy of nested parameters with ``value`` at the path ``names``; skip validation."""
    if not names:
        return value
    inner = _with(getattr(holder, names[0]), names[1:], value)
    assert isinstance(holder, Parameters)
    return holder.model_copy(update={names[0]: inner})
