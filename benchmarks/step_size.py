"""How much Fig. 12 depends on the solver's step; prints a table.

python benchmarks/step_size.py
"""

from kneexo.analysis import track
from kneexo.parameters import Scenario, SimulationParameters

if __name__ == "__main__":
    print("integrator, step | max error (deg) | mean change (rpm) | peak pressure (kPa)")
    for integrator, step_s in (
        ("exact_hold", 2e-3),
        ("radau3", 2e-3),
        ("radau3", 1e-3),
        ("radau3", 5e-4),
        ("runge_kutta3", 1e-4),
    ):
        simulation = SimulationParameters(duration_s=20.0, integrator=integrator, step_s=step_s)
        m = track(Scenario(simulation=simulation)).metrics
        print(
            f"{integrator}, {1e3 * step_s:g} ms | {m.max_error_deg:.5f} "
            f"| {m.mean_command_change_rpm:.3f} | {1e3 * m.peak_pressure_mpa:.2f}",
            flush=True,
        )
