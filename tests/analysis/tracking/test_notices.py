"""What a model leaves out, and notices about scenarios that surprise their users."""

import re

import numpy as np
import pytest

from kneexo.analysis import fit_polynomials, linearize_loop
from kneexo.analysis.tracking.notices import model_lines, model_notices, notices, omissions, wrapped
from kneexo.geometry.rod_polynomial import completed
from kneexo.parameters import (
    TABLE_1_LINKAGES,
    RodPolynomialParameters,
    SampledReference,
    Scenario,
    SineReference,
    StepReference,
)
from kneexo.parameters.paths import changed

TEN_SECONDS = SampledReference(times_s=(0.0, 4.0, 10.0), angles_deg=(20, 40, 30))


def test_an_ordinary_run_has_no_notice():
    assert list(notices(Scenario())) == []
    assert list(notices(Scenario(reference=TEN_SECONDS))) == []
    assert list(notices(Scenario(reference="gait"))) == []


@pytest.mark.parametrize(("duration_s", "count"), [(10.0, 0), (11.0, 0), (11.2, 1), (30.0, 1)])
def test_a_long_hold_of_the_last_sample_is_a_notice(duration_s, count):
    scenario = Scenario(reference=TEN_SECONDS, simulation={"duration_s": duration_s})
    lines = list(notices(scenario))
    assert len(lines) == count
    if lines:
        assert lines[0].startswith("the reference ends at 10 s, and the run holds its last sample")
        assert f"simulation.duration_s = {duration_s:g} s; leave" in lines[0]


def test_a_late_begin_of_the_reference_is_a_notice():
    for start_s, count in ((0.5, 0), (5.0, 1)):
        times = (start_s, start_s + 2.0, start_s + 5.0)
        reference = SampledReference(times_s=times, angles_deg=(20, 40, 30))
        lines = list(notices(Scenario(reference=reference)))
        assert len(lines) == count
    assert lines[0].startswith("the reference begins at 5 s, and the run holds its first sample")


def test_samples_before_the_run_are_one_notice():
    reference = SampledReference(times_s=(-2.0, 0.0, 2.0), angles_deg=(20, 40, 30))
    lines = list(notices(Scenario(reference=reference)))
    assert lines == ["the samples before 0 s, from -2 s on, are not run; add 2 s to all times"]


def sampled_notices(times_s, angles_deg, **values):
    reference = SampledReference(times_s=times_s, angles_deg=angles_deg, **values)
    return list(notices(Scenario(reference=reference)))


def test_what_was_done_to_the_samples_of_a_file_is_a_notice():
    shift, clip = sampled_notices((0, 4, 10), (20, -5, 30), clip=True, shift_s=12.3)
    assert shift == "the run begins at 12.3 s of the files of reference and moment"
    assert clip == "samples up to 5° beyond the stops are clipped"


def test_units_that_may_be_others_are_notices():
    times_s, angles = np.linspace(0.0, 2.0, 101), 35.0 - 33.0 * np.cos(np.linspace(0.0, 12.0, 101))
    assert sampled_notices(times_s, angles) == []
    (line,) = sampled_notices(times_s, np.radians(angles))
    assert line == "the reference stays within 1.19°; if it is in rad, multiply it by 57.3"
    (line,) = sampled_notices(1e3 * times_s, angles)  # at most 33 deg · 6 rad/s
    assert line == "the reference moves at most 0.2 deg/s; divide its times by 1000 if in ms"
    assert sampled_notices((0, 50, 101), (0.0, 0.0, 0.0)) == []  # a knee that stands still


@pytest.mark.parametrize("kind", ["step", "ramp"])
def test_a_motion_after_the_run_is_a_notice(kind):
    reference = {"kind": kind, "time_s": 30.0}
    (line,) = notices(Scenario(reference=reference))
    assert line.startswith(f"the {kind} at 30 s is not run, because the run ends at 30 s")
    assert not list(notices(Scenario(reference=reference | {"time_s": 29.9})))


def test_torque_control_without_wearer_is_a_notice():
    (line,) = notices(Scenario(controller="torque"))
    assert line.endswith("add wearer: leg and plant: {load: knee}")
    worn = {"plant.load": {"kind": "knee"}, "wearer": "leg", "controller": {"kind": "torque"}}
    assert not list(notices(changed(Scenario(), worn)))
    assert not list(notices(Scenario()))


