"""The base of the cylinders of both orders: start, stroke, end stops, what both have in common."""

import math

import numpy as np
import pytest
from hydraulics import cylinder_at
from pydrake.systems.analysis import Simulator
from scipy.integrate import solve_ivp

from diagramc.testing import check_leaf
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import (
    CylinderParameters,
    EndStopParameters,
    FullCylinderParameters,
    PlantParameters,
    Scenario,
)
from kneexo.simulation import simulate
from kneexo.simulation.compiled import scenario_values
from kneexo.systems import FullCylinder, ReducedCylinder
from kneexo.systems.cylinder import EndStops, start_extension, stop_force

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
@pytest.mark.parametrize("values", [{"flow": math.nan}, {"force": math.nan}, {"force": math.inf}])
def test_input_that_is_not_finite_raises_instead_of_hanging(cylinder, values):
    system = cylinder()
    system.set_name("cylinder")
    with pytest.raises(SimulationError, match=r"^t = 0 s: cylinder: .* is not finite; [^\n]*$"):
        Simulator(system, cylinder_at(system, **values)).AdvanceTo(0.1)


@BOTH
def test_a_mass_that_depends_on_the_posture_takes_force_to_change(cylinder, leaf):
    """M dv/dt + ½ (dM/dx) v² = F − F_L, Lagrange's equation of the kinetic energy ½ M(x) v²."""
    inputs = {
        "load_flow": [(-1e-5, 1e-5)],
        "load_force": [(-100.0, 100.0)],
        "moving_mass": [(5.0, 9.0), (-90.0, 90.0)],
    }
    pressures = [(0.5, 2.0)] * (1 if cylinder is ReducedCylinder else 2)
    state = [(0.02, 0.13), (-0.4, 0.4), *pressures]
    probe = leaf.Probe(cylinder(), inputs, state)
    check_leaf(cylinder(), inputs | {"continuous_state": state})
    for z in probe.points(5):
        context = probe.context(z)
        rod_force = probe.system.GetOutputPort("rod_force").Eval(context)[0]
        _, v, acceleration = probe.system.GetOutputPort("rod_state").Eval(context)
        load_force, mass, slope = z[2:5]
        expected = (rod_force - load_force - 0.5 * slope * v**2) / mass
        assert acceleration == pytest.approx(expected, rel=1e-12)


# ------------------------------------------------------------------------------- end stops

STOPS = EndStops(0.02, 0.12, 2e6, 1.5)


def rebound(speed_m_s, stops):
    """Share of its speed with which a mass of 1.6 kg leaves the outer stop."""

    def rates(_, state):
        return [state[1], float(stop_force(state[0], state[1], stops)) / 1.6]

    start = [stops.stop_high_m, speed_m_s]
    end = solve_ivp(rates, (0.0, 5e-3), start, rtol=1e-9, atol=1e-12).y[:, -1]
    assert end[0] < stops.stop_high_m
    return -end[1] / speed_m_s


@pytest.mark.parametrize(
    ("extension", "velocity", "force"),
    [
        (0.02, -1.0, 0.0),
        (0.12, 1.0, 0.0),
        (0.07, 5.0, 0.0),
        (0.1202, 0.0, -400.0),
        (0.0199, 0.0, 200.0),
        (0.1202, 0.2, -400.0 * 1.3),
        (0.0199, -0.2, 200.0 * 1.3),
        (0.1202, -1.0, 0.0),  # leaves faster than the stop can follow
        (0.0199, 1.0, 0.0),
    ],
)
def test_a_stop_pushes_the_rod_back_and_never_pulls(extension, velocity, force):
    assert stop_force(extension, velocity, STOPS) == pytest.approx(force, rel=1e-9, abs=1e-9)


def test_a_stop_without_dissipation_returns_all_speed_and_the_default_a_part():
    assert rebound(0.3, STOPS._replace(stop_dissipation_s_per_m=0.0)) == pytest.approx(1.0, 1e-6)
    default = EndStopParameters()
    stops = EndStops(0.0, 0.1, default.stiffness_n_per_m, default.dissipation_s_per_m)
    assert rebound(0.3, stops) == pytest.approx(0.712, abs=0.001)
    assert rebound(1.0, stops) < rebound(0.3, stops)


