import math

import numpy as np
import pytest
from hydraulics import cylinder_at as at
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from diagramc.testing import check_leaf
from kneexo.errors import SimulationError
from kneexo.parameters import CylinderParameters
from kneexo.systems import ReducedCylinder

# Lee et al. 2020, Tables 2 and 3.
AREA, VOLUME, BULK_MODULUS, MASS, DAMPING = 274.8894e-6, 41_233e-9, 1.72e9, 1.6, 0.05
PARAMETERS = CylinderParameters(
    mass_kg=1.45, damping_n_s_per_m=30.0, stiffness_n_per_m=250.0, leakage_m3_per_s_pa=3e-13
)
INPUTS = {"load_flow": [(-1.2e-5, 1.2e-5)], "load_force": [(-100.0, 100.0)]}
STATE = [(0.0, 0.15), (-0.05, 0.05), (-2.0, 2.0)]


def state_matrix(system):
    """∂(dx/dt)/∂x of the leaf, from AutoDiffXd; it is linear, so anywhere."""
    converted = system.ToAutoDiffXd()
    context = converted.CreateDefaultContext()
    converted.GetInputPort("load_flow").FixValue(context, 0.0)
    context.SetContinuousState(InitializeAutoDiff([0.07, 0.0, 0.0]).ravel())
    return ExtractGradient(converted.EvalTimeDerivatives(context).CopyToVector())


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


def test_undamped_hydraulic_frequency_is_2807_rad_per_s():
    still = CylinderParameters(damping_n_s_per_m=0.0)
    poles = np.linalg.eigvals(state_matrix(ReducedCylinder(still)))
    expected = math.sqrt(4.0 * BULK_MODULUS * AREA**2 / (MASS * VOLUME))
    assert np.abs(poles).max() == pytest.approx(expected, rel=1e-6)  # seven digits of the area
    assert expected == pytest.approx(2807.0, abs=0.5)
    assert np.abs(poles.real).max() < 1e-6


def test_leakage_and_friction_damp_the_hydraulic_mode_by_0_0059():
    system = ReducedCylinder(CylinderParameters(leakage_m3_per_s_pa=2e-13))
    pole = max(np.linalg.eigvals(state_matrix(system)), key=np.imag)
    assert -pole.real / abs(pole) == pytest.approx(0.0059, abs=5e-5)  # last printed digit
    # Closed form to first order in the damping: ζ = (4 β_e C/V_t + B/m)/(2 ω).
    both = 4.0 * BULK_MODULUS * 2e-13 / VOLUME + DAMPING / MASS
    assert -pole.real == pytest.approx(0.5 * both, rel=1e-4)


def test_simulator_with_its_defaults_meets_the_matrix_exponential():
    system = ReducedCylinder(PARAMETERS, 0.05)
    flow, force, end = 6e-6, 15.0, 0.03
    matrix = state_matrix(system)
    p = PARAMETERS
    constant = np.array([0.0, -force / p.mass_kg, 4e-6 * p.bulk_modulus_pa / VOLUME * flow])
    start = np.array([0.05, 0.0, 0.0])
    values, vectors = np.linalg.eig(matrix)
    rest = -np.linalg.solve(matrix, constant)
    modes = np.linalg.solve(vectors, start - rest)
    exact = rest + (vectors @ (np.exp(values * end) * modes)).real

    simulator = Simulator(system, at(system, flow=flow, force=force))
    simulator.AdvanceTo(end)
    state = simulator.get_context().get_continuous_state_vector().CopyToVector()
    # Drake's default accuracy is 1e-3 on this state vector; 13 periods of the hydraulic mode.
    np.testing.assert_array_less(np.abs(state - exact), [1e-6, 1e-3, 1e-2])


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(("start", "flow"), [(0.1495, 1.1e-5), (0.0005, -1.1e-5)])
def test_leaving_the_stroke_raises_with_time_and_signal(start, flow):
    system = ReducedCylinder(CylinderParameters(), start)
    system.set_name("cylinder")
    simulator = Simulator(system, at(system, flow=flow))
    with pytest.raises(SimulationError) as error:
        simulator.AdvanceTo(0.1)
    time, name, rest = str(error.value).split(": ", 2)
    assert name == "cylinder"
    assert rest.startswith("rod_extension = ")
    assert rest.endswith(
        " m left the stroke 0 … 0.15 m; reduce the motion, the load, the push, the fault or the "
        "step"
    )
    # 0.5 mm at 40 mm/s take 12.5 ms; the mode adds up to 40 mm/s / 2807 rad/s = 14 µm.
    assert float(time.removeprefix("t = ").removesuffix(" s")) == pytest.approx(0.0125, abs=1e-3)


def test_stroke_is_a_context_parameter():
    system = ReducedCylinder()
    context = at(system)
    system.set_parameter(context, "stroke_m", 0.06)
    with pytest.raises(
        SimulationError, match=r"rod_extension = 0.075 m left the stroke 0 … 0.06 m"
    ):
        Simulator(system, context).AdvanceTo(0.01)


@pytest.mark.parametrize("values", [{"flow": math.nan}, {"force": math.nan}, {"force": math.inf}])
def test_input_that_is_not_finite_raises_instead_of_hanging(values):
    system = ReducedCylinder()
    system.set_name("cylinder")
    with pytest.raises(SimulationError, match=r"^t = 0 s: cylinder: .* is not finite; [^\n]*$"):
        Simulator(system, at(system, **values)).AdvanceTo(0.1)
