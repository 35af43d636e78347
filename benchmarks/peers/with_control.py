"""The simple loop in python-control, which has no systems of mixed time bases.

So the plant is a nonlinear I/O system in continuous time, the PID one in discrete time, and each
2 ms the held command goes through one call of `input_output_response`.
"""

from __future__ import annotations

import control
import numpy as np
from peers import simple_loop as loop

HOW = "RK45, rtol 1e-6"
NOTE = "no hybrid systems: one input_output_response per 2 ms"
RK4 = False


def prepare(p, steps, duration_s):
    """A function that runs the loop and returns rod extension and pressure (n, 2)."""
    x_0, z_0 = loop.start(p)
    dt = p.sample_time_s
    samples = round(duration_s / dt)
    plant = control.nlsys(
        lambda t, x, u, _: np.array(loop.derivatives(p, x, u[0])),
        lambda t, x, u, _: x[1:2],
        inputs=1,
        outputs=1,
        states=4,
        name="plant",
    )
    controller = control.nlsys(
        lambda t, z, error, _: np.array(loop.pid(p, z, error[0])[1]),
        lambda t, z, error, _: np.array([loop.pid(p, z, error[0])[0]]),
        inputs=1,
        outputs=1,
        states=2,
        dt=dt,
        name="pid",
    )

    def run():
        x, z = np.array(x_0), np.array(z_0)
        record = np.empty((samples + 1, 2))
        record[0] = x[[loop.EXTENSION, loop.PRESSURE]]
        for sample in range(samples):
            t = sample * dt
            error = [loop.reference_angle(p, t) - loop.measured_angle(p, x[1])]
            command = controller.output(t, z, error)
            z = controller.dynamics(t, z, error)
            response = control.input_output_response(
                plant,
                [t, t + dt],
                [command[0], command[0]],
                x,
                solve_ivp_method="RK45",
                solve_ivp_kwargs={"rtol": 1e-6, "atol": 1e-8},
            )
            x = response.states[:, -1]
            record[sample + 1] = x[[loop.EXTENSION, loop.PRESSURE]]
        return record * [1.0, loop.PA_PER_MPA]

    return run
