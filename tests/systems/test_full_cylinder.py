import math

import numpy as np
import pytest
from hydraulics import cylinder_at as at
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from diagramc import InputTable, compile_diagram
from diagramc.testing import check_leaf
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import BypassParameters, CylinderParameters, FullCylinderParameters
from kneexo.systems import FullCylinder, ReducedCylinder
from kneexo.systems.full_cylinder import effective_bulk_modulus, holding_pressures

# Lee et al. 2020, Tables 2 and 3: bore 20 mm, rod 10 mm.
AREA_1, AREA_2 = math.pi / 4.0 * 0.020**2, math.pi / 4.0 * (0.020**2 - 0.010**2)
CYLINDER = CylinderParameters(
    mass_kg=1.45, damping_n_s_per_m=30.0, stiffness_n_per_m=250.0, leakage_m3_per_s_pa=3e-13
)
# Every term of the equations is there.
FULL = FullCylinderParameters(
    dead_volume_m3=4e-6,
    reservoir_pressure_pa=0.3e6,
    cap_external_leakage_m3_per_s_pa=4e-13,
    rod_side_external_leakage_m3_per_s_pa=7e-13,
    makeup_conductance_m3_per_s_pa=3e-11,
    makeup_band_pa=0.4e6,
    relief_pressure_pa=2.5e6,
    relief_conductance_m3_per_s_pa=2e-11,
    valve_band_pa=0.3e6,
    entrained_air=0.004,
    coulomb_friction_n=20.0,
    stribeck_friction_n=15.0,
    stribeck_speed_m_s=0.02,
    friction_band_m_s=0.015,
)
PUMP_LEAKAGE = 9e-13
IDLE = FullCylinderParameters(
    makeup_conductance_m3_per_s_pa=0.0, relief_conductance_m3_per_s_pa=0.0
)
INPUTS = {"load_flow": [(-1.2e-5, 1.2e-5)], "load_force": [(-100.0, 100.0)]}
STATE = [(0.0, 0.15), (-0.05, 0.05), (0.1, 2.9), (0.1, 2.9)]


def rates(system, **values):
    return system.EvalTimeDerivatives(at(system, **values)).CopyToVector()


def full_system():
    return FullCylinder(CYLINDER, FULL, 0.06, (0.4e6, 0.7e6), PUMP_LEAKAGE)


# ------------------------------------------------------------- the equations, written anew


def rounded_corner(excess, band):
    if excess <= 0.0:
        return 0.0
    return excess**2 / (2.0 * band) if excess < band else excess - band / 2.0


def smooth_step(difference, band):
    z = min(max((difference + band) / (2.0 * band), 0.0), 1.0)
    return 3.0 * z**2 - 2.0 * z**3


def written_out(state, flow, force, c=CYLINDER, n=FULL, c_em=PUMP_LEAKAGE):
    """Eq. 12 and 14 with the signs corrected, chamber by chamber; pressures in MPa, P_r = gauge."""
    x, v = state[:2]
    pressures, p_r = [1e6 * state[2], 1e6 * state[3]], n.reservoir_pressure_pa
    load = pressures[0] - pressures[1]
    # Eq. 12: D ω follows from the load flow by Eq. 13; C_im of the pump cancels, so it is zero.
    displaced = flow + 0.5 * c_em * load
    pump = [displaced - c_em * (pressures[0] - p_r), -displaced - c_em * (pressures[1] - p_r)]
    swept, areas = [-AREA_1 * v, AREA_2 * v], [AREA_1, AREA_2]
    volumes = [n.dead_volume_m3 + AREA_1 * x, n.dead_volume_m3 + AREA_2 * (0.150 - x)]
    external = [n.cap_external_leakage_m3_per_s_pa, n.rod_side_external_leakage_m3_per_s_pa]
    makeup, relief, pressure_rates = [], [], []
    for i, own in enumerate(pressures):
        other, sign = pressures[1 - i], (1.0, -1.0)[i]
        held = smooth_step(other - own, n.makeup_band_pa)
        check = rounded_corner(p_r - own, n.valve_band_pa)
        makeup.append(
            n.makeup_conductance_m3_per_s_pa * (held * (p_r - own) + (1.0 - held) * check)
        )
        relief.append(
            n.relief_conductance_m3_per_s_pa
            * rounded_corner(own - n.relief_pressure_pa, n.valve_band_pa)
        )
        into = pump[i] + swept[i] - sign * c.leakage_m3_per_s_pa * load
        into += makeup[i] - relief[i] - external[i] * (own - p_r)
        absolute = own + 101_325.0
        air = n.entrained_air * (101_325.0 / absolute) ** (1.0 / 1.4)
        compliance = (1.0 / c.bulk_modulus_pa + air / (1.4 * absolute)) / (1.0 + air)
        pressure_rates.append(1e-6 * into / volumes[i] / compliance)
    stribeck = n.stribeck_friction_n * math.exp(-((v / n.stribeck_speed_m_s) ** 2))
    friction = (n.coulomb_friction_n + stribeck) * math.tanh(v / n.friction_band_m_s)
    rod_force = pressures[0] * areas[0] - pressures[1] * areas[1] - friction
    rod_force -= c.damping_n_s_per_m * v + c.stiffness_n_per_m * x
    a = (rod_force - force) / c.mass_kg
    outputs = [x, v, load, rod_force, x, v, a, *pressures, *makeup, *relief]
    return [*outputs, v, a, *pressure_rates]


