"""Continuous states by name, against the Contexts of the leaf systems that have them."""

import pytest

from kneexo.parameters import BldcPumpParameters
from kneexo.systems import BldcPump
from kneexo.systems.bldc_pump import state_variables
from kneexo.systems.cylinder import cylinder_states


def test_pressures_are_states_in_megapascal():
    states = cylinder_states("cap_pressure_pa", "rod_side_pressure_pa")
    assert {state.column: state.factor for state in states} == {
        "rod_extension_m": 1.0,
        "rod_velocity_m_s": 1.0,
        "cap_pressure_pa": 1e6,
        "rod_side_pressure_pa": 1e6,
    }


def test_the_column_of_a_motor_is_its_state_times_the_factor():
    pump = BldcPump(BldcPumpParameters())
    context = pump.CreateDefaultContext()
    context.SetContinuousState([0.3])
    (state,) = state_variables()
    (speed,) = pump.GetOutputPort(state.column.removesuffix("_rad_s")).Eval(context)
    assert speed == pytest.approx(0.3 * state.factor, rel=1e-15)
    assert state_variables(ideal=True) == ()
