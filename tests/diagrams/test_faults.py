"""Loops with faults: consequences derived by hand, both engines, batches, and refusals."""

import importlib
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from kneexo.analysis import estimate_sine, sinestream, track
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.diagrams import make_closed_loop
from kneexo.diagrams.faults import fault_structure
from kneexo.errors import ParameterError
from kneexo.export.firmware import export_firmware
from kneexo.export.fmu import export_fmu
from kneexo.export.target import make_target
from kneexo.parameters import KneeLoadParameters, Scenario
from kneexo.parameters.scenario_file import dump_scenario, load_scenario
from kneexo.simulation import simulate
from kneexo.simulation.compiled import scenario_values, simulate_together

T = 0.002
STILL = {"kind": "step", "start_deg": 40.0, "end_deg": 40.0}
SHORT = {"duration_s": 0.2}
BASE = Scenario(simulation=SHORT)
LAG = "plant.pump.lag_s"
LEAKAGE = "plant.pump.internal_leakage_m3_per_s_pa"


def with_faults(*faults, base=BASE):
    return base.changed({"faults": faults})


def difference(scenario, name):
    """A signal of the run minus that of the run without faults."""
    healthy = scenario.changed({"faults": ()})
    return simulate(scenario)[name] - simulate(healthy)[name]


# ------------------------------------------------------------------------- consequences


@pytest.mark.slow
def test_a_frozen_encoder_under_p_control_lets_the_rod_drift_at_a_known_speed():
    """The error does not change, so the pump turns at a constant speed, and v = D_m ω/(i A)."""
    base = Scenario(
        controller={"kind": "pid", "proportional_per_s": 5.0, "velocity_feedforward": 0.0},
        reference={"kind": "step", "start_deg": 40.0, "end_deg": 44.0, "time_s": 0.1},
        encoder={"quantized": False},
        plant={"pump": {"internal_leakage_m3_per_s_pa": 0.0}},
        simulation={"duration_s": 0.6},
    )
    run = simulate(with_faults({"kind": "frozen", "start_s": 0.05}, base=base))
    pump, cylinder = base.plant.pump, base.plant.cylinder
    speed = run["motor_speed_command_rad_s"][-1]
    flow = pump.displacement_m3_per_rad * speed / pump.gear_ratio
    # 0.4 s are forty time constants of the motor. The oil still oscillates a little.
    travelled = run["rod_extension_m"][-1] - run["rod_extension_m"][-51]
    assert abs(speed) > 10.0
    assert travelled == pytest.approx(flow / cylinder.mean_area_m2 * 50 * T, rel=1e-3)


def test_a_dead_command_lets_the_motor_run_down():
    fault = {"place": "command", "kind": "scale", "size": 0.0, "start_s": 0.1}
    run = simulate(with_faults(fault))
    speed, since = run["motor_speed_rad_s"], int(0.1 / T)
    lag = BASE.plant.pump.lag_s
    expected = speed[since] * np.exp(-T / lag * np.arange(speed.size - since))
    # The limit of the acceleration is not reached.
    np.testing.assert_allclose(speed[since:], expected, rtol=1e-6, atol=1e-9 * abs(speed[since]))


@pytest.mark.slow
def test_a_lost_frame_holds_the_last_command():
    fault = {"place": "command", "kind": "frozen", "start_s": 0.1, "duration_s": 3 * T}
    commands = simulate(with_faults(fault))["motor_speed_command_rad_s"]
    # The record at t is the command until t. The frames at 0.1, 0.102 and 0.104 s are lost.
    held = commands[51:54]
    assert np.all(held == commands[50])
    assert commands[54] != commands[50]
    assert commands[49] != commands[50]


