"""Linear forms of control laws that run as Python, against mathematics."""

import math

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from kneexo.analysis.linear.loop_equilibrium import find_equilibrium
from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.law.decision import why_python
from kneexo.parameters import Scenario

ANGLE_RAD = math.radians(40.0)


def with_math(rod_extension, rod_reference, knee_reference, k=8e4):
    error = rod_reference[0] - rod_extension
    return k * math.sin(error) * (1.0 + knee_reference[0] ** 2)


def with_branch_on_state(rod_extension, rod_reference, knee_reference, state=(0.0,), k=8e4):
    error = rod_reference[0] - rod_extension
    factor = 1.0 + knee_reference[0] ** 2 if state[0] > -1.0 else 0.0
    return k * error * factor, [0.5 * state[0]]


@pytest.mark.parametrize("law", [with_math, with_branch_on_state])
def test_the_linear_form_has_the_derivatives_of_the_law(law):
    """Central differences of the first one, which needs floats, have an error of 1e-9."""
    rest = find_equilibrium(Scenario().with_law(law))
    system = rest.equations.diagram.GetSubsystemByName("controller").GetSubsystemByName("law")
    states = int(law is with_branch_on_state)
    matrix = (
        system.GetMyContextFromRoot(rest.context)
        .get_numeric_parameter(0)
        .CopyToVector()
        .reshape(1 + states, -1)
    )
    gain = 8e4 * (1.0 + ANGLE_RAD**2)
    expected = [-gain, gain, *[0.0] * 7]
    np.testing.assert_allclose(matrix[0, 1 + states :], expected, rtol=1e-7, atol=1e-7 * gain)
    if states:
        np.testing.assert_allclose(matrix[1], [0.0, 0.5, *[0.0] * 9], atol=1e-12)


def test_a_kink_at_rest_gives_the_mean_of_both_sides():
    def kinked(rod_extension, rod_reference, k=8e4):
        error = rod_reference[0] - rod_extension
        return k * error if error > 0.0 else 3.0 * k * error

    def smooth(rod_extension, rod_reference, k=8e4):
        return 2.0 * k * (rod_reference[0] - rod_extension)

    frequency_hz = [0.3, 5.0]
    responses = [linearize_loop(law=law).loop_response(frequency_hz) for law in (kinked, smooth)]
    np.testing.assert_allclose(responses[0], responses[1], rtol=1e-6)


def continuous_pi(scalars):
    """A PI law with a continuous integral, as a Drake system of some scalar types."""

    @TemplateSystem.define("ContinuousPi_", T_list=scalars)
    def template(scalar):
        class Impl(LeafSystem_[scalar]):
            def _construct(self, converter=None):
                LeafSystem_[scalar].__init__(self, converter)
                self.rod = self.DeclareVectorInputPort("rod_extension", 1)
                self.reference = self.DeclareVectorInputPort("rod_reference", 4)
                self.DeclareContinuousState(1)
                self.DeclareVectorOutputPort("motor_speed_command", 1, self.command)

            def _construct_copy(self, other, converter=None):
                Impl._construct(self, converter=converter)

            def error(self, context):
                return self.reference.Eval(context)[0] - self.rod.Eval(context)[0]

            def DoCalcTimeDerivatives(self, context, derivatives):
                derivatives.get_mutable_vector().SetAtIndex(0, self.error(context))

            def command(self, context, output):
                integral = context.get_continuous_state_vector()[0]
                output.SetAtIndex(0, 2e4 * self.error(context) + 5e4 * integral)

        return Impl

    return template[None]


def test_a_system_with_a_continuous_state_has_the_loop_of_its_equations():
    compiled, called = continuous_pi([float, AutoDiffXd, Expression]), continuous_pi([float])
    runs = [bool(why_python(Scenario().with_law(law))) for law in (compiled, called)]
    assert runs == [False, True]
    expected, loop = linearize_loop(law=compiled), linearize_loop(law=called)
    frequency_hz = [0.05, 0.3, 5.0, 240.0]
    for name in ("loop_response", "output_response"):
        ours, theirs = getattr(loop, name)(frequency_hz), getattr(expected, name)(frequency_hz)
        np.testing.assert_allclose(ours, theirs, rtol=1e-7)
    assert len(loop.eigenvalues) == len(expected.eigenvalues)
