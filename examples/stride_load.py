"""Print force, pressure and rod speed of an actuator that carries the measured moment of walking.

The table has a row for each extreme value of the stride, for the whole moment and for half of it.
"""

import kneexo as kx
from kneexo.analysis import stride_load

scenario = kx.Scenario()
for share in (1.0, 0.5):
    load = stride_load(scenario, share=share)
    print(f"share {share:g} of the moment")
    print("| | θ (deg) | M (N·m) | F (N) | P_L | P_1 | P_2 (MPa) | rod (mm/s) |")
    print("|---|---|---|---|---|---|---|---|")
    for event, i in load.events().items():
        pressures = (load.load_pressure_pa, load.cap_pressure_pa, load.rod_side_pressure_pa)
        print(
            f"| {event} | {load.knee_angle_deg[i]:.1f} | {load.knee_moment_n_m[i]:.1f} "
            f"| {load.rod_force_n[i]:.0f} | {' | '.join(f'{1e-6 * p[i]:.2f}' for p in pressures)} "
            f"| {1e3 * load.rod_speed_m_s[i]:.0f} |"
        )
    print(f"power {load.knee_power_w.min():.0f} … {load.knee_power_w.max():.0f} W")
    print(f"the pump can follow the rod in {load.share_within_speed:.0%} of the samples")
    print(*load.warnings(), sep="\n")
