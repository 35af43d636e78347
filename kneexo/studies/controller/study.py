"""What λ, Φ and η of the sliding-mode controller do: the discussion of Lee et al. 2020, counted.

Every point of a grid over λ, Φ and η gets the scenario's own reference, a faster sine, a small and
a large step, and the margins of its sampled loop. Inside the boundary layer the law depends on
Φ and η only through the slope k/Φ = βη/Φ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import product
from typing import Any, Unpack

import numpy as np
import scipy
from pydantic import field_validator, model_validator

from kneexo.analysis.assessment import assess
from kneexo.analysis.hardware import tuned
from kneexo.analysis.tracking import track
from kneexo.errors import KneexoError, ParameterError
from kneexo.parameters import (
    ObserverParameters,
    Scenario,
    SineReference,
    SlidingModeParameters,
    StepReference,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.quantity import (
    Parameters,
    positive_values,
    quantity,
    require_increasing,
)
from kneexo.result import Array, Result
from kneexo.simulation import awaitable, needs_runs
from kneexo.studies.markdown import number, percent
from kneexo.sweeps import SweepOptions, open_sweep


class ControllerSettings(Parameters):
    """Grid over λ, Φ and η, and the experiments made at each of its points: ``kneexo study``."""

    lambdas_per_s: tuple[float, ...] = positive_values(
        (5.0, 7.1, 10.0, 14.1, 20.0, 28.3, 40.0, 56.6, 80.0),
        "1/s",
        "assumption: the default times powers of √2",
    )
    phis_m_s2: tuple[float, ...] = positive_values(
        (0.32, 0.57, 1.0, 1.8, 3.2, 5.7, 10.0, 18.0, 32.0, 57.0, 100.0),
        "m/s²",
        "assumption: the default times powers of 10^(1/4)",
    )
    etas_m_s3: tuple[float, ...] = positive_values(
        (8.9e3, 2.8e4, 8.9e4, 2.8e5, 8.9e5, 2.8e6),
        "m/s³",
        "assumption: the default times powers of √10",
    )
    step_deg: float = quantity(
        2.0,
        "deg",
        "assumption: twenty counts of the encoder, and within the speed limit up to λ = 60 1/s",
        ge=1e-3,
        le=45,
    )
    large_step_deg: float = quantity(
        20.0, "deg", "assumption: one that the speed limit governs", ge=1e-3, le=45
    )
    step_duration_s: float = quantity(
        4.0, "s", "assumption: four times what the large step takes", ge=0.01, le=1e3
    )
    settling_band_deg: float = quantity(
        0.2,
        "deg",
        "assumption: a step has settled when its error stays within ± this; a tenth of the small "
        "step, a hundredth of the large one, two counts of the encoder",
        ge=1e-3,
        le=45,
    )
    fast_amplitude_deg: float = quantity(
        2.5, "deg", "assumption: at 1 Hz it stays below the speed limit", ge=1e-3, le=45
    )
    fast_frequency_hz: float = quantity(
        1.0, "Hz", "assumption: ten times the reference of Section 5", ge=1e-3, le=250
    )
    fast_duration_s: float = quantity(4.0, "s", "assumption: four periods", ge=0.01, le=1e4)
    chattering_factor: float = quantity(
        2.0,
        "1",
        "assumption: a value chatters whose command changes by so much more than at the best one",
        gt=1,
        le=100,
    )
    wrong_factor: float = quantity(
        3.0, "1", "assumption: a value is wrong that is so much too large or small", gt=1, le=100
    )
    sound_disk_margin: float = quantity(
        0.5,
        "1",
        "assumption: 28° of phase or a gain of 0.6…1.67, each alone; a loop below it is "
        "counted apart",
        ge=1e-3,
        le=2,
    )
    limit_cycle_time_constant_s: float = quantity(
        0.008,
        "s",
        "assumption: T_f of a loop that is linearly stable and errs by degrees",
        ge=1e-5,
        le=1,
    )
    limit_cycle_slope_per_s: float = quantity(
        1e4, "1/s", "assumption: k/Φ of the same", ge=1e-3, le=1e12
    )
    limit_cycle_lambdas_per_s: tuple[float, ...] = positive_values(
        (20.0, 10.0), "1/s", "assumption: λ of the same"
    )
    hold_duration_s: float = quantity(
        20.0, "s", "assumption: long enough for an oscillation at rest to settle", ge=0.01, le=1e4
    )
    unlimited_acceleration_rad_s2: float = quantity(
        1e7, "rad/s²", "assumption: a thousand times the default limit", ge=1, le=1e7
    )
    map_time_constants_s: tuple[float, ...] = positive_values(
        (0.003, 0.004, 0.006, 0.008, 0.012, 0.016, 0.020, 0.028, 0.040),
        "s",
        "assumption: T_f about its default",
    )
    map_slopes_per_s: tuple[float, ...] = positive_values(
        (5.6e3, 1e4, 1.8e4, 3.2e4, 5.6e4, 1e5, 1.8e5, 3.2e5, 5.6e5, 1e6),
        "1/s",
        "assumption: k/Φ about its default",
    )

    _increasing = field_validator(
        "lambdas_per_s", "phis_m_s2", "etas_m_s3", "map_time_constants_s", "map_slopes_per_s"
    )(require_increasing)

    @model_validator(mode="after")
    def _band_within_the_steps(self) -> ControllerSettings:
        smallest = min(self.step_deg, self.large_step_deg)
        if self.settling_band_deg >= smallest:
            raise ValueError(
                f"settling_band_deg = {self.settling_band_deg:g} deg: must be less than the "
                f"smaller step, {smallest:g} deg"
            )
        return self


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
"""Quantities that are measured at each point of the grid.

