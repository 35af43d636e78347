"""FMUs of scenarios: beside compiled runs, in FMPy and in libcosim."""

import ctypes
import fcntl
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagramc import write_fmu
from diagramc.c import build as c_build
from diagramc.fmu.units import unit_of_name
from kneexo.command_line.main import main
from kneexo.command_line.parameter_list import parameter_rows
from kneexo.diagrams import SIGNALS, available_signals, columns, make_closed_loop, make_controller
from kneexo.errors import ParameterError
from kneexo.export import fmu as exports
from kneexo.export.fmu import export_fmu, parameter_effects
from kneexo.export.target import WHAT, largest_step_s
from kneexo.geometry.rod_polynomial import completed
from kneexo.page.sliders import SLIDERS
from kneexo.parameters import (
    CuffParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    LegParameters,
    LoadCellParameters,
    PidParameters,
    PlantParameters,
    ProtectionParameters,
    SampledReference,
    Scenario,
    SimulationParameters,
    TorqueParameters,
)
from kneexo.parameters.fields.fields import unit_of
from kneexo.parameters.paths import changed, value_at
from kneexo.parameters.presets import with_preset
from kneexo.simulation.compiled import scenario_values, simulate_compiled

ROOT = Path(__file__).parents[2]
PAPER = Scenario()
LOADED = Scenario(
    plant=PlantParameters(load=KneeLoadParameters(), full_order=FullCylinderParameters()),
    simulation=SimulationParameters(duration_s=2.0),
)
SHORT = Scenario(simulation=SimulationParameters(duration_s=1.0))
TICK_S = 0.002
REFERENCE = SIGNALS["knee_reference"]
NEEDS_COMPILER = pytest.mark.skipif(
    not any(map(shutil.which, c_build.COMPILERS)), reason="needs a C compiler"
)


@cache
def _fmu(scenario, what, fmi, step_s):
    return exports.make_fmu(scenario, what, fmi=fmi, step_s=step_s)


def make_fmu(scenario, what, fmi=3, step_s=None):
    """One FMU for equal arguments; no test changes it."""
    return _fmu(scenario, what, fmi, step_s)


@pytest.fixture(scope="module", autouse=True)
def _effects_once():
    """Compute the effects of the numbers of a scenario, half the time of an export, once."""

    @cache
    def effects(scenario, names):
        return parameter_effects(scenario, list(names))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exports, "parameter_effects", lambda s, names: effects(s, tuple(names)))
        yield


@pytest.fixture(scope="module")
def path(tmp_path_factory, worker_id):
    """``path(what, fmi, scenario)``: a written FMU, which all workers of pytest share."""
    folder = tmp_path_factory.getbasetemp()
    folder = (folder if worker_id == "master" else folder.parent) / "shared_fmus"
    folder.mkdir(exist_ok=True)

    @cache
    def written(what, fmi, scenario=PAPER):
        name = hashlib.sha256(repr(scenario).encode()).hexdigest()[:16]
        file = folder / f"{what}_{fmi}_{name}.fmu"
        with file.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # another worker may be at it
            if not file.exists():
                write_fmu(file, make_fmu(scenario, what, fmi))
        with zipfile.ZipFile(file) as archive:
            if not any(member.endswith(".so") for member in archive.namelist()):
                pytest.skip("needs a C compiler on Linux in 64 bits")
        return str(file)

    return written


@cache
def _compiled(scenario):
    step_s = largest_step_s(scenario, "loop")
    return simulate_compiled(scenario, integrator="rk4", step_s=step_s).data


def _steps(data):
    return range(len(data["knee_angle_rad"]) - 1)


def _relative(values, expected):
    """Largest difference, as a part of the largest value; 0 where both are zero."""
    difference = np.abs(np.array(values) - expected).max()
    return difference / np.abs(expected).max() if difference else 0.0


def _loop_run(loop, steps, *names):
    rows = [loop.get(*names)]
    for n in steps:
        loop.step(n * TICK_S)
        rows.append(loop.get(*names))
    return np.array(rows)


