"""Shared checks: one leaf system in Drake's three scalars, as functions of one flat vector z.

z holds the time, every input, the state and every Context parameter; the results are every
output, the time derivatives and the discrete update.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, ExpressionKind, Variable

TREE_LIMIT = 20_000


def tree_size(expression, limit=TREE_LIMIT):
    """Nodes of the unfolded tree; counting stops beyond ``limit``. Variables are leaves."""
    count, pending = 0, [expression]
    while pending and count <= limit:
        count += 1
        node = pending.pop()
        if isinstance(node, float | int | Variable):
            continue
        if isinstance(node, Expression) and node.get_kind() in (
            ExpressionKind.Var,
            ExpressionKind.Constant,
        ):
            continue
        pending.extend(node.Unapply()[1])
    return count


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
    """A float leaf with the ranges from which its z is drawn.

    ``inputs`` maps each port to the (low, high) of its elements; ``state`` holds those of the
    continuous or of the discrete state. Parameters vary by ``spread`` around their defaults.
    """

    def __init__(self, system, inputs, state=(), *, spread=0.1, time=(0.1, 2.0)):
        self.system = system
        self.ports = list(inputs)
        context = system.CreateDefaultContext()
        groups = range(context.num_numeric_parameter_groups())
        parameters = [context.get_numeric_parameter(i).CopyToVector() for i in groups]
        ranges = [time, *(r for name in self.ports for r in inputs[name]), *state]
        low, high = np.transpose(ranges).astype(float)
        values = np.concatenate([*parameters, []])
        self.center = np.concatenate([0.5 * (low + high), values])
        self.width = np.concatenate([0.5 * (high - low), spread * np.abs(values)])
        scale = np.concatenate([0.5 * (high - low), np.abs(values)])
        self.scale = np.where(scale > 0.0, scale, 1.0)
        sizes = [1, *(len(inputs[n]) for n in self.ports), len(state), *map(len, parameters)]
        self.splits = np.cumsum(sizes)[:-1]

    def points(self, count, seed=1):
        directions = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(self.center)))
        return self.center + directions * self.width

    def context(self, system, z, *, parameters=True):
        """A Context of ``system`` at z; with ``parameters=False`` it keeps its own ones."""
        context = system.CreateDefaultContext()
        parts = np.split(np.asarray(z), self.splits)
        for index in range(len(parts) if parameters else len(self.ports) + 2):
            self._set(system, context, index, parts[index])
        return context

    def _set(self, system, context, index, values):
        """Set one part of z: the time, an input, the state or a group of parameters."""
        group = index - len(self.ports) - 2
        if index == 0:
            context.SetTime(values[0])
        elif index <= len(self.ports):
            system.GetInputPort(self.ports[index - 1]).FixValue(context, values)
        elif group >= 0:
            context.get_mutable_numeric_parameter(group).SetFromVector(values)
        elif context.num_continuous_states():
            context.SetContinuousState(values)
        elif context.num_discrete_state_groups():
            context.SetDiscreteState(0, values)

    def results(self, z, system=None):
        system = system or self.system
        return results(system, self.context(system, z))

    def check_contract(self, count=3, **changed):
        """Check conversions, dependencies of outputs and sizes of trees, and ``changed`` values."""
        self.check_conversions(count)
        self.check_outputs_follow_every_source()
        self.check_conversions_keep_arguments()
        for name, value in changed.items():
            self.check_conversions_keep(name, value)
        assert self.largest_tree() < TREE_LIMIT

    def check_conversions(self, count=3):
        """Values of all scalars agree to 1e-12, AutoDiff derivatives with central differences."""
        dual_system, symbolic_system = self.system.ToAutoDiffXd(), self.system.ToSymbolic()
        variables = [Variable(f"z{i}") for i in range(len(self.center))]
        expressions = self.results([Expression(v) for v in variables], symbolic_system)
        for z in self.points(count):
            exact = self.results(z)
            seeds = zip(z, np.eye(len(z)), strict=True)
            dual = self.results([AutoDiffXd(v, e) for v, e in seeds], dual_system)
            environment = dict(zip(variables, z, strict=True))
            # The same few dozen operations in another order of rounding.
            for values in (
                [d.value() for d in dual],
                [e.Evaluate(environment) for e in expressions],
            ):
                np.testing.assert_allclose(values, exact, rtol=1e-12, atol=0.0)
            zero = np.zeros(len(z))
            gradient = np.array([d.derivatives() if d.derivatives().size else zero for d in dual])
            self._check_derivatives(z, exact, gradient * self.scale)

    def _check_derivatives(self, z, exact, gradient):
        largest = np.abs(exact) + np.abs(gradient).max(axis=1)
        for index, scale in enumerate(self.scale):
            step = 1e-3 * scale * np.eye(len(z))[index]
            one, two = (self.results(z + n * step) - self.results(z - n * step) for n in (1, 2))
            # Five-point differences at a relative step of 1e-3: truncation 1e-12 of the fifth
            # derivative, rounding 1e-16/1e-3 of the value and of the terms that it sums.
            difference = (8.0 * one - two) / 12e-3
            error = np.abs(gradient[:, index] - difference)
            assert np.all(error <= 1e-6 * np.abs(difference) + 1e-10 * largest), (index, error)

    def check_outputs_follow_every_source(self):
        """In one Context, no cached output survives a change of what it depends on."""
        z, other = self.points(2, seed=4)
        context = self.context(self.system, z)
        results(self.system, context)  # fills the caches
        parts = np.split(z, self.splits)
        for index, values in enumerate(np.split(other, self.splits)):
            parts[index] = values
            self._set(self.system, context, index, values)
            fresh = self.results(np.concatenate(parts))
            np.testing.assert_array_equal(results(self.system, context), fresh)

    def largest_tree(self):
        """Nodes of the largest output, derivative or update with all of z symbolic."""
        z = [Expression(Variable(f"z{i}")) for i in range(len(self.center))]
        return max(map(tree_size, self.results(z, self.system.ToSymbolic())))

    def check_conversions_keep(self, name, value):
        """A parameter set in the Context matters, and reaches both conversions."""
        system = self.system
        context = self.context(system, self.points(1, seed=2)[0], parameters=False)
        before = results(system, context)
        system.set_parameter(context, name, value)
        changed = results(system, context)
        assert not np.allclose(changed, before, rtol=1e-6, atol=0.0)
        for converted in (system.ToAutoDiffXd(), system.ToSymbolic()):
            other = converted.CreateDefaultContext()
            other.SetTimeStateAndParametersFrom(context)
            converted.FixInputPortsFrom(system, context, other)
            numbers = [
                v.value() if isinstance(v, AutoDiffXd) else v.Evaluate()
                for v in results(converted, other)
            ]
            np.testing.assert_allclose(numbers, changed, rtol=1e-12, atol=0.0)

    def check_conversions_keep_arguments(self):
        """Without touching a parameter, both conversions give the values of the original."""
        z = self.points(1, seed=3)[0]
        exact = results(self.system, self.context(self.system, z, parameters=False))
        for converted in (self.system.ToAutoDiffXd(), self.system.ToSymbolic()):
            values = results(converted, self.context(converted, z, parameters=False))
            numbers = [v.value() if isinstance(v, AutoDiffXd) else v.Evaluate() for v in values]
            np.testing.assert_allclose(numbers, exact, rtol=1e-12, atol=0.0)


@pytest.fixture(scope="session")
def leaf():
    """``leaf.Probe(system, inputs, state)`` and the limit of trees."""
    return SimpleNamespace(Probe=Probe, tree_limit=TREE_LIMIT)
