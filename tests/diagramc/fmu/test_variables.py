"""Variables of an FMU: their order, what they set, what sets the start of an output."""

import pytest

from diagramc.errors import CompilationError
from diagramc.fmu.variables import FmuParameter, Variable, VariableTable


@pytest.fixture
def table(lag_source, lag_parameters):
    """The variables of the lag; its parameters are given in the other order."""
    return VariableTable(lag_source().plan, lag_parameters[::-1], {"u_m_s": 0.25})


def test_tunable_parameters_come_before_fixed_ones(table):
    assert [(variable.name, variable.variability) for variable in table.variables] == [
        ("time", "continuous"),
        ("u_m_s", "continuous"),
        ("offset_m_s", "tunable"),
        ("initial.x_mm", "fixed"),
        ("x_m", "continuous"),
        ("late_m", "continuous"),
        ("d_m_s", "continuous"),
        ("sample_time_s", "constant"),
    ]
    assert [table.variables[i].start for i in (1, 2, 3, 7)] == [0.25, 0.0, 500.0, 0.1]


@pytest.mark.parametrize(
    ("variable", "unit"),
    [
        (Variable("time", "independent", "continuous"), "s"),
        (Variable("u_m_s", "input", "continuous"), "m/s"),
        (Variable("time", "input", "continuous"), None),
    ],
)
def test_the_unit_is_the_end_of_the_name(variable, unit):
    assert (variable.unit and variable.unit.name) == unit


@pytest.mark.parametrize(
    ("names_and_members", "message"),
    [
        ([("p", "gain.k")], r"^lag: the parameter gain\.k in C is unknown$"),
        ([("p", "initial_x[1]")], r"initial_x\[1\] in C is unknown"),
        ([("p", "initial_x[0]"), ("q", "initial_x[0]")], "is set by two parameters"),
        ([("x_m", "initial_x[0]")], "^x_m: the parameter and the output of the FMU have this name"),
    ],
)
def test_parameters_that_clash_are_refused(lag_source, names_and_members, message):
    parameters = [FmuParameter(name, 0.0, (member,)) for name, member in names_and_members]
    with pytest.raises(CompilationError, match=message):
        VariableTable(lag_source().plan, parameters, {})