# ---------------------------------------------------------------------------------- start


def test_rod_starts_at_rest_holding_nothing_or_where_given():
    system = FullCylinder()
    start = system.CreateDefaultContext().get_continuous_state_vector().CopyToVector()
    # Without load P_1 = P_r is the lower pressure: P_1 A_1 = P_2 A_2.
    np.testing.assert_allclose(start, [0.075, 0.0, 0.2, 0.2 * AREA_1 / AREA_2], rtol=1e-14)
    np.testing.assert_allclose(rates(system), 0.0, atol=1e-9)
    context = full_system().CreateDefaultContext()
    assert list(context.get_continuous_state_vector().CopyToVector()) == [0.06, 0.0, 0.4, 0.7]


# ----------------------------------------------------------------------------- conversion


def test_conversions_agree_and_keep_arguments_and_changes():
    check_leaf(full_system(), INPUTS | {"moving_mass": None, "continuous_state": STATE})


def test_conversions_keep_the_initial_state():
    state = full_system().ToAutoDiffXd().CreateDefaultContext().get_continuous_state_vector()
    assert [value.value() for value in state.CopyToVector()] == [0.06, 0.0, 0.4, 0.7]


# -------------------------------------------------------------------------------- numbers


def test_random_points_meet_the_written_out_equations(leaf):
    probe = leaf.Probe(full_system(), INPUTS, STATE)
    regimes = set()
    for z in probe.points(200):
        flow, force, state = z[1], z[2], z[3:7]
        expected = written_out(state, flow, force)
        # Forces of up to 900 N cancel in the acceleration, and flows of 1e-4 m³/s in the rates.
        np.testing.assert_allclose(probe.results(z), expected, rtol=1e-11, atol=1e-10)
        regimes.add(tuple(np.sign(expected[9:13])))
    assert len(regimes) >= 6  # each valve was seen open and shut


