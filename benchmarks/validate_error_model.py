"""The closed forms of the sliding-mode error against simulation, over a decade of λ and of k/Φ.

Prints one row for each pair: simulated over predicted error (root mean square) with a piston area
of 8/7 and 6/7 of what the controller believes (those of P_1 and P_2 loaded), and with the motor's
lag alone; 5 % is required. Then the same with either chamber of the full order loaded, at the
default gains, and for how fast a sine the slow form holds. Run it with ``python
benchmarks/validate_error_model.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.analysis.signals import rms
from kneexo.common.result import Array
from kneexo.parameters import (
    CylinderParameters,
    KneeLoadParameters,
    Scenario,
    SineReference,
    SlidingModeParameters,
)
from kneexo.parameters.paths import changed
from kneexo.simulation import simulate
from kneexo.studies.size.error_model import Chamber, ErrorModel, error_model
from kneexo.sweeps import parallel_map

LAMBDAS = (5.0, 7.0, 10.0, 20.0, 35.0, 50.0)
SLOPES = (2e4, 5e4, 1e5, 2e5)
SHARES = (8.0 / 7.0, 6.0 / 7.0)
SLOW = {"reference": dict(SineReference(amplitude_deg=20.0, frequency_hz=0.01))}
SLOW["simulation.duration_s"] = 400.0
LAG = {"reference": dict(SineReference(amplitude_deg=5.0, frequency_hz=0.05))}
LAG["simulation.duration_s"] = 80.0


def loop(lambda_: float, slope: float, share: float = 1.0, **values: object) -> Scenario:
    """A loop without quantizer whose plant has ``share`` of the believed piston area."""
    law, oil = SlidingModeParameters(), CylinderParameters()
    bore = math.sqrt(4.0 / math.pi * share * oil.mean_area_m2 + 0.5 * oil.rod_diameter_m**2)
    return changed(
        Scenario(),
        {
            "controller.lambda_per_s": lambda_,
            "controller.phi_m_s2": law.gain_ratio * law.eta_m_s3 / slope,
            "encoder.quantized": False,
            "plant.rod_map": "polynomial",
            "plant.cylinder.bore_m": bore,
            "nominal": {"rod_map": "polynomial"},
            **values,
        },
    )


@dataclass(frozen=True)
class ErrorComparison:
    """Simulated and predicted error of the rod over the last part of a run, each (n,)."""

    model: ErrorModel
    time_s: Array
    simulated_m: Array
    predicted_m: Array

    @property
    def ratio(self) -> float:
        """Root mean square of the simulated error over that of the predicted one."""
        return rms(self.simulated_m) / rms(self.predicted_m)

    @property
    def correlation(self) -> float:
        """Cosine of the angle between both errors: 1 for one shape, −1 for opposite signs."""
        product = float(np.mean(self.simulated_m * self.predicted_m))
        return product / (rms(self.simulated_m) * rms(self.predicted_m))


def compare_error(
    scenario: Scenario, *, loaded_chamber: Chamber | None = None, settled_s: float = 0.0
) -> ErrorComparison:
    """Simulate a scenario without its quantizers and compare its error with the closed form.

    The comparison begins at ``settled_s``. The error is that of the measured rod (Eq. 10).
    """
    model = error_model(scenario, loaded_chamber=loaded_chamber)
    run = simulate(
        scenario.without_quantizers(),
        signals=("measured_rod_extension", "rod_reference", "load_pressure"),
    )
    late = run.time_s >= settled_s - 1e-9
    predicted = model.error_m(
        run["rod_reference_velocity_m_s"],
        run["rod_reference_acceleration_m_s2"],
        run["load_pressure_pa"],
    )
    error = run["measured_rod_extension_m"] - run["rod_reference_m"]
    return ErrorComparison(model, run.time_s[late], error[late], predicted[late])


def overstatement(model: ErrorModel, frequency_hz: float) -> float:
    """Return |e| for a slow reference over |e| of `ErrorModel.response`, at one frequency."""
    p = 2j * np.pi * frequency_hz
    return float(abs(model.error_m(p, p * p) / model.response(frequency_hz)[0]))


def area_ratio(item: tuple[float, float, float]) -> str:
    """Simulated over predicted error with a wrong area; in words where the loop is unstable."""
    scenario = loop(*item, **SLOW)
    if not linearize_loop(scenario).stable:
        return "unstable" if not error_model(scenario).stable else "unstable (observer)"
    return f"{compare_error(scenario, settled_s=300.0).ratio:.4f}"


def lag_ratio(item: tuple[float, float]) -> str:
    """Return simulated over predicted error; in parentheses, predicted without the half sample."""
    comparison = compare_error(loop(*item, **LAG), settled_s=60.0)
    lag = Scenario().plant.pump.lag_s
    return f"{comparison.ratio:.4f} ({comparison.ratio * comparison.model.delay_s / lag:.3f})"


def chamber_ratio(item: tuple[str, float]) -> str:
    """Return simulated over predicted error in full order, with one chamber loaded."""
    chamber, force = item
    load = dict(KneeLoadParameters(segment_mass_kg=0.0, disturbance_n=force))
    full = {"plant.load": load, "plant.full_order": {}}
    scenario = loop(20.0, 1e5, **SLOW, **full)
    comparison = compare_error(scenario, loaded_chamber=chamber, settled_s=300.0)
    return f"{comparison.ratio:.4f}"


def main() -> None:
    """Print the tables."""
    pairs = [(lambda_, slope) for lambda_ in LAMBDAS for slope in SLOPES]
    areas = [(*pair, share) for pair in pairs for share in SHARES]
    area = dict(zip(areas, parallel_map(area_ratio, areas, workers=None), strict=True))
    lag = dict(zip(pairs, parallel_map(lag_ratio, pairs, workers=None), strict=True))
    print("λ (1/s) | k/Φ (1/s) | area 8/7 | area 6/7 | lag (with τ_m alone)")
    for pair in pairs:
        cells = [area[(*pair, share)] for share in SHARES]
        print(f"{pair[0]:g} | {pair[1]:g} | {' | '.join(cells)} | {lag[pair]}")
    print("\nfull order, λ = 20 1/s, k/Φ = 1e5 1/s: chamber loaded | simulated over predicted")
    for item in (("cap", 60.0), ("rod_side", -60.0)):
        print(f"{item[0]} | {chamber_ratio(item)}")
    print("\nslow form over full form at 0.01, 0.05, 0.1, 0.2 Hz, area 8/7; lag alone")
    for lambda_, slope in ((5.0, 2e4), (20.0, 1e5), (50.0, 2e5)):
        cells = [
            " ".join(
                f"{overstatement(error_model(loop(lambda_, slope, share)), f):.3f}"
                for f in (0.01, 0.05, 0.1, 0.2)
            )
            for share in (8.0 / 7.0, 1.0)
        ]
        print(f"{lambda_:g} | {slope:g} | {cells[0]} | {cells[1]}")


if __name__ == "__main__":
    main()
