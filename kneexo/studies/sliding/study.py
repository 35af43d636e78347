"""The study of the sliding condition s·ds/dt ≤ −η|s| on the reduced- and the full-order plant."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Unpack

import numpy as np

from kneexo.analysis.bandwidth import rod_of
from kneexo.analysis.error_model import error_model
from kneexo.analysis.frequency_response import require_sine
from kneexo.analysis.hardware import sliding_mode
from kneexo.errors import ParameterError
from kneexo.parameters import (
    EncoderParameters,
    ExactParameters,
    FullCylinderParameters,
    Scenario,
    SlidingModeParameters,
)
from kneexo.parameters.paths import changed
from kneexo.result import Result
from kneexo.rod_polynomial import controller_polynomial
from kneexo.studies.sliding.condition import SlidingMeasurement, check_sliding
from kneexo.studies.sliding.settings import SLIDING_LAW, SlidingSettings
from kneexo.sweeps import SweepOptions, open_sweep
from kneexo.systems.knee_coordinates import rod_derivatives

LAWS = {"paper": "Eq. 27", "area": "Eq. 27 + area", "area_gain": "Eq. 27 + area, gain"}
"""Labels of the compared formulas for the gain k: Eq. 27, and Eq. 27 with further terms."""


# -------------------------------------------------------------------------------- study


def effective_masses_kg(scenario: Scenario) -> tuple[float, float]:
    """Return mass bounds in kg that cover the gain b of each chamber over the reference's range.

    For a reduced-order plant they are the control law's own bounds. For a full-order plant these
    bounds are multiplied by (Ā/A_i)(4V_i/V_t), the factor by which the reduced order is too stiff.
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
    """Return the scenario with the controller's parameters for one of the `LAWS`."""
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
    """One run of the study: its labels, and its numbers from `check_sliding`."""

    part: str
    """Part of the study: ``motion``, ``start`` or ``sampled``.

    A ``motion`` run follows the reference, a ``start`` run begins outside the boundary layer, and a
    ``sampled`` run has a controller sampled at 2 ms.
    """
    plant: str
    law: str
    load_n: float
    eta_m_s3: float
    measured: SlidingMeasurement

    @property
    def stays(self) -> bool:
        """True if the run completed and s, once in the boundary layer |s| ≤ Φ, never left it."""
        return not self.measured.failure and self.measured.left_share == 0.0

    def results(self) -> dict[str, Any]:
        """Return the labels, then the measured numbers without the trace, as plain data."""
        labels = asdict(self)
        numbers = labels.pop("measured")
        del numbers["trace"]
        return labels | numbers


def full_order(scenario: Scenario) -> Scenario:
    """Return the scenario with the full-order model of the cylinder."""
    full = scenario.plant.full_order or FullCylinderParameters()
    return changed(scenario, {"plant.full_order": dict(full)})


def _cases(
    scenario: Scenario, settings: SlidingSettings
) -> list[tuple[tuple[str, str, str, float, float], Scenario]]:
    """Return the labels (part, plant, law, load, η) and the scenario of each run of the study."""
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
    """Least η in m/s³ with which Eq. 27 should keep |s| ≤ Φ on the full-order plant."""

    speed: float
    """The η at which βη equals ω̂²(A_1/Ā − 1)|ẋ_d| at the reference's peak speed."""
    stability: float
    """The η at which 2λβη/Φ equals ω̂²(1 − A_2/Ā).

    With a smaller η, a load on chamber 2 drives s outwards.
    """


def needed_eta(scenario: Scenario = SLIDING_LAW) -> NeededEta:
    """Return the η that closed formulas require along the scenario's sinusoidal reference."""
    law, oil = sliding_mode(scenario), scenario.plant.cylinder
    reference = require_sine(scenario)
    phase = np.linspace(0.0, 2.0 * np.pi, 2001)
    amplitude = math.radians(reference.amplitude_deg)
    angle = math.radians(reference.mean_deg) - amplitude * np.cos(phase)
    rate = 2.0 * math.pi * reference.frequency_hz * amplitude * np.sin(phase)
    none = 0.0 * phase
    p_si = controller_polynomial(scenario).p_si
    speed = np.abs(rod_derivatives(p_si, (angle, rate, none, none))[1])
    area = error_model(changed(scenario, {"plant.full_order": None})).stiffness_per_s2
    area *= oil.cap_area_m2 / oil.mean_area_m2 - 1.0
    return NeededEta(
        speed=area * float(np.max(speed)) / law.gain_ratio,
        stability=0.5 * area * law.phi_m_s2 / (law.lambda_per_s * law.gain_ratio),
    )


@dataclass(frozen=True, repr=False)
class SlidingResult(Result):
    """Runs of `sliding_study`. ``needed`` is the η that closed formulas require."""

    cases: tuple[SlidingCase, ...]
    needed: NeededEta
    scenario: Scenario
    settings: SlidingSettings

    @property
    def law(self) -> SlidingModeParameters:
        """The controller of the scenario."""
        return sliding_mode(self.scenario)

    def of(self, part: str, **labels: Any) -> list[SlidingCase]:
        """Return the cases of a part that have the values ``labels``, in the order of the runs."""
        return [
            case
            for case in self.cases
            if case.part == part and all(getattr(case, k) == v for k, v in labels.items())
        ]

    def smallest_eta(self, law: str, load_n: float) -> float:
        """Return the least η in m/s³ such that s stays in the boundary layer at this η and above.

        The result is inf if s leaves the layer at the largest η. The runs are those of the
        full-order plant that follow the reference.
        """
        cases = self.of("motion", plant="full", law=law, load_n=load_n)
        smallest = math.inf
        for case in sorted(cases, key=lambda c: -c.eta_m_s3):
            if not case.stays:
                break
            smallest = case.eta_m_s3
        return smallest

    def results(self) -> dict[str, Any]:
        """Return the study as plain data with units in the names. The traces are left out."""
        return {
            "needed_eta_m_s3": asdict(self.needed),
            "smallest_eta_m_s3": {
                law: {f"{load:g} N": self.smallest_eta(law, load) for load in self.settings.loads_n}
                for law in LAWS
            },
            "effective_mass_kg": effective_masses_kg(full_order(self.scenario)),
            "cases": [case.results() for case in self.cases],
        }


def sliding_study(
    scenario: Scenario = SLIDING_LAW,
    settings: SlidingSettings = SlidingSettings(),
    **options: Unpack[SweepOptions],
) -> SlidingResult:
    """Check the sliding condition on the reduced- and on the full-order plant, for each of `LAWS`.

    ``scenario`` must have the continuous law, exact states, a knee load and a sinusoidal reference.
    The study simulates the two orders of its cylinder under the loads of ``settings``. ``options``:
    see `kneexo.sweeps.SweepOptions`. Raises `ParameterError` for any other scenario.
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
            weight=lambda case: case.duration_s,
        )
    return SlidingResult(
        cases=tuple(
            SlidingCase(*labels, SlidingMeasurement.from_data(data))
            for (labels, _), data in zip(labelled, outcomes, strict=True)
        ),
        needed=needed_eta(scenario),
        scenario=scenario,
        settings=settings,
    )
