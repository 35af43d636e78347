"""Bad inputs of a controller with protection: C with sanitizers, FMU, WebAssembly, Drake."""

import subprocess
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from diagramc import wasm_module
from kneexo.diagrams import SIGNALS
from kneexo.export import fmu as exports
from kneexo.export.firmware import make_firmware
from kneexo.export.fmu import export_fmu
from kneexo.export.target import count_range, make_target
from kneexo.parameters import Scenario
from kneexo.parameters.device.safety_states import REASONS

ROWS_C = Path(__file__).with_name("rows.c")
SHORT = {"healthy_s": 0.02, "overdue_s": 0.1, "safe_state": "dynamic_brake"}
SCENARIO = Scenario(protection=SHORT, plant={"motor": {}}, simulation={"duration_s": 0.5})
STANDING = SCENARIO.changed({"protection.safe_state": "zero_speed"})
WORN = Scenario.preset("wearer").changed({"protection": SHORT | {"safe_state": "zero_speed"}})
NAN, INF = np.nan, np.inf
INT = (-(2.0**31), 2.0**31 - 1.0)
COUNTS = [-9e3, -2e3, 0.0, 1500.0, 9e3, 16383.0, *INT]
REALS = [NAN, INF, -INF, -1e308, 1e308, *INT, 0, 0.5, 1, -1, 1e-320, 1.6, -0.1, 524, -5, 5]
COMMAND = "motor_speed_command_rad_s"
SENSORS = "motor_speed_rad_s", *SIGNALS["measured_force"]
NAMES = ["encoder_count", *SIGNALS["knee_reference"], SENSORS[0], "emergency_stop", "reset"]
OUTPUTS = [COMMAND, "safety_state", "safety_reason", "release"]
TRIP = 5  # samples
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Werror", "-std=c99", "-ffp-contract=off", "-g")
SANITIZERS = ("-O1", "-fno-sanitize-recover=all", "-fsanitize=address,undefined")


