"""The report of ``kneexo reproduce``: the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kneexo.parameters import RodPolynomialParameters
from kneexo.studies.markdown import document, markdown_table, row_table
from kneexo.studies.paper import PAPER_BANDWIDTH_HZ
from kneexo.studies.reproduce.study import ReproduceResult

_Row = tuple[str, str, float | None, str, str, str]
"""Quantity, unit, the paper's value (None: not printed), key of ours, its form, how obtained."""

_G4 = "quintic fitted to geometry G4 over 5…90°, 198 degrees of freedom"

_COMPARED: dict[str, tuple[_Row, ...]] = {
    "table1": (
        (
            *("x at 10° (Section 5)", "mm", 139.05, "x_at_10deg_mm", ".2f"),
            "Eq. 10 with Table 1",
        ),
        (
            *("x at 70° (Section 5)", "mm", 38.98, "x_at_70deg_mm", ".2f"),
            "Eq. 10 with Table 1; the paper's number is most likely a misprint (docs/model.md)",
        ),
        (
            *("rod travel in one period (Section 5)", "mm", 200.14, "strokes_per_period_mm", ".2f"),
            "two strokes between 10° and 70°, Eq. 10 with Table 1",
        ),
        (
            *("largest error of x(θ_p)", "mm", None, "linkage_max_mm", ".3f"),
            "linkage G1 against Table 1, 901 points over 0…90°",
        ),
        (
            *("SSE of x(θ_p) (Fig. 5a)", "mm²", 0.1781, "refit_p_sse_mm2", ".4f"),
            "quintic fitted to linkage G1, 901 points; the paper's SSE and RMSE imply about 200",
        ),
        ("SSE of θ_p(x) (Fig. 5b)", "deg²", 1.241, "refit_q_sse_deg2", ".3f", "as above"),
        (
            *("RMSE of x(θ_p) (Fig. 5a)", "mm", 0.03, "linkage_rmse_mm", ".4f"),
            "linkage G1 against Table 1, 901 points over 0…90°; the paper's is its own fit",
        ),
        (
            *("RMSE of θ_p(x) (Fig. 5b)", "deg", 0.0792, "refit_q_rmse_deg", ".4f"),
            "quintic fitted to linkage G1",
        ),
    ),
    "table1_g4": (
        ("SSE of x(θ_p), G4", "mm²", 0.1781, "refit_p_sse_mm2", ".4f", _G4),
        ("SSE of θ_p(x), G4", "deg²", 1.241, "refit_q_sse_deg2", ".3f", _G4),
        ("RMSE of x(θ_p), G4", "mm", 0.03, "refit_p_rmse_mm", ".4f", _G4),
        ("RMSE of θ_p(x), G4", "deg", 0.0792, "refit_q_rmse_deg", ".4f", _G4),
    ),
    "fig9": (
        (
            *("error 1 s after a start 89 mm off (Fig. 9)", "mm", None, "error_after_1s_mm", ".4f"),
            "continuous SMC, exact states, no speed limit, λ = 10 1/s",
        ),
        (
            "error after 10 s (Fig. 9: \u201cconverged to zero\u201d)",
            *("mm", 0.0, "final_error_mm", ".1e", "same run"),
        ),
    ),
    "fig12": (
        (
            "largest error with SMC (Fig. 12, \u201cless than 2°\u201d)",
            *("deg", 2.0, "smc.max_error_deg", ".3f"),
            "0.1 Hz, 10…70°, after the first period; quantized encoder, observer",
        ),
        (
            "largest error with PID (Fig. 12, \u201cup to approximately 4°\u201d)",
            *("deg", 4.0, "pid.max_error_deg", ".3f"),
            "P alone, 5 1/s: a PID tuned as poorly as the figure shows",
        ),
        (
            *("same with the best PID found", "deg", None, "pid_tuned.max_error_deg", ".3f"),
            "same encoder and budget of chattering as SMC (`benchmarks/tune_pid.py`)",
        ),
        (
            "same with reference velocity fed forward",
            *("deg", None, "pid_feedforward.max_error_deg", ".3f"),
            "as above; SMC also uses the reference's derivatives",
        ),
    ),
    "fig13": (
        (
            *("−3 dB bandwidth (Fig. 13)", "Hz", PAPER_BANDWIDTH_HZ, "bandwidth_hz", ".4f"),
            "fundamental, 1/√2, {trials} trials, nothing fitted",
        ),
        (
            *("phase there (Fig. 13)", "deg", None, "phase_at_bandwidth_deg", ".1f"),
            "fundamental",
        ),
    ),
    "scaling": (
        (
            *("bandwidth with gear 3:1", "× nominal", None, "gear_3.ratio", ".3f"),
            "same loop, gear ratio halved: the pump's flow sets the bandwidth",
        ),
        (
            *("bandwidth at half the amplitude", "× nominal", None, "half_amplitude.ratio", ".3f"),
            "same loop, 25…55°",
        ),
    ),
}
"""Numbers of the paper beside ours, by the part of the results that holds ours."""