The margins of an unstable loop are nan, and so are the results of a failed run. ``settling_s`` and
``large_settling_s`` are the times after which the error of the small and of the large step stays
within ± ``settling_band_deg``. They are inf for a step that does not settle in its run."""

MAP_METRICS = ("max_error_deg", "mean_command_change_rpm", "stable", "disk_margin")
"""What the maps over two gains keep of a run."""

LIMIT_CYCLE_VARIANTS = ("as built", "exact encoder", "unlimited acceleration")
"""The variants of the loop that tell what makes the limit cycle."""

_SATURATED = 0.01  # share of the samples from which on a run counts as saturated


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, and the ``share`` of ``cases`` on the grid in which it holds.

    ``case`` says what is counted and when it holds; ``sound_cases`` are those between loops with a
    sound disk margin.
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
        """True when it holds in every case, false when it holds in less than half of them."""
        if self.cases == 0:
            return "not decided"
        if self.share == 1.0:
            return "true"
        return "false" if self.share < 0.5 else "true in part"


@dataclass(frozen=True)
class LimitCycleCase:
    """A loop that is linearly stable and errs by degrees; ``time_s`` and ``error_deg`` (n,).

    ``oscillation_at_rest_deg``: peak to peak, at the upper end of the reference. Of a run that
    failed only the reason is left.
    """

    lambda_per_s: float
    variant: str
    stable: bool
    disk_margin: float
    max_error_deg: float = math.nan
    mean_command_change_rpm: float = math.nan
    oscillation_at_rest_deg: float = math.nan
    time_s: Array = field(default_factory=lambda: np.empty(0))
    error_deg: Array = field(default_factory=lambda: np.empty(0))
    failure: str = ""


@dataclass(frozen=True, repr=False)
class ControllerResult(Result):
    """The grid, the limit cycle, and what both say about the paper's discussion.

    ``values``: an array (λ, Φ, η) for each of `METRICS`. ``map_values``: an array (T_f, k/Φ) for
    each of ``MAP_METRICS``, at the scenario's λ and η. ``failures``: why runs failed, by λ, Φ, η.
    """

    scenario: Scenario
    settings: ControllerSettings
    values: Mapping[str, Array]
    failures: Mapping[tuple[float, float, float], str]
    limit_cycle: tuple[LimitCycleCase, ...]
    map_values: Mapping[str, Array]

    @property
    def slope_per_s(self) -> Array:
        """k/Φ = βη/Φ in 1/s, the gain inside the boundary layer at rest; (Φ, η)."""
        law = observed_smc(self.scenario)[0]
        inverse = 1.0 / np.array(self.settings.phis_m_s2)
        return law.gain_ratio * np.outer(inverse, self.settings.etas_m_s3)

    @property
    def centre(self) -> tuple[int, int, int]:
        """Indices of the grid's λ, Φ and η that lie closest to the scenario's."""
        grid, law = self.settings, observed_smc(self.scenario)[0]
        return (
            _nearest(grid.lambdas_per_s, law.lambda_per_s),
            _nearest(grid.phis_m_s2, law.phi_m_s2),
            _nearest(grid.etas_m_s3, law.eta_m_s3),
        )

    def claims(self) -> tuple[Claim, Claim, Claim]:
        """What the paper says about λ, Φ and η, each counted over the grid."""
        return _faster(self), _chattering(self), _adherence(self)

    def results(self) -> dict[str, Any]:
        """Plain data; the grid's arrays are in the order λ, Φ, η."""
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
                {key: v for key, v in asdict(case).items() if not isinstance(v, np.ndarray)}
                for case in self.limit_cycle
            ],
            "map": {
                "time_constants_s": grid.map_time_constants_s,
                "slopes_per_s": grid.map_slopes_per_s,
                **self.map_values,
            },
        }


