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
from kneexo.analysis.frequency.bandwidth import speed_limit_reached_hz
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.analysis.signals import rms, to_rpm
from kneexo.analysis.tracking.tracking import mean_change
from kneexo.common.result import Array, Result
from kneexo.parameters import G4, RodPolynomialParameters, Scenario, SineReference
from kneexo.parameters.paths import changed
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
        numbers: dict[str, Any] = {
            "table1": _table_1(self.fit),
            "table1_g4": _table_1_of_g4(),
            "fig9": _fig_9(self.fig9),
            "fig12": {name: _fig_12(tracked) for name, tracked in self.fig12.items()},
            "fig12_start": start_errors(self.fig12["smc"]),
            "fig13": _fig_13(self.fig13),
            "scaling": _scaling(self.scaling),
            "speed_limit": speed_demand(),
            "eq27_exact_states": {name: _eq_27_exact(run) for name, run in self.eq27_exact.items()},
            "eq27_differences": {
                name: _eq_27_differences(tracked) for name, tracked in self.eq27_differences.items()
            },
        }
        return numbers | {"comparison": [row.as_dict() for row in compared(numbers)]}


@dataclass(frozen=True)
class _Group:
    """Scenarios that one function runs for one figure."""

    run: Callable[[Scenario], Any]
    scenarios: Mapping[str, Scenario]