# --------------------------------------------------------------------------------- contents


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("what", WHAT)
def test_description_is_valid(what, fmi, path):
    pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    from fmpy.validation import validate_fmu

    assert validate_fmu(path(what, fmi)) == []


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_fields_of_the_three_targets(path, fmi):
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    fields = {}
    for what in WHAT:
        description = fmpy.read_model_description(path(what, fmi))
        assert description.coSimulation.modelIdentifier == f"knee_{what}"
        by = {causality: {} for causality in ("input", "output", "parameter", "local")}
        for v in description.modelVariables:
            by.get(v.causality, {})[v.name] = v.unit
        fields[what] = by
        assert float(description.defaultExperiment.stopTime) == 30.0
        assert by["local"] == {"sample_time_s": "s"}
    reference = dict(zip(REFERENCE, ["rad", "rad/s", "rad/s2", "rad/s3"], strict=True))
    command = {"motor_speed_command_rad_s": "rad/s"}
    assert fields["controller"]["input"] == {**reference, "encoder_reading_rad": "rad"}
    assert fields["controller"]["output"] == command
    assert fields["plant"]["input"] == {**command, "disturbance_force_n": "N"}
    assert fields["loop"]["input"] == {"disturbance_force_n": "N"}
    assert fields["loop"]["output"].keys() == set(columns(available_signals(PAPER)))
    plant = fields["plant"]["output"]
    assert plant.pop("encoder_count") is None  # it has no unit
    assert plant == {name: fields["loop"]["output"][name] for name in plant}
    assert plant["load_flow_m3_s"] == "m3/s"
    assert plant["load_pressure_pa"] == "Pa"
    assert plant["shaft_torque_n_m"] == "N.m"
    assert plant["shaft_power_w"] == "W"


@pytest.mark.parametrize(
    ("what", "scenario", "count"),
    [
        ("controller", PAPER, 22),
        pytest.param("controller", LOADED, 22, marks=pytest.mark.slow),
        pytest.param("plant", LOADED, 34, marks=pytest.mark.slow),
        pytest.param("loop", LOADED, 44, marks=pytest.mark.slow),
    ],
)
def test_scenario_parameters_are_those_of_kneexo_params(what, scenario, count):
    """Value, unit and range as `kneexo params` tells them."""
    fmu = make_fmu(scenario, what)
    rows = {row["parameter"]: row for row in parameter_rows(scenario)}
    units = {v.name: v.unit.name if v.unit else "1" for v in fmu.table.variables}
    named = [p for p in fmu.parameters if p.name in rows]
    assert len(named) == count
    for parameter in named:
        row = rows[parameter.name]
        assert parameter.start == row["value"]
        symbol = row["unit"].replace("²", "2").replace("³", "3").replace("·", ".")
        assert units[parameter.name] == {"N/(m/s)": "N.s/m"}.get(symbol, symbol)
        low, high = re.fullmatch(r">=? (\S+) and <= (\S+)", row["range"]).groups()
        assert parameter.low == pytest.approx(float(low), rel=1e-5)
        assert parameter.high == pytest.approx(float(high), rel=1e-5)


@pytest.mark.parametrize("what", WHAT)
@pytest.mark.parametrize(
    "scenario",
    [pytest.param(PAPER, id="paper"), pytest.param(LOADED, id="loaded", marks=pytest.mark.slow)],
)
def test_each_context_parameter_has_one_master_with_its_value(what, scenario):
    fmu = make_fmu(scenario, what)
    members = [m for p in fmu.parameters for m in p.members if not m.startswith("initial_x")]
    assert sorted(members) == sorted(fmu.source.plan.members)
    values = dict(zip(fmu.source.plan.members, fmu.source.parameters.tolist(), strict=True))
    for parameter in fmu.parameters:
        for member in parameter.members:
            if member in values:
                assert parameter.start == values[member]
                assert parameter.tunable


def test_each_number_has_its_unit():
    """The unit by the name, as in an FMU, is the unit of the field."""
    spelt = {"N/(m/s)": "N.s/m", "(rad/s)/N": "rad/(s.N)", "(rad/s²)/N": "rad/(s2.N)"}
    fields = [
        (name, unit_of(field))
        for kind in (*SLIDERS, LegParameters, CuffParameters, LoadCellParameters, TorqueParameters)
        for name, field in kind.model_fields.items()
        if kind is not ProtectionParameters  # an FMU has no mm and no rpm
    ]
    units = {name: unit for name, unit in fields if unit and unit not in ("1", "counts/rev")}
    assert len(units) > 50
    for name, unit in units.items():
        expected = spelt.get(unit, unit.translate(str.maketrans("·²³", ".23")))
        assert unit_of_name(name).name == expected, name


@pytest.fixture
def effects_of():
    """``effects_of(scenario, paths)``: the effects of the numbers at ``paths`` alone."""

    def effects(scenario, paths):
        numbers = [row for row in exports._numbers(scenario) if row[0] in paths]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(exports, "_numbers", lambda _: numbers)
            return parameter_effects(scenario, list(scenario_values(scenario)))

    return effects


