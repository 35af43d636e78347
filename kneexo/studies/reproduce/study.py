"""Compute the paper's figures and numbers with kneexo (``kneexo reproduce``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from kneexo.analysis import (
    FrequencyResponse,
    PolynomialFit,
    Run,
    TrackingResult,
    fit_polynomials,
    simulate,
    sinestream,
    track,
)
from kneexo.analysis.bandwidth import speed_limit_reached_hz
from kneexo.analysis.frequency_response import SinestreamSettings
from kneexo.analysis.signals import rms, to_rpm
from kneexo.analysis.tracking import mean_change
from kneexo.parameters import G4, RodPolynomialParameters, Scenario, SineReference
from kneexo.parameters.paths import changed
from kneexo.result import Array, Result
from kneexo.simulation import needs_runs
from kneexo.studies.paper import (
    EQ_27_DIFFERENCES,
    EQ_27_EXACT_STATES,
    FIG_12,
    FIG_13_SCALING,
    IDEAL_SMC,
)
from kneexo.studies.reproduce.comparison import compared
from kneexo.sweeps import open_sweep

ReproduceSettings = SinestreamSettings
"""Settings of the sinestream that measures Fig. 13, the only settings of this study."""

FIG_5_POINTS = 204
"""Number of points fitted in Fig. 5: SSE/RMSE² = 198 as printed, plus the six coefficients."""


@dataclass(frozen=True, repr=False)
class ReproduceResult(Result):
    """Fits, runs and frequency responses behind the paper's figures."""

    fit: PolynomialFit
    fig9: Run
    fig12: Mapping[str, TrackingResult]
    fig13: FrequencyResponse
    scaling: Mapping[str, FrequencyResponse]
    eq27_exact: Mapping[str, Run]
    eq27_differences: Mapping[str, TrackingResult]

    def results(self) -> dict[str, Any]:
        """Return the numbers of all figures as plain data, with units in the names."""
        table = RodPolynomialParameters()
        fit, error = self.fit, rod_error_mm(self.fig9)
        peak_rpm, saturation_hz = speed_demand()
        response = self.fig13
        g4 = fit_polynomials(G4, start_deg=5.0, samples=FIG_5_POINTS)
        numbers = {
            "table1": {
                "x_at_10deg_mm": float(np.polyval(table.p_mm_deg, 10.0)),
                "x_at_70deg_mm": float(np.polyval(table.p_mm_deg, 70.0)),
                "linkage_rmse_mm": rms(fit.table_p_error_mm),
                "linkage_max_mm": float(np.max(np.abs(fit.table_p_error_mm))),
                "refit_p_mm_deg": fit.p_mm_deg,
                "refit_p_rmse_mm": rms(fit.p_error_mm),
                "refit_p_sse_mm2": fit.p_sse_mm2,
                "refit_q_sse_deg2": fit.q_sse_deg2,
                "strokes_per_period_mm": 2.0
                * float(np.polyval(table.p_mm_deg, 10.0) - np.polyval(table.p_mm_deg, 70.0)),
                "refit_q_deg_mm": fit.q_deg_mm,
                "refit_q_rmse_deg": rms(fit.q_error_deg),
                "table_q_rmse_deg": rms(fit.table_q_error_deg),
            },
            "table1_g4": {
                "refit_p_sse_mm2": g4.p_sse_mm2,
                "refit_q_sse_deg2": g4.q_sse_deg2,
                "refit_p_rmse_mm": math.sqrt(g4.p_sse_mm2 / g4.degrees_of_freedom),
                "refit_q_rmse_deg": math.sqrt(g4.q_sse_deg2 / g4.degrees_of_freedom),
            },
            "fig9": {
                "initial_error_mm": float(abs(error[0])),
                "error_after_1s_mm": float(abs(np.interp(1.0, self.fig9.time_s, error))),
                "final_error_mm": float(abs(error[-1])),
            },
            "fig12": {
                name: asdict(tracked.metrics)
                | {"controller": tracked.scenario.controller.model_dump(exclude_defaults=True)}
                for name, tracked in self.fig12.items()
            },
            "fig12_start": start_errors(self.fig12["smc"]),
            "fig13": {
                "frequencies_hz": response.frequencies_hz,
                "gain": response.gain,
                "phase_deg": response.phase_deg,
                "bandwidth_hz": response.bandwidth_hz,
                "phase_at_bandwidth_deg": response.phase_at_bandwidth_deg,
                "gain_spread": np.ptp(np.abs(response.response), axis=0),
                "trials": [
                    {"values": trial, "gain": np.abs(values)}
                    for trial, values in zip(response.trials, response.response, strict=True)
                ],
            },
            "scaling": {
                name: {
                    "bandwidth_hz": scaled.bandwidth_hz,
                    "ratio": scaled.bandwidth_hz / self.scaling["nominal"].bandwidth_hz,
                }
                for name, scaled in self.scaling.items()
            },
            "speed_limit": {
                "peak_speed_demand_at_0.1hz_rpm": peak_rpm,
                "saturation_from_hz": saturation_hz,
            },
            "eq27_exact_states": {
                name: {
                    "growth_rate_per_s": growth_rate(run),
                    "mean_command_change_rpm": to_rpm(
                        mean_change(run["motor_speed_command_rad_s"])
                    ),
                }
                for name, run in self.eq27_exact.items()
            },
            "eq27_differences": {
                name: {
                    "max_error_deg": tracked.metrics.max_error_deg,
                    "rms_error_deg": tracked.metrics.rms_error_deg,
                    "mean_command_change_rpm": tracked.metrics.mean_command_change_rpm,
                }
                for name, tracked in self.eq27_differences.items()
            },
        }
        return numbers | {"comparison": [row.as_dict() for row in compared(numbers)]}