def test_a_wearer_is_not_left_out():
    loaded = Scenario(plant={"load": "knee"})
    assert "torque of the wearer" in omissions(loaded)
    assert "torque of the wearer" not in omissions(changed(loaded, {"wearer": "leg"}))


OWN = Scenario(plant={"linkage": {"rod_pin_radius_m": 0.27}})


def test_a_fitted_polynomial_is_a_notice():
    (line,) = notices(OWN)
    error = np.abs(fit_polynomials(OWN.plant.linkage).p_error_mm).max()
    assert line.startswith("the controller's polynomial is fitted to this linkage: off by at most")
    assert f" {error:.2g} mm of rod" in line


@pytest.mark.parametrize("linkage", TABLE_1_LINKAGES)
def test_table_1_is_no_surprise_for_the_linkages_of_the_paper(linkage):
    for polynomial in (None, RodPolynomialParameters()):
        scenario = Scenario(plant={"linkage": linkage}, polynomial=polynomial)
        assert list(notices(scenario)) == []


def test_a_polynomial_of_another_linkage_is_a_notice():
    wrong = OWN.model_copy(update={"polynomial": RodPolynomialParameters()})
    (line,) = notices(wrong)
    error = np.abs(fit_polynomials(OWN.plant.linkage).table_p_error_mm).max()
    assert f"polynomial is off the linkage by up to {error:.2g} mm of rod" in line
    assert line.endswith("leave polynomial out, so that kneexo fits it")


def test_a_completed_scenario_has_no_notice_about_its_polynomial():
    assert list(notices(completed(OWN))) == []


def test_a_small_misfit_is_no_notice():
    fitted = completed(OWN).polynomial
    for offset_mm, count in ((0.2, 0), (0.4, 1)):
        p = (*fitted.p_mm_deg[:-1], fitted.p_mm_deg[-1] + offset_mm)
        given = OWN.model_copy(update={"polynomial": RodPolynomialParameters(p_mm_deg=p)})
        assert len(list(notices(given))) == count


@pytest.mark.parametrize(("duration_s", "count"), [(1.9, 1), (3.996, 1), (3.998, 0)])
def test_a_run_of_less_than_two_periods_is_a_notice(duration_s, count):
    values = {"reference.frequency_hz": 0.5, "simulation.duration_s": duration_s}
    lines = list(notices(changed(Scenario(), values)))
    assert len(lines) == count
    if lines:
        start = f"the run of {duration_s:g} s has less than two periods of the reference, 2 s each"
        assert lines[0].startswith(start)


WEIGHTLESS = (
    "plant.cylinder.mass_kg = 3.2 kg has inertia but no weight; plant.load: knee adds weight"
)
BENCH, LEG = Scenario.preset("bench"), Scenario.preset("leg")


def test_the_default_model_leaves_out_load_full_order_and_bus():
    assert model_lines(Scenario(), ()) == [
        "Left out: load on the knee, full order of the cylinder (valves, friction, air), "
        "torque of the motor,\n  bus."
    ]
    assert omissions(BENCH) == (
        "torque of the wearer",
        "full order of the cylinder (valves, friction, air)",
        "torque of the motor",
    )
    assert omissions(LEG) == ("torque of the wearer", "air in the oil", "torque of the motor")


@pytest.mark.parametrize(
    ("values", "omission"),
    [
        ({"plant.load.segment_mass_kg": 0.0}, "weight of the shank"),
        ({"plant.load.gravity_m_s2": 0.0}, "weight of the shank"),
        ({"plant.full_order.coulomb_friction_n": 0.0}, "friction of the seals"),
        ({"plant.pump.internal_leakage_m3_per_s_pa": 0.0}, "leakage"),
        ({"plant.ideal_motor": True}, "lag and limits of the motor"),
        ({"plant.motor": True}, "heat of the motor"),
        ({"plant.rod_map": "polynomial"}, "error of the polynomial"),
        ({"encoder.quantized": False}, "counts of the encoder"),
        ({"estimator": {"kind": "exact"}}, "estimation of the rod's state"),
        (
            {
                "estimator": {"kind": "exact"},
                "controller.continuous": True,
                "bus": {"kind": "none"},
            },
            "sampling",
        ),
        ({"bus": {"kind": "none"}}, "bus"),
    ],
)
def test_each_idealization_is_an_omission(values, omission):
    assert omission in omissions(changed(LEG, values))
    assert omission not in omissions(LEG)


