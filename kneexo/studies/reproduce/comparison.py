"""Judges the paper's printed numbers by the computed ones, within the precision of the print."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import reduce
from typing import Any, Literal

from kneexo.studies.paper import PAPER_BANDWIDTH_HZ

HOLDS = "holds"
"""Judgement of a number that keeps a bound of the paper."""
HOLDS_AS_PRINTED = "holds within what the paper prints"
"""Judgement of a number that agrees with all digits that the paper prints."""
DOES_NOT_HOLD = "does not hold"
"""Judgement of a number that differs from the paper's."""
NOT_PRINTED = "not printed"
"""Judgement of a number that the paper does not print."""


@dataclass(frozen=True)
class PaperNumber:
    """A number of the report, and the place of the computed number in the results."""

    quantity: str
    unit: str
    key: tuple[str, ...]
    """Keys of the computed number in the results of the study."""
    form: str
    """Format of the computed number in the report."""
    method: str
    """How the number is computed."""
    printed: str = ""
    """The number as the paper prints it, or an empty text if the paper does not print it."""
    kind: Literal["value", "upper bound"] = "value"
    """"upper bound" if the paper says that the number is less than ``printed``."""
    reason: str = ""
    """The known reason of a difference from the paper."""


@dataclass(frozen=True)
class Comparison:
    """A number of the paper beside the computed number."""

    number: PaperNumber
    computed: float

    @property
    def paper(self) -> float | None:
        """The paper's number, or None if the paper does not print the number."""
        return float(self.number.printed) if self.number.printed else None

    @property
    def difference(self) -> float | None:
        """The computed number minus the paper's number, or None without a number of the paper."""
        return None if self.paper is None else self.computed - self.paper

    @property
    def precision(self) -> float | None:
        """Unit of the last digit that the paper prints, or None without a number of the paper."""
        if not self.number.printed:
            return None
        exponent = Decimal(self.number.printed).as_tuple().exponent
        return float(Decimal(10) ** int(exponent))

    @property
    def criterion(self) -> str:
        """The condition under which the number holds, or an empty text without the paper's."""
        if self.precision is None:
            return ""
        if self.number.kind == "upper bound":
            return f"below {self.number.printed}"
        return f"± {0.5 * self.precision:g}"

    @property
    def judgement(self) -> str:
        """`HOLDS`, `HOLDS_AS_PRINTED`, `DOES_NOT_HOLD` or `NOT_PRINTED`.

        An upper bound holds if the computed number is less than the bound. A value holds within
        what the paper prints if it differs by at most half a unit of the last printed digit.
        """
        if self.difference is None or self.precision is None:
            return NOT_PRINTED
        if self.number.kind == "upper bound":
            return HOLDS if self.difference < 0.0 else DOES_NOT_HOLD
        # 1e-9 of a unit: decimal numbers such as 139.05 are rounded to binary numbers.
        agrees = abs(self.difference) <= (0.5 + 1e-9) * self.precision
        return HOLDS_AS_PRINTED if agrees else DOES_NOT_HOLD

    @property
    def because(self) -> str:
        """The known reason of a number that does not hold. Empty for all other numbers."""
        return self.number.reason if self.judgement == DOES_NOT_HOLD else ""

    def as_dict(self) -> dict[str, Any]:
        """Return numbers, judgement and reason as plain data."""
        return {
            "quantity": self.number.quantity,
            "unit": self.number.unit,
            "paper": self.paper,
            "kneexo": self.computed,
            "difference": self.difference,
            "judgement": self.judgement,
            "because": self.because,
            "method": self.number.method,
        }


def compared(results: Mapping[str, Any]) -> Iterator[Comparison]:
    """Yield each of `PAPER_NUMBERS` with the number of the study's ``results`` beside it."""
    for number in PAPER_NUMBERS:
        computed: Any = reduce(lambda item, key: item[key], number.key, results)
        yield Comparison(number, float(computed))


_MISPRINT = "x at 70° is most likely a misprint (docs/theory.md)"
_ALL_ANGLES = (
    "the paper does not print its points, about 200 from about 5° on; here 901 points over 0…90° "
    "(docs/validation.md)"
)
_IDENTIFIED = (
    "the paper prints no link lengths; G4 is identified from the rounded coefficients of Table 1"
)
_LIMIT = (
    "the reference asks for less than the limit, so the limit does not explain the residual error"
)
_REDUCED_ORDER = (
    "nothing is fitted, and the reduced order has one piston area for both chambers; models of "
    "full order reach −3 dB below and above the paper's frequency (docs/cylinder_order.md)"
)
_G4 = "quintic fitted to geometry G4 over 5…90°, 198 degrees of freedom"

