import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydrake.systems.analysis import Simulator

from diagramc.testing import check_leaf
from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    PlantParameters,
    SlidingModeParameters,
)
from kneexo.systems import SlidingModeController

# Lee et al. 2020, Tables 2 and 3.
AREA, VOLUME, BULK_MODULUS = 274.8894e-6, 41_233e-9, 1.72e9
DISPLACEMENT, GEAR = 0.8e-6 / (2.0 * math.pi), 6.0
M_HAT, BETA = math.sqrt(1.4 * 1.8), math.sqrt(1.8 / 1.4)
B_HAT = 4.0 * BULK_MODULUS * AREA * DISPLACEMENT / (GEAR * M_HAT * VOLUME)
STIFFNESS_HAT = 4.0 * BULK_MODULUS * AREA**2 / (M_HAT * VOLUME)  # ω̂² in 1/s²
LIMIT = 5000.0 * 2.0 * math.pi / 60.0

UNCERTAIN = {
    "stiffness_uncertainty_n_per_m": 300.0,
    "damping_uncertainty_n_s_per_m": 20.0,
    "load_rate_uncertainty_n_per_s": 50.0,
    "area_uncertainty": 0.1,
}
PLANT = PlantParameters(
    cylinder=CylinderParameters(stiffness_n_per_m=150.0, damping_n_s_per_m=12.0),
    pump=BldcPumpParameters(gear_ratio=5.0),
)
INSIDE = {  # of the boundary layer: |s| stays below 3.2 m/s²
    "estimated_state": [(0.0749, 0.0751), (-0.02, 0.02), (-0.5, 0.5)],
    "rod_reference": [(0.0749, 0.0751), (-0.02, 0.02), (-0.5, 0.5), (-5.0, 5.0)],
}
OUTSIDE = {"estimated_state": [(0.0, 0.15), (-0.05, 0.05), (-1.0, 1.0)]} | {
    "rod_reference": [(0.0, 0.15), (-0.05, 0.05), (-1.0, 1.0), (-5.0, 5.0)]
}
UNLIMITED = {"command_limit_rad_s": 1e12}


def at(system, state, reference):
    context = system.CreateDefaultContext()
    system.GetInputPort("estimated_state").FixValue(context, state)
    system.GetInputPort("rod_reference").FixValue(context, reference)
    return context


def command(state, reference, plant=PLANT, **values):
    """The next command of the discrete controller."""
    system = SlidingModeController(SlidingModeParameters(**values), plant)
    update = system.EvalUniquePeriodicDiscreteUpdate(at(system, state, reference))
    return update.get_vector(0).GetAtIndex(0)


def sliding(state, reference, lambda_):
    e, e_1, e_2 = np.subtract(state, reference[:3])
    return e_2 + 2.0 * lambda_ * e_1 + lambda_**2 * e


def written_out(state, reference, *, signum=False):
    """Eq. 27 for `PLANT`, `UNCERTAIN` and the default gains, unlimited."""
    lambda_, phi, eta = 20.0, 3.2, 2.8e5
    _, v, a = state
    demand = reference[3] - 2.0 * lambda_ * (a - reference[2]) - lambda_**2 * (v - reference[1])
    f = -(STIFFNESS_HAT + 150.0 / M_HAT) * v - 12.0 / M_HAT * a
    k = (300.0 * abs(v) + 20.0 * abs(a) + 50.0) / M_HAT
    k += 0.1 * STIFFNESS_HAT * abs(v) + abs(1.0 - BETA) * abs(demand) + BETA * eta
    s = sliding(state, reference, lambda_)
    switch = np.sign(s) if signum else min(max(s / phi, -1.0), 1.0)
    return (demand - f - k * switch) / (B_HAT * GEAR / 5.0)


# ----------------------------------------------------------------------------- conversion


@pytest.mark.parametrize("ranges", [INSIDE, OUTSIDE], ids=["inside", "outside"])
@pytest.mark.parametrize(
    "values",
    [UNLIMITED, {}, {**UNLIMITED, "switching": "signum"}, {**UNLIMITED, "continuous": True}],
    ids=["unlimited", "limited", "signum", "continuous"],
)
def test_conversions_agree_and_keep_arguments(ranges, values):
    parameters = SlidingModeParameters(**UNCERTAIN, **values)
    state = {} if parameters.continuous else {"discrete_state": (-500.0, 500.0)}
    check_leaf(SlidingModeController(parameters, PLANT), ranges | state)


