"""The paper's figures and numbers, each beside what kneexo finds (``kneexo reproduce``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from kneexo.analysis import (
    FrequencyResponse,
    PolynomialFit,
    Run,
    TrackingResult,
    fit_polynomials,
    nominal_trial,
    parallel_map,
    process_pool,
    simulate,
    sinestream,
    track,
)
from kneexo.analysis.bandwidth import speed_limit_reached_hz
from kneexo.analysis.coroutines import Steps, steps
from kneexo.analysis.simulation import Array, needs_runs, rms, to_rpm
from kneexo.analysis.tracking import mean_change
from kneexo.parameters import (
    EQ_27_DIFFERENCES,
    EQ_27_EXACT_STATES,
    FIG_12,
    FIG_13_SCALING,
    G4,
    IDEAL_SMC,
    RodPolynomialParameters,
    Scenario,
    SineReference,
    SinestreamParameters,
)
from kneexo.result import Result
from kneexo.scenario import changed

PAPER_BANDWIDTH_HZ = 0.21
"""The paper's measured −3 dB bandwidth (Section 5, Fig. 13)."""


FIG_5_POINTS = 204
"""Points of the fits of Fig. 5: printed SSE over squared RMSE is 198, six coefficients beside."""


@dataclass(frozen=True, repr=False)
class Reproduction(Result):
    """Everything that ``kneexo reproduce`` computes; see `results` and `report`."""

    fit: PolynomialFit
    fig9: Run
    fig12: Mapping[str, TrackingResult]
    fig13: FrequencyResponse
    scaling: Mapping[str, FrequencyResponse]
    eq27_exact: Mapping[str, Run]
    eq27_differences: Mapping[str, TrackingResult]


@needs_runs
def _ideal(scenario: Scenario) -> Steps[Run]:
    return (yield from steps(simulate, scenario, signals=("rod_reference", "rod_extension")))


@needs_runs
def _hydraulic(scenario: Scenario) -> Steps[Run]:
    return (yield from steps(simulate, scenario, signals=("load_pressure", "motor_speed_command")))


_STUDIES: tuple[tuple[str, Callable[[Scenario], Any], Mapping[str, Scenario]], ...] = (
    ("fig9", _ideal, {"": IDEAL_SMC}),
    ("fig12", track, FIG_12),
    ("exact", _hydraulic, EQ_27_EXACT_STATES),
    ("differences", track, EQ_27_DIFFERENCES),
)


@needs_runs
def _call(task: partial[Any]) -> Steps[Any]:
    return (yield from steps(task))


def _cost(task: partial[Any]) -> float:
    """Steps of the solver, roughly."""
    simulation = task.args[0].simulation
    return simulation.duration_s / simulation.step_s


def reproduce(
    settings: SinestreamParameters = SinestreamParameters(),
    *,
    engine: Literal["compiled", "drake"] | None = None,
    workers: int | None = 1,
    executor: Executor | None = None,
    progress: bool = False,
) -> Reproduction:
    """Run every study of the paper.

    ``engine``: see `Scenario.with_engine`. ``workers`` (see `kneexo.analysis.parallel_map`) share
    the work of Drake's Simulator; compiled equations take a second without them. An ``executor``
    gets everything.
    """
    tasks = {
        (key, name): partial(run, case.with_engine(engine))
        for key, run, cases in _STUDIES
        for name, case in cases.items()
    }
    base = Scenario().with_engine(engine)
    if executor is not None:
        pool_of: AbstractContextManager[Executor | None] = nullcontext(executor)
    else:
        pool_of = process_pool(workers if engine == "drake" else 1)
    with pool_of as pool:
        values = parallel_map(
            _call,
            list(tasks.values()),
            executor=pool,
            description="Fig. 9, Fig. 12, Eq. 27 at 2 ms" if progress else None,
            weight=_cost,
        )
        response = sinestream(base, settings, executor=pool, progress=progress)
        scaling = {}
        for name, (case, own) in FIG_13_SCALING.items():
            scaled = case.with_engine(engine)
            trials = [nominal_trial(scaled)]
            scaling[name] = sinestream(scaled, own, trials=trials, executor=pool, progress=progress)
    done = dict(zip(tasks, values, strict=True))

    def group(key: str) -> dict[str, Any]:
        return {name: value for (kind, name), value in done.items() if kind == key}

    return Reproduction(
        fit=fit_polynomials(),
        fig9=done["fig9", ""],
        fig12=group("fig12"),
        fig13=response,
        scaling=scaling,
        eq27_exact=group("exact"),
        eq27_differences=group("differences"),
    )


