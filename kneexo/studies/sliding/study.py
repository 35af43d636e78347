"""Does Eq. 27 keep its promise? The sliding condition s·ds/dt ≤ −η|s|, and what follows from it.

With the true s = ë + 2λė + λ²e, ds/dt = x⃛ − x⃛_d + 2λë + λ²ė, and x⃛ comes from the plant's own
equations: the acceleration of the rod differentiated along dx/dt by AutoDiff, exactly, at each
logged state. So whether the condition holds at a state does not depend on the solver.

On a plant with another loaded area A_i, gain b and a motor without lag, outside the layer,

    ds/dt = (b/b̂)[ω̂²(1 − A_i/Ā) ẋ − k sgn s] + (b/b̂ − 1)(x⃛_d − 2λë − λ²ė),

so that the condition takes k ≥ ω̂²|1 − A_i/Ā||ẋ| + |1 − b̂/b||x⃛_d − 2λë − λ²ė| + (b̂/b) η. Eq. 27
lacks the first term, and bounds b̂/b by the masses alone. In full order one chamber is stiff and
its volume V_i follows the rod, b̂/b = (m/m̂)(Ā/A_i)(4V_i/V_t): as if the mass changed.

Inside the layer |s| ≤ Φ implies |e| ≤ Φ/λ² once the start has died down (Slotine), and here
`error_bounds` says what it implies before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Unpack

import numpy as np
from pydrake.autodiffutils import AutoDiffXd

from kneexo.analysis.bandwidth import rod_of
from kneexo.analysis.error_model import error_model
from kneexo.analysis.frequency_response import require_sine
from kneexo.analysis.hardware import sliding_mode
from kneexo.diagrams import SIGNALS, make_plant
from kneexo.diagrams.plant import plant_parts
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import (
    EncoderParameters,
    ExactParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SlidingModeParameters,
)
from kneexo.parameters.paths import changed
from kneexo.parameters.quantity import Parameters, quantities, quantity
from kneexo.result import Array, Result
from kneexo.simulation import Run, awaitable, needs_runs, simulate
from kneexo.sweeps import SweepOptions, open_sweep
from kneexo.systems.knee_coordinates import rod_derivatives
from kneexo.systems.sliding_mode_controller import sliding_variable


class SlidingSettings(Parameters):
    """Which η, loads and gains the check of the sliding condition runs through."""

    etas_m_s3: tuple[float, ...] = quantities(
        (1e3, 1e4, 3e4, 3.6e4, 7e4, 9e4, 2.8e5),
        "m/s³",
        "assumption: from 1/300 of the speed authority to all of it, with two each "
        "about 3.3e4 and 8.0e4, what the closed forms ask for with P_1 and P_2 loaded",
        ge=1e-3,
        le=1e12,
    )
    loads_n: tuple[float, ...] = quantities(
        (60.0, -60.0),
        "N",
        "assumption: four times the switching force, so that one chamber carries "
        "the load throughout, P_1 or P_2",
        ge=-1e4,
        le=1e4,
    )
    start_eta_m_s3: float = quantity(
        1e3,
        "m/s³",
        "assumption: so small that reaching the layer takes a time worth looking at",
        ge=1e-3,
        le=1e12,
    )
    start_offset_m: float = quantity(
        -0.010, "m", "assumption: λ² times it lies outside the layer", ge=-0.15, le=0.15
    )
    start_duration_s: float = quantity(
        0.010, "s", "assumption: ten times what reaching takes", ge=1e-3, le=1e3
    )
    start_sample_time_s: float = quantity(
        2e-5, "s", "assumption: of the log; fifty before the layer is reached", ge=1e-5, le=1
    )
    sampled_eta_m_s3: float = quantity(
        2.8e4,
        "m/s³",
        "assumption: k/Φ = 9.9e3 1/s, below the stability boundary of exact states at 2 ms",
        ge=1e-3,
        le=1e12,
    )
    sampled_offset_m: float = quantity(
        -0.020, "m", "assumption: half a second at the speed limit", ge=-0.15, le=0.15
    )
    settling_factor: float = quantity(
        8.0,
        "1",
        "assumption: times 1/λ after which what is left of the start does not count, 0.3 %",
        ge=0,
        le=1e3,
    )
    rated_samples: int = quantity(
        2000,
        "1",
        "assumption: samples outside the layer at which ds/dt is evaluated, at most",
        ge=10,
        le=1_000_000,
    )


SLIDING_LAW = Scenario(
    plant=PlantParameters(
        load=KneeLoadParameters(segment_mass_kg=0.0), rod_map="polynomial", ideal_motor=True
    ),
    encoder=EncoderParameters(quantized=False),
    estimator=ExactParameters(),
    controller=SlidingModeParameters(
        continuous=True,
        sample_time_s=2e-4,
        load_rate_uncertainty_n_per_s=2.5e3,
        command_limit_rad_s=1e12,
    ),
    simulation=SimulationParameters(duration_s=10.0),
)
"""The setting of the sliding condition: continuous time, exact states, an ideal motor.

