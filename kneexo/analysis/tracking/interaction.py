"""Metrics of the interaction of wearer and exoskeleton in one run: torque, assistance, power."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kneexo.analysis.signals import periods_in
from kneexo.analysis.tracking.clauses import said
from kneexo.common.result import Array, Result
from kneexo.errors import ResultError
from kneexo.simulation import Run

INTERACTION_SIGNALS = ("interaction_torque", "wearer_motion")
"""Names of the signals that `interaction_metrics` requires."""

INTERACTION_METRICS = ("peak_torque_n_m", "rms_torque_n_m")
"""Names of the fields of `InteractionMetrics` that `kneexo.studies.assessment.assess` returns."""

TORQUE_SIGNALS = ("desired_torque", "moment_arm", "rod_force")
"""Names of the signals of `torque_error`."""


@dataclass(frozen=True, repr=False)
class InteractionMetrics(Result):
    """Metrics from ``start_s`` to ``end_s``, over T = ``end_s`` − ``start_s``.

    `interaction_metrics` computes them. τ_i is the torque of the wearer on the exoskeleton,
    positive in flexion.
    """

    start_s: float
    end_s: float
    rms_torque_n_m: float
    """√(∫τ_i² dt/T)."""
    mean_torque_n_m: float
    """∫|τ_i| dt/T."""
    peak_torque_n_m: float
    """Largest |τ_i|."""
    peak_time_s: float
    """Time of the largest |τ_i|."""
    assistance_ratio: float
    """−∫τ_i M dt/∫M² dt, the share of the biological moment M that the exoskeleton gives.

    The ratio is nan without a biological moment.
    """
    power_from_wearer_w: float
    """∫max(τ_i dθ_h/dt, 0) dt/T, mean power that the wearer gives to the exoskeleton."""
    power_to_wearer_w: float
    """∫max(−τ_i dθ_h/dt, 0) dt/T, mean power that the wearer gets from the exoskeleton."""

    @property
    def line(self) -> str:
        """One line with the metrics."""
        ratio = self.assistance_ratio
        assistance = "" if math.isnan(ratio) else f"; assistance ratio {ratio:.3g}"
        return (
            f"{said('wearer', **vars(self))} at {self.peak_time_s:.4g} s; the wearer gives "
            f"{self.power_from_wearer_w:.3g} W and gets {self.power_to_wearer_w:.3g} W{assistance}."
        )


def interaction_metrics(run: Run, *, period_s: float = 0.0) -> InteractionMetrics:
    """Return the `InteractionMetrics` of a run with a wearer.

    Parameters
    ----------
    run
        Run with the signals ``interaction_torque`` and ``wearer_motion``. The assistance ratio also
        requires ``biological_moment``.
    period_s
        Period of the motion. The metrics are those of the whole periods after the first period,
        which has the initial transient. If the period is 0, or the run is shorter than two periods,
        the metrics are those of the whole run.

    Raises
    ------
    ResultError
        The run lacks a signal, or has fewer than two samples.
    """
    torque, rate, time = run["interaction_torque_n_m"], run["wearer_rate_rad_s"], run.time_s
    if time.size < 2:
        raise ResultError(f"the run has {time.size} samples; must have at least 2")
    window = whole_periods(time, period_s)
    torque, rate, time = torque[window], rate[window], time[window]

    def mean(values: Array) -> float:
        return float(np.trapezoid(values, time) / (time[-1] - time[0]))

    ratio = math.nan
    if "biological_moment_n_m" in run.data:
        moment = run["biological_moment_n_m"][window]
        if (square := mean(moment**2)) > 0.0:
            ratio = -mean(torque * moment) / square
    largest = int(np.argmax(np.abs(torque)))
    return InteractionMetrics(
        start_s=float(time[0]),
        end_s=float(time[-1]),
        rms_torque_n_m=math.sqrt(mean(torque**2)),
        mean_torque_n_m=mean(np.abs(torque)),
        peak_torque_n_m=float(np.abs(torque[largest])),
        peak_time_s=float(time[largest]),
        assistance_ratio=ratio,
        power_from_wearer_w=mean(np.maximum(torque * rate, 0.0)),
        power_to_wearer_w=mean(np.maximum(-torque * rate, 0.0)),
    )


def whole_periods(time_s: Array, period_s: float) -> slice:
    """Return the samples of the whole periods after the first period.

    All samples are returned if the period is 0 or if ``time_s`` (n,) has less than two periods. The
    last period may lack its last sample, because a period may end between two samples.
    """
    span_s = time_s[-1] - time_s[0] + (time_s[1] - time_s[0])
    periods = periods_in(span_s, period_s)
    if periods < 2:
        return slice(None)
    ends = time_s[0] + period_s * np.array([1, periods])
    first, last = np.searchsorted(time_s, ends - 1e-9)
    return slice(int(first), int(last) + 1)


def torque_error(run: Run) -> Array:
    """Return desired minus actual torque of the actuator on the knee, τ_d + r F in N·m, (n,).

    The torque of the rod force F at the moment arm r is −r F. Raises `ResultError` if the run lacks
    one of the `TORQUE_SIGNALS`.
    """
    return np.asarray(run["desired_torque_n_m"] + run["moment_arm_m"] * run["rod_force_n"])