_GROUPS = {
    "fig9": _Group(
        partial(simulate, signals=("rod_reference", "rod_extension")), {"ideal_smc": IDEAL_SMC}
    ),
    "fig12": _Group(track, FIG_12),
    "eq27_exact": _Group(
        partial(simulate, signals=("load_pressure", "motor_speed_command")), EQ_27_EXACT_STATES
    ),
    "eq27_differences": _Group(track, EQ_27_DIFFERENCES),
}
"""Dictionary from a field of `ReproduceResult` to its runs."""


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
        `kneexo.studies.paper`, and run with the linkage and the engine of the scenario given here.
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
    linkage = scenario.plant.linkage

    def alike(case: Scenario) -> Scenario:
        return changed(case, {"plant.linkage": linkage}).with_engine(engine)

    tasks = {
        (figure, name): partial(group.run, alike(case))
        for figure, group in _GROUPS.items()
        for name, case in group.scenarios.items()
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
            scaling[name] = measure(alike(case), narrow, trials=[{}])
    runs: dict[str, dict[str, Any]] = {figure: {} for figure in _GROUPS}
    for (figure, name), value in zip(tasks, values, strict=True):
        runs[figure][name] = value
    return ReproduceResult(
        fit=fit_polynomials(linkage),
        fig9=runs["fig9"]["ideal_smc"],
        fig12=runs["fig12"],
        fig13=response,
        scaling=scaling,
        eq27_exact=runs["eq27_exact"],
        eq27_differences=runs["eq27_differences"],
    )


# --------------------------------------------------------------------------------- numbers


def _table_1(fit: PolynomialFit) -> dict[str, Any]:
    """Return how Table 1 fits the linkage, and the polynomials of ``fit`` in its place."""
    table_p_mm_deg = RodPolynomialParameters().p_mm_deg
    x_10_mm, x_70_mm = (float(np.polyval(table_p_mm_deg, angle)) for angle in (10.0, 70.0))
    return {
        "x_at_10deg_mm": x_10_mm,
        "x_at_70deg_mm": x_70_mm,
        "linkage_rmse_mm": rms(fit.table_p_error_mm),
        "linkage_max_mm": float(np.max(np.abs(fit.table_p_error_mm))),
        "refit_p_mm_deg": fit.p_mm_deg,
        "refit_p_rmse_mm": rms(fit.p_error_mm),
        "refit_p_sse_mm2": fit.p_sse_mm2,
        "refit_q_sse_deg2": fit.q_sse_deg2,
        "strokes_per_period_mm": 2.0 * (x_10_mm - x_70_mm),
        "refit_q_deg_mm": fit.q_deg_mm,
        "refit_q_rmse_deg": rms(fit.q_error_deg),
        "table_q_rmse_deg": rms(fit.table_q_error_deg),
    }


def _table_1_of_g4() -> dict[str, float]:
    """Return the errors of polynomials that are fitted to the geometry G4 as in Fig. 5.

    The paper does not print the points of Fig. 5. They begin at about 5°.
    """
    fit = fit_polynomials(G4, start_deg=5.0, samples=FIG_5_POINTS)
    return {
        "refit_p_sse_mm2": fit.p_sse_mm2,
        "refit_q_sse_deg2": fit.q_sse_deg2,
        "refit_p_rmse_mm": math.sqrt(fit.p_sse_mm2 / fit.degrees_of_freedom),
        "refit_q_rmse_deg": math.sqrt(fit.q_sse_deg2 / fit.degrees_of_freedom),
    }


def _fig_9(run: Run) -> dict[str, float]:
    """Return the magnitude of the rod's position error at the start, after 1 s and at the end."""
    error_mm = rod_error_mm(run)
    return {
        "initial_error_mm": float(abs(error_mm[0])),
        "error_after_1s_mm": float(abs(np.interp(1.0, run.time_s, error_mm))),
        "final_error_mm": float(abs(error_mm[-1])),
    }


def _fig_12(tracked: TrackingResult) -> dict[str, Any]:
    """Return the metrics of a run, and the parameters of its controller that are no defaults."""
    controller = tracked.scenario.controller.model_dump(exclude_defaults=True)
    return asdict(tracked.metrics) | {"controller": controller}


def _fig_13(response: FrequencyResponse) -> dict[str, Any]:
    """Return the mean frequency response of the trials, and the gain of each trial."""
    return {
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
    }


def _scaling(responses: Mapping[str, FrequencyResponse]) -> dict[str, dict[str, float]]:
    """Return the bandwidth of each changed setup, and its ratio to the nominal bandwidth."""
    nominal_hz = responses["nominal"].bandwidth_hz
    return {
        name: {"bandwidth_hz": response.bandwidth_hz, "ratio": response.bandwidth_hz / nominal_hz}
        for name, response in responses.items()
    }


def _eq_27_exact(run: Run) -> dict[str, float]:
    """Return how Eq. 27 with exact states behaves at 2 ms."""
    change_rad_s = mean_change(run["motor_speed_command_rad_s"])
    return {
        "growth_rate_per_s": growth_rate(run),
        "mean_command_change_rpm": to_rpm(change_rad_s),
    }


def _eq_27_differences(tracked: TrackingResult) -> dict[str, float]:
    """Return how Eq. 27 with differences of encoder readings behaves at 2 ms."""
    return {
        "max_error_deg": tracked.metrics.max_error_deg,
        "rms_error_deg": tracked.metrics.rms_error_deg,
        "mean_command_change_rpm": tracked.metrics.mean_command_change_rpm,
    }


def rod_error_mm(run: Run) -> Array:
    """Return the rod's position error e = x − x_d in mm, (n,)."""
    return np.asarray(1e3 * (run["rod_extension_m"] - run["rod_reference_m"]))


def start_errors(tracked: TrackingResult) -> dict[str, float]:
    """Return the largest errors in deg in the first quarter period of the sine, and afterwards."""
    run = tracked.run
    error_deg = np.abs(np.degrees(run["knee_angle_rad"] - run["knee_reference_rad"]))
    in_first_quarter = run.time_s <= 0.25 / SineReference().frequency_hz
    return {
        "first_quarter_period_deg": float(error_deg[in_first_quarter].max()),
        "later_deg": float(error_deg[~in_first_quarter].max()),
    }


def speed_demand() -> dict[str, float]:
    """Return what the paper's sine asks of the motor, by Eq. 10 between knee and rod.

    The first number is the peak motor speed in rpm at the frequency of the paper. The second number
    is the frequency in Hz at which the peak motor speed of the same sine equals the speed limit of
    the motor.
    """
    scenario = changed(Scenario(), {"plant.rod_map": "polynomial"})
    reached_hz = speed_limit_reached_hz(scenario)
    limit_rpm = to_rpm(scenario.plant.pump.speed_limit_rad_s)
    # The peak speed of a sine is proportional to its frequency.
    return {
        "peak_speed_demand_at_0.1hz_rpm": SineReference().frequency_hz / reached_hz * limit_rpm,
        "saturation_from_hz": reached_hz,
    }


def growth_rate(run: Run) -> float:
    """Return the exponential growth rate in 1/s of the load pressure's oscillation.

    Only the second half of the run counts.
    """
    second_half = run.time_s >= 0.5 * run.time_s[-1]
    time_s, pressure_pa = run.time_s[second_half], run["load_pressure_pa"][second_half]
    blocks = np.array_split(np.arange(time_s.size), 10)
    # The tiny term keeps the logarithm finite where the pressure does not move at all.
    log_amplitudes = [np.log(np.std(pressure_pa[block]) + 1e-12) for block in blocks]
    centres_s = [float(np.mean(time_s[block])) for block in blocks]
    return float(np.polyfit(centres_s, log_amplitudes, 1)[0])


FIG_12_TITLES = {
    "smc": "sliding-mode control",
    "pid": "PID as in the paper (P, 5 1/s)",
    "pid_tuned": "PID, tuned",
}
"""Dictionary from a controller's name in `FIG_12` to its title in the figure.

The figure shows only these controllers.
"""
