"""Wearer, cuff and load cell in the closed loop: ports, signs, and rest by hand."""

import math

import numpy as np
import pytest

from kneexo.diagrams import available_signals, make_closed_loop
from kneexo.errors import ParameterError
from kneexo.parameters import (
    KneeLoadParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    StepReference,
)
from kneexo.simulation import simulate
from kneexo.simulation.compiled import structure_key

LOADED = PlantParameters(load=KneeLoadParameters())
STILL = StepReference(start_deg=45.0, end_deg=45.0)
MOMENT = {"times_s": (0.0, 100.0), "moments_n_m": (10.0, 10.0)}
WEIGHT = 1.6 * 9.81 * 0.20  # N·m of a horizontal shank, Lee et al. 2020, Table 3
WEARER_SIGNALS = {"wearer_motion", "interaction_torque", "interaction_power", "cuff_slip"}


def scenario(wearer="leg", controller="torque", plant=LOADED, **values):
    if isinstance(wearer, dict):
        wearer = {"kind": "leg", **wearer}
    return Scenario(plant=plant, wearer=wearer, controller=controller, **values)


# ------------------------------------------------------------------------------ structure


@pytest.mark.parametrize(
    ("case", "systems", "signals"),
    [
        (Scenario(plant=LOADED), set(), set()),
        (
            Scenario(plant=LOADED, controller="torque"),
            {"load_cell"},
            {"measured_force", "desired_torque"},
        ),
        (
            scenario(controller="pid"),
            {"wearer", "cuff", "load_cell"},
            WEARER_SIGNALS | {"measured_force"},
        ),
        (
            scenario(wearer={"moment": MOMENT}),
            {"wearer", "cuff", "load_cell", "moment"},
            WEARER_SIGNALS | {"measured_force", "desired_torque", "biological_moment"},
        ),
    ],
    ids=["none", "torque", "position", "moment"],
)
def test_subsystems_signals_and_inputs(case, systems, signals):
    diagram = make_closed_loop(case)
    names = {system.get_name() for system in diagram.GetSystems()}
    assert names & {"wearer", "cuff", "load_cell", "moment"} == systems
    every = WEARER_SIGNALS | {"measured_force", "desired_torque", "biological_moment"}
    assert set(available_signals(case)) & every == signals
    assert all(diagram.HasOutputPort(name) for name in signals)
    assert diagram.HasInputPort("knee_torque") == ("cuff" not in systems)


def test_a_moment_can_be_an_input():
    diagram = make_closed_loop(scenario(wearer={"moment": MOMENT}), external_moment=True)
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("biological_moment").FixValue(context, 7.0)
    assert diagram.GetOutputPort("biological_moment").Eval(context)[0] == 7.0


def test_a_seed_is_a_number_and_noise_is_structure():
    keys = [
        structure_key(scenario(load_cell=cell))
        for cell in ({}, {"seed": 1}, {"seed": 2}, {"seed": 2, "noise_n": 1.0})
    ]
    assert keys[1] == keys[2] == keys[3] != keys[0]


def test_without_wearer_and_torque_control_the_load_cell_is_not_part_of_the_structure():
    assert structure_key(Scenario(load_cell={"seed": 1})) == structure_key(Scenario())


# ---------------------------------------------------------------------------------- signs


