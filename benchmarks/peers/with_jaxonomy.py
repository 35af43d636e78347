"""The simple loop in jaxonomy: two LeafSystems, traced by JAX and compiled by XLA."""

from __future__ import annotations

import logging

import jax
import jax.numpy as jnp
import jaxonomy
import numpy as np
from jaxonomy.framework import DependencyTicket, LeafSystem
from jaxonomy.simulation import SimulatorOptions
from peers import simple_loop as loop

HOW = "RK4 0.2 ms"
NOTE = "LeafSystems, warm; its recorder keeps every step"
RK4 = True


class Plant(LeafSystem):
    """Motor, cylinder and mass."""

    def __init__(self, p, x_0):
        super().__init__(name="plant")
        self.declare_input_port(name="command")
        self.declare_continuous_state(
            default_value=jnp.array(x_0),
            ode=lambda t, state, u: jnp.stack(loop.derivatives(p, state.continuous_state, u, jnp)),
        )
        self.declare_continuous_state_output(name="state")


class Controller(LeafSystem):
    """PID that holds its command."""

    def __init__(self, p, z_0):
        super().__init__(name="controller")
        self.declare_input_port(name="state")
        self.declare_discrete_state(default_value=jnp.array([0.0, *z_0]))

        def update(t, state, x):
            command, z = loop.update(p, t, x, state.discrete_state[1:], jnp)
            return jnp.stack([command, *z])

        self.declare_periodic_update(update, period=p.sample_time_s, offset=0.0)
        self.declare_output_port(
            lambda t, state, *inputs: state.discrete_state[0],
            name="command",
            requires_inputs=False,
            prerequisites_of_calc=[DependencyTicket.xd],
        )


def prepare(p, steps, duration_s):
    """A function that runs the loop and returns rod extension and pressure (n, 2)."""
    jax.config.update("jax_enable_x64", True)
    logging.getLogger("jaxonomy").setLevel(logging.WARNING)
    x_0, z_0 = loop.start(p)
    dt = p.sample_time_s
    samples = round(duration_s / dt)
    builder = jaxonomy.DiagramBuilder()
    plant, controller = builder.add(Plant(p, x_0), Controller(p, z_0))
    builder.connect(plant.output_ports[0], controller.input_ports[0])
    builder.connect(controller.output_ports[0], plant.input_ports[0])
    diagram = builder.build()
    context = diagram.create_context()
    options = SimulatorOptions(
        ode_solver_method="rk4", max_minor_step_size=dt / steps, buffer_length=samples * (steps + 3)
    )

    def run():
        result = jaxonomy.simulate(
            diagram,
            context,
            (0.0, duration_s),
            options=options,
            recorded_signals={"state": plant.output_ports[0]},
        )
        at = np.searchsorted(np.asarray(result.time), dt * np.arange(samples + 1) - 1e-9)
        state = np.asarray(result.outputs["state"])[at]
        return state[:, [loop.EXTENSION, loop.PRESSURE]] * [1.0, loop.PA_PER_MPA]

    return run