# Air and friction are not zero, and the corners of the valves are far from the states.
SMOOTH = FullCylinderParameters(
    entrained_air=0.01, coulomb_friction_n=20.0, stribeck_friction_n=10.0, friction_band_m_s=0.02
)
MAKERS = {
    "reduced": lambda stops: ReducedCylinder(CylinderParameters(), 0.1199, 1e5, stops),
    "full": lambda stops: FullCylinder(
        CylinderParameters(), SMOOTH, 0.1199, (3e5, 2e5), stops=stops
    ),
}
STATES = {"reduced": [0.1201, 0.01, 0.1], "full": [0.1201, 0.01, 0.3, 0.2]}


@pytest.mark.parametrize("order", MAKERS)
def test_the_load_cell_and_the_motion_feel_the_stop(order):
    forces, accelerations = [], []
    for stops in (None, STOPS):
        system = MAKERS[order](stops)
        context = system.CreateDefaultContext()
        system.GetInputPort("load_flow").FixValue(context, 0.0)
        context.SetContinuousState(STATES[order])
        forces.append(system.GetOutputPort("rod_force").Eval(context)[0])
        accelerations.append(system.GetOutputPort("rod_state").Eval(context)[2])
    expected = -2e6 * 1e-4 * (1.0 + 1.5 * 0.01)
    assert forces[1] - forces[0] == pytest.approx(expected, rel=1e-9)
    assert accelerations[1] - accelerations[0] == pytest.approx(expected / 1.6, rel=1e-9)


@pytest.mark.parametrize("order", MAKERS)
def test_conversions_with_stops_agree_and_keep_arguments_and_changes(order):
    inputs = {"load_flow": (-1e-5, 1e-5), "load_force": (-100.0, 100.0), "moving_mass": None}
    pressures = [(1.0, 1.4), (0.4, 0.6)][: len(STATES[order]) - 2]
    state = {"continuous_state": [(0.135, 0.14), (-0.05, 0.05), *pressures]}
    check_leaf(MAKERS[order](STOPS), inputs | state)


def test_the_stops_are_at_the_ends_of_the_range_of_motion():
    values = scenario_values(Scenario(plant={"end_stops": True}))
    low, high = (values[f"plant/cylinder.stop_{end}_m"] for end in ("low", "high"))
    # Table 1: 2.2 mm at 90° and 148.0 mm at 0°, by Eq. 10.
    assert (low, high) == (pytest.approx(2.2e-3, abs=5e-4), pytest.approx(148.0e-3, abs=5e-4))
    narrow = {"end_stops": True, "knee": {"flexion_max_deg": 80.0}}
    assert scenario_values(Scenario(plant=narrow))["plant/cylinder.stop_low_m"] > low
    assert PlantParameters().end_stops is None
    assert "plant/cylinder.stop_low_m" not in scenario_values(Scenario())


@pytest.mark.slow
@pytest.mark.parametrize(("torque", "angle_deg"), [(60.0, 90.0), (-60.0, 0.0)])
def test_a_knee_that_falls_comes_to_rest_on_a_stop(torque, angle_deg):
    """The penetration is F/k, with the force τ/r of a torque that nothing else holds."""
    falling = Scenario(
        plant={
            "load": {"kind": "knee", "segment_mass_kg": 0.0, "knee_torque_n_m": torque},
            "full_order": True,
            "bypass": True,
            "end_stops": True,
        },
        reference={"kind": "step", "start_deg": 30.0, "end_deg": 30.0},
        simulation={"duration_s": 2.0},
        faults=[
            {"place": "command", "kind": "scale", "size": 0.0, "start_s": 0.1},
            {"place": "plant.bypass.minimum_opening", "kind": "value", "size": 1.0, "start_s": 0.1},
        ],
    )
    run = simulate(falling)
    force = -torque / run["moment_arm_m"][-1]
    assert run["rod_force_n"][-1] == pytest.approx(-force, rel=1e-4)
    values = scenario_values(falling)
    stop = values["plant/cylinder.stop_low_m" if torque > 0.0 else "plant/cylinder.stop_high_m"]
    beyond = run["rod_extension_m"][-1] - stop
    # The open bypass leaves P_r (A_1 − A_2) on the rod.
    left = 0.2e6 * math.pi / 4.0 * 0.010**2
    assert beyond == pytest.approx((left + force) / 3e7, rel=1e-3)
    assert np.degrees(run["knee_angle_rad"][-1]) == pytest.approx(angle_deg, abs=0.1)
    with pytest.raises(SimulationError, match="left the range of motion"):
        simulate(falling.changed({"plant.end_stops": None}))