@pytest.mark.parametrize("full_order", [False, True], ids=["reduced", "full"])
def test_power_of_cuff_and_weight_on_the_knee_is_the_power_of_the_rods_load(four_bar, full_order):
    """−F_L dx/dt = (τ_i + W) dθ/dt, with m d²x/dt² = F − F_L."""
    plant = PlantParameters(load=KneeLoadParameters(), full_order=full_order)
    diagram = make_closed_loop(scenario(wearer={"motion": "passive"}, plant=plant))
    context = diagram.CreateDefaultContext()
    plant = diagram.GetSubsystemByName("plant")
    inner = plant.GetMyMutableContextFromRoot(context)
    cylinder = plant.GetSubsystemByName("cylinder").GetMyMutableContextFromRoot(context)
    leg = diagram.GetSubsystemByName("wearer").GetMyMutableContextFromRoot(context)
    for seed in range(20):
        random = np.random.default_rng(seed)
        knee, velocity, *pressures = random.uniform((0.1, -0.2, -2.0, 0.1), (1.4, 0.2, 2.0, 3.0))
        pressures = pressures[: 1 + full_order]
        cylinder.SetContinuousState([four_bar.rod(knee), velocity, *pressures])
        state = leg.get_continuous_state_vector().CopyToVector()
        leg.SetContinuousState([knee + random.uniform(-0.05, 0.05), 1.5, *state[2:]])
        rate = -velocity / four_bar.arm(knee)
        torque = diagram.GetOutputPort("interaction_torque").Eval(context)[0]
        weight = -WEIGHT * math.sin(knee)  # the thigh hangs
        acceleration = plant.GetOutputPort("rod_state").Eval(inner)[2]
        force = plant.GetOutputPort("rod_force").Eval(inner)[0]
        load_power = -(force - 1.6 * acceleration) * velocity
        # The fit of the inverse leaves 5e-12 rad, 2e-11 of the arm. F − m a cancels to 1e-15 F.
        assert load_power == pytest.approx((torque + weight) * rate, rel=1e-9, abs=1e-10)
        given, taken = diagram.GetOutputPort("interaction_power").Eval(context)
        assert given == pytest.approx(1.5 * torque, rel=1e-12)
        assert taken == pytest.approx(torque * rate, rel=1e-9)


def rest(case):
    """Mean of each column over the last 5 s; counts of the encoder leave a small limit cycle."""
    run = simulate(case)
    assert np.ptp(run["knee_angle_rad"][-2500:]) < 0.01
    return {name: values[-2500:].mean() for name, values in run.columns.items()}


@pytest.mark.slow
def test_at_zero_torque_the_leg_carries_the_exoskeleton(four_bar):
    run = rest(scenario(reference=STILL, simulation=SimulationParameters(duration_s=15.0)))
    # The integral has brought the force to the resolution of the load cell, 1 N at 0.1 m.
    assert run["rod_force_n"] == pytest.approx(0.0, abs=1.0)
    knee = run["knee_angle_rad"]
    assert run["interaction_torque_n_m"] == pytest.approx(WEIGHT * math.sin(knee), abs=0.1)
    assert run["wearer_angle_rad"] == pytest.approx(math.radians(45.0), rel=1e-12)
    assert knee == pytest.approx(math.radians(45.0) - WEIGHT * math.sin(knee) / 1500.0, abs=1e-4)


@pytest.mark.slow
def test_assistance_takes_its_share_of_the_moment_from_the_leg(four_bar):
    law = {"kind": "torque", "mode": "assist", "assistance": 0.3}
    case = scenario(
        wearer={"moment": MOMENT},
        controller=law,
        reference=STILL,
        simulation=SimulationParameters(duration_s=15.0),
    )
    run = rest(case)
    knee = run["knee_angle_rad"]
    # 30 % of 10 N·m in flexion: the rod pulls.
    assert run["desired_torque_n_m"] == 3.0
    assert run["rod_force_n"] * four_bar.arm(knee) == pytest.approx(-3.0, abs=0.1)
    carried = WEIGHT * math.sin(knee) - 3.0
    assert run["interaction_torque_n_m"] == pytest.approx(carried, abs=0.2)