PAPER_NUMBERS = (
    PaperNumber(
        "x at 10° (Section 5)",
        "mm",
        ("table1", "x_at_10deg_mm"),
        ".2f",
        "Eq. 10 with Table 1",
        "139.05",
    ),
    PaperNumber(
        "x at 70° (Section 5)",
        "mm",
        ("table1", "x_at_70deg_mm"),
        ".2f",
        "Eq. 10 with Table 1",
        "38.98",
        reason=_MISPRINT,
    ),
    PaperNumber(
        "rod travel in one period (Section 5)",
        "mm",
        ("table1", "strokes_per_period_mm"),
        ".2f",
        "two strokes between 10° and 70°, Eq. 10 with Table 1",
        "200.14",
        reason=_MISPRINT,
    ),
    PaperNumber(
        "largest error of x(θ_p)",
        "mm",
        ("table1", "linkage_max_mm"),
        ".3f",
        "the linkage against Table 1, 901 points over 0…90°",
    ),
    PaperNumber(
        "SSE of x(θ_p) (Fig. 5a)",
        "mm²",
        ("table1", "refit_p_sse_mm2"),
        ".4f",
        "quintic fitted to the linkage, 901 points",
        "0.1781",
        reason=_ALL_ANGLES,
    ),
    PaperNumber(
        "SSE of θ_p(x) (Fig. 5b)",
        "deg²",
        ("table1", "refit_q_sse_deg2"),
        ".3f",
        "quintic fitted to the linkage, 901 points",
        "1.241",
        reason=_ALL_ANGLES,
    ),
    PaperNumber(
        "RMSE of x(θ_p) (Fig. 5a)",
        "mm",
        ("table1", "linkage_rmse_mm"),
        ".4f",
        "the linkage against Table 1, 901 points over 0…90°; the paper's is its own fit",
        "0.03",
    ),
    PaperNumber(
        "RMSE of θ_p(x) (Fig. 5b)",
        "deg",
        ("table1", "refit_q_rmse_deg"),
        ".4f",
        "quintic fitted to the linkage, 901 points",
        "0.0792",
        reason=_ALL_ANGLES,
    ),
    PaperNumber(
        "SSE of x(θ_p), G4",
        "mm²",
        ("table1_g4", "refit_p_sse_mm2"),
        ".4f",
        _G4,
        "0.1781",
        reason=_IDENTIFIED,
    ),
    PaperNumber(
        "SSE of θ_p(x), G4",
        "deg²",
        ("table1_g4", "refit_q_sse_deg2"),
        ".3f",
        _G4,
        "1.241",
        reason=_IDENTIFIED,
    ),
    PaperNumber("RMSE of x(θ_p), G4", "mm", ("table1_g4", "refit_p_rmse_mm"), ".4f", _G4, "0.03"),
    PaperNumber(
        "RMSE of θ_p(x), G4",
        "deg",
        ("table1_g4", "refit_q_rmse_deg"),
        ".4f",
        _G4,
        "0.0792",
        reason=_IDENTIFIED,
    ),
    PaperNumber(
        "error 1 s after a start 89 mm off (Fig. 9)",
        "mm",
        ("fig9", "error_after_1s_mm"),
        ".4f",
        "continuous SMC, exact states, no speed limit, λ = 10 1/s",
    ),
    PaperNumber(
        "error after 10 s (Fig. 9: “converged to zero”)",
        "mm",
        ("fig9", "final_error_mm"),
        ".1e",
        "run of Fig. 9; two decimals, as the paper prints lengths",
        "0.00",
    ),
    PaperNumber(
        "largest error with SMC (Fig. 12, “less than 2°”)",
        "deg",
        ("fig12", "smc", "max_error_deg"),
        ".3f",
        "0.1 Hz, 10…70°, after the first period; quantized encoder, observer",
        "2",
        "upper bound",
    ),
    PaperNumber(
        "largest error with PID (Fig. 12, “up to approximately 4°”)",
        "deg",
        ("fig12", "pid", "max_error_deg"),
        ".3f",
        "P alone, 5 1/s: a PID tuned as poorly as the figure shows",
        "4",
    ),
    PaperNumber(
        "largest error with the best PID found",
        "deg",
        ("fig12", "pid_tuned", "max_error_deg"),
        ".3f",
        "same encoder and budget of chattering as SMC (`benchmarks/tune_pid.py`)",
    ),
    PaperNumber(
        "largest error with the best PID and reference velocity fed forward",
        "deg",
        ("fig12", "pid_feedforward", "max_error_deg"),
        ".3f",
        "same encoder and budget; SMC also uses the reference's derivatives",
    ),
    PaperNumber(
        "peak motor speed at 0.1 Hz (Section 5: at its limit)",
        "rpm",
        ("speed_limit", "peak_speed_demand_at_0.1hz_rpm"),
        ".0f",
        "Eq. 10, Tables 1 to 3, gear 6:1",
        "5000",
        reason=_LIMIT,
    ),
    PaperNumber(
        "−3 dB bandwidth (Fig. 13)",
        "Hz",
        ("fig13", "bandwidth_hz"),
        ".4f",
        "fundamental, 1/√2, all trials, nothing fitted",
        f"{PAPER_BANDWIDTH_HZ}",
        reason=_REDUCED_ORDER,
    ),
    PaperNumber(
        "phase at −3 dB (Fig. 13)", "deg", ("fig13", "phase_at_bandwidth_deg"), ".1f", "fundamental"
    ),
    PaperNumber(
        "bandwidth with gear 3:1",
        "× nominal",
        ("scaling", "gear_3", "ratio"),
        ".3f",
        "same loop, gear ratio halved: the pump's flow sets the bandwidth",
    ),
    PaperNumber(
        "bandwidth at half the amplitude",
        "× nominal",
        ("scaling", "half_amplitude", "ratio"),
        ".3f",
        "same loop, 25…55°",
    ),
)
"""The paper's numbers in the order of the report, and numbers that the paper does not print."""