The sample time is that of the log. Eq. 27 drops the leakage, 4 β_e C_t/V_t = 33 N/s per newton of
load; here its bound on dF_L/dt holds it, for 75 N."""


_ROUNDING = 1e-6
"""Share of η by which the condition may seem violated where it holds with equality."""

_TRACE_POINTS = 600

_SHORTEST = 20
"""Samples of the shortest run that says anything."""

LAWS = {"paper": "Eq. 27", "area": "Eq. 27 + area", "area_gain": "Eq. 27 + area, gain"}
"""The k that are compared, and their names in tables."""


# -------------------------------------------------------------------------------- ds/dt


def plant_state_columns(plant: PlantParameters) -> tuple[tuple[str, float], ...]:
    """The plant's continuous state: columns of a run, and their factors to the Context's units."""
    states = (state for part in plant_parts(plant) for state in part.states)
    return tuple((state.column, 1.0 / state.factor) for state in states)


def sliding_signals(scenario: Scenario) -> tuple[str, ...]:
    """The signals that `sliding_rates` needs."""
    states = {column for column, _ in plant_state_columns(scenario.plant)}
    return (
        *("rod_reference", "sliding_variable", "motor_speed_command"),
        *(name for name, columns in SIGNALS.items() if states.intersection(columns)),
    )


def sliding_rates(
    scenario: Scenario, run: Run, rows: Any, commands_rad_s: Array
) -> tuple[Array, Array]:
    """True s and ds/dt, each (n,), at ``rows`` of a run with the motor speed commands in force.

    The run needs the signals of `sliding_signals`. Raises `ParameterError` for another controller.
    """
    lambda_ = sliding_mode(scenario).lambda_per_s
    plant: Any = make_plant(scenario.plant, table_1=scenario.polynomial)
    automatic = plant.ToAutoDiffXd()
    context, seeded = plant.CreateDefaultContext(), automatic.CreateDefaultContext()
    rod_state = automatic.GetOutputPort("rod_state")
    state_columns = plant_state_columns(scenario.plant)
    states = np.stack([factor * run[name] for name, factor in state_columns], axis=1)
    reference = np.stack(
        [
            run[f"rod_reference_{name}"]
            for name in ("m", "velocity_m_s", "acceleration_m_s2", "jerk_m_s3")
        ]
    )
    s, s_rate = np.empty(len(rows)), np.empty(len(rows))
    for index, (row, command) in enumerate(zip(rows, commands_rad_s, strict=True)):
        time, state = float(run.time_s[row]), states[row]
        context.SetTime(time)
        context.SetContinuousState(state)
        plant.GetInputPort("motor_speed_command").FixValue(context, [command])
        rates = plant.EvalTimeDerivatives(context).CopyToVector()
        # One direction is enough: along the flow, time included.
        seeded.SetTime(AutoDiffXd(time, [1.0]))
        seeded.SetContinuousState(
            [AutoDiffXd(x, [rate]) for x, rate in zip(state, rates, strict=True)]
        )
        motion = rod_state.Eval(seeded)
        here, there = reference[:, row], reference[1:, row]
        s[index] = sliding_variable([x.value() for x in motion], here, lambda_)
        s_rate[index] = sliding_variable([x.derivatives()[0] for x in motion], there, lambda_)
    return s, s_rate


# ---------------------------------------------------------------------- bounds on the error


def error_bounds(
    time_s: Array, error_m: float, rate_m_s: float, *, lambda_per_s: float, phi_m_s2: float
) -> tuple[Array, Array]:
    """Bounds on |e| in m and |ė| in m/s, each (n,), while |s| ≤ Φ.

    ``error_m`` and ``rate_m_s``: e and ė at the first of ``time_s``. From (d/dt + λ)² e = s:
    the free motion, plus Φ times the integral over the absolute impulse response. The second part
    ends at Φ/λ² and at 2Φ/(eλ), below Slotine's 2Φ/λ.
    """
    z = lambda_per_s * (time_s - time_s[0])
    decay, slope = np.exp(-z), rate_m_s / lambda_per_s + error_m
    free = np.abs(decay * (error_m + slope * z))
    free_rate = lambda_per_s * np.abs(decay * (slope - error_m - slope * z))
    rise = 1.0 - decay * (1.0 + z)
    rate_rise = np.where(z < 1.0, z * decay, 2.0 / math.e - z * decay)
    return (
        np.asarray(free + phi_m_s2 / lambda_per_s**2 * rise),
        np.asarray(free_rate + phi_m_s2 / lambda_per_s * rate_rise),
    )


# ----------------------------------------------------------------------------- one run


@needs_runs
async def check_sliding(
    settings: SlidingSettings, scenario: Scenario = SLIDING_LAW
) -> dict[str, Any]:
    """Run a scenario and measure, in plain numbers by name, what Eq. 27 promises.

    ``outside_share``: share of the run with |s| > Φ; of these samples, ``holding_share`` has
    s·ds/dt ≤ −η|s| and ``attracting_share`` s·ds/dt < 0, and ``worst_rate_m_s3`` is the largest
    sgn(s)·ds/dt. ``reaching_s`` is when the layer is reached, at the latest expected after
    ``promised_s``; ``left_share`` is the share of the time after it that is outside again, and
    ``largest_s`` the largest |s|/Φ then. ``error_share``, ``rate_share`` and
    ``acceleration_share`` are the largest |e|, |ė| and |ë| after the start has died down, over
    Slotine's bounds Φ/λ², 2Φ/λ and 4Φ; ``bounded_share`` counts the samples with |e| within
    `error_bounds`, until the layer is left.

    With a sampled law the rates are those just after an update; ``held_share`` and ``mean_share``
    count the condition just before the next one, and for the mean ds/dt in between. A run that
    fails, as ``failure`` says, is repeated over half the time until it does not (``duration_s``).
    What does not exist is nan. ``trace`` holds signals for figures.
    """
    law = sliding_mode(scenario)
    measured: dict[str, Any] = dict.fromkeys(
        (
            *("outside_share", "holding_share", "attracting_share", "worst_rate_m_s3"),
            *("held_share", "mean_share", "reaching_s", "left_share", "largest_s"),
            *("error_share", "rate_share", "acceleration_share", "bounded_share"),
            "largest_error_mm",
        ),
        math.nan,
    )
    run, measured["failure"] = await _longest_run(scenario)
    measured["duration_s"] = float(run.time_s[-1])
    command = run["motor_speed_command_rad_s"]
    if not law.continuous:
        command = command[1:]  # logged is what was held up to the sample
    rows = np.arange(command.size)
    if scenario.estimator.kind == "exact":
        s = run["sliding_variable_m_s2"][rows]
    else:
        s, _ = sliding_rates(scenario, run, rows, command)
    error = (run["rod_extension_m"] - run["rod_reference_m"])[rows]
    rate = (run["rod_velocity_m_s"] - run["rod_reference_velocity_m_s"])[rows]
    time, phi, lambda_ = run.time_s[rows], law.phi_m_s2, law.lambda_per_s
    outside = np.abs(s) > phi
    measured["outside_share"] = float(np.mean(outside))
    measured["promised_s"] = (
        max(0.0, float(abs(s[0]) - phi)) / law.eta_m_s3 if law.eta_m_s3 else 0.0
    )

    chosen = _thinned(np.flatnonzero(outside), settings.rated_samples)
    reaching_rate = np.empty(0)
    if chosen.size:
        eta = law.eta_m_s3 * (1.0 - _ROUNDING)
        reaching_rate = _reaching_rate(scenario, run, chosen, command[chosen])
        measured["holding_share"] = float(np.mean(reaching_rate <= -eta))
        measured["attracting_share"] = float(np.mean(reaching_rate < 0.0))
        measured["worst_rate_m_s3"] = float(np.max(reaching_rate))
        if not law.continuous:
            inner = chosen[chosen < rows.size - 1]
            late = _reaching_rate(scenario, run, inner + 1, command[inner])
            mean = np.sign(s[inner]) * (s[inner + 1] - s[inner]) / law.sample_time_s
            measured["held_share"] = float(np.mean(late <= -eta))
            measured["mean_share"] = float(np.mean(mean <= -eta))
    bound = np.full(time.size, math.nan)
    if not outside.all():
        reached = int(np.argmin(outside))
        measured["reaching_s"] = float(time[reached])
        measured["left_share"] = float(np.mean(outside[reached:]))
        measured["largest_s"] = float(np.max(np.abs(s[reached:]))) / phi
        left = reached + int(np.argmax(outside[reached:])) if outside[reached:].any() else time.size
        inside = slice(reached, left)
        bound[inside], _ = error_bounds(
            time[inside],
            float(error[reached]),
            float(rate[reached]),
            lambda_per_s=lambda_,
            phi_m_s2=phi,
        )
        within = np.abs(error[inside]) <= bound[inside] * (1.0 + _ROUNDING)
        measured["bounded_share"] = float(np.mean(within))
        late = time >= time[reached] + settings.settling_factor / lambda_
        if late.any():
            acceleration = s[late] - 2.0 * lambda_ * rate[late] - lambda_**2 * error[late]
            measured["largest_error_mm"] = 1e3 * float(np.max(np.abs(error[late])))
            measured["error_share"] = float(np.max(np.abs(error[late]))) * lambda_**2 / phi
            measured["rate_share"] = float(np.max(np.abs(rate[late]))) * lambda_ / (2.0 * phi)
            measured["acceleration_share"] = float(np.max(np.abs(acceleration))) / (4.0 * phi)
    points = _thinned(rows, _TRACE_POINTS)
    shown = np.linspace(0, chosen.size - 1, min(chosen.size, _TRACE_POINTS)).astype(int)
    measured["trace"] = {
        "time_s": time[points].tolist(),
        "s_m_s2": s[points].tolist(),
        "error_m": error[points].tolist(),
        "bound_m": bound[points].tolist(),
        "outside_time_s": time[chosen[shown]].tolist(),
        "reaching_rate_m_s3": reaching_rate[shown].tolist(),
    }
    return measured


async def _longest_run(scenario: Scenario) -> tuple[Run, str]:
    """The run of a scenario, over half the time as long as it fails; and why it failed first."""
    failure, duration = "", scenario.simulation.duration_s
    while True:
        shortened = changed(scenario, {"simulation.duration_s": duration})
        try:
            run = await awaitable(simulate, shortened, signals=sliding_signals(scenario))
            return run, failure
        except SimulationError as error:
            failure = failure or str(error)
            duration *= 0.5
            if duration < _SHORTEST * scenario.controller.sample_time_s:
                raise


def _reaching_rate(scenario: Scenario, run: Run, rows: Array, command: Array) -> Array:
    """sgn(s)·ds/dt at rows outside the layer: at most −η, the law promises."""
    s, s_rate = sliding_rates(scenario, run, rows, command)
    return np.asarray(np.sign(s) * s_rate)


def _thinned(rows: Any, largest: int) -> Any:
    """At most ``largest`` rows: the first half of them in a row, the rest evenly spread."""
    if rows.size <= largest:
        return rows
    half = largest // 2
    spread = np.linspace(half, rows.size - 1, largest - half).astype(int)
    return np.concatenate([rows[:half], rows[spread]])


# -------------------------------------------------------------------------------- study


def effective_masses_kg(scenario: Scenario) -> tuple[float, float]:
    """Mass bounds in kg that stand for the gain b of either chamber over the reference's range.

    The law's own bounds times (Ā/A_i)(4V_i/V_t), the stiffness that the reduced order has too much.
    """
    law, oil, full = sliding_mode(scenario), scenario.plant.cylinder, scenario.plant.full_order
    if full is None:
        return law.mass_min_kg, law.mass_max_kg
    rod = rod_of(scenario, np.radians(scenario.reference.range_deg))
    factors = [
        oil.mean_area_m2 / area * 4.0 * (full.dead_volume_m3 + area * way) / oil.total_volume_m3
        for area, ways in (
            (oil.cap_area_m2, rod),
            (oil.rod_side_area_m2, oil.stroke_m - rod),
        )
        for way in ways
    ]
    return float(law.mass_min_kg * min(factors)), float(law.mass_max_kg * max(factors))


def _with_law(scenario: Scenario, law: str) -> Scenario:
    """The scenario with one of the `LAWS`."""
    oil, values = scenario.plant.cylinder, {}
    if law != "paper":
        values["controller.area_uncertainty"] = oil.cap_area_m2 / oil.mean_area_m2 - 1.0
    if law == "area_gain":
        bounds = effective_masses_kg(scenario)
        values |= dict(
            zip(("controller.mass_min_kg", "controller.mass_max_kg"), bounds, strict=True)
        )
    return changed(scenario, values)


@dataclass(frozen=True)
class SlidingCase:
    """One run of the study and what `check_sliding` measured in it."""

    part: str
    """motion: along the reference; start: from outside the layer; sampled: at 2 ms."""
    plant: str
    law: str
    load_n: float
    eta_m_s3: float
    measured: Mapping[str, Any]

    @property
    def stays(self) -> bool:
        """Whether s never left the layer again, and the run reached its end."""
        return not self.measured["failure"] and self.measured["left_share"] == 0.0


def full_order(scenario: Scenario) -> Scenario:
    """The scenario with the cylinder in full order."""
    full = scenario.plant.full_order or FullCylinderParameters()
    return changed(scenario, {"plant.full_order": dict(full)})


def _cases(
    scenario: Scenario, settings: SlidingSettings
) -> list[tuple[tuple[str, str, str, float, float], Scenario]]:
    """Labels (part, plant, law, load, η) and scenarios of the study."""
    law = sliding_mode(scenario)
    full = full_order(scenario)
    reduced = changed(scenario, {"plant.full_order": None})
    plants = [
        *(
            (f"reduced, {mass:g} kg", "paper", changed(reduced, {"plant.cylinder.mass_kg": mass}))
            for mass in (law.mass_min_kg, law.mass_max_kg)
        ),
        *(("full", name, _with_law(full, name)) for name in LAWS),
    ]
    start = {
        "initial_offset_m": settings.start_offset_m,
        "controller.sample_time_s": settings.start_sample_time_s,
        "simulation.duration_s": settings.start_duration_s,
    }
    parts: list[tuple[str, float, dict[str, Any]]] = [
        ("motion", eta, {}) for eta in settings.etas_m_s3
    ]
    parts += [("start", settings.start_eta_m_s3, start)]
    cases = [
        (
            (part, plant, name, load, eta),
            changed(
                variant,
                changes | {"controller.eta_m_s3": eta, "plant.load.disturbance_n": load},
            ),
        )
        for part, eta, changes in parts
        for plant, name, variant in plants
        for load in settings.loads_n
        # The load does not move the reduced order, but for its leakage.
        if plant == "full" or load == settings.loads_n[0]
    ]
    exact = {
        "encoder": dict(EncoderParameters(quantized=False)),
        "estimator": dict(ExactParameters()),
        "controller.eta_m_s3": settings.sampled_eta_m_s3,
    }
    loops = {
        "ideal motor": exact | {"plant.ideal_motor": True},
        "motor": exact,
        "motor, encoder, observer": {},
    }
    for plant, variant in (("reduced", reduced), ("full", full)):
        for load in settings.loads_n:
            for loop, changes in loops.items():
                sampled = changed(
                    Scenario(
                        plant=variant.plant,
                        reference=scenario.reference,
                        initial_offset_m=settings.sampled_offset_m,
                        simulation=scenario.simulation,
                    ),
                    {
                        "plant.load.disturbance_n": load,
                        "plant.ideal_motor": False,
                        "controller.lambda_per_s": law.lambda_per_s,
                    }
                    | changes,
                )
                eta = sliding_mode(sampled).eta_m_s3
                cases.append((("sampled", f"{plant}, {loop}", "paper", load, eta), sampled))
    return cases


@dataclass(frozen=True)
class NeededEta:
    """η in m/s³ from which on the paper's k should keep s inside the layer in full order."""

    speed: float
    """βη covers ω̂²|ΔA/Ā||ẋ_d| at the reference's peak speed."""
    stability: float
    """2λβη/Φ exceeds ω̂²(1 − A_2/Ā): with P_2 loaded the layer itself repels below."""