@pytest.mark.slow
@pytest.mark.parametrize(("size", "kind"), [(1.5, "offset"), (-2.0, "offset"), (10.0, "drift")])
def test_the_knee_takes_over_an_error_of_the_encoder(size, kind):
    """The controller holds the wrong reading at the reference, so the knee is off by the error."""
    base = BASE.changed({"reference": STILL, "encoder.quantized": False})
    base = base.changed({"simulation.duration_s": 1.0})
    fault = {"kind": kind, "size": size, "start_s": 0.02}
    moved = difference(with_faults(fault, base=base), "encoder_reading_rad")
    assert moved[10] == pytest.approx(math.radians(size) if kind == "offset" else 0.0, rel=1e-9)
    assert abs(moved[-1]) < 0.3 * math.radians(abs(size))  # the loop removes it from the reading
    angle = difference(with_faults(fault, base=base), "knee_angle_rad")[-1]
    assert np.sign(angle) == -np.sign(size) * np.sign(_encoder_slope(base))


def _encoder_slope(base):
    """dθ_4/dθ_p of the linkage in the reference's posture."""
    from kneexo.geometry.linkage import pose

    angles = [float(pose(base.plant.linkage, math.radians(a)).theta_4) for a in (40.0, 40.1)]
    return angles[1] - angles[0]


