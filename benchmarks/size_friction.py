"""Print when the knee sized for walking leaves its range of motion with friction, by solver.

python benchmarks/size_friction.py

The design is that of docs/sizing.md for 1 Hz, on the full-order cylinder, with the seal friction
of `SizeSettings`. Friction that changes its sign within a fraction of a millisecond makes the last
part of such a run depend on the solver.
"""

from kneexo.analysis.walking.walking import walking_metrics
from kneexo.parameters import UNCERTAIN_KNEE, FullCylinderParameters
from kneexo.parameters.paths import changed
from kneexo.studies.hardware import ACCELERATION_LIMIT, DISPLACEMENT, scaled, tuned
from kneexo.studies.size import SizeSettings

FLOW, ACCELERATION_RAD_S2 = 14.8, 6671.0
GAINS = {"lambda_per_s": 100.0, "slope_per_s": 3.5e4, "observer_s": 0.020}
SOLVERS = (("radau3", 1e-3), ("exact_hold", 2e-3), ("rk4", 2e-6), ("rk4", 1e-5))

if __name__ == "__main__":
    settings, valves = SizeSettings(), FullCylinderParameters()
    flow = FLOW * settings.margin
    limit = ACCELERATION_RAD_S2 * settings.margin
    acceleration = limit / UNCERTAIN_KNEE.plant.pump.acceleration_limit_rad_s2
    hardware = scaled(UNCERTAIN_KNEE, {DISPLACEMENT: flow, ACCELERATION_LIMIT: acceleration})
    conductances = {
        name: getattr(valves, name) * flow
        for name in ("makeup_conductance_m3_per_s_pa", "relief_conductance_m3_per_s_pa")
    }
    for friction_n in (0.0, settings.seal_friction_n):
        full = conductances | {"coulomb_friction_n": friction_n}
        for integrator, step_s in SOLVERS:
            simulation = {"simulation.integrator": integrator, "simulation.step_s": step_s}
            design = changed(tuned(hardware, GAINS), {"plant.full_order": full} | simulation)
            walked = walking_metrics(design, frequency_hz=1.0)
            outcome = walked["failure"] or f"largest error {walked['max_error_deg']:.2f} deg"
            print(f"{friction_n:g} N | {integrator}, {step_s:g} s | {outcome}", flush=True)