def needed_eta(scenario: Scenario = SLIDING_LAW) -> NeededEta:
    """What the closed forms ask of η, for a sinusoidal reference."""
    law, oil = sliding_mode(scenario), scenario.plant.cylinder
    reference = require_sine(scenario)
    phase = np.linspace(0.0, 2.0 * np.pi, 2001)
    amplitude = math.radians(reference.amplitude_deg)
    angle = math.radians(reference.mean_deg) - amplitude * np.cos(phase)
    rate = 2.0 * math.pi * reference.frequency_hz * amplitude * np.sin(phase)
    none = 0.0 * phase
    speed = np.abs(rod_derivatives(scenario.polynomial.p_si, (angle, rate, none, none))[1])
    area = error_model(changed(scenario, {"plant.full_order": None})).stiffness_per_s2
    area *= oil.cap_area_m2 / oil.mean_area_m2 - 1.0
    return NeededEta(
        speed=area * float(np.max(speed)) / law.gain_ratio,
        stability=0.5 * area * law.phi_m_s2 / (law.lambda_per_s * law.gain_ratio),
    )


@dataclass(frozen=True, repr=False)
class SlidingResult(Result):
    """What `sliding_study` measures; ``needed`` is what the closed forms ask for."""

    cases: tuple[SlidingCase, ...]
    needed: NeededEta
    scenario: Scenario
    settings: SlidingSettings

    @property
    def law(self) -> SlidingModeParameters:
        """The controller of the scenario."""
        return sliding_mode(self.scenario)

    def of(self, part: str, **labels: Any) -> list[SlidingCase]:
        """The cases of a part with these labels, in order."""
        return [
            case
            for case in self.cases
            if case.part == part and all(getattr(case, k) == v for k, v in labels.items())
        ]

    def smallest_eta(self, law: str, load_n: float) -> float:
        """Smallest η in m/s³ from which on s stays in the layer in full order; inf if none."""
        cases = self.of("motion", plant="full", law=law, load_n=load_n)
        smallest = math.inf
        for case in sorted(cases, key=lambda c: -c.eta_m_s3):
            if not case.stays:
                break
            smallest = case.eta_m_s3
        return smallest

    def results(self) -> dict[str, Any]:
        """Plain data, units in the names."""
        return {
            "needed_eta_m_s3": asdict(self.needed),
            "smallest_eta_m_s3": {
                law: {f"{load:g} N": self.smallest_eta(law, load) for load in self.settings.loads_n}
                for law in LAWS
            },
            "effective_mass_kg": effective_masses_kg(full_order(self.scenario)),
            "cases": [
                {name: value for name, value in asdict(case).items() if name != "measured"}
                | {name: value for name, value in case.measured.items() if name != "trace"}
                for case in self.cases
            ],
        }