@pytest.mark.parametrize(
    "values",
    [
        {"plant.load.knee_torque_n_m": 2.0, "plant.full_order.entrained_air": 0.01},
        {
            "plant.load.knee_torque_n_m": -2.0,
            "plant.full_order.entrained_air": 0.01,
            "plant.full_order.coulomb_friction_n": 0.0,
            "plant.full_order.stribeck_friction_n": 5.0,
            "bus": {"kind": "none", "latency_samples": 1},
        },
    ],
)
def test_a_whole_model_leaves_out_nothing_that_can_be_computed(values):
    scenario = changed(LEG, values | {"plant.motor": True, "plant.thermal": True})
    assert model_lines(scenario, ()) == ["Left out: nothing that kneexo can compute."]


@pytest.mark.parametrize("scenario", [Scenario(), BENCH, LEG])
def test_a_preset_contradicts_nothing(scenario):
    assert list(model_notices(scenario)) == []


def test_a_heavy_rod_contradicts_the_bounds_of_the_controller_and_has_no_weight():
    heavy = changed(Scenario(), {"plant.cylinder.mass_kg": 3.2})
    bounds = (
        "plant.cylinder.mass_kg = 3.2 kg is outside controller.mass_min_kg … mass_max_kg, "
        "1.4 … 1.8 kg"
    )
    assert list(model_notices(heavy)) == [bounds, WEIGHTLESS]
    loaded = changed(heavy, {"plant.load": {"kind": "knee"}})
    assert list(model_notices(loaded)) == [
        bounds,
        "plant.cylinder.mass_kg = 3.2 kg has inertia but no weight; gravity acts on "
        "plant.load.segment_mass_kg = 1.6 kg",
    ]
    believed = {"plant.load.segment_mass_kg": 3.2, "controller.mass_max_kg": 3.6}
    assert list(model_notices(changed(loaded, believed))) == []
    assert list(model_notices(changed(heavy, {"controller": {"kind": "pid"}}))) == [WEIGHTLESS]


@pytest.mark.parametrize(("mass_kg", "count"), [(1.4, 0), (1.8, 0), (1.39, 1), (1.81, 2)])
def test_the_bounds_of_the_mass_belong_to_it(mass_kg, count):
    scenario = changed(Scenario(), {"plant.cylinder.mass_kg": mass_kg})
    assert len(list(model_notices(scenario))) == count


def test_an_inertia_of_the_load_is_a_mass_beyond_the_bounds_of_the_controller():
    scenario = changed(Scenario(), {"plant.load": {"kind": "knee", "inertia_kg_m2": 0.064}})
    # I/r² with the arms of 107.09 mm at 68.3° and 36.8 mm at 0°
    assert list(model_notices(scenario)) == [
        "plant.load.inertia_kg_m2 = 0.064 kg·m² acts as 5.58 … 47.3 kg at the rod, which is "
        "outside controller.mass_min_kg … mass_max_kg, 1.4 … 1.8 kg"
    ]
    pid = changed(scenario, {"controller": "pid"})
    assert not list(model_notices(pid))
    assert list(model_notices(changed(pid, {"plant.cylinder.mass_kg": 3.0}))) == [
        "plant.cylinder.mass_kg = 3 kg has no effect; plant.load.inertia_kg_m2 = 0.064 kg·m² "
        "replaces it"
    ]


def test_a_nominal_plant_that_differs_is_a_notice():
    nominal = {"cylinder": {"bulk_modulus_pa": 1e9}}
    (line,) = model_notices(Scenario(nominal=nominal))
    assert line == "nominal.cylinder.bulk_modulus_pa is 1e+09 Pa, that of the plant 1.72e+09 Pa"
    nominal["pump"] = {"lag_s": 0.02, "gear_ratio": 5.0}
    (line,) = model_notices(Scenario(nominal=nominal))
    assert line.endswith("1.72e+09 Pa; 2 more differences")
    assert list(model_notices(Scenario(nominal=Scenario().plant))) == []


