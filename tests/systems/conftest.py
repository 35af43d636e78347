"""One leaf system of floats as a function of one flat vector z, for comparison with equations.

z holds the time, every input and the state; the results are every output, the time derivatives and
the discrete update.
"""

from types import SimpleNamespace

import numpy as np
import pytest


def results(system, context):
    """Outputs, time derivatives and discrete update in a context, one after the other."""
    ports = map(system.get_output_port, range(system.num_output_ports()))
    parts = [port.Eval(context) for port in ports]
    if context.num_continuous_states():
        parts.append(system.EvalTimeDerivatives(context).CopyToVector())
    if context.num_discrete_state_groups():
        update = system.EvalUniquePeriodicDiscreteUpdate(context)
        parts.append(update.get_vector(0).CopyToVector())
    return np.concatenate(parts)


class Probe:
    """A leaf with the ranges from which its z is drawn.

    ``inputs`` maps each port to the (low, high) of its elements; ``state`` holds those of the
    continuous or of the discrete state.
    """

    def __init__(self, system, inputs, state=(), *, time=(0.1, 2.0)):
        self.system = system
        self.ports = list(inputs)
        ranges = [time, *(r for name in self.ports for r in inputs[name]), *state]
        self.low, self.high = np.transpose(ranges).astype(float)
        self.splits = np.cumsum([1, *(len(inputs[n]) for n in self.ports)])

    def points(self, count, seed=1):
        shares = np.random.default_rng(seed).uniform(0.0, 1.0, (count, len(self.low)))
        return self.low + shares * (self.high - self.low)

    def context(self, z):
        """A Context of the leaf at z."""
        context = self.system.CreateDefaultContext()
        time, *inputs, state = np.split(np.asarray(z), self.splits)
        context.SetTime(time[0])
        for name, values in zip(self.ports, inputs, strict=True):
            self.system.GetInputPort(name).FixValue(context, values)
        if context.num_continuous_states():
            context.SetContinuousState(state)
        elif context.num_discrete_state_groups():
            context.SetDiscreteState(0, state)
        return context

    def results(self, z):
        return results(self.system, self.context(z))


@pytest.fixture(scope="session")
def leaf():
    """``leaf.Probe(system, inputs, state)``."""
    return SimpleNamespace(Probe=Probe)