# ------------------------------------------------------------------------------------- runs


def controller_study(
    scenario: Scenario = Scenario(),
    settings: ControllerSettings = ControllerSettings(),
    **options: Unpack[SweepOptions],
) -> ControllerResult:
    """Run the grid and the limit cycle; ``options``: see `kneexo.sweeps.SweepOptions`.

    A run of the grid that fails leaves nan and its reason. Raises `ParameterError` when
    ``scenario`` has no sampled sliding-mode controller behind an observer, or when a step or the
    faster sine leaves the range of motion.
    """
    law = observed_smc(scenario)[0]
    experiments(scenario, settings)  # a reference out of range is found before the sweep

    def with_slope(slope: float, time_constant: float, lambda_: float) -> Scenario:
        gains = {"lambda_per_s": lambda_, "slope_per_s": slope, "observer_s": time_constant}
        return tuned(scenario, gains)

    axes = (settings.lambdas_per_s, settings.phis_m_s2, settings.etas_m_s3)
    points = list(product(*axes))
    grid = [_with_law(scenario, *point) for point in points]
    cases = list(product(settings.limit_cycle_lambdas_per_s, LIMIT_CYCLE_VARIANTS))
    limit_cycle_slope, limit_cycle_time_constant = (
        settings.limit_cycle_slope_per_s,
        settings.limit_cycle_time_constant_s,
    )
    limit_cycles = [
        changed(
            with_slope(limit_cycle_slope, limit_cycle_time_constant, lambda_),
            _variant(variant, settings),
        )
        for lambda_, variant in cases
    ]
    map_axes = (settings.map_time_constants_s, settings.map_slopes_per_s)
    loops = [with_slope(slope, time, law.lambda_per_s) for time, slope in product(*map_axes)]
    with open_sweep(**options) as sweep:
        measured = sweep.map(partial(_measure, settings), grid, "grid of λ, Φ, η")
        cycled = sweep.map(partial(_limit_cycle, settings), limit_cycles, "limit cycle")
        mapped = sweep.map(assess, loops, "map of T_f, k/Φ")
    return ControllerResult(
        scenario,
        settings,
        values=_arrays(measured, METRICS, axes),
        failures={
            point: values["failure"]
            for point, values in zip(points, measured, strict=True)
            if values["failure"]
        },
        limit_cycle=tuple(
            _limit_cycle_case(*case, run) for case, run in zip(cases, cycled, strict=True)
        ),
        map_values=_arrays(mapped, MAP_METRICS, map_axes),
    )