@pytest.mark.slow
def test_a_virtual_spring_carries_leg_and_exoskeleton(four_bar):
    leg = {"motion": "passive", "loss_modulus_n_m_per_rad": 0.0, "neutral_angle_rad": 0.5}
    law = {"kind": "torque", "mode": "impedance", "stiffness_n_m_per_rad": 100.0}
    case = scenario(
        wearer=leg,
        controller=law,
        reference=STILL,
        simulation=SimulationParameters(duration_s=20.0),
    )
    run = rest(case)
    knee, leg_angle = run["knee_angle_rad"], run["wearer_angle_rad"]
    moment = -4.575 * 9.81 * 0.261 * math.sin(leg_angle) - 2.0 * (leg_angle - 0.5)
    assert run["interaction_torque_n_m"] == pytest.approx(moment, abs=0.02)
    spring = -100.0 * (knee - math.radians(45.0))
    # One count of the encoder is 2 mrad, 0.2 N·m; one step of the load cell 0.1 N·m.
    assert spring + moment - WEIGHT * math.sin(knee) == pytest.approx(0.0, abs=0.4)


@pytest.mark.slow
def test_the_inertia_of_a_shank_needs_lower_gains_and_a_slower_load_cell():
    """The figures of the theory page."""
    from kneexo.analysis.linear.sampled_loop import linearize_loop

    plant = PlantParameters(load=KneeLoadParameters(inertia_kg_m2=0.064))
    loop = linearize_loop(scenario(plant=plant), knee_angle_deg=45.0)
    assert loop.margins().gain_margin == pytest.approx(1.44, abs=0.005)
    for angle_deg, eigenvalue in ((20.0, 1.04), (5.0, 1.19)):
        loop = linearize_loop(scenario(plant=plant), knee_angle_deg=angle_deg)
        assert np.abs(loop.eigenvalues).max() == pytest.approx(eigenvalue, abs=0.005)
    law = {"kind": "torque", "proportional_rad_s_per_n": 2.0, "integral_rad_s2_per_n": 10.0}
    lower = scenario(plant=plant, controller=law)
    assert not linearize_loop(lower, knee_angle_deg=5.0).stable
    slower = lower.changed({"load_cell.filter_s": 0.005})
    for angle_deg, margin in ((5.0, 1.91), (20.0, 2.77), (45.0, 1.89)):
        loop = linearize_loop(slower, knee_angle_deg=angle_deg)
        assert loop.margins().gain_margin == pytest.approx(margin, abs=0.01)


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"wearer": "leg"}, r"wearer.kind = leg needs plant.load.kind = knee, .* \{load: knee\}"),
        (
            {"controller": {"kind": "torque", "mode": "assist"}},
            r"controller.mode = assist needs wearer.moment; add a wearer",
        ),
        (
            {"plant": LOADED, "wearer": "leg", "controller": {"kind": "torque", "mode": "assist"}},
            r"controller.mode = assist needs wearer.moment; add gait, a table, .*",
        ),
        (
            {"plant": LOADED, "wearer": {"kind": "leg", "effort": 0.7}},
            r"wearer.effort = 0.7 needs wearer.moment; add gait, a table, .*",
        ),
        (
            {
                "plant": LOADED,
                "wearer": {"kind": "leg", "moment": {"times_s": (0, 20), "moments_n_m": (0, 1)}},
            },
            r"wearer.moment covers 0 … 20 s, and the run lasts from 0 to 30 s; must cover it; "
            r"extend the table, or reduce simulation.duration_s",
        ),
        (
            {
                "plant": LOADED,
                "wearer": {"kind": "leg", "moment": {"times_s": (1, 40), "moments_n_m": (0, 1)}},
            },
            r"wearer.moment covers 1 … 40 s, and the run lasts from 0 to 30 s; must cover it; "
            r"subtract 1 s from its times",
        ),
    ],
)
def test_a_wearer_that_does_not_fit_is_refused_in_one_line(values, line):
    with pytest.raises(ParameterError, match=rf"^Scenario: {line}\Z"):
        Scenario(**values)


def test_a_signal_of_the_wearer_needs_a_wearer():
    with pytest.raises(ParameterError, match=r"'interaction_torque' .*; needs wearer.kind = leg$"):
        make_closed_loop(signals=["interaction_torque"])
