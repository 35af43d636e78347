"""The simple loop in bdsim: FUNCTION and INTEGRATOR blocks, a sampled block of its own, a clock."""

from __future__ import annotations

import contextlib
import io

import bdsim
import numpy as np
from bdsim.block import SampledBlock
from peers import simple_loop as loop

HOW = "RK45, rtol 1e-6"
NOTE = "FUNCTION, INTEGRATOR, a sampled block"
RK4 = False


class Controller(SampledBlock):
    """Reads the states of the plant, holds the command between ticks of its clock."""

    nin = nout = 1

    def __init__(self, clock, p, z_0):
        super().__init__(clock=clock, nin=1, nout=1, x0=[0.0, *z_0])
        self._p = p

    def output(self, t, inputs, x):
        """The held command."""
        return [x[0]]

    def next(self, t, inputs, x):
        """Command and state of the PID at a tick."""
        command, z = loop.update(self._p, t, inputs[0], x[1:])
        return np.array([command, *z])


def prepare(p, steps, duration_s):
    """A function that runs the loop and returns rod extension and pressure (n, 2)."""
    x_0, z_0 = loop.start(p)
    dt = p.sample_time_s
    with contextlib.redirect_stdout(io.StringIO()):  # it reports toolboxes that are not there
        simulation = bdsim.BDSim(graphics=False, progress=False, sysargs=False, quiet=True)

    def run():
        diagram = simulation.blockdiagram()
        clock = diagram.clock(dt, "s", offset=0)
        controller = Controller(clock, p, z_0)
        diagram.add_block(controller)
        rates = diagram.FUNCTION(
            lambda x, u: np.array(loop.derivatives(p, x, u)), nin=2, name="rates"
        )
        plant = diagram.INTEGRATOR(x0=x_0, name="plant")
        diagram.connect(rates, plant)
        diagram.connect(plant, rates[0], controller)
        diagram.connect(controller, rates[1])
        with contextlib.redirect_stdout(io.StringIO()):
            diagram.compile(report=False)
            result = simulation.run(
                diagram, T=duration_s, dt=dt, solver_args={"rtol": 1e-6, "atol": 1e-8}
            )
        return result.x[:, [loop.EXTENSION, loop.PRESSURE]] * [1.0, loop.PA_PER_MPA]

    return run