def experiments(scenario: Scenario, settings: ControllerSettings) -> dict[str, Scenario]:
    """The faster sine, both steps and the hold, about the middle of the scenario's reference."""
    high, middle = scenario.reference.range_deg[1], scenario.reference.middle_deg

    def step(start: float, end: float, duration: float) -> Scenario:
        reference = StepReference(start_deg=start, end_deg=end, time_s=0.0)
        return changed(scenario, {"reference": reference, "simulation.duration_s": duration})

    def about_the_middle(size: float) -> Scenario:
        return step(middle - 0.5 * size, middle + 0.5 * size, settings.step_duration_s)

    fast = SineReference(
        mean_deg=middle,
        amplitude_deg=settings.fast_amplitude_deg,
        frequency_hz=settings.fast_frequency_hz,
    )
    return {
        "fast": changed(
            scenario, {"reference": fast, "simulation.duration_s": settings.fast_duration_s}
        ),
        "step": about_the_middle(settings.step_deg),
        "large_step": about_the_middle(settings.large_step_deg),
        "hold": step(high - settings.step_deg, high, settings.hold_duration_s),
    }


def settling_time_s(time_s: Array, error: Array, band: float) -> float:
    """Last time at which |error| (n,) exceeds ``band``; inf when that is the end.

    The first sample does not count: it is the start of the step.
    """
    outside = np.flatnonzero(np.abs(error[1:]) > band)
    if outside.size == 0:
        return 0.0
    last = int(outside[-1]) + 1
    return math.inf if last == time_s.size - 1 else float(time_s[last])


def ideal_settling_time_s(lambda_per_s: Any, share: float) -> Any:
    """Time in s in which (d/dt + λ)² e = 0 brings e, at rest, to ``share``: a step from s = 0."""
    return (
        float(scipy.optimize.brentq(lambda y: (1.0 + y) * math.exp(-y) - share, 0.0, 100.0))
        / lambda_per_s
    )


@needs_runs
async def _measure(settings: ControllerSettings, scenario: Scenario) -> dict[str, Any]:
    """`METRICS` of one point of the grid, and the first reason of a failure."""
    cases = experiments(scenario, settings)
    at_reference = await awaitable(assess, scenario)
    fast = await awaitable(assess, cases["fast"], margins=False)
    metrics: dict[str, Any] = {name: at_reference[name] for name in METRICS if name in at_reference}
    metrics["fast_max_error_deg"] = fast["max_error_deg"]
    reasons = [
        at_reference["tracking_failure"],
        at_reference["margins_failure"],
        fast["tracking_failure"],
    ]
    for name, key in (("step", "settling_s"), ("large_step", "large_settling_s")):
        try:
            step = await awaitable(track, cases[name])
            band = settings.settling_band_deg
            metrics[key] = settling_time_s(step.run.time_s, step.error_deg, band)
        except KneexoError as failure:
            metrics[key] = math.nan
            reasons.append(str(failure))
    metrics["failure"] = next(filter(None, reasons), "")
    return metrics


@needs_runs
async def _limit_cycle(settings: ControllerSettings, scenario: Scenario) -> dict[str, Any]:
    """Fields of a `LimitCycleCase` but for λ and the variant."""
    linear = assess(scenario, tracking=False)
    margins = {name: linear[name] for name in ("stable", "disk_margin")}
    try:
        tracked = await awaitable(track, scenario)
        hold = await awaitable(track, experiments(scenario, settings)["hold"])
    except KneexoError as failure:
        return margins | {"failure": str(failure)}
    late = hold.run.time_s >= 0.5 * hold.run.time_s[-1]
    return margins | {
        "max_error_deg": tracked.metrics.max_error_deg,
        "mean_command_change_rpm": tracked.metrics.mean_command_change_rpm,
        "oscillation_at_rest_deg": float(np.ptp(hold.error_deg[late])),
        "time_s": tracked.run.time_s.tolist(),
        "error_deg": tracked.error_deg.tolist(),
    }