def report(reproduction: ReproduceResult) -> str:
    """Markdown: each number of the paper beside ours."""
    results = reproduction.results()
    table1, fig12, speed = (results[key] for key in ("table1", "fig12", "speed_limit"))
    table, smc, trials = RodPolynomialParameters(), fig12["smc"], len(results["fig13"]["trials"])
    quintics = zip(
        *(table.p_mm_deg, table1["refit_p_mm_deg"]),
        *(table.q_deg_mm, table1["refit_q_deg_mm"]),
        strict=True,
    )
    return document(
        "# Lee, Lee, Song and Baek (2020), reproduced",
        markdown_table(
            ("quantity", "unit", "paper", "kneexo", "difference", "how obtained"),
            [
                [text.format(trials=trials) for text in _compared(results[part], *row)]
                for part, rows in _COMPARED.items()
                for row in rows
            ],
        ),
        "## Table 1: the quintics fitted to linkage G1",
        markdown_table(
            ("", "paper", "kneexo", "", "paper", "kneexo"),
            [
                (f"p_{n}", f"{p:.4g}", f"{fit_p:.4g}", f"q_{n}", f"{q:.4g}", f"{fit_q:.4g}")
                for n, (p, fit_p, q, fit_q) in enumerate(quintics, 1)
            ],
        ),
        "## Fig. 12: controllers on the same measurements",
        row_table(
            _named(fig12),
            {
                "controller": "name",
                "max error (deg)": ("max_error_deg", ".3f"),
                "rms error (deg)": ("rms_error_deg", ".3f"),
                "mean change of command (rpm/sample)": ("mean_command_change_rpm", ".2f"),
                "saturated share": ("saturated_share", ".3f"),
                "peak command (rpm)": ("peak_command_rpm", ".0f"),
            },
        ),
        "## The paper's explanation of its residual error",
        "> The reason why the error did not converge to zero, unlike the ideal system, was that "
        "the Maxon motor's permissible maximum speed was limited to 5000 rpm",
        f"Its own numbers do not bear this out: at 0.1 Hz the reference asks for "
        f"{speed['peak_speed_demand_at_0.1hz_rpm']:.0f} rpm at its peak (Eq. 10, Tables 1 to 3, "
        f"gear 6:1), and the speed limit is reached from {speed['saturation_from_hz']:.3f} Hz on. "
        f"In the SMC run above the command peaks at {smc['peak_command_rpm']:.0f} rpm and is at "
        f"its limit in {100 * smc['saturated_share']:.1f} % of the samples after the first period.",
        "## Eq. 27 taken literally at 2 ms",
        "Two separate failures. With exact states the sampled 447 Hz mode of the oil is unstable "
        "when k/Φ is too large:",
        row_table(
            _named(results["eq27_exact_states"]),
            {
                "k/Φ (1/s)": "name",
                "growth rate of the pressure oscillation (1/s)": ("growth_rate_per_s", "+.2f"),
            },
        ),
        "With plain differences of the encoder, quantization ruins the tracking:",
        row_table(
            _named(results["eq27_differences"]),
            {
                "k/Φ (1/s)": "name",
                "max error (deg)": ("max_error_deg", ".2f"),
                "rms error (deg)": ("rms_error_deg", ".2f"),
                "mean change of command (rpm/sample)": ("mean_command_change_rpm", ".0f"),
            },
        ),
    )


def _compared(
    values: Any, quantity: str, unit: str, printed: float | None, key: str, form: str, how: str
) -> list[str]:
    """Cells of one comparison."""
    for name in key.split("."):
        values = values[name]
    paper = "not printed" if printed is None else f"{printed:g}"
    difference = "" if printed is None else f"{values - printed:+.3g}"
    return [quantity, unit, paper, f"{values:{form}}", difference, how]


def _named(cases: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The cases as rows of a table."""
    return [{"name": name} | case for name, case in cases.items()]
