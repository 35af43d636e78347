"""Runs by Drake's Simulator."""

import pytest
from pydrake.symbolic import Variable, exp
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, SymbolicVectorSystem

from kneexo.errors import SimulationError
from kneexo.parameters import SimulationParameters
from kneexo.simulation.drake import simulate_diagram

NAMES = ("force_n", "late", "early")


def diagram():
    """Logs every 10 ms 1e308, and e to a large power, infinite from 0.13 s and 0.09 s on."""
    t = Variable("t")
    outputs = [1e308, exp(1e4 * (t - 0.05)), exp(1e4 * (t - 0.01))]
    builder = DiagramBuilder()
    system = builder.AddSystem(SymbolicVectorSystem(time=t, output=outputs))
    LogVectorOutput(system.get_output_port(), builder, 0.01).set_name("log")
    return builder.Build()


def run(duration_s):
    loop = diagram()
    settings = SimulationParameters(duration_s=duration_s, integrator="radau3")
    return simulate_diagram(loop, loop.CreateDefaultContext(), NAMES, settings)


def test_the_first_value_that_is_not_finite_ends_a_run():
    finite = run(0.08)
    assert finite["force_n"].tolist() == [1e308] * 9  # finite, unlike its sum
    assert finite["early"][-1] > 1e300
    with pytest.raises(SimulationError, match=r"\At = 0\.09 s: early is not finite; reduce the"):
        run(0.2)