def _limit_cycle_case(lambda_: float, variant: str, run: dict[str, Any]) -> LimitCycleCase:
    arrays: dict[str, Any] = {
        name: np.array(run[name]) for name in ("time_s", "error_deg") if name in run
    }
    return LimitCycleCase(lambda_, variant, **(run | arrays))


def _variant(name: str, settings: ControllerSettings) -> dict[str, Any]:
    unlimited = settings.unlimited_acceleration_rad_s2
    changes: dict[str, dict[str, Any]] = {
        "as built": {},
        "exact encoder": {"encoder.quantized": False},
        "unlimited acceleration": {"plant.pump.acceleration_limit_rad_s2": unlimited},
    }
    return changes[name]


def observed_smc(scenario: Scenario) -> tuple[SlidingModeParameters, ObserverParameters]:
    """Controller and observer of a scenario that can be studied, else `ParameterError`."""
    law, estimator = scenario.controller, scenario.estimator
    if law.kind != "smc" or law.continuous or law.switching == "signum":
        raise ParameterError(
            f"controller.kind = {law.kind}: must be a sampled smc with switching: saturation, "
            f"whose λ, Φ and η the study varies"
        )
    if estimator.kind != "observer":
        raise ParameterError(f"estimator.kind = {estimator.kind}: must be observer for the study")
    return law, estimator


def _with_law(scenario: Scenario, lambda_: float, phi: float, eta: float) -> Scenario:
    values = {"lambda_per_s": lambda_, "phi_m_s2": phi, "eta_m_s3": eta}
    return changed(scenario, {f"controller.{name}": value for name, value in values.items()})


def _arrays(
    figures: list[dict[str, Any]], names: tuple[str, ...], axes: tuple[tuple[float, ...], ...]
) -> dict[str, Array]:
    """Arrays by name over ``axes``; a missing value (None) is nan."""
    shape = [len(axis) for axis in axes]
    return {
        name: np.array([values[name] for values in figures], dtype=float).reshape(shape)
        for name in names
    }


def _nearest(values: tuple[float, ...], value: float) -> int:
    return int(np.argmin(np.abs(np.log(np.array(values) / value))))


# ----------------------------------------------------------------------------------- claims


def _share(holds: Any) -> float:
    return float(np.mean(holds)) if holds.size else math.nan


def _counted(holds: Any, cases: Any, sound: Any) -> dict[str, Any]:
    return {
        "cases": int(np.count_nonzero(cases)),
        "share": _share(holds[cases]),
        "sound_cases": int(np.count_nonzero(cases & sound)),
        "sound_share": _share(holds[cases & sound]),
    }


def _faster(study: ControllerResult) -> Claim:
    grid, settling = study.settings, study.values["settling_s"]
    sound = study.values["disk_margin"] >= grid.sound_disk_margin
    small, large = settling[:-1], settling[1:]
    decided = ~np.isnan(small) & ~np.isnan(large) & (np.isfinite(small) | np.isfinite(large))
    _, phi, eta = study.centre
    band = grid.settling_band_deg
    ideal = ideal_settling_time_s(np.array(grid.lambdas_per_s), band / grid.step_deg)
    return Claim(
        quote="the larger the value of λ, the faster the robot attempted to follow the desired "
        "target value",
        case="two neighbouring λ at equal Φ and η; holds when the larger one brings a step of "
        f"{grid.step_deg:g}° to within ±{band:g}° of its end sooner",
        **_counted(large < small, decided, sound[1:] & sound[:-1]),
        finding=f"λ = {_numbers(grid.lambdas_per_s)} 1/s at the default Φ and η: the step of "
        f"{grid.step_deg:g}° settles to ±{band:g}° in {_numbers(settling[:, phi, eta])} s; s = 0 "
        f"alone would take {_numbers(ideal)} s. The step of {grid.large_step_deg:g}° settles to "
        f"the same ±{band:g}° in {_numbers(study.values['large_settling_s'][:, phi, eta])} s: the "
        f"speed limit bounds it.",
    )