class Program:
    """The exported C of a scenario with sanitizers, and its recorded inputs."""

    def __init__(self, folder, tool, scenario, precision="double"):
        source, vectors = make_firmware(scenario, precision=precision, vectors_s=0.4)
        self.names, self.outputs, self.good = *names_of(source), vectors.inputs
        for name, text in source.files().items():
            (folder / name).write_text(text)
        fields = "".join(f" IN(controller_real_t, {name})" for name in self.names[1:])
        fields = f"-DFIELDS=IN(int32_t, {self.names[0]}){fields}"
        files = fields, "-I.", ROWS_C, "controller.c", "controller_params.c"
        command = [tool("gcc"), *WARNINGS, *SANITIZERS, *files, "-o", "program", "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
        self.file = folder / "program"

    def run(self, starts, rows):
        """Statuses (n, 2) and outputs by name, of inputs (n, m) with a start where ``starts``."""
        data = np.column_stack([starts, rows]).astype(float).tobytes()
        done = subprocess.run(self.file, input=data, capture_output=True)
        assert (done.returncode, done.stderr) == (0, b"")
        found = np.frombuffer(done.stdout).reshape(len(rows), -1)
        return found[:, :2], dict(zip(self.outputs, found[:, 2:].T, strict=True))


def names_of(source):
    return [[field.name for field in part] for part in (source.plan.inputs, source.plan.outputs)]


def check(scenario, names, starts, rows, out):
    """The safety properties of a run whose inputs may be anything."""
    column = dict(zip(names, rows.T, strict=True))
    state, command, reset = out["safety_state"], out[COMMAND], column["reset"]
    free = np.abs(column["emergency_stop"]) <= 0.5
    assert all(np.isfinite(values).all() for values in out.values())
    assert (state[~free] >= 2).all()
    np.testing.assert_array_equal(out["release"], state == 4)
    assert not command[state > 2].any()
    assert np.abs(command).max() <= scenario.command_limit_rad_s * (1.0 + 1e-6)
    low, high = count_range(scenario)
    encoder = column.get("encoder_count", column.get("encoder_reading_rad"))
    bad = [~((encoder >= low) & (encoder <= high))]  # wider than the range of a reading in rad
    bad += [~(np.abs(column[n]) < 1e6) for n in names if n in SENSORS]
    last = partial(np.lib.stride_tricks.sliding_window_view, window_shape=TRIP + 1)
    for flags in bad:
        lasting = last(flags).all(axis=1) & ~last(starts)[:, 1:].any(axis=1)
        assert (state[TRIP:][lasting] >= 2).all()
    before, state, command = state[:-1], state[1:], np.abs(command)
    risen = (np.abs(reset[:-1]) <= 0.5) & (reset[1:] > 0.5) & (reset[1:] < INF) & free[1:]
    assert risen[(before >= 2) & (state < 2) & ~starts[1:]].all()
    assert not (np.diff(command) > 0)[(before == 2) & (state == 2) & ~starts[1:]].any()


def hostile(names, good, count, seed, restarts=0.0):
    """Recorded inputs with odd values: single, lasting, at the start, at several inputs at once."""
    random = np.random.default_rng(seed)
    starts = random.random(count) < restarts
    starts[0] = True
    rows = good[np.arange(count) % len(good)]
    for place, name in enumerate(names):
        rate = {"emergency_stop": 0.004, "reset": 0.3}.get(name, 0.02)
        odd = random.choice(COUNTS if name == "encoder_count" else REALS, count)
        lasting = np.repeat(random.random(count // 12 + 1) < rate, 12)[:count]
        chosen = (random.random(count) < rate) | lasting
        rows[chosen, place] = odd[chosen]
    return starts, rows


def matrix(names, good):
    """Each input with each odd value, alone or with the button, from each state."""
    rows, button = [], names.index("emergency_stop")
    states = ((1, 0), (30, 0), (30, 1), (30, 90))  # samples before, and with the button
    for (free, pressed), (place, name), on in product(states, enumerate(names), (0.0, 1.0)):
        for odd in COUNTS if name == "encoder_count" else REALS:
            block = good[np.arange(free + pressed + 100) % len(good)]
            block[free : free + pressed, button] = 1.0
            block[free + pressed :, button] = on
            block[free + pressed :, place] = odd
            rows.append(block)
    return np.concatenate([np.arange(len(b)) == 0 for b in rows]), np.concatenate(rows)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("scenario", [SCENARIO, STANDING, WORN], ids=["brake", "stands", "worn"])
def test_c_accepts_each_input_and_stops(tmp_path, tool, scenario, precision):
    program = Program(tmp_path, tool, scenario, precision)
    arguments = program.names, program.good
    for starts, rows in (matrix(*arguments), hostile(*arguments, 1_000_000, 1, 0.005)):
        statuses, out = program.run(starts, rows)
        assert not statuses.any()
        assert set(out["safety_state"]) >= {0.0, 1.0, 2.0}
        check(scenario, program.names, starts, rows, out)


def divides(knee_reference, knee_angle):
    away = knee_reference[1] - 7.0
    return 50.0 * away / away + 0.0 * knee_angle


DIVIDES = SCENARIO.with_law(divides)
ZERO = {"knee_reference_rate_rad_s": 7.0}
FAILED = {COMMAND: 0.0, "safety_state": 4.0, "release": 1.0}


@pytest.mark.slow
def test_after_a_bad_result_c_is_in_the_safe_state_until_a_start(tmp_path, tool):
    program, samples = Program(tmp_path, tool, DIVIDES), np.arange(50)
    rows = np.tile(program.good[100], (50, 1))
    rows[30, program.names.index(*ZERO)] = 7.0
    statuses, out = program.run(np.isin(samples, [0, 45]), rows)
    assert statuses[:, 1].tolist() == [0] * 30 + [2] + [8] * 14 + [0] * 5
    has_failed = np.all([out[name] == value for name, value in FAILED.items()], axis=0)
    np.testing.assert_array_equal(has_failed, statuses[:, 1] > 0)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_accepts_bad_inputs_and_fails_as_c(tmp_path, fmu_instance, monkeypatch, fmi):
    monkeypatch.setattr(exports, "parameter_effects", lambda *_: {})  # takes half a minute
    names = ["encoder_reading_rad", *NAMES[1:]]
    good = make_firmware(SCENARIO, vectors_s=0.4)[1].inputs.copy()
    good[:, 0] *= SCENARIO.encoder.resolution_rad
    starts, rows = hostile(names, good, 4000, 2)
    knee = fmu_instance(export_fmu(SCENARIO, tmp_path / "a.fmu", fmi=fmi).path)
    knee.start(**dict(zip(names, rows[0], strict=True)))
    found = []
    for k, row in enumerate(rows):
        knee.set(zip(names, row, strict=True))
        knee.step(0.002 * k)
        found.append(knee.get(*OUTPUTS))
    assert not knee.messages
    check(SCENARIO, names, starts, rows, dict(zip(OUTPUTS, np.array(found).T, strict=True)))
    knee = fmu_instance(export_fmu(DIVIDES, tmp_path / "b.fmu", fmi=fmi).path)
    moving = dict(zip(names, good[100], strict=True))
    knee.start(**moving)
    knee.step(0.0)
    assert knee.get(COMMAND) == 50.0
    for inputs, words in ((moving | ZERO, "a result is not finite"), (moving, "is not started")):
        knee.set(**inputs)
        assert words in knee.refusal(knee.step, 0.002)
        assert knee.get(*FAILED) == list(FAILED.values())


@pytest.mark.slow
def test_a_module_of_webassembly_accepts_bad_inputs(tmp_path, web_run):
    source, vectors = make_firmware(SCENARIO, vectors_s=0.4)
    module = wasm_module(source)
    starts, rows = hostile(NAMES, vectors.inputs, 20_000, 3)
    sent = rows.copy()
    sent[rows[:, 0] == INT[0], 0] = NAN  # a count that no int32_t has
    run, (_, outputs) = web_run(module.code), names_of(source)
    found = run.run(module.table, sent)[1:]
    check(SCENARIO, NAMES, starts, rows, dict(zip(outputs, found.T, strict=True)))
    run.vector("params", 1)[:] = NAN
    assert run("start") == 16
    first = dict(
        zip(outputs, run.vector("outputs", len(outputs), len(rows) + 1)[:, 0], strict=True)
    )
    assert first | FAILED == first


# ------------------------------------------------------------------------------ in Drake

STILL = np.array([731.0, np.radians(10.0), *[0.0] * 6])


@cache
def target():
    return make_target(SCENARIO, "controller", counts=True)


def drake(starts, rows):
    """Outputs by name of the controller in Drake, after the update of each sample."""
    system, found = target().diagram, []
    for starting, row in zip(starts, rows, strict=True):
        if starting:
            context = system.CreateDefaultContext()
        for name, values in zip(target().inputs, np.split(row, [1, 5, 6, 7]), strict=True):
            system.GetInputPort(name).FixValue(context, values)
        if starting:
            system.ExecuteInitializationEvents(context)
        update = system.EvalUniquePeriodicDiscreteUpdate(context)
        context.get_mutable_discrete_state().SetFrom(update)
        ports = [system.GetOutputPort(name.removesuffix("_rad_s")) for name in OUTPUTS]
        found.append([port.Eval(context)[0] for port in ports])
    out = dict(zip(OUTPUTS, np.array(found).T, strict=True))
    check(SCENARIO, NAMES, starts, rows, out)
    return out


def standing(count, **columns):
    """Outputs at a knee that stands at 10 deg; a column has all values, or that from sample 20."""
    rows = np.tile(STILL, (count, 1))
    for name, values in columns.items():
        rows[20 if np.ndim(values) == 0 else 0 :, NAMES.index(name)] = values
    return drake(np.arange(count) == 0, rows)


LASTING = [
    *product(["encoder_count"], [16383.0, -9e3, *INT], ["range"]),
    *product(["motor_speed_rad_s"], [NAN, INF, -1e300], ["flow"]),
    *product(SIGNALS["knee_reference"], [NAN, -INF, 1e10], ["following"]),
    ("knee_reference_rad", 1.6, "following"),
]


@pytest.mark.parametrize(("name", "value", "reason"), LASTING)
def test_a_lasting_bad_value_stops_the_motor_and_a_short_one_does_nothing(name, value, reason):
    out, samples = standing(30, **{name: value}), np.arange(40)
    assert (out["safety_state"][10 : 20 + TRIP] == 1.0).all()
    assert out["safety_reason"][-1] == REASONS.index(reason)
    # Four bad samples, and every second one: a detector counts down again in between.
    bad = ((samples >= 20) & (samples < 24)) | ((samples >= 26) & (samples % 2 == 0))
    out = standing(40, **{name: np.where(bad, value, STILL[NAMES.index(name)])})
    assert not out["safety_reason"].any()
    np.testing.assert_array_equal(out[COMMAND], standing(40)[COMMAND])  # the held value is equal


def test_a_bad_speed_is_no_standstill():
    """The stop ends by ``overdue``."""
    state = standing(90, emergency_stop=1.0, motor_speed_rad_s=NAN)["safety_state"]
    overdue = round(SHORT["overdue_s"] / 0.002)
    assert state[20:].tolist() == [2.0] * overdue + [4.0] * (70 - overdue)


@pytest.mark.parametrize("count", [1500.0, 16383.0], ids=["no linkage", "no reading"])
def test_a_start_without_a_reading_moves_no_motor_and_can_be_reset(count):
    samples = np.arange(120)
    counts = np.where(samples < 3, count, STILL[0])
    out = standing(120, encoder_count=counts, reset=samples >= 100)
    assert (out["safety_reason"][:100] == REASONS.index("range")).all()
    assert not out[COMMAND][:100].any()
    assert out["safety_state"][-1] == 1.0


def test_drake_takes_hostile_inputs():
    drake(*hostile(NAMES, STILL[None, :], 150, 5, 0.005))


@pytest.mark.slow
def test_c_is_the_controller_in_drake(tmp_path, tool):
    program = Program(tmp_path, tool, SCENARIO)
    for seed in range(5):
        starts, rows = hostile(NAMES, program.good, 3000, seed, 0.005)
        found, (_, out) = drake(starts, rows), program.run(starts, rows)
        for name in OUTPUTS:  # the states are equal, the command differs by rounding
            np.testing.assert_allclose(out[name], found[name], rtol=0, atol=1e-6)
