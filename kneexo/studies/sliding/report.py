"""Markdown of `kneexo.studies.sliding.study`."""

from __future__ import annotations

import math

from kneexo.parameters import Scenario
from kneexo.studies.markdown import Cell, document, number, row_table
from kneexo.studies.sliding.study import (
    LAWS,
    SlidingCase,
    SlidingResult,
    effective_masses_kg,
    full_order,
)


def report(study: SlidingResult) -> str:
    """Markdown: what holds where, and whether the paper's k suffices."""
    law = study.law
    labels: dict[str, Cell] = {
        "load (N)": ("load_n", "g"),
        "k": lambda case: LAWS[case.law],
        "η (m/s³)": ("eta_m_s3", ".3g"),
    }
    reaching: dict[str, Cell] = {
        "reached after (ms)": _measured("reaching_s", 1e3),
        "promised (ms)": _measured("promised_s", 1e3),
        "outside again (%)": _measured("left_share", 100.0),
    }
    condition = "s·ds/dt ≤ −η\\|s\\|"
    holding = f"outside: {condition} (%)"
    return document(
        "# Sliding condition",
        "Continuous law, exact states, motor without lag and limit, "
        f"λ = {law.lambda_per_s:g} 1/s, Φ = {law.phi_m_s2:g} m/s²: inside the layer "
        f"\\|e\\| ≤ Φ/λ² = {1e3 * law.phi_m_s2 / law.lambda_per_s**2:.3g} mm.",
        "## Along the reference",
        row_table(
            study.of("motion"),
            {
                "plant": "plant",
                **labels,
                "outside the layer (%)": _measured("outside_share", 100.0),
                f"there {condition} (%)": _measured("holding_share", 100.0),
                "there s·ds/dt < 0 (%)": _measured("attracting_share", 100.0),
                "largest \\|s\\|/Φ": _measured("largest_s"),
                "largest error (mm)": _measured("largest_error_mm"),
                "run": lambda case: (
                    "left the range of motion" if case.measured["failure"] else "complete"
                ),
            },
        ),
        "## From outside the layer",
        row_table(
            study.of("start"),
            {
                "plant": "plant",
                **labels,
                holding: _measured("holding_share", 100.0),
                "largest sgn(s)·ds/dt (m/s³)": _measured("worst_rate_m_s3"),
                **reaching,
            },
        ),
        "## The law at its sample time, with the paper's k",
        row_table(
            study.of("sampled"),
            {
                "loop": "plant",
                **labels,
                f"{holding} after an update": _measured("holding_share", 100.0),
                "before the next": _measured("held_share", 100.0),
                "on the mean": _measured("mean_share", 100.0),
                **reaching,
                "largest error (mm)": _measured("largest_error_mm"),
            },
        ),
        "## Findings",
        _findings(study),
    )


def _measured(name: str, factor: float = 1.0) -> Cell:
    """What `check_sliding` measured, times a factor."""

    def text(case: SlidingCase) -> str:
        return number(factor * case.measured[name])

    return text


def _findings(study: SlidingResult) -> list[str]:
    law, needed = study.law, study.needed
    ideal = [case for case in study.cases if case.part != "sampled"]
    derived = [case for case in ideal if case.plant != "full"]
    kept = [
        case
        for case in derived
        if case.stays
        and (not case.measured["outside_share"] or case.measured["holding_share"] == 1.0)
    ]
    low, high = effective_masses_kg(full_order(study.scenario))
    lines = [
        f"- Reduced order, for which Eq. 27 was derived: it keeps its promise in {len(kept)} "
        f"of {len(derived)} runs, with the masses at both of its bounds."
    ]
    for load in study.settings.loads_n:
        smallest = study.smallest_eta("paper", load)
        where = (
            f"from η = {smallest:.3g} m/s³ on"
            if math.isfinite(smallest)
            else "at none of the η tried"
        )
        lines.append(
            f"- Full order, {load:g} N: with the paper's k, s stays in the layer {where}; with "
            f"the area term from {study.smallest_eta('area', load):.3g} m/s³ on."
        )
    lines += [
        f"- The closed forms ask the paper's k for η ≥ {needed.speed:.3g} m/s³, so that βη "
        f"covers ω̂²|ΔA/Ā||ẋ_d|; and with P_2 loaded for η ≥ {needed.stability:.3g} m/s³, "
        f"below which the layer itself is unstable (2λk/Φ < ω̂²(1 − A_2/Ā)). So below that it "
        f"does not suffice on the full-order plant.",
        "- The inequality itself, with the η that the law was given, needs more: one chamber's "
        f"oil is softer than the model's, as if the mass were {low:.2f}…{high:.2f} kg in "
        f"place of {law.mass_min_kg:g}…{law.mass_max_kg:g} kg. Share of the samples outside in "
        f"which it holds: " + "; ".join(_shares(study)) + ".",
        "- Sampled, the promise is out of reach whatever k: in one sample η moves s by ηT, "
        f"{law.eta_m_s3 * Scenario().controller.sample_time_s / law.phi_m_s2:.0f} times Φ for "
        f"the default. A motor with lag adds a degree: after a change of sign ds/dt follows "
        f"only with the motor. The layer is then reached at the speed limit.",
    ]
    return lines


def _shares(study: SlidingResult) -> list[str]:
    """Share of the samples outside, of all full-order runs of a law, that hold."""
    texts = []
    for name, label in LAWS.items():
        shares = [
            case.measured["holding_share"]
            for case in study.cases
            if case.plant == "full" and case.law == name and case.measured["outside_share"] > 0.0
        ]
        if shares:
            low, high = 100.0 * min(shares), 100.0 * max(shares)
            texts.append(f"{label} {low:.0f}…{high:.0f} % of a run")
    return texts