# --------------------------------------------------------------------------------- numbers


def rod_error_mm(run: Run) -> Array:
    """E = x − x_d in mm, (n,)."""
    return np.asarray(1e3 * (run["rod_extension_m"] - run["rod_reference_m"]))


def speed_demand() -> tuple[float, float]:
    """Peak motor speed in rpm that the paper's reference asks for, by Eq. 10, and the frequency in
    Hz at which that peak is the speed limit.
    """
    scenario = changed(Scenario(), {"plant.rod_map": "polynomial"})
    reached_hz = speed_limit_reached_hz(scenario)
    share = SineReference().frequency_hz / reached_hz
    return share * to_rpm(scenario.plant.pump.speed_limit_rad_s), reached_hz


def growth_rate(run: Run) -> float:
    """Exponential growth rate in 1/s of the load pressure's oscillation over the second half."""
    half = run.time_s >= 0.5 * run.time_s[-1]
    time, pressure = run.time_s[half], run["load_pressure_pa"][half]
    blocks = np.array_split(np.arange(time.size), 10)
    level = [np.log(np.std(pressure[block]) + 1e-12) for block in blocks]
    centre = [float(np.mean(time[block])) for block in blocks]
    return float(np.polyfit(centre, level, 1)[0])


def results(done: Reproduction) -> dict[str, Any]:
    """The content of ``results.json``: plain numbers, units in the names."""
    table = RodPolynomialParameters()
    fit, error = done.fit, rod_error_mm(done.fig9)
    peak_rpm, saturation_hz = speed_demand()
    response = done.fig13
    g4 = fit_polynomials(G4, start_deg=5.0, samples=FIG_5_POINTS)
    return {
        "table1": {
            "x_at_10deg_mm": float(np.polyval(table.p_mm_deg, 10.0)),
            "x_at_70deg_mm": float(np.polyval(table.p_mm_deg, 70.0)),
            "linkage_rmse_mm": rms(fit.table_p_error_mm),
            "linkage_max_mm": float(np.max(np.abs(fit.table_p_error_mm))),
            "refit_p_mm_deg": fit.p_mm_deg,
            "refit_p_rmse_mm": rms(fit.p_error_mm),
            "refit_p_sse_mm2": float(np.sum(fit.p_error_mm**2)),
            "refit_q_sse_deg2": float(np.sum(fit.q_error_deg**2)),
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
            "error_after_1s_mm": float(abs(np.interp(1.0, done.fig9.time_s, error))),
            "final_error_mm": float(abs(error[-1])),
        },
        "fig12": {
            name: asdict(tracked.metrics)
            | {"controller": tracked.scenario.controller.model_dump(exclude_defaults=True)}
            for name, tracked in done.fig12.items()
        },
        "fig13": {
            "frequencies_hz": response.frequencies_hz,
            "gain": response.gain,
            "phase_deg": response.phase_deg,
            "bandwidth_hz": response.bandwidth_hz,
            "phase_at_bandwidth_deg": response.phase_at_bandwidth_deg,
            "gain_spread": np.ptp(np.abs(response.response), axis=0),
            "trials": [
                asdict(trial) | {"gain": np.abs(values)}
                for trial, values in zip(response.trials, response.response, strict=True)
            ],
        },
        "scaling": {
            name: {
                "bandwidth_hz": scaled.bandwidth_hz,
                "ratio": scaled.bandwidth_hz / done.scaling["nominal"].bandwidth_hz,
            }
            for name, scaled in done.scaling.items()
        },
        "speed_limit": {
            "peak_command_at_0.1hz_rpm": peak_rpm,
            "saturation_from_hz": saturation_hz,
        },
        "eq27_exact_states": {
            name: {
                "growth_rate_per_s": growth_rate(run),
                "mean_command_change_rpm": to_rpm(mean_change(run["motor_speed_command_rad_s"])),
            }
            for name, run in done.eq27_exact.items()
        },
        "eq27_differences": {
            name: {
                "max_error_deg": tracked.metrics.max_error_deg,
                "rms_error_deg": tracked.metrics.rms_error_deg,
                "mean_command_change_rpm": tracked.metrics.mean_command_change_rpm,
            }
            for name, tracked in done.eq27_differences.items()
        },
    }


