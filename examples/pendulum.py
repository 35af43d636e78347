"""Compile Drake's own pendulum to machine code, and let it swing from three angles."""

import matplotlib.pyplot as plt
import numpy as np
from pydrake.examples import PendulumPlant

import kneexo as kx

model = kx.compile(PendulumPlant(), inputs=["tau"])  # no torque: an open input is zero
parameters = model.parameters()
print("parameters:", dict(zip(model.parameter_names, parameters.tolist(), strict=True)))
for angle_deg in (30.0, 90.0, 170.0):
    state = model.state()
    state.continuous[:] = np.radians(angle_deg), 0.0  # angle in rad, rate in rad/s
    run = model.simulate(parameters, state, 10.0, record_period_s=0.01)
    swing_deg = np.degrees(run["state"][:, 0])
    print(f"from {angle_deg:g} deg: {swing_deg[-1]:.2f} deg after 10 s")
    plt.plot(run.time_s, swing_deg, label=f"from {angle_deg:g}°")
plt.xlabel("time (s)")
plt.ylabel("angle (deg)")
plt.legend()
plt.savefig("pendulum.png")
