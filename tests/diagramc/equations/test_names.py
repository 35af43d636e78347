"""Names of parameters and states."""

import pytest
from pydrake.examples import AcrobotPlant, PendulumPlant
from pydrake.systems.framework import BasicVector_
from pydrake.systems.primitives import ConstantVectorSource, Integrator

from diagramc.equations.reader import read_equations


def test_elements_have_the_names_that_drake_gives_them(diagram_of):
    equations = read_equations(diagram_of(PendulumPlant()), ["tau"])
    assert equations.parameters == [
        f"block.{name}" for name in ("mass", "length", "damping", "gravity")
    ]
    assert equations.states == ["block.theta", "block.thetadot"]


def test_elements_without_a_name_are_numbered(diagram_of):
    equations = read_equations(diagram_of(AcrobotPlant()), ["elbow_torque"])
    # pydrake 1.51 to 1.58 has no accessor of l2.
    assert equations.parameters[:5] == [
        "block.m1",
        "block.m2",
        "block.l1",
        "block.0[3]",
        "block.lc1",
    ]
    equations = read_equations(diagram_of(ConstantVectorSource([1.0, 2.0])))
    assert equations.parameters == ["block.0[0]", "block.0[1]"]
    equations = read_equations(diagram_of(Integrator(2)), ["u0"])
    assert equations.states == ["block.x[0]", "block.x[1]"]


@pytest.mark.parametrize(
    ("parameter_names", "names"),
    [
        (("mass_kg", "length_m"), ["block.mass_kg", "block.length_m", "block.1[0]"]),
        (("mass_kg",), ["block.0[0]", "block.0[1]", "block.1[0]"]),
    ],
)
def test_a_leaf_names_the_parameters_of_its_first_group(diagram_of, leaf, parameter_names, names):
    def construct(self, T):
        self.parameter_names = parameter_names
        groups = [self.DeclareNumericParameter(BasicVector_[T](size)) for size in (2, 1)]

        def output(context, out):
            values = [context.get_numeric_parameter(group)[0] for group in groups]
            out.SetAtIndex(0, values[0] * values[1])

        self.DeclareVectorOutputPort("out", 1, output)

    diagram = diagram_of(leaf("Named", construct))
    assert read_equations(diagram).parameters == names