# -------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("ranges", [INSIDE, OUTSIDE], ids=["inside", "outside"])
@pytest.mark.parametrize("switching", ["saturation", "signum"])
def test_random_points_meet_the_written_out_law(leaf, ranges, switching):
    parameters = SlidingModeParameters(switching=switching, **UNCERTAIN, **UNLIMITED)
    system = SlidingModeController(parameters, PLANT)
    probe = leaf.Probe(system, ranges, [(-500.0, 500.0)])
    for z in probe.points(50):
        state, reference, held = z[1:4], z[4:8], z[8]
        expected = written_out(state, reference, signum=switching == "signum")
        results = probe.results(z)
        # Seven printed digits of the area, squared; terms of up to 1e3 rad/s.
        assert results[2] == pytest.approx(expected, rel=1e-6, abs=1e-3)
        assert results[1] == pytest.approx(sliding(state, reference, 20.0), rel=1e-12, abs=1e-12)
        assert results[0] == held


def test_continuous_command_is_the_same_law(leaf):
    system = SlidingModeController(
        SlidingModeParameters(continuous=True, **UNCERTAIN, **UNLIMITED), PLANT
    )
    probe = leaf.Probe(system, INSIDE)
    for z in probe.points(5):
        expected = written_out(z[1:4], z[4:8])
        assert probe.results(z)[0] == pytest.approx(expected, rel=1e-6, abs=1e-3)  # as above


def test_default_gains_slope_at_1e5_per_s_and_use_the_full_speed_authority():
    still = [0.075, 0.0, 0.0, 0.0]  # at rest on the reference the demand is zero
    e = 1e-6
    u = command([0.075 + e, 0.0, 0.0], still, PlantParameters())
    assert -u * B_HAT / (20.0**2 * e) == pytest.approx(1e5, rel=0.01)  # k/Φ, to the digits shown
    full = command([0.15, 0.0, 0.0], still, PlantParameters(), **UNLIMITED)
    assert -full == pytest.approx(BETA * 2.8e5 / B_HAT, rel=1e-6)
    assert -full == pytest.approx(LIMIT, rel=0.015)  # βη is b̂ · 524 rad/s to two digits


@given(
    mass=st.floats(1.4, 1.8),
    state=st.tuples(st.floats(0.0, 0.15), st.floats(-0.05, 0.05), st.floats(-2.0, 2.0)),
    reference=st.tuples(
        st.floats(0.0, 0.15), st.floats(-0.05, 0.05), st.floats(-2.0, 2.0), st.floats(-9.0, 9.0)
    ),
)
def test_sliding_condition_holds_for_every_mass_between_the_bounds(mass, state, reference):
    # d/dt s² / 2 <= −η|s| outside the boundary layer (Lee et al. 2020, Eq. 24 to 27).
    s = sliding(state, reference, 20.0)
    u = command(state, reference, PlantParameters(), **UNLIMITED)
    jerk = M_HAT / mass * (B_HAT * u - STIFFNESS_HAT * state[1])  # the plant, without friction
    demand = reference[3] - 40.0 * (state[2] - reference[2]) - 400.0 * (state[1] - reference[1])
    if abs(s) >= 3.2:
        # 1e-6 of k for the digits of the area and the friction that the controller expects.
        assert s * (jerk - demand) <= -(1.0 - 1e-5) * 2.8e5 * abs(s)


def rate_outside(area_share, v, **values):
    """sgn(s) ds/dt well outside the layer, of a plant that is right but for its piston area."""
    state, reference = [0.15, v, 0.0], [0.0, v, 0.0, 0.0]
    u = command(state, reference, PlantParameters(), **UNLIMITED, **values)
    # The area scales what the pump's pressure does, and once more what the rod's speed costs.
    return area_share * (B_HAT * u - area_share * STIFFNESS_HAT * v)


@given(area_share=st.floats(6.0 / 7.0, 8.0 / 7.0), v=st.floats(-0.05, 0.05))
def test_area_term_completes_the_sliding_condition(area_share, v):
    # With |A/Ā − 1| <= 1/7 and the gain A/Ā >= 6/7 inside β >= 1.134; 1e-5 for the digits.
    eta = 1e4 * min(1.0, area_share * BETA)
    assert rate_outside(area_share, v, eta_m_s3=1e4, area_uncertainty=1.0 / 7.0) <= -0.99999 * eta


def test_eq_27_without_the_area_term_lets_s_grow():
    # At −40 mm/s a chamber of 8/7 Ā asks for 7.94e6 · 0.04/7 = 45 000 m/s³ of k; βη is 11 339.
    assert rate_outside(8.0 / 7.0, -0.04, eta_m_s3=1e4) > 3e4
    assert rate_outside(8.0 / 7.0, -0.04, eta_m_s3=5e4) < 0.0


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize("continuous", [False, True], ids=["discrete", "continuous"])
def test_nan_estimate_is_not_hidden_by_the_limit(continuous):
    system = SlidingModeController(SlidingModeParameters(continuous=continuous))
    simulator = Simulator(system, at(system, [0.07, math.nan, 0.0], [0.07, 0.0, 0.0, 0.0]))
    simulator.AdvanceTo(0.01)
    assert np.isnan(system.GetOutputPort("motor_speed_command").Eval(simulator.get_context()))