def test_effects_of_the_numbers_of_a_scenario(effects_of):
    paper = completed(PAPER)
    paths = (
        "plant.pump.gear_ratio",
        "plant.pump.speed_limit_rad_s",
        "plant.cylinder.mass_kg",
        "plant.cylinder.leakage_m3_per_s_pa",
        "plant.cylinder.stiffness_n_per_m",
        "plant.cylinder.bore_m",
        "plant.linkage.a_3_m",
        "controller.command_limit_rad_s",
        "reference.mean_deg",
        "polynomial.p_mm_deg[5]",
        "simulation.duration_s",
    )
    effects = effects_of(paper, paths)
    both = {"plant/motor.gear_ratio", "controller/law.gear_ratio"}
    assert effects["plant.pump.gear_ratio"].same == both
    assert effects["plant.cylinder.mass_kg"].same == {"plant/cylinder.mass_kg"}
    assert effects["plant.cylinder.leakage_m3_per_s_pa"].same == {
        "plant/cylinder.leakage_m3_per_s_pa"
    }
    assert not effects["plant.cylinder.mass_kg"].start
    assert effects["plant.cylinder.stiffness_n_per_m"].start
    # The command's limit is the lower one of two.
    limit = effects["plant.pump.speed_limit_rad_s"]
    assert limit.touched == {"plant/motor.speed_limit_rad_s", "controller/law.command_limit_rad_s"}
    assert limit.same == set()
    assert effects["controller.command_limit_rad_s"].same == set()
    # Here the motor's limit is the lower one up to 3000 rad/s.
    higher = changed(paper, {"controller.command_limit_rad_s": 3000.0})
    speed = "plant.pump.speed_limit_rad_s"
    assert effects_of(higher, [speed])[speed].same == set()
    # A link moves the fit of the linkage too, an area follows two diameters, degrees are turned.
    assert "plant/knee.1[0]" in effects["plant.linkage.a_3_m"].touched
    assert effects["plant.linkage.a_3_m"].same == set()
    assert "plant/cylinder.mean_area_m2" in effects["plant.cylinder.bore_m"].touched
    assert effects["plant.cylinder.bore_m"].same == set()
    assert effects["reference.mean_deg"].touched == {"reference.mean_rad"}
    assert effects["reference.mean_deg"].same == set()
    assert effects["polynomial.p_mm_deg[5]"].touched == {
        "controller/coordinates.p_6",
        "controller/rod_reference.p_6",
    }
    assert "simulation.duration_s" not in effects


@pytest.mark.slow
def test_a_believed_plant_has_names_of_its_own():
    fmu = make_fmu(changed(PAPER, {"nominal": PlantParameters()}), "loop")
    members = {p.name: p.members for p in fmu.parameters}
    assert members["plant.pump.gear_ratio"] == ("motor.gear_ratio",)
    assert members["nominal.pump.gear_ratio"] == ("law.gear_ratio",)


def test_descriptions_tell_the_origin():
    told = {p.name: p.description for p in make_fmu(PAPER, "loop").parameters}
    assert told["plant.pump.gear_ratio"].startswith(
        "sets controller/law.gear_ratio, plant/motor.gear_ratio; Section 5: 6:1"
    )
    assert told["cylinder.mean_area_m2"] == (
        "Context parameter plant/cylinder.mean_area_m2, computed from plant.cylinder.bore_m, "
        "plant.cylinder.rod_diameter_m"
    )
    assert told["plant.cylinder.stiffness_n_per_m"].endswith("; the initial state does not follow")
    assert not told["plant.cylinder.stroke_m"].endswith("follow")
    assert told["initial.rod_extension_m"] == "the scenario starts at rest, the knee at 10 deg"


def test_only_an_fmu_with_initial_states_tells_what_they_do_not_follow():
    for what in ("controller", "plant"):
        parameters = make_fmu(PAPER, what).parameters
        told = any("initial state" in p.description for p in parameters)
        assert told == any(p.name.startswith("initial.") for p in parameters) == (what == "plant")


def make_user_controller(scenario):
    """As a user's: what its numbers come from is not known."""
    return make_controller(scenario.model_copy(update={"controller": PidParameters()}))