@pytest.mark.parametrize(("columns", "width"), [("", 100), ("140", 100), ("60", 60)])
def test_no_line_is_wider_than_the_terminal_unless_it_is_one_word(monkeypatch, columns, width):
    monkeypatch.setenv("COLUMNS", columns)
    words = " ".join(30 * ["plant.load"])
    lines = wrapped(f"{words} {130 * 'x'}").split("\n")
    assert width - 10 < max(len(line) for line in lines[:-1]) <= width
    assert lines[-1] == f"  {130 * 'x'}"
    assert " ".join(" ".join(lines).split()) == f"{words} {130 * 'x'}"
    assert model_lines(Scenario(), ["a", "b"])[1:] == ["Note: a.", "Note: b."]


@pytest.mark.parametrize(
    ("cell", "line"),
    [
        ({"dropout_s": 2.0, "dropout_start_s": 3.0}, "2 s: .* from 3.01 s to 5 s, which margins"),
        ({"dropout_s": 1e5}, "100000 s: .* from 1.01 s to 30 s, which margins"),
        ({"dropout_s": 0.009}, ""),
        ({"dropout_s": 9.0, "dropout_start_s": 30.0}, ""),
    ],
)
def test_readings_that_are_missing_for_long_are_a_notice(cell, line):
    values = {"plant": {"load": "knee"}, "wearer": "leg", "load_cell": cell}
    lines = list(notices(Scenario(controller={"kind": "torque", "timeout_s": 0.01}, **values)))
    assert len(lines) == bool(line)
    assert not line or re.match(f"load_cell.dropout_s = {line}", lines[0])
    assert not list(notices(Scenario(**values)))  # position control does not read the cell


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "line"),
    [
        ({"stiffness_n_m_per_rad": 5e4}, r"must be 0 … \d{5} N·m/rad; reduce it"),
        ({"stiffness_n_m_per_rad": 5e4, "mode": "assist_as_needed"}, r"must be 0 … \d{5} .*"),
        ({"speed_feedforward": 1.0}, r"must be \d{4} … \d{5} N·m/rad; increase it"),
        (
            {"integral_rad_s2_per_n": 1e6},
            r"no stiffness is stable; reduce the controller's gains and damping",
        ),
    ],
)
def test_an_unstable_virtual_stiffness_is_a_notice_with_both_ends(law, line):
    law = {"mode": "impedance", "damping_n_m_s_per_rad": 0.0, "leak_per_s": 0.0} | law
    scenario = Scenario(
        plant={"load": "knee"},
        wearer={"kind": "leg", "motion": "active"},
        controller={"kind": "torque"} | law,
        reference=StepReference(start_deg=45.0, end_deg=45.0),
    )
    stiffness = scenario.controller.stiffness_n_m_per_rad
    where = "45°" if law["mode"] == "impedance" else "45°, outside the band"
    start = f"controller.stiffness_n_m_per_rad = {stiffness:g} N·m/rad is unstable at {where}: "
    (notice,) = notices(scenario)
    assert re.fullmatch(re.escape(start) + line, notice)
    free = scenario.changed({"controller.mode": "zero_torque"})
    assert not list(notices(free))


@pytest.mark.slow
def test_torque_control_that_is_unstable_near_extension_is_a_notice():
    load = {"kind": "knee", "inertia_kg_m2": 0.064}
    scenario = Scenario(
        plant={"load": load},
        wearer={"kind": "leg"},
        controller={"kind": "torque"},
        reference=SineReference(mean_deg=40.0, amplitude_deg=35.0),
    )
    loop = linearize_loop(scenario, knee_angle_deg=5.0)
    largest = abs(loop.eigenvalues).max()
    assert largest > 1.1
    (notice,) = notices(scenario)
    assert notice == (
        f"knee and wearer are unstable at 5°: the largest eigenvalue of the sampled loop is "
        f"{largest:.3g}, and must be below 1; reduce the controller's gains"
    )
    softer = {
        "controller.proportional_rad_s_per_n": 2.0,
        "controller.integral_rad_s2_per_n": 10.0,
        "load_cell.filter_s": 0.005,
    }
    assert not list(notices(scenario.changed(softer)))
    assert not list(notices(scenario.changed({"plant.load": {"kind": "knee"}})))