PLANTS = [
    (LAG, 0.02, {}),
    (LEAKAGE, 1e-11, {}),
    ("plant.cylinder.bulk_modulus_pa", 4e8, {}),
    ("plant.full_order.entrained_air", 0.05, {"plant.full_order": True}),
    ("plant.full_order.relief_conductance_m3_per_s_pa", 0.0, {"plant.full_order": True}),
    ("plant.bypass.minimum_opening", 0.1, {"plant.full_order": True, "plant.bypass": True}),
    (
        "plant.bypass.conductance_m3_per_s_pa",
        0.0,
        {"plant.full_order": True, "plant.bypass": {"minimum_opening": 0.1}},
    ),
    ("plant.motor.current_limit_a", 0.6, {"plant.motor": True}),
    ("plant.motor.supply_voltage_v", 2.0, {"plant.motor": True}),
    ("plant.motor.coulomb_torque_n_m", 1.0, {"plant.motor": True}),
    ("plant.load.knee_torque_n_m", 12.0, {"plant.load": "knee"}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("path", "value", "values"), PLANTS)
def test_a_number_that_changes_at_the_start_is_a_plant_with_this_number(path, value, values):
    """The controller believes in the plant without the fault."""
    base = BASE.changed(values)
    base = base.changed({"nominal": base.plant})
    fault = {"place": path, "kind": "value", "size": value, "start_s": 0.0}
    faulty = simulate(with_faults(fault, base=base))
    other = base.changed({path: value})
    if path.startswith("plant.load"):  # whose pressure holds the load at the start
        healthy = simulate(base)["knee_angle_rad"]
        moved = np.max(np.abs(faulty["knee_angle_rad"] - healthy))
        assert moved > 1e-6
        return
    np.testing.assert_allclose(
        faulty["rod_extension_m"], simulate(other)["rod_extension_m"], rtol=0.0, atol=1e-9
    )


def test_a_reading_is_wrong_at_the_first_sample_of_the_fault_and_a_command_after_it():
    at = {"start_s": 0.1, "duration_s": T}
    values = scenario_values(
        with_faults(
            {"kind": "offset", "size": 2.0} | at,
            {"place": "command", "kind": "offset", "size": 3.0} | at,
        )
    )
    assert [values[f"fault_{n}.lead_s"] for n in (0, 1)] == [T, 0.0]
    sizes = [math.radians(2.0), 3.0 * 2.0 * math.pi / 60.0]
    assert [values[f"fault_{n}.size"] for n in (0, 1)] == pytest.approx(sizes, rel=1e-12)


def test_a_change_of_a_number_ends():
    fault = {"place": LAG, "kind": "value", "size": 0.05, "start_s": 0.05, "duration_s": 0.05}
    active = simulate(with_faults(fault))["active_faults"]
    np.testing.assert_array_equal(np.flatnonzero(active), np.arange(26, 51))


@pytest.mark.slow
def test_a_fault_begins_at_its_time_to_failure_or_after_the_run():
    dead = {"place": "command", "kind": "scale", "size": 0.0, "start_s": 0.0, "seed": 1}
    scenario = with_faults(dead | {"mttf_s": 0.05})
    begin_s = scenario.faults[0].begin_s
    active = simulate(scenario)["active_faults"]
    assert 0.0 < begin_s < BASE.duration_s
    assert np.flatnonzero(active)[0] == math.ceil(begin_s / 0.002) + 1
    result = track(with_faults(dead | {"mttf_s": 1e4}))
    assert not result.run["active_faults"].any()
    (line,) = [notice for notice in result.verdict.notices if "fault" in notice]
    assert re.fullmatch(r"a fault begins after the run by its mttf_s: at \d+ s", line)
    drop = {"start_s": 0.05, "duration_s": 0.05}
    result = track(with_faults(drop, dead | {"mttf_s": 1e4}))
    lines = [notice for notice in result.verdict.notices if "fault" in notice]
    assert [part for line in lines for part in line.split(":")[:1]] == [
        "a fault begins after the run by its mttf_s", "2 faults"
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signal", "sign"), [("knee_angle_rad", "above"), ("motor_speed_rad_s", "below")]
)
def test_triggers_of_two_signals_of_one_column_have_a_model_each(signal, sign):
    """In one process the second model must not be the first one."""
    threshold = {"knee_angle_rad": math.radians(10.1), "motor_speed_rad_s": -20.0}[signal]
    fault = {"place": "command", "kind": "scale", "size": 0.9, "start_s": 0.0}
    scenario = with_faults(fault | {"signal": signal, sign: threshold})
    column = simulate(BASE)[signal]
    beyond = column > threshold if sign == "above" else column < threshold
    first = int(np.flatnonzero(beyond)[0])
    for engine in ("compiled", "drake"):
        active = simulate(scenario.with_engine(engine))["active_faults"]
        assert np.flatnonzero(active)[0] == first + 1


def test_the_signal_of_a_trigger_belongs_to_the_structure():
    fault = {"kind": "frozen", "start_s": 0.0, "above": 1.0}
    names = ("knee_angle_rad", "motor_speed_rad_s", "rod_force_n")
    structures = {fault_structure(with_faults(fault | {"signal": name})) for name in names}
    assert len(structures) == 3


@pytest.mark.slow
def test_several_faults_add_up_and_two_of_one_system_share_its_port():
    faults = [
        {"place": LAG, "kind": "value", "size": 0.02, "start_s": 0.05},
        {"place": LEAKAGE, "kind": "value", "size": 1e-11, "start_s": 0.1},
        {"kind": "noise", "size": 0.1, "start_s": 0.15},
    ]
    scenario = with_faults(*faults)
    assert fault_structure(scenario)[3:] == (("plant/motor", ("lag_s", "leakage_m3_per_s_pa")),)
    active = simulate(scenario)["active_faults"]
    assert [active[n] for n in (20, 40, 60, 90)] == [0.0, 1.0, 2.0, 3.0]


def test_without_faults_the_loop_has_no_system_of_a_fault():
    names = [system.get_name() for system in make_closed_loop().GetSystems()]
    assert not [name for name in names if "fault" in name]
    assert not [name for name in scenario_values(BASE) if "fault" in name]


# ----------------------------------------------------------------------------- both engines


SIGNAL_KINDS = {"frozen": 0.0, "offset": 1.0, "drift": 5.0, "scale": 0.8, "noise": 0.2}
SIGNAL_KINDS |= {"dropped": 0.4, "late": 1.0, "bit_flip": 2.0, "value": 9.0}
LOADED = Scenario(
    plant={"load": KneeLoadParameters()},
    encoder={"quantized": False},
    simulation={"duration_s": 0.1},
)


@st.composite
def fault_lists(draw):
    """One to three faults of the loop, without triggers."""
    faults = []
    places = st.sampled_from(("encoder", "command", LAG, LEAKAGE))
    for place in draw(st.lists(places, min_size=1, max_size=3, unique=True)):
        kinds = {kind: size for kind, size in SIGNAL_KINDS.items() if kind != "bit_flip"}
        kind = draw(st.sampled_from(sorted(kinds))) if place in ("encoder", "command") else "value"
        size = {LAG: 0.03, LEAKAGE: 2e-11}.get(place) or kinds[kind]
        start = T * draw(st.integers(1, 40))
        faults.append({"place": place, "kind": kind, "size": size, "start_s": start})
        faults[-1]["duration_s"] = T * draw(st.integers(1, 30))
    return faults


@pytest.mark.slow(gate=0)
@settings(max_examples=8)
@given(fault_lists())
def test_drake_and_the_compiled_engine_have_the_same_faults(faults):
    scenario = with_faults(*faults, base=LOADED)
    compiled = simulate(scenario)
    drake = simulate(scenario.with_engine("drake").with_steps(2e-4))
    np.testing.assert_array_equal(compiled["active_faults"], drake["active_faults"])
    # Without faults the engines differ by 1e-8 rad. Jumps excite a fast mode of the oil.
    np.testing.assert_allclose(
        compiled["knee_angle_rad"], drake["knee_angle_rad"], rtol=0.0, atol=1e-5
    )


@pytest.mark.slow
def test_a_fault_has_the_same_bits_in_a_batch():
    scenarios = [
        with_faults({"kind": "offset", "size": size, "start_s": start})
        for size, start in ((1.0, 0.05), (-2.0, 0.1), (0.5, 0.02))
    ]
    for scenario, run in zip(scenarios, simulate_together(scenarios), strict=True):
        np.testing.assert_array_equal(run["knee_angle_rad"], simulate(scenario)["knee_angle_rad"])


# --------------------------------------------------------------------------------- refusals


PHI = BASE.plant.linkage.phi_rad
REFUSED = [
    ({"start_s": 0.199}, r"faults\.0: start_s = 0.199 s: must be <= 0.198 s, the last sample"),
    ({"duration_s": 1e-3}, r"faults\.0: duration_s = 0.001 s: must be >= 0.002 s, because a fault"),
    ({"size": 5.0}, "size = 5 of kind = frozen: must be left out"),
    ({"place": "load_cell"}, r"faults\.0: place = load_cell: needs wearer.kind = leg or"),
    ({"place": "plant.pump.lag"}, r"faults\.0: plant.pump.lag: unknown name; did you mean"),
    ({"place": "encoder.phase_rad"}, "is unknown; must be encoder, load_cell, command, emer"),
    ({"place": "plant.ideal_motor"}, "is no number that can change during a run"),
    ({"place": LAG, "size": 50.0}, r"faults\.0: .*lag_s = 50 s is out of range"),
    ({"place": LAG, "size": 0.01}, "has no effect with size = 0.01; the value is 0.01 without"),
    (
        {"place": "plant.linkage.phi_rad", "size": PHI + 1e-3},
        "is of the linkage, which cannot change during a run",
    ),
    ({"kind": "bit_flip", "size": 12.0}, "size = 12 of kind = bit_flip: needs encoder.quantized"),
    ({"kind": "scale", "size": 1e3}, "size = 1000 of kind = scale: must be -100 … 100"),
    ({"kind": "scale", "size": 1.0}, "size = 1 of kind = scale: has no effect; give another size"),
    ({"kind": "dropped", "size": 0.0}, "size = 0 of kind = dropped: must be 1e-06 … 1"),
    ({"kind": "frozn"}, r"faults\.0\.kind = 'frozn': must be 'frozen', 'offset', "),
    ({"kind": "late", "size": 0.0}, "size = 0 of kind = late: must be 1 … 10"),
    (
        {"kind": "late", "size": 9.0, "start_s": 0.01},
        "start_s = 0.01 s: must be >= 0.018 s, because",
    ),
    ({"kind": "bit_flip", "size": 1.5}, "must be a whole number, 0 … 15"),
    ({"kind": "offset", "size": 0.0}, "size = 0 deg of kind = offset: has no effect; give"),
    ({"signal": "knee_angle_rad"}, "signal: must have above or below"),
    ({"above": 1.0}, "signal: must have above or below, and a threshold must have a signal"),
    ({"signal": "knee_angle", "above": 1.0}, "signal 'knee_angle' cannot start a fault; did you"),
    (
        {"signal": "active_faults", "above": 0.0},
        "cannot start a fault; take another of signals.csv",
    ),
    ({"place": "command", "kind": "bit_flip", "size": 1.0}, "must be at the encoder"),
    ({"place": "plant.pump.lag_s.", "kind": "frozen"}, "unknown name"),
    ({"place": "encodr"}, r"place = encodr: must be encoder, .*a number; did you mean encoder\?"),
    ({"kind": "noise", "size": -1.0}, "size = -1 deg of kind = noise: must be 0 … 10000 deg"),
    ({"kind": "drift", "size": 1e5}, r"size = 100000 deg/s of kind = drift: must be -10000 … 1000"),
    ({"size": math.nan}, r"faults\.0\.size = nan is out of range: must be finite and >= -1e\+12"),
    ({"place": "load_cell.offset_n", "size": 5.0}, "load_cell.offset_n: needs wearer.kind = leg"),
    ({"place": "reset", "kind": "frozen"}, "kind = frozen at place = reset: must be value, exc"),
    ({"place": "reset", "kind": "value", "size": 2.0}, "size = 2 at place = reset: must be 1"),
    ({"place": "reset", "kind": "value", "size": 1.0}, "place = reset: needs protection; add"),
]


@pytest.mark.parametrize(("values", "message"), REFUSED)
def test_a_wrong_fault_is_one_line(values, message):
    fault = {"place": "encoder", "kind": "frozen", "start_s": 0.1} | values
    if "." in fault["place"]:
        fault["kind"] = "value"
    with pytest.raises(ParameterError, match=message) as error:
        fault_structure(with_faults(fault))
    assert "\n" not in str(error.value)


def test_two_faults_that_exclude_each_other_are_refused():
    fault = {"kind": "frozen", "start_s": 0.05, "duration_s": 0.05}
    with_faults(fault, fault | {"start_s": 0.1})
    with pytest.raises(
        ParameterError, match=r"faults\.1: is at the same place and time as faults\.0"
    ):
        with_faults(fault, fault | {"start_s": 0.09})
    later = fault | {"mttf_s": 1e6}  # begins after the run
    with_faults(fault, later)


def test_a_number_of_a_list_has_no_path():
    with pytest.raises(ParameterError, match=r"faults\.0\.size: unknown name; give the whole list"):
        BASE.changed({"faults.0.size": 1.0})


@pytest.mark.slow
def test_single_precision_switches_faults_at_the_same_samples(tmp_path):
    fault = {"place": "command", "kind": "offset", "size": 50.0, "start_s": 0.5, "duration_s": 0.5}
    scenario = with_faults(fault, base=BASE.changed({"simulation.duration_s": 2.0}))
    measured = export_firmware(scenario, tmp_path / "c", "loop", precision="float")
    assert measured.replay.difference["active_faults"] == 0.0
    assert measured.replay.largest["active_faults"] == 1.0


def test_the_plant_alone_has_no_faults():
    scenario = with_faults({"kind": "frozen", "start_s": 0.1})
    with pytest.raises(ParameterError, match="faults: the plant alone contains no faults"):
        make_target(scenario, "plant")
    assert "active_faults" in make_target(scenario, "loop").outputs


def test_the_verdict_says_when_faults_were_active():
    fault = {"place": LAG, "kind": "value", "size": 0.05, "start_s": 0.05, "duration_s": 0.05}
    (line,) = [n for n in track(with_faults(fault)).verdict.notices if "faults" in n]
    assert line.startswith("1 fault: at most 1 at once, the first from 0.052 s, the last until 0.1")
    never = fault | {"signal": "knee_angle_rad", "above": 3.0}
    (line,) = [n for n in track(with_faults(never)).verdict.notices if "fault" in n]
    assert line.startswith("no fault was active, because no signal passed its threshold")


@pytest.mark.parametrize(
    ("signal", "needed"),
    [
        ("wearer_angle_rad", "wearer.kind = leg"),
        ("cap_pressure_pa", "plant.full_order = true"),
        ("desired_torque_n_m", "controller.kind = torque"),
    ],
)
@pytest.mark.parametrize("engine", ["compiled", "drake"])
def test_a_trigger_by_a_signal_that_the_loop_lacks_is_refused(signal, needed, engine):
    scenario = with_faults({"start_s": 0.1, "signal": signal, "above": 0.0}).with_engine(engine)
    with pytest.raises(
        ParameterError, match=rf"faults\.0: signal '{signal}' is not in .* needs {needed}$"
    ):
        simulate(scenario)


@pytest.mark.parametrize("name", ["size", "wearer"])
def test_studies_of_hardware_and_wearer_leave_push_and_faults_out(name, monkeypatch):
    module = importlib.import_module(f"kneexo.studies.{name}.{name}")

    class SeenError(Exception):
        """The scenario that the study passes on."""

    def seen(scenario, *_):
        raise SeenError(scenario)

    monkeypatch.setattr(module, {"size": "_sizing", "wearer": "designs"}[name], seen)
    preset = {"size": "bench", "wearer": "wearer"}[name]
    scenario = Scenario.preset(preset).changed({"faults": [{"start_s": 1.0}]})
    with pytest.raises(SeenError) as caught:
        getattr(module, f"{name}_study")(scenario)
    assert caught.value.args == (scenario.undisturbed(),)
    assert caught.value.args[0].faults == ()


@pytest.mark.slow
def test_frequency_responses_leave_push_and_faults_out():
    """The frozen encoder would stop the knee, and the push move it."""
    sine = {"kind": "sine", "frequency_hz": 2.0, "amplitude_deg": 1.0}
    base = Scenario(reference=sine, plant={"load": "knee"}, simulation={"duration_s": 1.0})
    push = {"torque_n_m": 60.0, "start_s": 0.5, "duration_s": 0.1}
    disturbed = base.changed({"push": push, "faults": [{"start_s": 0.4}]})
    assert estimate_sine(disturbed) == estimate_sine(base)
    settings = SinestreamSettings(frequencies_hz=(2.0, 3.0, 4.0))
    measured = [sinestream(s, settings, trials=[{}]).response for s in (disturbed, base)]
    np.testing.assert_array_equal(*measured)


def test_faults_of_a_file_are_those_of_python(tmp_path):
    faults = [{"place": "command", "kind": "scale", "size": 0.5, "start_s": 0.1}]
    scenario = with_faults(*faults)
    path = tmp_path / "my knee.yaml"
    path.write_text(dump_scenario(scenario))
    assert load_scenario(path) == scenario
    path.write_text("faults:\n  - {place: encoder, kind: offset, size: x}\n")
    with pytest.raises(ParameterError, match="size = 'x': must be a number"):
        load_scenario(path)


@pytest.mark.slow
def test_an_exported_loop_has_its_faults(tmp_path):
    fault = {"place": "command", "kind": "scale", "size": 0.5, "start_s": 0.1}
    scenario = with_faults(fault)
    assert export_firmware(scenario, tmp_path / "c", "loop").replay.passed
    assert "active_faults" in export_fmu(scenario, tmp_path, "loop").outputs