@pytest.mark.slow
def test_names_of_the_scenario_do_not_stand_for_numbers_of_a_users_system(path, fmu_instance):
    scenario = SHORT.with_law(make_user_controller)
    for what in ("controller", "loop"):
        names = [p.name for p in make_fmu(scenario, what).parameters]
        assert "law.proportional_per_s" in names
        assert not any(name.startswith(("plant.", "controller.")) for name in names)
    assert "plant.pump.gear_ratio" in [p.name for p in make_fmu(scenario, "plant").parameters]
    data = _compiled(scenario)
    loop = fmu_instance(path("loop", 3, scenario)).start()
    angles = _loop_run(loop, _steps(data), "knee_angle_rad")
    assert _relative(angles, data["knee_angle_rad"]) < 1e-9


def test_start_values_of_inputs_are_those_of_the_loop():
    loop = make_closed_loop(PAPER, signals=())
    context = loop.CreateDefaultContext()
    starts = make_fmu(PAPER, "controller").starts
    assert starts["encoder_reading_rad"] == loop.GetOutputPort("encoder_reading").Eval(context)[0]
    assert starts["encoder_reading_rad"] == pytest.approx(1.1213, abs=1e-4)  # 731 counts
    assert [starts[name] for name in REFERENCE] == pytest.approx(
        [math.radians(10.0), 0.0, math.radians(30.0) * (0.2 * math.pi) ** 2, 0.0], abs=1e-12
    )


# ------------------------------------------------------------------------------------- runs


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_plant_and_controller_follow_the_compiled_run(path, fmu_instance, fmi):
    """The controller steps first, so that its command acts in the sample that computes it."""
    data = _compiled(PAPER)
    reference = np.column_stack([data[name] for name in REFERENCE])
    plant, controller = fmu_instance(path("plant", fmi)), fmu_instance(path("controller", fmi))
    plant.start()
    controller.enter()
    controller.set(encoder_reading_rad=plant.get("encoder_reading_rad"))
    controller.fmu.exitInitializationMode()
    names = ("rod_extension_m", "load_pressure_pa", "knee_angle_rad", "encoder_reading_rad")
    rows = [plant.get(*names)]
    counts = [plant.get("encoder_count")]
    for n in _steps(data):
        controller.set(
            zip(REFERENCE, reference[n], strict=True),
            encoder_reading_rad=plant.get("encoder_reading_rad"),
        )
        controller.step(n * TICK_S)
        command = controller.get("motor_speed_command_rad_s")
        plant.set(motor_speed_command_rad_s=command)
        plant.step(n * TICK_S)
        rows.append(plant.get(*names))
        counts.append(plant.get("encoder_count"))
    assert len(rows) == 15_001
    for name, values in zip(names, np.array(rows).T, strict=True):
        assert _relative(values, data[name]) < 1e-9, name
    resolution = 2.0 * np.pi / 4096.0
    assert counts == np.round(data["encoder_reading_rad"] / resolution).tolist()


