"""The base of the cylinders of both orders: start, stroke, what both have in common."""

import pytest

from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import CylinderParameters
from kneexo.systems import FullCylinder, ReducedCylinder
from kneexo.systems.cylinder import cylinder_states, cylinder_values, start_extension

BOTH = pytest.mark.parametrize("cylinder", [ReducedCylinder, FullCylinder])


def at_rest(system, extension_m):
    """A Context with this extension, no flow and the pressures of the start."""
    context = system.CreateDefaultContext()
    system.GetInputPort("load_flow").FixValue(context, 0.0)
    state = context.get_continuous_state_vector().CopyToVector()
    context.SetContinuousState([extension_m, *state[1:]])
    return context


@pytest.mark.parametrize(
    ("start_m", "expected_m"), [(None, 0.06), (0.0, 0.0), (0.12, 0.12), (0.05, 0.05)]
)
def test_a_rod_starts_in_the_middle_or_where_it_is_asked_to(start_m, expected_m):
    assert start_extension(CylinderParameters(stroke_m=0.12), start_m) == expected_m


@pytest.mark.parametrize("start_m", [-1e-9, 0.1200001, float("nan")])
def test_a_start_outside_the_stroke_is_refused(start_m):
    line = r"initial_extension_m = \S+ m is outside the stroke 0 … 0\.12 m"
    with pytest.raises(ParameterError, match=line):
        start_extension(CylinderParameters(stroke_m=0.12), start_m)


def test_values_of_one_order_come_first():
    parameters = CylinderParameters(mass_kg=1.7)
    values = cylinder_values(parameters, "mean_area_m2")
    assert next(iter(values)) == "mean_area_m2"
    assert values["mean_area_m2"] == parameters.mean_area_m2
    assert values["mass_kg"] == 1.7
    assert set(values) - set(cylinder_values(parameters)) == {"mean_area_m2"}


@BOTH
def test_the_margin_is_the_way_to_the_nearer_end(cylinder):
    system = cylinder(CylinderParameters(stroke_m=0.12))
    for extension_m, margin_m in ((0.01, 0.01), (0.1, 0.02), (0.06, 0.06), (0.125, -0.005)):
        assert system.margin(at_rest(system, extension_m)) == pytest.approx(margin_m, abs=1e-15)


@BOTH
@pytest.mark.parametrize("extension_m", [-1e-6, 0.120001])
def test_a_rod_beyond_its_stroke_is_refused(cylinder, extension_m):
    system = cylinder(CylinderParameters(stroke_m=0.12))
    system.check(at_rest(system, 0.12))
    with pytest.raises(SimulationError, match=r"left the stroke 0 … 0\.12 m; reduce the motion"):
        system.check(at_rest(system, extension_m))


@BOTH
def test_a_mass_that_depends_on_the_posture_takes_force_to_change(cylinder, leaf):
    """M dv/dt + ½ (dM/dx) v² = F − F_L, Lagrange's equation of the kinetic energy ½ M(x) v²."""
    inputs = {
        "load_flow": [(-1e-5, 1e-5)],
        "load_force": [(-100.0, 100.0)],
        "moving_mass": [(5.0, 9.0), (-90.0, 90.0)],
    }
    pressures = [(0.5, 2.0)] * (1 if cylinder is ReducedCylinder else 2)
    probe = leaf.Probe(cylinder(), inputs, [(0.02, 0.13), (-0.4, 0.4), *pressures])
    if cylinder is ReducedCylinder:  # random pressures meet the kinks of the valves
        probe.check_conversions(2)
    probe.check_outputs_follow_every_source()
    for z in probe.points(5):
        context = probe.context(probe.system, z)
        rod_force = probe.system.GetOutputPort("rod_force").Eval(context)[0]
        _, v, acceleration = probe.system.GetOutputPort("rod_state").Eval(context)
        load_force, mass, slope = z[2:5]
        expected = (rod_force - load_force - 0.5 * slope * v**2) / mass
        assert acceleration == pytest.approx(expected, rel=1e-12)


@BOTH
def test_the_states_are_those_of_the_context(cylinder):
    system = cylinder()
    context = at_rest(system, 0.03)
    pressures = ("load_pressure_pa",) if cylinder is ReducedCylinder else ("cap_pa", "rod_side_pa")
    assert context.num_continuous_states() == len(cylinder_states(*pressures))
    assert system.GetOutputPort("rod_extension").Eval(context) == 0.03