# ---------------------------------------------------------------------------------- report


def _g4_rows(
    found: Mapping[str, float],
) -> list[tuple[str, str, float | None, float, str, str]]:
    """Rows of the report: quintics refitted to geometry G4."""
    note = "quintic fitted to geometry G4 over 5…90°, 198 degrees of freedom"
    return [
        ("SSE of x(θ_p), G4", "mm²", 0.1781, found["refit_p_sse_mm2"], "{:.4f}", note),
        ("SSE of θ_p(x), G4", "deg²", 1.241, found["refit_q_sse_deg2"], "{:.3f}", note),
        ("RMSE of x(θ_p), G4", "mm", 0.03, found["refit_p_rmse_mm"], "{:.4f}", note),
        ("RMSE of θ_p(x), G4", "deg", 0.0792, found["refit_q_rmse_deg"], "{:.4f}", note),
    ]


def report(numbers: Mapping[str, Any]) -> str:
    """The content of ``report.md``: each number of the paper beside ours.

    ``numbers``: what `results` returns.
    """
    table1, fig9, fig12, fig13 = (numbers[key] for key in ("table1", "fig9", "fig12", "fig13"))
    speed, scaling = numbers["speed_limit"], numbers["scaling"]
    table = RodPolynomialParameters()
    rows: list[tuple[str, str, float | None, float, str, str]] = [
        (
            "x at 10° (Section 5)",
            "mm",
            139.05,
            table1["x_at_10deg_mm"],
            "{:.2f}",
            "Eq. 10 with Table 1",
        ),
        (
            "x at 70° (Section 5)",
            "mm",
            38.98,
            table1["x_at_70deg_mm"],
            "{:.2f}",
            "Eq. 10 with Table 1, whose printed coefficients are rounded",
        ),
        (
            "rod travel in one period (Section 5)",
            "mm",
            200.14,
            table1["strokes_per_period_mm"],
            "{:.2f}",
            "two strokes between 10° and 70°, Eq. 10 with Table 1",
        ),
        (
            "largest error of x(θ_p)",
            "mm",
            None,
            table1["linkage_max_mm"],
            "{:.3f}",
            "linkage G1 against Table 1, 901 points over 0…90°",
        ),
        (
            "SSE of x(θ_p) (Fig. 5a)",
            "mm²",
            0.1781,
            table1["refit_p_sse_mm2"],
            "{:.4f}",
            "quintic fitted to linkage G1, 901 points; the paper's SSE and RMSE imply about 200",
        ),
        (
            "SSE of θ_p(x) (Fig. 5b)",
            "deg²",
            1.241,
            table1["refit_q_sse_deg2"],
            "{:.3f}",
            "as above",
        ),
        (
            "RMSE of x(θ_p) (Fig. 5a)",
            "mm",
            0.03,
            table1["linkage_rmse_mm"],
            "{:.4f}",
            "linkage G1 against Table 1, 901 points over 0…90°; the paper's is its own fit",
        ),
        (
            "RMSE of θ_p(x) (Fig. 5b)",
            "deg",
            0.0792,
            table1["refit_q_rmse_deg"],
            "{:.4f}",
            "quintic fitted to linkage G1",
        ),
        *_g4_rows(numbers["table1_g4"]),
        (
            "error 1 s after a start 89 mm off (Fig. 9)",
            "mm",
            None,
            fig9["error_after_1s_mm"],
            "{:.4f}",
            "continuous SMC, exact states, no speed limit, λ = 10 1/s",
        ),
        (
            "error after 10 s (Fig. 9: \u201cconverged to zero\u201d)",
            "mm",
            0.0,
            fig9["final_error_mm"],
            "{:.1e}",
            "same run",
        ),
        (
            "largest error with SMC (Fig. 12, \u201cless than 2°\u201d)",
            "deg",
            2.0,
            fig12["smc"]["max_error_deg"],
            "{:.3f}",
            "0.1 Hz, 10…70°, after the first period; quantized encoder, observer",
        ),
        (
            "largest error with PID (Fig. 12, \u201cup to approximately 4°\u201d)",
            "deg",
            4.0,
            fig12["pid"]["max_error_deg"],
            "{:.3f}",
            "P alone, 5 1/s: a PID tuned as poorly as the figure shows",
        ),
        (
            "same with the best PID found",
            "deg",
            None,
            fig12["pid_tuned"]["max_error_deg"],
            "{:.3f}",
            "same encoder and budget of chattering as SMC (`benchmarks/tune_pid.py`)",
        ),
        (
            "same with reference velocity fed forward",
            "deg",
            None,
            fig12["pid_feedforward"]["max_error_deg"],
            "{:.3f}",
            "as above; SMC also uses the reference's derivatives",
        ),
        (
            "−3 dB bandwidth (Fig. 13)",
            "Hz",
            PAPER_BANDWIDTH_HZ,
            fig13["bandwidth_hz"],
            "{:.4f}",
            "fundamental, 1/√2, five trials, nothing fitted",
        ),
        (
            "phase there (Fig. 13)",
            "deg",
            None,
            fig13["phase_at_bandwidth_deg"],
            "{:.1f}",
            "fundamental",
        ),
        (
            "bandwidth with gear 3:1",
            "× nominal",
            None,
            scaling["gear_3"]["ratio"],
            "{:.3f}",
            "same loop, gear ratio halved: the pump's flow sets the bandwidth",
        ),
        (
            "bandwidth at half the amplitude",
            "× nominal",
            None,
            scaling["half_amplitude"]["ratio"],
            "{:.3f}",
            "same loop, 25…55°",
        ),
    ]
    lines = [
        "# Lee, Lee, Song and Baek (2020), reproduced",
        "",
        "| quantity | unit | paper | kneexo | difference | how obtained |",
        "|---|---|---|---|---|---|",
    ]
    for quantity, unit, paper, ours, form, how in rows:
        printed = "not printed" if paper is None else f"{paper:g}"
        difference = "" if paper is None else f"{ours - paper:+.3g}"
        lines.append(
            f"| {quantity} | {unit} | {printed} | {form.format(ours)} | {difference} | {how} |"
        )
    smc = fig12["smc"]
    lines += [
        "",
        "## Table 1: the quintics fitted to linkage G1",
        "",
        "| | paper | kneexo | | paper | kneexo |",
        "|---|---|---|---|---|---|",
        *(
            f"| p_{n + 1} | {p:.4g} | {own_p:.4g} | q_{n + 1} | {q:.4g} | {own_q:.4g} |"
            for n, (p, own_p, q, own_q) in enumerate(
                zip(
                    table.p_mm_deg,
                    table1["refit_p_mm_deg"],
                    table.q_deg_mm,
                    table1["refit_q_deg_mm"],
                    strict=True,
                )
            )
        ),
        "",
        "## Fig. 12: controllers on the same measurements",
        "",
        "| controller | max error (deg) | rms error (deg) | mean change of command (rpm/sample) "
        "| saturated share | peak command (rpm) |",
        "|---|---|---|---|---|---|",
        *(
            f"| {name} | {m['max_error_deg']:.3f} | {m['rms_error_deg']:.3f} "
            f"| {m['mean_command_change_rpm']:.2f} | {m['saturated_share']:.3f} "
            f"| {m['peak_command_rpm']:.0f} |"
            for name, m in fig12.items()
        ),
        "",
        "## The paper's explanation of its residual error",
        "",
        "> The reason why the error did not converge to zero, unlike the ideal system, was that "
        "the Maxon motor's permissible maximum speed was limited to 5000 rpm",
        "",
        f"Its own numbers do not bear this out: at 0.1 Hz the reference asks for "
        f"{speed['peak_command_at_0.1hz_rpm']:.0f} rpm at its peak (Eq. 10, Tables 1 to 3, gear "
        f"6:1), and the speed limit is reached from {speed['saturation_from_hz']:.3f} Hz on. In "
        f"the SMC run above the command peaks at {smc['peak_command_rpm']:.0f} rpm and is at its "
        f"limit in {100 * smc['saturated_share']:.1f} % of the samples after the first period.",
        "",
        "## Eq. 27 taken literally at 2 ms",
        "",
        "Two separate failures. With exact states the sampled 447 Hz mode of the oil is unstable "
        "when k/Φ is too large:",
        "",
        "| k/Φ (1/s) | growth rate of the pressure oscillation (1/s) |",
        "|---|---|",
        *(
            f"| {name} | {case['growth_rate_per_s']:+.2f} |"
            for name, case in numbers["eq27_exact_states"].items()
        ),
        "",
        "With plain differences of the encoder, quantization ruins the tracking:",
        "",
        "| k/Φ (1/s) | max error (deg) | rms error (deg) | mean change of command (rpm/sample) |",
        "|---|---|---|---|",
        *(
            f"| {name} | {case['max_error_deg']:.2f} | {case['rms_error_deg']:.2f} "
            f"| {case['mean_command_change_rpm']:.0f} |"
            for name, case in numbers["eq27_differences"].items()
        ),
        "",
    ]
    return "\n".join(lines)


