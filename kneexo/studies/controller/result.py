"""The result of the controller study, and how often the paper's claims hold on its grid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy

from kneexo.common.result import Array, Result
from kneexo.errors import ParameterError
from kneexo.parameters import (
    ObserverParameters,
    Scenario,
    SlidingModeParameters,
)
from kneexo.studies.controller.settings import ControllerSettings

METRICS = (
    "max_error_deg",
    "mean_command_change_rpm",
    "saturated_share",
    "fast_max_error_deg",
    "settling_s",
    "large_settling_s",
    "stable",
    "disk_margin",
    "phase_margin_deg",
)
"""Names of the quantities that are measured at each point of the grid.

The margins of an unstable loop and the results of a failed run are nan. ``settling_s`` is the time
after which the error of the small step stays within ± ``settling_band_deg``. ``large_settling_s``
is this time for the large step. A time is inf if the error does not settle during the run.
"""


MAP_METRICS = ("max_error_deg", "mean_command_change_rpm", "stable", "disk_margin")
"""Names of the metrics on the map over the observer's time constant T_f and the slope k/Φ."""


_SATURATED = 0.01  # a run counts as saturated from this share of its samples on


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, and the share of cases on the grid in which the statement holds.

    ``case`` says in words which points form a case and when the statement holds. ``sound_cases``
    and ``sound_share`` count only the cases in which every loop has a sound disk margin.
    ``finding`` is the result in words.
    """

    quote: str
    case: str
    cases: int
    share: float
    sound_cases: int
    sound_share: float
    finding: str

    @property
    def verdict(self) -> str:
        """``true`` if the claim holds in all cases, ``true in part`` if it holds in at least half.

        Otherwise the verdict is ``false``. Without any case, the verdict is ``not decided``.
        """
        if self.cases == 0:
            return "not decided"
        if self.share == 1.0:
            return "true"
        return "false" if self.share < 0.5 else "true in part"


@dataclass(frozen=True)
class LimitCycleCase:
    """One variant of the loop whose limit cycle has an amplitude of several degrees.

    ``time_s`` and ``error_deg`` have shape (n,). ``oscillation_at_rest_deg`` is the error from peak
    to peak while the reference rests at its upper end. If a run fails, ``failure`` has the reason,
    numbers are nan and signals are empty.
    """

    lambda_per_s: float
    variant: str
    stable: bool
    disk_margin: float
    max_error_deg: float = math.nan
    mean_command_change_rpm: float = math.nan
    oscillation_at_rest_deg: float = math.nan
    time_s: Sequence[float] = ()
    error_deg: Sequence[float] = ()
    failure: str = ""


@dataclass(frozen=True, repr=False)
class ControllerResult(Result):
    """Metrics over the grid of λ, Φ and η and over the map of T_f and k/Φ, and the limit cycle.

    ``values`` maps each name of `METRICS` to an array (λ, Φ, η). ``map_values`` maps each name of
    `MAP_METRICS` to an array (T_f, k/Φ), with the scenario's λ and η. ``failures`` maps the
    (λ, Φ, η) of a failed run to the reason.
    """

    scenario: Scenario
    settings: ControllerSettings
    values: Mapping[str, Array]
    failures: Mapping[tuple[float, float, float], str]
    limit_cycle: tuple[LimitCycleCase, ...]
    map_values: Mapping[str, Array]

    @property
    def slope_per_s(self) -> Array:
        """Slope k/Φ = βη/Φ in 1/s of the control law inside the boundary layer |s| ≤ Φ.

        The knee is at rest. The array has the axes (Φ, η).
        """
        law = observed_smc(self.scenario)[0]
        inverse = 1.0 / np.array(self.settings.phis_m_s2)
        return law.gain_ratio * np.outer(inverse, self.settings.etas_m_s3)

    @property
    def centre(self) -> tuple[int, int, int]:
        """Indices of the grid's λ, Φ and η that are closest to the values of the scenario."""
        grid, law = self.settings, observed_smc(self.scenario)[0]
        return (
            _nearest(grid.lambdas_per_s, law.lambda_per_s),
            _nearest(grid.phis_m_s2, law.phi_m_s2),
            _nearest(grid.etas_m_s3, law.eta_m_s3),
        )

    def claims(self) -> tuple[Claim, Claim, Claim]:
        """Return the paper's statements about λ, Φ and η, with the share of cases that agree."""
        return _claim_on_lambda(self), _claim_on_phi(self), _claim_on_eta(self)

    def results(self) -> dict[str, Any]:
        """Return plain data. The axes of the grid's arrays are λ, Φ and η."""
        grid = self.settings
        return {
            "lambdas_per_s": grid.lambdas_per_s,
            "phis_m_s2": grid.phis_m_s2,
            "etas_m_s3": grid.etas_m_s3,
            "slope_per_s": self.slope_per_s,
            "grid": dict(self.values),
            "failures": [
                {"lambda_per_s": point[0], "phi_m_s2": point[1], "eta_m_s3": point[2], "why": why}
                for point, why in self.failures.items()
            ],
            "claims": [asdict(claim) | {"verdict": claim.verdict} for claim in self.claims()],
            "limit_cycle": [
                {key: v for key, v in asdict(case).items() if key not in ("time_s", "error_deg")}
                for case in self.limit_cycle
            ],
            "map": {
                "time_constants_s": grid.map_time_constants_s,
                "slopes_per_s": grid.map_slopes_per_s,
                **self.map_values,
            },
        }


