"""The simple loop in pathsim: an ODE block, a sampled Wrapper block, RK4."""

from __future__ import annotations

import numpy as np
from pathsim import Connection, Simulation, solvers
from pathsim.blocks import ODE, Scope, Wrapper
from peers import simple_loop as loop

HOW = "RK4 0.2 ms"
NOTE = "ODE and Wrapper blocks"
RK4 = True


def prepare(p, steps, duration_s):
    """A function that runs the loop and returns rod extension and pressure (n, 2)."""
    x_0, z_0 = loop.start(p)
    dt = p.sample_time_s

    def run():
        state = {"z": z_0, "sample": 0}

        def controller(*x):
            t = state["sample"] * dt
            state["sample"] += 1
            command, state["z"] = loop.update(p, t, x, state["z"])
            return command

        plant = ODE(lambda x, u, t: np.array(loop.derivatives(p, x, u[0])), np.array(x_0))
        sampled = Wrapper(controller, T=dt)
        scope = Scope(sampling_period=dt)
        simulation = Simulation(
            [plant, sampled, scope],
            [
                Connection(sampled, plant),
                *(Connection(plant[i], sampled[i]) for i in range(4)),
                Connection(plant[loop.EXTENSION], scope[0]),
                Connection(plant[loop.PRESSURE], scope[1]),
            ],
            dt=dt / steps,
            Solver=solvers.RK4,
            log=False,
        )
        simulation.run(duration_s, adaptive=False)
        _, record = scope.read()
        return np.column_stack([record[0], loop.PA_PER_MPA * record[1]])

    return run