@pytest.mark.parametrize("fmi", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_loop_follows_the_compiled_run(path, fmu_instance, fmi):
    data = _compiled(SHORT)
    names = list(columns(available_signals(PAPER)))
    rows = _loop_run(fmu_instance(path("loop", fmi)).start(), _steps(data), *names)
    for name, values in zip(names, rows.T, strict=True):
        assert _relative(values, data[name]) < 1e-9, name


@pytest.mark.slow
def test_loaded_loop_of_full_order_follows_the_compiled_run(path, fmu_instance):
    data = _compiled(LOADED)
    loop = fmu_instance(path("loop", 3, LOADED)).start()
    names = list(columns(available_signals(LOADED)))
    assert "cap_makeup_flow_m3_s" in names
    rows = _loop_run(loop, _steps(data), *names)
    for name, values in zip(names, rows.T, strict=True):
        assert _relative(values, data[name]) < 1e-9, name
    loop.fmu.reset()
    loop.start(**{"initial.cap_pressure_pa": 3e5, "initial.rod_side_pressure_pa": 4e5})
    assert loop.get("cap_pressure_pa", "rod_side_pressure_pa") == [3e5, 4e5]


@pytest.mark.slow
def test_loop_with_a_wearer_follows_the_compiled_run_with_the_moment_as_input(path, fmu_instance):
    scenario = Scenario(
        plant={"load": "knee"},
        wearer={
            "kind": "leg",
            "motion": "active",
            "effort": 0.8,
            "moment": {"times_s": (0.0, 0.6), "moments_n_m": (10.0, 10.0)},
        },
        controller={"kind": "torque", "mode": "assist"},
        load_cell={"noise_n": 2.0, "seed": 5},
        simulation=SimulationParameters(duration_s=0.6),
    )
    data = _compiled(scenario)
    loop = fmu_instance(path("loop", 3, scenario))
    loop.set([("biological_moment_n_m", 10.0)])
    loop.start()
    names = list(columns(available_signals(scenario)))
    rows = _loop_run(loop, _steps(data), *names)
    assert np.ptp(data["interaction_torque_n_m"]) > 0.5
    for name, values in zip(names, rows.T, strict=True):
        assert _relative(values, data[name]) < 1e-9, name


@pytest.mark.slow
def test_sampled_reference_is_an_input(path, fmu_instance):
    samples = SampledReference(times_s=(0.0, 0.3, 0.6), angles_deg=(20.0, 30.0, 25.0))
    scenario = Scenario(reference=samples, simulation=SimulationParameters(duration_s=0.6))
    data = _compiled(scenario)
    loop = fmu_instance(path("loop", 3, scenario))
    reference = np.column_stack([data[name] for name in REFERENCE])
    assert loop.get(*REFERENCE) == pytest.approx(reference[0], rel=1e-12)
    loop.start()
    angles = [loop.get("knee_angle_rad")]
    for n in _steps(data):
        loop.set(zip(REFERENCE, reference[n], strict=True))
        loop.step(n * TICK_S)
        angles.append(loop.get("knee_angle_rad"))
    assert _relative(angles, data["knee_angle_rad"]) < 1e-9


@pytest.mark.parametrize("fmi", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_outputs_at_the_start_are_those_of_drake(path, fmu_instance, fmi):
    loop = fmu_instance(path("loop", fmi)).start()
    diagram = make_closed_loop(PAPER, signals=())
    simulator = Simulator(diagram)
    simulator.Initialize()
    for signal in available_signals(PAPER):
        expected = diagram.GetOutputPort(signal).Eval(simulator.get_context())
        got = [loop.get(name) for name in SIGNALS[signal]]
        assert got == pytest.approx(expected.tolist(), rel=1e-12, abs=1e-12), signal


@pytest.mark.slow
def test_each_scenario_parameter_acts_as_in_the_scenario(path, fmu_instance):
    """The start is that of the exported scenario, so those that move it are left out."""
    fmu = make_fmu(SHORT, "loop")
    loop = fmu_instance(path("loop", 3, SHORT))
    base = _compiled(SHORT)["rod_extension_m"]
    moved = 0
    for parameter in fmu.parameters:
        value = value_at(SHORT, parameter.name)
        if value is None or parameter.description.endswith("does not follow"):
            continue
        other = value * 1.1 if value else min(0.01, 0.01 * parameter.high)
        expected = _compiled(changed(SHORT, {parameter.name: other}))["rod_extension_m"]
        loop.fmu.reset()
        loop.start(**{parameter.name: other})
        values = _loop_run(loop, range(len(expected) - 1), "rod_extension_m")
        assert _relative(values, expected) < 1e-9, parameter.name
        moved += np.abs(expected - base).max() > 1e-9
    assert moved == 12  # the others are uncertainties and limits that nothing reaches here


def test_a_parameter_changed_in_a_run_acts_from_there_on(path, fmu_instance):
    states = {
        "initial.motor_speed_rad_s": "motor_speed_rad_s",
        "initial.rod_extension_m": "rod_extension_m",
        "initial.rod_velocity_m_s": "rod_velocity_m_s",
        "initial.load_pressure_pa": "load_pressure_pa",
    }
    tuned = {"plant.cylinder.mass_kg": 3.2, "plant.pump.lag_s": 0.03}
    plant = fmu_instance(path("plant", 3)).start()
    untouched = fmu_instance(path("plant", 3)).start()
    for instance in (plant, untouched):
        instance.set(motor_speed_command_rad_s=200.0, disturbance_force_n=40.0)
        instance.step(0.0, 10 * TICK_S)
    later = fmu_instance(path("plant", 3))
    later.enter(**{initial: plant.get(name) for initial, name in states.items()}, **tuned)
    later.set(motor_speed_command_rad_s=-100.0, disturbance_force_n=0.0)
    later.fmu.exitInitializationMode()
    plant.set(tuned)
    for n in range(50):
        for instance, start in ((plant, 10), (untouched, 10), (later, 0)):
            instance.set(motor_speed_command_rad_s=-100.0, disturbance_force_n=0.0)
            instance.step((start + n) * TICK_S)
        expected = later.get(*states.values())
        assert plant.get(*states.values()) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert untouched.get("load_pressure_pa") != pytest.approx(expected[3], rel=1e-3)


@pytest.mark.parametrize("fmi", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_saved_loops_continue_to_the_bit(path, fmu_instance, fmi):
    names = list(columns(available_signals(PAPER)))
    loop = fmu_instance(path("loop", fmi)).start()
    loop.step(0.0, 50 * TICK_S)
    data = loop.serialize()
    steps = range(50, 100)
    expected = _loop_run(loop, steps, *names)
    loop.deserialize(data)
    assert np.array_equal(_loop_run(loop, steps, *names), expected)
    other = fmu_instance(path("loop", fmi), name="other")
    other.deserialize(data)
    assert np.array_equal(_loop_run(other, steps, *names), expected)


@NEEDS_COMPILER
@pytest.mark.slow
def test_a_stiff_loop_has_the_bits_of_its_c_and_continues_with_them(
    tmp_path, fmu_instance, exported
):
    """By one compiler with one rounding of each operation, whole and from a saved state."""
    leg = Scenario.model_validate(with_preset("leg", {}))
    fmu = exports.make_fmu(leg, "loop", integrator="rosenbrock")
    names = [field.name for field in fmu.source.plan.outputs]
    rows = np.zeros((100, len(fmu.source.plan.inputs)))
    expected = exported.Replay(fmu.source, flags=c_build.FLAGS).from_start(rows)
    file = write_fmu(tmp_path / "loop.fmu", fmu).path
    loop = fmu_instance(file).start()
    assert np.array_equal(_loop_run(loop, range(50), *names), expected[:51])
    data = loop.serialize()
    assert np.array_equal(_loop_run(loop, range(50, 100), *names), expected[50:])
    other = fmu_instance(file, name="other")
    other.deserialize(data)
    assert np.array_equal(_loop_run(other, range(50, 100), *names), expected[50:])


def test_initial_states_are_parameters(path, fmu_instance):
    plant = fmu_instance(path("plant", 3)).start(
        **{"initial.rod_extension_m": 0.1, "initial.load_pressure_pa": 2.5e5}
    )
    assert plant.get("rod_extension_m", "load_pressure_pa") == [0.1, 2.5e5]
    assert plant.get("rod_force_n") == pytest.approx(2.5e5 * 2.748893571891069e-4, rel=1e-12)


@pytest.mark.slow
def test_initial_states_of_a_plant_of_full_order_are_those_of_the_closed_loop():
    loop = make_closed_loop(LOADED, signals=())
    context = loop.CreateDefaultContext()
    ports = ("motor_speed", "rod_extension", "rod_velocity", "chamber_pressures")
    expected = [value for port in ports for value in loop.GetOutputPort(port).Eval(context)]
    names = [name for port in ports for name in SIGNALS[port]]
    fmu = make_fmu(LOADED, "plant")
    initial = [p for p in fmu.parameters if p.name.startswith("initial.")]
    assert [p.name for p in initial] == [f"initial.{name}" for name in names]
    assert [p.start for p in initial] == pytest.approx(expected, rel=1e-12)
    assert expected[3] != expected[4]
    states = ["plant/motor.x[0]", *(f"plant/cylinder.x[{i}]" for i in range(4))]
    assert list(fmu.source.equations.states) == states
    assert [p.members for p in initial] == [(f"initial_x[{i}]",) for i in range(5)]
    assert [p.divisor for p in initial] == [1e3, 1.0, 1.0, 1e6, 1e6]  # rad/s, m, m/s, Pa


def test_beyond_its_stops_the_knee_fails_with_a_reason(path, fmu_instance):
    plant = fmu_instance(path("plant", 3)).start()
    plant.set(motor_speed_command_rad_s=500.0)  # extends the knee, which is at 10 deg
    with pytest.raises(Exception, match="failed with status 3"):
        plant.step(0.0, 1000 * TICK_S)
    (message,) = plant.messages
    assert "status = 4: the state is outside the limits of plant/cylinder, plant/knee" in message
    time = float(re.match(r"t = (\S+) s: the step failed", message)[1])
    assert 0.1 < time < 1.9
    assert plant.get("time") == 0.0  # the whole step is undone
    plant.step(0.0, 10 * TICK_S)


@pytest.mark.parametrize("fmi", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_fmpy_simulates_the_loop_by_itself(path, fmi):
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    data = _compiled(SHORT)
    result = fmpy.simulate_fmu(
        path("loop", fmi),
        stop_time=1.0,
        output_interval=TICK_S,
        output=["rod_extension_m"],
        start_values={"controller.lambda_per_s": 20.0},
    )
    assert result["time"][-1] == pytest.approx(1.0)
    assert _relative(result["rod_extension_m"], data["rod_extension_m"]) < 1e-9


@pytest.mark.slow
def test_libcosim_couples_plant_and_controller(path, tmp_path):
    """A master of others: all step at once, so that the command arrives a sample later."""
    pytest.importorskip("libcosimpy", reason="needs libcosim: pip install '.[fmu]'")
    try:
        ctypes.CDLL("libatomic.so.1")
    except OSError:
        pytest.skip("libcosim needs libatomic: apt-get install libatomic1")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    data = _compiled(changed(SHORT, {"bus.latency_samples": 1}))
    reference = np.column_stack([data[name] for name in REFERENCE])
    references = {}
    for what in ("plant", "controller"):
        fmu = make_fmu(PAPER, what, 2)
        references[what] = {v.name: i for i, v in enumerate(fmu.table.variables)}
    execution = CosimExecution.from_step_size(int(TICK_S * 1e9))
    slaves = {
        what: execution.add_local_slave(CosimLocalSlave(path(what, 2), what))
        for what in ("plant", "controller")
    }
    for source, target, name in (
        ("plant", "controller", "encoder_reading_rad"),
        ("controller", "plant", "motor_speed_command_rad_s"),
    ):
        execution.connect_real_variables(
            slaves[source], references[source][name], slaves[target], references[target][name]
        )
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(manipulator)
    inputs = [references["controller"][name] for name in REFERENCE]
    output = [references["plant"]["rod_extension_m"]]
    values = [data["rod_extension_m"][0]]
    for n in _steps(data):
        assert manipulator.slave_real_values(slaves["controller"], inputs, reference[n].tolist())
        assert execution.step()
        values.append(observer.last_real_values(slaves["plant"], output)[0])
    assert len(values) == 501
    assert _relative(values, data["rod_extension_m"]) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{"step_s": 5e-4}, {"integrator": "rosenbrock", "tolerance": 1e-5}],
    ids=["step_s", "integrator"],
)
def test_options_of_the_command_line_are_those_of_the_sources(options, tmp_path, no_compiler):
    file = tmp_path / "plant.fmu"
    chosen = [f"--{name.replace('_', '-')}={value}" for name, value in options.items()]
    assert main(["export", "fmu", "--what", "plant", *chosen, "--out", str(file)]) == 0
    with zipfile.ZipFile(file) as archive:
        code = archive.read("sources/knee_plant.c").decode()
        texts = archive.read("sources/knee_plant_fmu.c").decode()
    source = exports.make_fmu(PAPER, "plant", **options).source
    assert code == source.files()["knee_plant.c"]
    assert code != make_fmu(PAPER, "plant").source.files()["knee_plant.c"]
    assert ("1000 substeps do not meet the tolerance" in texts) == ("integrator" in options)


@pytest.mark.slow(gate=0)
@NEEDS_COMPILER
def test_the_example_of_the_docs_prints_what_they_say(tmp_path):
    pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    text = (ROOT / "docs/fmu.md").read_text(encoding="utf-8")
    code, of_a_diagram = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    commands = re.findall(r"^kneexo (export fmu .*)$", text, re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        arguments = [sys.executable, "-m", "kneexo", *command.split()]
        subprocess.run(arguments, cwd=tmp_path, check=True, capture_output=True)
    printed = [
        subprocess.run(
            [sys.executable, "-c", text], cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout
        for text in (code, of_a_diagram)
    ]
    (difference,) = re.findall(r"largest difference .* (\S+) of the largest", printed[0])
    told = re.search(r"It printed `(\S+)`", text)[1]
    assert float(difference) < 10.0 * float(told) < 1e-12
    assert re.search(r"`(.* rad after 2 s)`", text)[1] in printed[1]


@NEEDS_COMPILER
@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_others_build_the_sources(tmp_path, monkeypatch, fmi):
    """FMPy makes the binary of a source FMU by CMake, with what the descriptions list."""
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    cmake = pytest.importorskip("cmake", reason="needs CMake: pip install '.[fmu]'")
    from fmpy.build import build_platform_binary

    with monkeypatch.context() as context:
        context.setattr(c_build, "COMPILERS", ())
        file = export_fmu(PAPER, tmp_path, "loop", fmi=fmi)
    assert file.platforms == ()
    monkeypatch.setenv("PATH", f"{cmake.CMAKE_BIN_DIR}{os.pathsep}{os.environ['PATH']}")
    folder = fmpy.extract(file.path)
    build_platform_binary(folder)
    result = fmpy.simulate_fmu(
        folder, stop_time=1.0, output_interval=TICK_S, output=["rod_extension_m"]
    )
    expected = _compiled(SHORT)["rod_extension_m"]
    assert _relative(result["rod_extension_m"], expected) < 1e-9


# ------------------------------------------------------------------------------------ files


def test_equal_scenarios_give_equal_files(tmp_path, path):
    first = Path(path("controller", 3)).read_bytes()
    second = export_fmu(Scenario(), tmp_path / "b", "controller")
    assert second.path == str(tmp_path / "b" / "knee_controller.fmu")
    assert Path(second.path).read_bytes() == first
    with zipfile.ZipFile(second.path) as archive:
        tool = rb'generationTool="kneexo \d+\.\d+\.\d+, diagramc \d+\.\d+\.\d+"'
        assert re.search(tool, archive.read("modelDescription.xml"))
    assert [file.name for file in sorted(tmp_path.iterdir())] == ["b"]


def test_a_file_of_another_kind_stays(tmp_path, no_compiler, capsys):
    file = tmp_path / "my.yaml"
    file.write_text("{}")
    assert main(["export", "fmu", "--out", str(file)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"kneexo: file {file}/knee_controller.fmu: cannot write there (")
    assert file.read_text() == "{}"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"what": "knee"}, "what = 'knee': must be one of controller, plant, loop"),
        ({"fmi": 1}, "fmi = 1: must be one of 2, 3"),
        ({"fmi": "3"}, "fmi = '3': must be one of 2, 3"),
    ],
)
def test_wrong_options_are_refused(options, message, tmp_path):
    with pytest.raises(ParameterError, match=message):
        export_fmu(PAPER, tmp_path / "knee.fmu", **options)
    assert list(tmp_path.iterdir()) == []


# -------------------------------------------------------------------------------- commands


@pytest.mark.slow
def test_command_tells_what_it_wrote(tmp_path, capsys):
    out = tmp_path / "knee.fmu"
    arguments = ["export", "fmu", "--what", "plant", "--fmi", "2", "--out", str(out)]
    assert main([*arguments, "--set", "plant.cylinder.mass_kg=1.7"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"plant as FMU by FMI 2: {out}"
    assert lines[1] == "  inputs: motor_speed_command_rad_s, disturbance_force_n"
    assert lines[2].startswith("  outputs: encoder_reading_rad, encoder_count, knee_angle_rad")
    assert "  parameters: 111, of which 13 have names of the scenario" in lines
    assert "  communication step: 0.002 s or a whole multiple" in lines
    assert lines[-1].startswith("  binaries: ")
    with zipfile.ZipFile(out) as archive:
        text = archive.read("modelDescription.xml").decode()
    assert 'fmiVersion="2.0"' in text
    assert re.search(r'name="plant.cylinder.mass_kg".*\n\s*<Real .*start="1.7"', text)


def test_command_without_a_compiler(tmp_path, capsys, no_compiler):
    assert main(["export", "fmu", "--out", str(tmp_path)]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("  binaries: none; a binary needs 64-bit Linux and a C compiler")
    assert main(["export", "fmu", "--out", str(tmp_path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["platforms"] == []
    assert document["path"] == str(tmp_path / "knee_controller.fmu")
    assert document["sample_time_s"] == TICK_S
    assert len(document["parameters"]) == 40
    assert "plant.pump.gear_ratio" in document["scenario_parameters"]
    assert set(document["scenario_parameters"]) < set(document["parameters"])


@pytest.mark.slow
def test_a_gain_of_the_users_law_is_a_parameter(tmp_path: Path) -> None:
    scenario = Scenario().with_law(lambda rod_extension, k=2.0: k * rod_extension)
    file = export_fmu(scenario, tmp_path / "law.fmu", "controller")
    with zipfile.ZipFile(file.path) as archive:
        text = archive.read("modelDescription.xml").decode()
    (variable,) = re.findall(r'<Float64 name="law.k"[^>]*>', text)
    assert 'causality="parameter" variability="tunable"' in variable
    assert 'start="2.0"' in variable