def ideal_settling_time_s(lambda_per_s: Any, share: float) -> Any:
    """Return the time in s after which an ideal sliding error is ``share`` of its initial value.

    The error e solves (d/dt + λ)² e = 0, and ė = 0 at the start. The result has the shape of λ.
    """
    return (
        float(scipy.optimize.brentq(lambda y: (1.0 + y) * math.exp(-y) - share, 0.0, 100.0))
        / lambda_per_s
    )


def observed_smc(scenario: Scenario) -> tuple[SlidingModeParameters, ObserverParameters]:
    """Return the sliding-mode controller and the observer of a scenario.

    Raises `ParameterError` for another controller or estimator, which lacks λ, Φ, η or T_f.
    """
    law, estimator = scenario.controller, scenario.estimator
    if law.kind != "smc" or law.continuous or law.switching == "signum":
        raise ParameterError(
            f"controller.kind = {law.kind}: must be a sampled smc with switching: saturation, "
            f"whose λ, Φ and η the study varies"
        )
    if estimator.kind != "observer":
        raise ParameterError(f"estimator.kind = {estimator.kind}: must be observer for the study")
    return law, estimator


def _nearest(values: tuple[float, ...], value: float) -> int:
    """Return the index of the element of ``values`` with the smallest ratio to ``value``."""
    return int(np.argmin(np.abs(np.log(np.array(values) / value))))


def _share(holds: Any) -> float:
    return float(np.mean(holds)) if holds.size else math.nan


def _counted(holds: Any, cases: Any, sound: Any) -> dict[str, Any]:
    """Return the fields of a `Claim` that count cases. The arguments are masks on the grid."""
    return {
        "cases": int(np.count_nonzero(cases)),
        "share": _share(holds[cases]),
        "sound_cases": int(np.count_nonzero(cases & sound)),
        "sound_share": _share(holds[cases & sound]),
    }


def _claim_on_lambda(study: ControllerResult) -> Claim:
    """Compare the settling times of neighbours along the axis of λ."""
    grid, settling_s = study.settings, study.values["settling_s"]
    is_sound = study.values["disk_margin"] >= grid.sound_disk_margin
    at_smaller, at_larger = settling_s[:-1], settling_s[1:]
    is_known = ~np.isnan(at_smaller) & ~np.isnan(at_larger)
    is_case = is_known & (np.isfinite(at_smaller) | np.isfinite(at_larger))
    _, phi, eta = study.centre
    band = grid.settling_band_deg
    ideal_s = ideal_settling_time_s(np.array(grid.lambdas_per_s), band / grid.step_deg)
    return Claim(
        quote="the larger the value of λ, the faster the robot attempted to follow the desired "
        "target value",
        case="two neighbouring λ at equal Φ and η; holds when the larger one brings a step of "
        f"{grid.step_deg:g}° to within ±{band:g}° of its end sooner",
        **_counted(at_larger < at_smaller, is_case, is_sound[1:] & is_sound[:-1]),
        finding=_finding(
            "lambda",
            grid=grid,
            settling_s=settling_s[:, phi, eta],
            large_settling_s=study.values["large_settling_s"][:, phi, eta],
            ideal_s=ideal_s,
        ),
    )