# --------------------------------------------------------------------------------- figures

FIG_12_TITLES = {
    "smc": "sliding-mode control",
    "pid": "PID as in the paper (P, 5 1/s)",
    "pid_tuned": "PID, tuned",
}


def figures(done: Reproduction) -> dict[str, Figure]:
    """The paper's figures by name, in its layout; the caller closes them."""
    return {
        "fig05_polynomial_fit": done.fit.plot()[0].figure,
        "fig09_ideal_smc": _plot_fig9(done.fig9),
        "fig12_tracking": _plot_fig12(done.fig12),
        "fig13_frequency_response": _plot_fig13(done.fig13),
        "eq27_at_2ms": _plot_eq27(done),
    }


def _plot_fig9(run: Run) -> Figure:
    figure, ax = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    ax[0].plot(run.time_s, 1e3 * run["rod_reference_m"], "k--", lw=1, label="reference")
    ax[0].plot(run.time_s, 1e3 * run["rod_extension_m"], "C0", lw=1.2, label="rod extension")
    ax[0].set(xlabel="time (s)", ylabel="rod extension x (mm)", title="(a)")
    ax[0].legend()
    error = rod_error_mm(run)
    ax[1].plot(run.time_s, error, "C3", lw=1.2)
    ax[1].set(xlabel="time (s)", ylabel="tracking error x − x_d (mm)", title="(b)")
    inset = ax[1].inset_axes((0.45, 0.2, 0.5, 0.5))
    inset.semilogy(run.time_s, np.maximum(np.abs(error), 1e-12), "C3", lw=1)
    inset.set(xlabel="time (s)", ylabel="|error| (mm)")
    return figure


