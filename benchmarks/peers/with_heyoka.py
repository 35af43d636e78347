"""The simple loop in heyoka: the plant by Taylor's method, the PID as a compiled function.

heyoka's integrators know no discrete updates, so Python goes from sample to sample: the PID's
``cfunc`` sets the held command, a parameter of the plant's equations, and ``propagate_until`` goes
on to the next sample in as many steps as the tolerance, the rounding error by default, needs. A
limit is a ``select``, which a Taylor series takes on one side of the corner for a whole step.
"""

from __future__ import annotations

from types import SimpleNamespace

import heyoka as hy
import numpy as np
from peers import simple_loop as loop

HOW = "Taylor's method to rounding"
NOTE = "propagate_until per 2 ms from Python, the PID a cfunc"
RK4 = False
_XP = SimpleNamespace(
    **{name: getattr(hy, name) for name in ("cos", "sin", "acos", "atan2", "sqrt")},
    minimum=lambda a, b: hy.select(hy.lt(a, b), a, b),
    maximum=lambda a, b: hy.select(hy.gt(a, b), a, b),
)


def prepare(p, steps, duration_s):
    """A function that runs the loop and returns rod extension and pressure (n, 2)."""
    x_0, z_0 = loop.start(p)
    dt = p.sample_time_s
    samples = round(duration_s / dt)
    x = hy.make_vars("speed", "extension", "velocity", "pressure")
    t, *z = hy.make_vars("t", "integral", "filtered")
    rates = loop.derivatives(p, x, hy.par[0], _XP)
    plant = hy.taylor_adaptive(list(zip(x, rates, strict=True)), x_0, pars=[0.0])
    command, z_next = loop.update(p, t, x, z, _XP)
    pid = hy.cfunc([command, *z_next], [t, x[loop.EXTENSION], *z])

    def run():
        plant.time, plant.state[:] = 0.0, x_0
        state, held = plant.state, plant.pars
        inputs, outputs = np.array([0.0, 0.0, *z_0]), np.empty(3)
        record = np.empty((samples + 1, 4))
        record[0] = x_0
        for sample in range(samples):
            inputs[0], inputs[1] = sample * dt, state[loop.EXTENSION]
            pid(inputs, outputs)
            held[0], inputs[2:] = outputs[0], outputs[1:]
            plant.propagate_until((sample + 1) * dt)
            record[sample + 1] = state
        return record[:, [loop.EXTENSION, loop.PRESSURE]] * [1.0, loop.PA_PER_MPA]

    return run