def _chattering(study: ControllerResult) -> Claim:
    grid, change = study.settings, study.values["mean_command_change_rpm"]
    calm = np.where(np.isfinite(change), change, np.inf)
    best = np.argmin(calm, axis=1)  # (λ, η)
    logs = np.log(grid.phis_m_s2)
    distance = logs[None, :, None] - logs[best][:, None, :]
    wrong = np.isfinite(change) & (np.abs(distance) >= math.log(grid.wrong_factor) - 1e-9)
    chatters = change > grid.chattering_factor * np.min(calm, axis=1)[:, None, :]
    small, large = wrong & (distance < 0.0), wrong & (distance > 0.0)
    sound = study.values["disk_margin"] >= grid.sound_disk_margin
    chosen = best[:, study.centre[2]]
    rule = np.array(grid.lambdas_per_s) * study.slope_per_s[chosen, study.centre[2]]
    return Claim(
        quote="it was important to select a proper Φ value […] failure to do so resulted in "
        "chattering",
        case=f"a Φ at least {grid.wrong_factor:g} times larger or smaller than the calmest one at "
        f"equal λ and η; holds when its command changes more than {grid.chattering_factor:g} "
        f"times as much per sample",
        **_counted(chatters, wrong, sound),
        finding=f"Too small a Φ chatters in {percent(_share(chatters[small]))} of "
        f"{np.count_nonzero(small)} cases (the counts of the encoder, amplified up to the speed "
        f"limit), too large a Φ in {percent(_share(chatters[large]))} of "
        f"{np.count_nonzero(large)} (an oscillation of a loop without damping, see the limit cycle "
        f"below). The calmest Φ at the default η is {_numbers(np.array(grid.phis_m_s2)[chosen])} "
        f"m/s² at λ = {_numbers(grid.lambdas_per_s)} 1/s; λk/Φ there is "
        f"{rule.min():.2g}…{rule.max():.2g} 1/s².",
    )


def _adherence(study: ControllerResult) -> Claim:
    grid, error = study.settings, study.values["max_error_deg"]
    sound = study.values["disk_margin"] >= grid.sound_disk_margin
    free = (study.values["stable"] == 1.0) & (study.values["saturated_share"] < _SATURATED)
    finite = np.isfinite(error[..., :-1]) & np.isfinite(error[..., 1:])
    falls = error[..., 1:] < error[..., :-1]
    beyond = finite & ~free[..., 1:]
    lambda_, phi, eta = study.centre
    slope = float(study.slope_per_s[phi, eta])
    same = [
        _at_slope(study.slope_per_s[:, n], error[lambda_, :, n], slope)
        for n in range(len(grid.etas_m_s3))
    ]
    return Claim(
        quote="the k value was also increased as the η value became larger, making the system "
        "more adherent to the target value",
        case="two neighbouring η at equal λ and Φ, the larger one with a stable loop and less "
        f"than {100 * _SATURATED:g} % of its samples saturated; holds when its largest error is "
        f"smaller",
        **_counted(falls, finite & free[..., 1:], sound[..., 1:] & sound[..., :-1]),
        finding=f"Where the larger η saturates or is unstable the error falls in "
        f"{percent(_share(falls[beyond]))} of {np.count_nonzero(beyond)} cases. η = "
        f"{_numbers(grid.etas_m_s3)} m/s³ at the default λ and Φ: error "
        f"{_numbers(error[lambda_, phi])}°. It is k/Φ that counts, which rises with η: with Φ "
        f"raised too, so that k/Φ stays {slope:.2g} 1/s, the same η give {_numbers(same)}°.",
    )


def _at_slope(slopes: Array, error: Array, slope: float) -> float:
    """Error at one k/Φ, by interpolation of both logarithms; nan out of their range."""
    order = np.argsort(slopes)
    x, y = np.log(slopes[order]), np.log(error[order])
    rounding = 0.02  # of the grid's values
    if not x[0] - rounding <= math.log(slope) <= x[-1] + rounding:
        return math.nan
    return float(np.exp(np.interp(math.log(slope), x, y)))


def _numbers(values: Any) -> str:
    return ", ".join(map(number, values))