def _plot_fig12(cases: Mapping[str, TrackingResult]) -> Figure:
    shown = {name: cases[name] for name in FIG_12_TITLES}
    figure, axes = plt.subplots(
        len(shown), 2, figsize=(10, 3 * len(shown)), sharex=True, layout="constrained"
    )
    for row, (name, tracked) in enumerate(shown.items()):
        tracked.plot_angle(axes[row, 0]).set_title(f"({'ace'[row]}) {FIG_12_TITLES[name]}")
        error = tracked.plot_error(axes[row, 1])
        error.set_title(f"({'bdf'[row]}) max {tracked.metrics.max_error_deg:.2f}° after one period")
        for ax in axes[row] if row < len(shown) - 1 else ():
            ax.set_xlabel("")
    return figure


def _plot_fig13(response: FrequencyResponse) -> Figure:
    ax = response.plot()
    ax[0].axvline(PAPER_BANDWIDTH_HZ, color="0.3", ls=":", label=f"paper {PAPER_BANDWIDTH_HZ} Hz")
    ax[0].legend(loc="lower left")
    return ax[0].figure


def _plot_eq27(done: Reproduction) -> Figure:
    figure, ax = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    for name, run in done.eq27_exact.items():
        ax[0].semilogy(run.time_s, np.abs(run["load_pressure_pa"]), ".", ms=1.5, label=name)
    ax[0].set(
        xlabel="time (s)",
        ylabel="|load pressure| (Pa)",
        ylim=(1e-2, 1e4),
        title="(a) exact states: sampled hydraulic mode",
    )
    for name, tracked in done.eq27_differences.items():
        ax[1].plot(tracked.run.time_s, tracked.error_deg, lw=0.8, label=name)
    ax[1].set(
        xlabel="time (s)",
        ylabel="tracking error (deg)",
        ylim=(-24, 16),
        title="(b) differences of the encoder: quantization",
    )
    for axis in ax:
        axis.legend(loc="upper left", title="k/Φ (1/s)", ncols=2, markerscale=6)
    return figure