def sliding_study(
    scenario: Scenario = SLIDING_LAW,
    settings: SlidingSettings = SlidingSettings(),
    **options: Unpack[SweepOptions],
) -> SlidingResult:
    """Check the sliding condition in reduced and full order, with Eq. 27's k and completed ones.

    ``scenario``: the continuous law with exact states and a sinusoidal reference; its cylinder is
    taken in both orders, with the loads of ``settings``. ``options``: see
    `kneexo.sweeps.SweepOptions`. Raises `ParameterError` for a scenario of another kind.
    """
    law = sliding_mode(scenario)
    if not law.continuous or scenario.plant.load.kind != "knee":
        raise ParameterError(
            "the study needs controller.continuous = true and plant.load.kind = knee"
        )
    labelled = _cases(scenario, settings)
    with open_sweep(**options) as sweep:
        outcomes = sweep.map(
            partial(check_sliding, settings),
            [case for _, case in labelled],
            "sliding condition",
            weight=lambda case: case.simulation.duration_s,
        )
    return SlidingResult(
        cases=tuple(
            SlidingCase(*labels, outcome)
            for (labels, _), outcome in zip(labelled, outcomes, strict=True)
        ),
        needed=needed_eta(scenario),
        scenario=scenario,
        settings=settings,
    )