_RUNS: tuple[tuple[str, Callable[[Scenario], Any], Mapping[str, Scenario]], ...] = (
    ("fig9", partial(simulate, signals=("rod_reference", "rod_extension")), {"": IDEAL_SMC}),
    ("fig12", track, FIG_12),
    (
        "exact",
        partial(simulate, signals=("load_pressure", "motor_speed_command")),
        EQ_27_EXACT_STATES,
    ),
    ("differences", track, EQ_27_DIFFERENCES),
)


@needs_runs
def _call(task: partial[Any]) -> Any:
    return task()


def _cost(task: partial[Any]) -> float:
    """Estimate a run's number of solver steps, so that the workers get equal amounts of work."""
    scenario = task.args[0]
    return scenario.duration_s / scenario.simulation.step_s


def reproduce_study(
    scenario: Scenario = Scenario(),
    settings: ReproduceSettings = ReproduceSettings(),
    *,
    workers: int | None = 1,
    executor: Executor | None = None,
    progress: bool = False,
) -> ReproduceResult:
    """Reproduce the figures and tables of the paper.

    Parameters
    ----------
    scenario
        The scenario of Fig. 13. The scenarios of the other figures come from
        `kneexo.studies.paper`, and run with the engine of the scenario given here.
    settings
        The sines that measure Fig. 13.
    workers
        Number of processes that share the runs of Drake's Simulator, as in
        `kneexo.sweeps.SweepOptions`. The compiled engine needs only a second and ignores the
        number.
    executor
        An executor that gets the runs of either engine.
    progress
        Whether progress bars are shown.
    """
    engine: Literal["compiled", "drake"] = "compiled" if scenario.simulation.compiled else "drake"
    tasks = {
        (key, name): partial(run, case.with_engine(engine))
        for key, run, cases in _RUNS
        for name, case in cases.items()
    }
    processes = workers if engine == "drake" else 1
    with open_sweep(workers=processes, executor=executor, progress=progress) as sweep:
        values = sweep.map(
            _call, list(tasks.values()), "Fig. 9, Fig. 12, Eq. 27 at 2 ms", weight=_cost
        )
        measure = partial(sinestream, executor=sweep.executor, progress=progress)
        response = measure(scenario, settings)
        scaling = {}
        for name, (case, narrow) in FIG_13_SCALING.items():
            scaled = case.with_engine(engine)
            scaling[name] = measure(scaled, narrow, trials=[{}])
    by_task = dict(zip(tasks, values, strict=True))

    def group(key: str) -> dict[str, Any]:
        return {name: value for (kind, name), value in by_task.items() if kind == key}

    return ReproduceResult(
        fit=fit_polynomials(),
        fig9=by_task["fig9", ""],
        fig12=group("fig12"),
        fig13=response,
        scaling=scaling,
        eq27_exact=group("exact"),
        eq27_differences=group("differences"),
    )


# --------------------------------------------------------------------------------- numbers


def rod_error_mm(run: Run) -> Array:
    """Return the rod's position error e = x − x_d in mm, (n,)."""
    return np.asarray(1e3 * (run["rod_extension_m"] - run["rod_reference_m"]))


def start_errors(tracked: TrackingResult) -> dict[str, float]:
    """Return the largest errors in deg in the first quarter period of the sine, and afterwards."""
    run = tracked.run
    error = np.abs(np.degrees(run["knee_angle_rad"] - run["knee_reference_rad"]))
    first = run.time_s <= 0.25 / SineReference().frequency_hz
    return {
        "first_quarter_period_deg": float(error[first].max()),
        "later_deg": float(error[~first].max()),
    }


def speed_demand() -> tuple[float, float]:
    """Return what the paper's sine asks of the motor: a peak speed, and a highest frequency.

    The first number is the peak motor speed in rpm at the frequency of the paper. The second is
    the frequency in Hz at which the peak motor speed of the same sine equals the speed limit of
    the motor. Eq. 10 relates knee and rod.
    """
    scenario = changed(Scenario(), {"plant.rod_map": "polynomial"})
    reached_hz = speed_limit_reached_hz(scenario)
    share = SineReference().frequency_hz / reached_hz
    return share * to_rpm(scenario.plant.pump.speed_limit_rad_s), reached_hz


def growth_rate(run: Run) -> float:
    """Return the exponential growth rate in 1/s of the load pressure's oscillation.

    Only the second half of the run counts.
    """
    half = run.time_s >= 0.5 * run.time_s[-1]
    time, pressure = run.time_s[half], run["load_pressure_pa"][half]
    blocks = np.array_split(np.arange(time.size), 10)
    level = [np.log(np.std(pressure[block]) + 1e-12) for block in blocks]
    centre = [float(np.mean(time[block])) for block in blocks]
    return float(np.polyfit(centre, level, 1)[0])


FIG_12_TITLES = {
    "smc": "sliding-mode control",
    "pid": "PID as in the paper (P, 5 1/s)",
    "pid_tuned": "PID, tuned",
}
"""Dictionary from a controller's name in `FIG_12` to its title in the figure.

The figure shows only these controllers.
"""