@pytest.mark.parametrize("seed", range(20))
def test_reduces_to_eq_15_at_equal_volumes_with_equal_leakages_and_idle_valves(seed):
    # dP_L/dt = (β/V)(Q_1 + Q_2 − (A_1 + A_2) v − (2 C_im' + C_em') P_L) with V_1 = V_2 = V and
    # Q_1 + Q_2 = 2 Q_L: Eq. 15 with V_t = 2 V and C_L = C_im' + C_em'/2, for any two areas.
    random = np.random.default_rng(seed)
    c_im, c_em, pump, dead = random.uniform(0.1e-12, 5e-12, 4) * [1.0, 1.0, 1.0, 1e6]
    x = AREA_2 * 0.150 / (AREA_1 + AREA_2)
    volume = dead + AREA_1 * x
    full_order = FullCylinderParameters(
        **dict(IDLE)
        | {
            "dead_volume_m3": dead,
            "cap_external_leakage_m3_per_s_pa": c_em,
            "rod_side_external_leakage_m3_per_s_pa": c_em,
        }
    )
    full = FullCylinder(
        CylinderParameters(leakage_m3_per_s_pa=c_im),
        full_order,
        pump_external_leakage_m3_per_s_pa=pump,
    )
    reduced = ReducedCylinder(
        CylinderParameters(total_volume_m3=2.0 * volume, leakage_m3_per_s_pa=c_im + 0.5 * c_em)
    )
    flow, v = random.uniform(-1.2e-5, 1.2e-5), random.uniform(-0.05, 0.05)
    cap, rod_side = random.uniform(0.0, 3.5, 2)
    both = rates(full, flow=flow, state=[x, v, cap, rod_side])
    one = rates(reduced, flow=flow, state=[x, v, cap - rod_side])
    assert both[2] - both[3] == pytest.approx(one[2], rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_idle_valves_that_are_not_blocked_pass_nothing_at_all(seed):
    # One line at P_r and the other above it, below the relief pressure: no flow to the last bit.
    loaded = np.random.default_rng(seed).uniform(0.25, 3.4)
    for pressures in ((0.2, loaded), (loaded, 0.2)):
        state = [0.07, 0.01, *pressures]
        system = FullCylinder()
        context = at(system, state=state)
        assert not system.GetOutputPort("relief_flow").Eval(context).any()
        # P_r = 0.2 MPa differs from 1e6 · 0.2 by rounding at most.
        assert np.abs(system.GetOutputPort("makeup_flow").Eval(context)).max() < 1e-19
        blocked = rates(FullCylinder(CylinderParameters(), IDLE), state=state)
        np.testing.assert_allclose(rates(system, state=state), blocked, rtol=1e-12, atol=1e-12)


def test_all_oil_comes_from_the_reservoir_or_goes_there():
    # Sum of both chambers, without compressibility: V_1' + V_2' + Σ V/β_e P' is what they exchange.
    system = full_system()
    state = [0.04, -0.03, 0.15, 2.8]
    context = at(system, flow=8e-6, state=state)
    _, v, rate_1, rate_2 = system.EvalTimeDerivatives(context).CopyToVector()
    v = state[1]
    stored = 0.0
    for pressure, rate, volume in (
        (0.15e6, rate_1, 4e-6 + AREA_1 * 0.04),
        (2.8e6, rate_2, 4e-6 + AREA_2 * 0.11),
    ):
        modulus = effective_bulk_modulus(pressure, bulk_modulus=1.72e9, entrained_air=0.004)
        stored += volume / modulus * 1e6 * rate
    above = np.array([0.15e6, 2.8e6]) - 0.3e6
    exchanged = system.GetOutputPort("makeup_flow").Eval(context).sum()
    exchanged -= system.GetOutputPort("relief_flow").Eval(context).sum()
    exchanged -= above @ [4e-13, 7e-13] + PUMP_LEAKAGE * above.sum()
    assert stored + (AREA_1 - AREA_2) * v == pytest.approx(exchanged, rel=1e-11)


# ---------------------------------------------------------------------------- component laws


@pytest.mark.parametrize("force", [-600.0, -1.0, 0.0, 15.0, 16.0, 800.0])
def test_holding_pressures_balance_the_force_with_the_lower_line_at_the_reservoir(force):
    cap, rod_side = holding_pressures(force, CYLINDER, 0.2e6)
    assert cap * AREA_1 - rod_side * AREA_2 == pytest.approx(force, abs=1e-10)
    assert min(cap, rod_side) == 0.2e6
    assert (cap > rod_side) == (force > 0.2e6 * math.pi / 4.0 * 0.010**2)  # 15.7 N


def test_air_softens_the_oil_most_at_low_pressure():
    def modulus(pressure, air):
        return effective_bulk_modulus(pressure, bulk_modulus=1.72e9, entrained_air=air)

    assert modulus(0.2e6, 0.0) == pytest.approx(1.72e9, rel=1e-15)
    assert modulus(0.2e6, 0.015) == pytest.approx(0.06e9, rel=0.02)
    assert modulus(0.2e6, 0.015) < modulus(1e6, 0.015) < modulus(3.5e6, 0.015) < 1.72e9
    assert modulus(-5e6, 0.015) > 0.0
    # Air alone at the atmosphere: n p_0, adiabatic.
    stiff = effective_bulk_modulus(0.0, bulk_modulus=1e30, entrained_air=1.0)
    assert stiff == pytest.approx(2.0 * 1.4 * 101_325.0, rel=1e-12)


# --------------------------------------------------------------------------------- bypass

BYPASS = BypassParameters(conductance_m3_per_s_pa=5e-10)
IDLE_BYPASSED = (CylinderParameters(damping_n_s_per_m=0.0, mass_kg=1000.0), IDLE)


def bypassed(opening, bypass=BYPASS, pressures=(2.0e6, 0.9e6), parts=IDLE_BYPASSED):
    system = FullCylinder(*parts, 0.06, pressures, bypass=bypass)
    context = at(system)
    system.GetInputPort("bypass_opening").FixValue(context, opening)
    return system, context


def test_conversions_with_a_bypass_agree_and_keep_arguments_and_changes():
    system = FullCylinder(CYLINDER, FULL, 0.06, (0.4e6, 0.7e6), PUMP_LEAKAGE, BYPASS)
    check_leaf(
        system,
        INPUTS | {"bypass_opening": (0.1, 0.9), "moving_mass": None, "continuous_state": STATE},
    )


def test_an_open_bypass_empties_both_chambers_into_the_reservoir():
    """The heavy rod stands, so P − P_r decays with the time constant V/(β K)."""
    system, context = bypassed(1.0)
    simulator = Simulator(system, context)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    elapsed = 4e-5
    simulator.AdvanceTo(elapsed)
    pressures = system.GetOutputPort("chamber_pressures").Eval(simulator.get_context())
    volumes = np.array([5e-6 + AREA_1 * 0.06, 5e-6 + AREA_2 * 0.09])
    decay = np.exp(-elapsed / (volumes / (1.72e9 * 5e-10)))
    # The rod, at 0.5 m/s² for 40 µs, displaces 1e-5 of the flow of the valve.
    np.testing.assert_allclose(pressures - 0.2e6, [1.8e6, 0.7e6] * decay, rtol=1e-3)
    assert decay.max() < 0.4


def test_a_rod_that_moves_feels_a_damper_through_an_open_bypass():
    """A_1 v = −K (P_1 − P_r) and A_2 v = K (P_2 − P_r): the pressures stay, F = −(A_1² + A_2²)v/K.

    A valve that only joined the chambers would let the oil of (A_1 − A_2) v nowhere. The rod that
    retracts would meet the relief pressure on this difference of areas, 275 N.
    """
    velocity, reservoir = -0.1, 0.2e6
    cap, rod_side = reservoir - AREA_1 * velocity / 5e-10, reservoir + AREA_2 * velocity / 5e-10
    system, context = bypassed(1.0)
    context.SetContinuousState([0.06, velocity, 1e-6 * cap, 1e-6 * rod_side])
    rates = system.EvalTimeDerivatives(context).CopyToVector()
    # A flow of 3e-5 m³/s would change a pressure by 2e9 Pa/s.
    np.testing.assert_allclose(rates[2:], 0.0, atol=1e-8)
    force = system.GetOutputPort("rod_force").Eval(context)[0]
    held = reservoir * (AREA_1 - AREA_2)
    assert force - held == pytest.approx((AREA_1**2 + AREA_2**2) * 0.1 / 5e-10, rel=1e-9)
    relief = FullCylinderParameters().relief_pressure_pa
    assert relief * (AREA_1 - AREA_2) == pytest.approx(274.9, abs=0.05)
    assert force < 50.0


def test_a_closed_bypass_and_one_that_is_stuck_shut_change_nothing():
    blocked = BypassParameters(conductance_m3_per_s_pa=0.0)
    parts = (CYLINDER, FULL)
    expected = rates(FullCylinder(*parts, 0.06, (2.0e6, 0.9e6)))
    for opened, valve in ((0.0, BYPASS), (1.0, blocked)):
        system, context = bypassed(opened, valve, parts=parts)
        assert list(system.EvalTimeDerivatives(context).CopyToVector()) == list(expected)


# ------------------------------------------------------------------------------ bad input


def test_start_with_a_pressure_that_is_not_finite_is_refused():
    with pytest.raises(ParameterError, match=r"^initial_pressures_pa = .*nan.*: must be finite$"):
        FullCylinder(initial_pressures_pa=(0.2e6, math.nan))


@pytest.mark.parametrize(
    ("leak", "rate"),
    [
        ("cap_external_leakage_m3_per_s_pa", "cap_pressure_rate"),
        ("rod_side_external_leakage_m3_per_s_pa", "rod_side_pressure_rate"),
    ],
)
def test_the_rate_that_is_not_finite_is_named(leak, rate):
    system = full_system()  # starts above the pressure of the reservoir
    context = at(system)
    system.set_parameter(context, leak, 1e305)
    with pytest.raises(SimulationError, match=rf"{rate} = -?inf .*is not finite"):
        system.EvalTimeDerivatives(context)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flow", "swinging_n", "resting_n"),
    [(-1e-5, (2.0, 20.0, 60.0), (100.0,)), (2e-6, (20.0, 24.0), (2.0, 11.0, 40.0))],
)
def test_the_rod_switches_modes_after_a_step_of_the_flow(flow, swinging_n, resting_n):
    """The loads of the docstring, far beyond those of the linear onset."""
    parameters, full = CylinderParameters(damping_n_s_per_m=200.0), FullCylinderParameters()
    builder = DiagramBuilder()
    cylinder = builder.AddNamedSystem("cylinder", FullCylinder(parameters, full))
    for name in ("load_flow", "load_force"):
        builder.ExportInput(cylinder.GetInputPort(name), name)
    builder.ExportOutput(cylinder.GetOutputPort("rod_velocity"), "v")
    model = compile_diagram(builder.Build(), inputs=["load_flow", "load_force"])
    for force in (*swinging_n, *resting_n):
        held = holding_pressures(force, parameters, full.reservoir_pressure_pa)
        state = model.state()
        state.continuous[:] = (0.03 if flow > 0.0 else 0.14), 0.0, *(1e-6 * p for p in held)
        run = model.simulate(
            model.parameters(),
            state,
            2.4,
            record_period_s=1e-3,
            integrator="rosenbrock",
            inputs=InputTable(coefficients=np.array([[[flow], [force]]])),
        )
        swing_mm_s = 1e3 * np.ptp(run["v"][run.time_s > 2.1])
        # 2.7 mm/s and more were seen where the rod swings, and rounding alone where it rests.
        assert swing_mm_s > 1.0 if force in swinging_n else swing_mm_s < 1e-6, force
