"""How fast and how exact compiled runs are: 30 s of several closed loops.

python benchmarks/speed.py [--runs 20]

The reference of each error is RK4 at 10 µs (2.5 µs in full order) of the same compiled equations,
whose agreement with Drake at an equal integrator and step the tests establish. Quantizer off: a
count that flips would hide the error of the integrator.
"""

import argparse
import time

import numpy as np

from kneexo.compilation import simulate_compiled
from kneexo.parameters import (
    PID_TUNED,
    EncoderParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SineReference,
    SlidingModeParameters,
)

FREE = EncoderParameters(quantized=False)
CASES = {
    "default (SMC, 0.1 Hz)": Scenario(),
    "0.21 Hz, saturated": Scenario(reference=SineReference(frequency_hz=0.21)),
    "1 Hz, saturated": Scenario(reference=SineReference(frequency_hz=1.0)),
    "PID": Scenario(controller=PID_TUNED),
    "signum": Scenario(controller=SlidingModeParameters(switching="signum")),
    "shank weight": Scenario(plant=PlantParameters(load=KneeLoadParameters())),
    "full order": Scenario(plant=PlantParameters(full_order=FullCylinderParameters())),
    "full order, 40 N friction": Scenario(
        plant=PlantParameters(full_order=FullCylinderParameters(coulomb_friction_n=40.0))
    ),
}
SIGNALS = (
    *("knee_reference", "knee_angle", "motor_speed_command"),
    *("load_pressure", "shaft_power", "hydraulic_power"),
)  # those that `kneexo.analysis.track` needs


def best_ms(runs, *arguments, **options):
    """Shortest wall time of one call in ms, after a first one that may compile."""
    simulate_compiled(*arguments, **options)
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        simulate_compiled(*arguments, **options)
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args().runs
    print(f"{'30 s of':28}{'exact hold':>12}{'rk4 0.2 ms':>12}{'error of x':>12}")
    for name, scenario in CASES.items():
        full = scenario.plant.full_order is not None
        hold = best_ms(runs, scenario, signals=SIGNALS)
        # At 0.2 ms the full order's valves are beyond RK4.
        step = 2e-5 if full else 2e-4
        rk4 = best_ms(max(1, runs // 5), scenario, signals=SIGNALS, integrator="rk4", step_s=step)
        free = scenario.model_copy(update={"encoder": FREE})
        fine = simulate_compiled(
            free, signals=["rod_extension"], integrator="rk4", step_s=2.5e-6 if full else 1e-5
        )
        error = np.abs(
            simulate_compiled(free, signals=["rod_extension"])["rod_extension_m"]
            - fine["rod_extension_m"]
        )
        note = "  (rk4: 0.02 ms)" if full else ""
        print(f"{name:28}{hold:9.2f} ms{rk4:9.1f} ms{error.max():10.1e} m{note}", flush=True)


if __name__ == "__main__":
    main()