def _claim_on_phi(study: ControllerResult) -> Claim:
    """Compare the changes of the command at each Φ with those at the calmest Φ."""
    grid, change_rpm = study.settings, study.values["mean_command_change_rpm"]
    finite_rpm = np.where(np.isfinite(change_rpm), change_rpm, np.inf)
    calmest = np.argmin(finite_rpm, axis=1)  # indices of Φ, (λ, η)
    logs = np.log(grid.phis_m_s2)
    distance = logs[None, :, None] - logs[calmest][:, None, :]  # log of the ratio of Φ, (λ, Φ, η)
    is_far = np.abs(distance) >= math.log(grid.wrong_factor) - 1e-9
    wrong = np.isfinite(change_rpm) & is_far
    chatters = change_rpm > grid.chattering_factor * np.min(finite_rpm, axis=1)[:, None, :]
    small, large = wrong & (distance < 0.0), wrong & (distance > 0.0)
    is_sound = study.values["disk_margin"] >= grid.sound_disk_margin
    _, _, eta = study.centre
    calmest_at_eta = calmest[:, eta]
    rule = np.array(grid.lambdas_per_s) * study.slope_per_s[calmest_at_eta, eta]
    return Claim(
        quote="it was important to select a proper Φ value […] failure to do so resulted in "
        "chattering",
        case=f"a Φ at least {grid.wrong_factor:g} times larger or smaller than the calmest one at "
        f"equal λ and η; holds when its command changes more than {grid.chattering_factor:g} "
        f"times as much per sample",
        **_counted(chatters, wrong, is_sound),
        finding=_finding(
            "phi",
            grid=grid,
            small={"cases": np.count_nonzero(small), "share": _share(chatters[small])},
            large={"cases": np.count_nonzero(large), "share": _share(chatters[large])},
            calmest_m_s2=np.array(grid.phis_m_s2)[calmest_at_eta],
            lowest_per_s2=rule.min(),
            highest_per_s2=rule.max(),
        ),
    )


def _claim_on_eta(study: ControllerResult) -> Claim:
    """Compare the largest errors of neighbours along the axis of η."""
    grid, error_deg = study.settings, study.values["max_error_deg"]
    is_sound = study.values["disk_margin"] >= grid.sound_disk_margin
    is_free = study.values["saturated_share"] < _SATURATED
    is_good = (study.values["stable"] == 1.0) & is_free
    at_smaller, at_larger = error_deg[..., :-1], error_deg[..., 1:]
    is_known = np.isfinite(at_smaller) & np.isfinite(at_larger)
    falls = at_larger < at_smaller
    is_case, beyond = is_known & is_good[..., 1:], is_known & ~is_good[..., 1:]
    lambda_, phi, eta = study.centre
    slope = float(study.slope_per_s[phi, eta])
    errors_at_slope_deg = [
        _at_slope(study.slope_per_s[:, n], error_deg[lambda_, :, n], slope)
        for n in range(len(grid.etas_m_s3))
    ]
    return Claim(
        quote="the k value was also increased as the η value became larger, making the system "
        "more adherent to the target value",
        case="two neighbouring η at equal λ and Φ, the larger one with a stable loop and less "
        f"than {100 * _SATURATED:g} % of its samples saturated; holds when its largest error is "
        f"smaller",
        **_counted(falls, is_case, is_sound[..., 1:] & is_sound[..., :-1]),
        finding=_finding(
            "eta",
            grid=grid,
            beyond={"cases": np.count_nonzero(beyond), "share": _share(falls[beyond])},
            errors_deg=error_deg[lambda_, phi],
            slope_per_s=slope,
            errors_at_slope_deg=errors_at_slope_deg,
        ),
    )


def _at_slope(slopes: Array, error: Array, slope: float) -> float:
    """Interpolate the error at one k/Φ, on logarithmic axes. Return nan outside ``slopes``."""
    order = np.argsort(slopes)
    log_slopes, log_errors = np.log(slopes[order]), np.log(error[order])
    rounding = 0.02  # of the grid's values
    if not log_slopes[0] - rounding <= math.log(slope) <= log_slopes[-1] + rounding:
        return math.nan
    return float(np.exp(np.interp(math.log(slope), log_slopes, log_errors)))


def _finding(symbol: str, **data: Any) -> str:
    """Fill the text template for λ, Φ or η with ``data``, and return the finding in words."""
    from kneexo.studies.template import filled  # not needed by the list of parameters

    return filled(f"controller/finding_{symbol}.md", **data).rstrip("\n")
