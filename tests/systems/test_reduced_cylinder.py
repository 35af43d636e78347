import numpy as np
import pytest
from hydraulics import cylinder_at as at
from pydrake.systems.analysis import Simulator

from diagramc.testing import check_leaf
from kneexo.errors import SimulationError
from kneexo.parameters import CylinderParameters
from kneexo.systems import ReducedCylinder

# Lee et al. 2020, Table 2.
AREA = 274.8894e-6
PARAMETERS = CylinderParameters(
    mass_kg=1.45, damping_n_s_per_m=30.0, stiffness_n_per_m=250.0, leakage_m3_per_s_pa=3e-13
)
INPUTS = {"load_flow": [(-1.2e-5, 1.2e-5)], "load_force": [(-100.0, 100.0)]}
STATE = [(0.0, 0.15), (-0.05, 0.05), (-2.0, 2.0)]


def written_out(p, state, flow, force):
    """Eq. 15 and 16 of Lee et al. 2020, with the pressure in MPa."""
    x, v, pressure = state[0], state[1], 1e6 * state[2]
    pressure_rate = 4.0 * p.bulk_modulus_pa / p.total_volume_m3 * (
        flow - AREA * v - p.leakage_m3_per_s_pa * pressure
    )  # fmt: skip
    rod_force = pressure * AREA - p.damping_n_s_per_m * v - p.stiffness_n_per_m * x
    return pressure, rod_force, (rod_force - force) / p.mass_kg, 1e-6 * pressure_rate


# ---------------------------------------------------------------------------------- start


def test_rod_starts_at_rest_in_the_middle_of_the_stroke_or_where_given():
    start = ReducedCylinder().CreateDefaultContext().get_continuous_state_vector().CopyToVector()
    assert list(start) == [0.075, 0.0, 0.0]
    cylinder = ReducedCylinder(CylinderParameters(), 0.02, 1.5e6)
    context = cylinder.CreateDefaultContext()
    assert list(context.get_continuous_state_vector().CopyToVector()) == [0.02, 0.0, 1.5]
    assert cylinder.GetOutputPort("load_pressure").Eval(context) == [1.5e6]


# ----------------------------------------------------------------------------- conversion


def test_conversions_agree_and_keep_arguments_and_changes():
    check_leaf(
        ReducedCylinder(PARAMETERS), INPUTS | {"moving_mass": None, "continuous_state": STATE}
    )


def test_conversions_keep_the_initial_state():
    system = ReducedCylinder(PARAMETERS, 0.02, 1.5e6).ToAutoDiffXd()
    state = system.CreateDefaultContext().get_continuous_state_vector().CopyToVector()
    assert [value.value() for value in state] == [0.02, 0.0, 1.5]


# -------------------------------------------------------------------------------- numbers


def test_random_points_meet_the_written_out_equations(leaf):
    probe = leaf.Probe(ReducedCylinder(PARAMETERS), INPUTS, STATE)
    for z in probe.points(50):
        flow, force, state = z[1], z[2], z[3:6]
        pressure, rod_force, a, pressure_rate = written_out(PARAMETERS, state, flow, force)
        x, v = state[:2]
        expected = [x, v, pressure, rod_force, x, v, a, v, a, pressure_rate]
        # The area is printed to seven digits; differences of terms of up to 550 N.
        np.testing.assert_allclose(probe.results(z), expected, rtol=1e-6, atol=1e-3)


# ------------------------------------------------------------------------------ bad input


def test_stroke_is_a_context_parameter():
    system = ReducedCylinder()
    context = at(system)
    system.set_parameter(context, "stroke_m", 0.06)
    with pytest.raises(
        SimulationError, match=r"rod_extension = 0.075 m left the stroke 0 … 0.06 m"
    ):
        Simulator(system, context).AdvanceTo(0.01)
