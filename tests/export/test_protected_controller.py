"""Bad inputs of a controller with protection: C with sanitizers, FMU, WebAssembly, Drake."""

import subprocess

import numpy as np
import pytest

from kneexo.compiler import wasm_module
from kneexo.diagrams import SIGNALS
from kneexo.export import fmu as exports
from kneexo.export.firmware import make_firmware
from kneexo.export.fmu import export_fmu, make_fmu
from kneexo.export.target import count_range, make_target
from kneexo.parameters import Scenario
from kneexo.parameters.safety_states import REASONS

SHORT = {"healthy_s": 0.02, "overdue_s": 0.1, "safe_state": "dynamic_brake"}
SCENARIO = Scenario(protection=SHORT, plant={"motor": {}}, simulation={"duration_s": 0.5})
STANDING = SCENARIO.changed({"protection.safe_state": "zero_speed"})
WORN = Scenario.preset("wearer").changed(
    {"protection": SHORT | {"safe_state": "zero_speed"}, "simulation.duration_s": 0.5}
)
NAN, INF = np.nan, np.inf
INT = (-(2.0**31), 2.0**31 - 1.0)
ODD = [NAN, INF, -INF, -1e308, 1e308, *INT]
TRIP = 5  # samples
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Werror", "-std=c99", "-ffp-contract=off", "-g")
SANITIZERS = ("-O1", "-fno-sanitize-recover=all", "-fsanitize=address,undefined")
DRIVER = """
#include <stdio.h>
#include "controller.h"
int main(void) {
    static controller_state_t state;
    double row[1 + INPUTS], found[2 + OUTPUTS];
    while (fread(row, sizeof row, 1, stdin) == 1) {
        controller_inputs_t in;
        controller_outputs_t out;
        found[0] = 0.0;
FIELDS
        if (row[0] > 0.0) found[0] += (double)controller_init(&state, &controller_params, &in);
        found[0] += (double)controller_outputs(&controller_params, &state, &in, &out);
        found[1] = (double)controller_step(&controller_params, &state, &in, &out);
RESULTS
        if (fwrite(found, sizeof found, 1, stdout) != 1) return 1;
    }
    return 0;
}
"""


def driver(source):
    """A program: a row has 1 for a start, and the inputs; it prints two statuses and outputs."""
    fields, results = [], []
    for place, field in enumerate(source.plan.inputs, 1):
        kind = "int32_t" if field.is_integer else "controller_real_t"
        fields.append(f"        in.{field.name} = ({kind})row[{place}];")
    for place, field in enumerate(source.plan.outputs, 2):
        results.append(f"        found[{place}] = (double)out.{field.name};")
    text = DRIVER.replace("FIELDS", "\n".join(fields)).replace("RESULTS", "\n".join(results))
    sizes = len(source.plan.inputs), len(source.plan.outputs)
    return text.replace("INPUTS", str(sizes[0])).replace("OUTPUTS", str(sizes[1]))


class Program:
    """The exported C of a scenario with sanitizers, and its recorded inputs."""

    def __init__(self, folder, tool, scenario, precision="double"):
        self.source, vectors = make_firmware(scenario, precision=precision, vectors_s=0.4)
        self.names = [field.name for field in self.source.plan.inputs]
        self.good = vectors.inputs
        for name, text in (self.source.files() | {"main.c": driver(self.source)}).items():
            (folder / name).write_text(text)
        files = "main.c", "controller.c", "controller_params.c"
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
        return found[:, :2], outputs_by_name(self.source, found[:, 2:])


def outputs_by_name(source, values):
    return dict(zip((field.name for field in source.plan.outputs), values.T, strict=True))


def since(flags, starts):
    """For each sample, for how many samples ``flags`` has been true without a start."""
    count, result = 0, []
    for flag, starting in zip(flags, starts, strict=True):
        count = (0 if starting else count) * flag + flag
        result.append(count)
    return np.array(result)


def check(scenario, names, starts, rows, out):
    """The safety properties of a run whose inputs may be anything."""
    column = dict(zip(names, rows.T, strict=True))
    assert all(np.isfinite(values).all() for values in out.values())
    state, command = out["safety_state"], out["motor_speed_command_rad_s"]
    end = 3 if scenario.protection.safe_state == "zero_speed" else 4
    assert set(state) <= {0.0, 1.0, 2.0, end}
    free = np.abs(column["emergency_stop"]) <= 0.5
    assert (state[~free] >= 2).all()
    np.testing.assert_array_equal(out["release"], (state == 4).astype(float))
    assert not command[state > 2].any()
    assert np.abs(command).max() <= scenario.command_limit_rad_s * (1.0 + 1e-6)
    if "encoder_count" in column:
        low, high = count_range(scenario)
        off = (column["encoder_count"] < low) | (column["encoder_count"] > high)
    else:
        off = ~np.isfinite(column["encoder_reading_rad"])
    bad = [off, ~(np.abs(column["motor_speed_rad_s"]) < 1e6)]
    if "measured_force_n" in column:
        bad.append(~(np.abs(column["measured_force_n"]) < 1e6))
    for flags in bad:
        assert (state[since(flags, starts) > TRIP] >= 2).all()
    reset = column["reset"]
    before = np.append(np.nan, reset[:-1])
    rises = (np.abs(before) <= 0.5) & (reset > 0.5) & np.isfinite(reset) & free
    left = (np.append(0.0, state[:-1]) >= 2) & (state < 2) & ~starts
    assert rises[left].all()
    slower = (np.append(0.0, state[:-1]) == 2) & (state == 2) & ~starts
    assert (np.abs(command[slower]) <= np.abs(np.append(0.0, command[:-1])[slower])).all()


def hostile(names, good, count, seed, integers=()):
    """Recorded inputs with odd values: single, lasting, at the start, at several inputs at once."""
    random = np.random.default_rng(seed)
    starts = random.random(count) < 0.005
    starts[0] = True
    rows = good[np.arange(count) % len(good)]
    for place, name in enumerate(names):
        rate = {"emergency_stop": 0.004, "reset": 0.3}.get(name, 0.02)
        odd = random.choice([0.0, 0.5, 1.0, -1.0, 1e-320, 1.6, -0.1, 524.0, *ODD], count)
        if name in integers:
            odd = np.where(np.isfinite(odd), np.clip(odd, *INT), random.integers(*INT, count))
            odd = np.where(random.random(count) < 0.5, odd, random.integers(-6000, 6000, count))
            odd = np.trunc(odd)
        episode = np.repeat(random.random(count // 12 + 1) < rate, 12)[:count]
        chosen = (random.random(count) < rate) | episode
        rows[chosen, place] = odd[chosen]
    return starts, rows


def matrix(names, good, integers=()):
    """Each input with each odd value, alone or with the button, from each state."""
    rows, button = [], names.index("emergency_stop")
    for length, pressed in ((1, 0), (30, 0), (30, 1), (30, 90)):
        for place, name in enumerate(names):
            low, high = (-9e3, 9e3) if name in integers else (-5.0, 5.0)
            for odd in [low, high, 16383.0, *INT] if name in integers else [low, high, *ODD]:
                for pressing in (0.0, 1.0):
                    block = good[np.arange(length + pressed + 100) % len(good)]
                    block[length : length + pressed, button] = 1.0
                    block[length + pressed :, button] = pressing
                    block[length + pressed :, place] = odd
                    rows.append(block)
    starts = np.zeros(sum(map(len, rows)), dtype=bool)
    starts[np.cumsum([0, *map(len, rows[:-1])])] = True
    return starts, np.concatenate(rows)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("scenario", [SCENARIO, STANDING, WORN], ids=["brake", "stands", "worn"])
def test_c_accepts_each_input_and_stops(tmp_path, tool, scenario, precision):
    program = Program(tmp_path, tool, scenario, precision)
    counts = ("encoder_count",)
    for starts, rows in (
        matrix(program.names, program.good, counts),
        hostile(program.names, program.good, 1_000_000, 1, counts),
    ):
        if precision == "float":  # what a float can be
            with np.errstate(over="ignore"):
                real = [name not in counts for name in program.names]
                rows[:, real] = rows[:, real].astype(np.float32)
        statuses, out = program.run(starts, rows)
        assert not statuses.any()
        assert set(out["safety_state"]) >= {0.0, 1.0, 2.0}
        check(scenario, program.names, starts, rows, out)


def divides(knee_reference, knee_angle):
    away = knee_reference[1] - 7.0
    return 50.0 * away / away + 0.0 * knee_angle


DIVIDES = SCENARIO.with_law(divides)
ZERO = {"knee_reference_rate_rad_s": 7.0}
FAILED = {"motor_speed_command_rad_s": 0.0, "safety_state": 4.0, "release": 1.0}


@pytest.mark.slow
def test_after_a_bad_result_c_is_in_the_safe_state_until_a_start(tmp_path, tool):
    program = Program(tmp_path, tool, DIVIDES)
    rows = np.tile(program.good[100], (50, 1))
    rows[30, program.names.index(*ZERO)] = 7.0
    statuses, out = program.run(np.isin(np.arange(50), [0, 45]), rows)
    assert statuses[:, 1].tolist() == [0] * 30 + [2] + [8] * 14 + [0] * 5
    assert statuses[:, 0].tolist() == [0] * 31 + [8] * 14 + [0] * 5
    for name, value in FAILED.items():
        assert (out[name][30:45] == value).all()
        assert not (out[name][[29, 46]] == value).any()
    rows[0] = rows[30]
    statuses, out = program.run(np.arange(50) == 0, rows)
    assert statuses[:2].tolist() == [[0.0, 2.0], [8.0, 8.0]]  # the law begins with a zero
    assert all((out[name] == value).all() for name, value in FAILED.items())


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_accepts_bad_inputs_and_a_failure_is_an_error(
    tmp_path, fmu_instance, monkeypatch, fmi
):
    monkeypatch.setattr(exports, "parameter_effects", lambda *_: {})  # takes half a minute
    source = make_fmu(SCENARIO, fmi=fmi).source
    names = [field.name for field in source.plan.inputs]
    knee = fmu_instance(export_fmu(SCENARIO, tmp_path / "a.fmu", fmi=fmi).path)
    outputs = [field.name for field in source.plan.outputs]
    _, vectors = make_firmware(SCENARIO, vectors_s=0.4)
    good = vectors.inputs * np.append(SCENARIO.encoder.resolution_rad, np.ones(len(names) - 1))
    starts, rows = hostile(names, good, 4000, 2)
    starts[1:] = False
    knee.start(**dict(zip(names, rows[0], strict=True)))
    found = []
    for k, row in enumerate(rows):
        knee.set(zip(names, row, strict=True))
        knee.step(0.002 * k)
        found.append(knee.get(*outputs))
    assert not knee.messages
    check(SCENARIO, names, starts, rows, dict(zip(outputs, np.array(found).T, strict=True)))
    knee = fmu_instance(export_fmu(DIVIDES, tmp_path / "b.fmu", fmi=fmi).path)
    moving = dict(zip(names, good[100], strict=True))
    knee.start(**moving)
    knee.step(0.0)
    assert knee.get("motor_speed_command_rad_s") == 50.0
    for inputs, words in ((moving | ZERO, "a result is not finite"), (moving, "is not started")):
        knee.set(**inputs)
        assert words in knee.refusal(knee.step, 0.002)
        assert knee.get(*FAILED) == list(FAILED.values())


@pytest.mark.slow
def test_a_module_of_webassembly_accepts_bad_inputs(tmp_path, web_run):
    source, vectors = make_firmware(SCENARIO, vectors_s=0.4)
    names = [field.name for field in source.plan.inputs]
    module = wasm_module(source)
    starts, rows = hostile(names, vectors.inputs, 20_000, 3)  # counts that no int32_t has, too
    starts[1:] = False
    found = web_run(module.code).run(module.table, rows)[1:]
    counts = rows[:, 0]
    rows[:, 0] = np.where((counts >= INT[0]) & (counts <= INT[1]), np.trunc(counts), INT[0])
    check(SCENARIO, names, starts, rows, outputs_by_name(source, found))


# ------------------------------------------------------------------------------ in Python


def drake_run(target, starts, rows):
    """Outputs (n, m) of the controller in Drake: those after the update of each sample."""
    system, found = target.diagram, []
    ports = [system.GetInputPort(name) for name in target.inputs]
    ends = np.cumsum([port.size() for port in ports])[:-1]
    for starting, row in zip(starts, rows, strict=True):
        if starting:
            context = system.CreateDefaultContext()
        for port, values in zip(ports, np.split(row, ends), strict=True):
            port.FixValue(context, values)
        if starting:
            system.ExecuteInitializationEvents(context)
        update = system.EvalUniquePeriodicDiscreteUpdate(context)
        context.get_mutable_discrete_state().SetFrom(update)
        found.append(
            np.concatenate([system.GetOutputPort(n).Eval(context) for n in target.outputs])
        )
    return np.array(found)


class Standing:
    """The controller in Drake at a knee that stands at 10 deg."""

    def __init__(self, scenario=SCENARIO):
        self.scenario, self.target = scenario, make_target(scenario, "controller", counts=True)
        system, interface = self.target.diagram, self.target.interface
        sizes = {name: system.GetInputPort(name).size() for name in self.target.inputs}
        self.names = [field.name for field in interface.members(sizes)]
        sizes = {name: system.GetOutputPort(name).size() for name in self.target.outputs}
        self.outputs = [field.name for field in interface.members(sizes)]
        self.row = np.zeros(len(self.names))
        self.row[[self.names.index("encoder_count"), self.names.index("knee_reference_rad")]] = (
            731.0,
            np.radians(10.0),
        )

    def run(self, count, **columns):
        """Outputs of ``count`` samples; a column has a value from sample 20 on, or all values."""
        rows = np.tile(self.row, (count, 1))
        for name, values in columns.items():
            rows[20 if np.ndim(values) == 0 else 0 :, self.names.index(name)] = values
        return self.check(np.arange(count) == 0, rows)

    def check(self, starts, rows):
        found = drake_run(self.target, starts, rows)
        out = dict(zip(self.outputs, found.T, strict=True))
        check(self.scenario, self.names, starts, rows, out)
        return out


@pytest.fixture(scope="module")
def standing():
    return Standing()


REFERENCE = SIGNALS["knee_reference"]
LASTING = [
    *(("encoder_count", value, "range") for value in (16383.0, -9e3, *INT)),
    *(("motor_speed_rad_s", value, "flow") for value in (NAN, INF, -1e300)),
    *((name, value, "following") for name in REFERENCE for value in (NAN, -INF, 1e10)),
    ("knee_reference_rad", 1.6, "following"),
]


@pytest.mark.parametrize(("name", "value", "reason"), LASTING)
def test_a_lasting_bad_value_stops_the_motor_and_a_short_one_does_nothing(
    standing, name, value, reason
):
    out = standing.run(30, **{name: value})
    assert (out["safety_state"][10 : 20 + TRIP] == 1.0).all()
    assert (out["safety_state"][20 + TRIP :] >= 2.0).all()
    assert out["safety_reason"][-1] == REASONS.index(reason)
    good = standing.row[standing.names.index(name)]
    short = np.where((np.arange(40) >= 20) & (np.arange(40) < 19 + TRIP), value, good)
    out, healthy = standing.run(40, **{name: short}), standing.run(40)
    assert not out["safety_reason"].any()
    command = "motor_speed_command_rad_s"
    np.testing.assert_array_equal(out[command], healthy[command])  # the held value is the same


def test_a_bad_speed_is_no_standstill(standing):
    """The stop ends by ``overdue``."""
    out = standing.run(90, emergency_stop=1.0, motor_speed_rad_s=NAN)
    overdue = round(SHORT["overdue_s"] / 0.002)
    assert (out["safety_state"][20 : 20 + overdue] == 2.0).all()
    assert (out["safety_state"][20 + overdue :] == 4.0).all()


def test_a_start_with_bad_inputs_keeps_the_knee_where_it_is(standing):
    """Before the first good reference the knee angle is the reference. Without a reading the
    motor stops before it has moved, and can be reset when there are readings.
    """
    first = np.arange(40) < 3
    row = dict(zip(standing.names, standing.row, strict=True))
    bad = {name: np.where(first, NAN, row[name]) for name in (*REFERENCE, "motor_speed_rad_s")}
    out = standing.run(40, **bad)
    assert not out["safety_reason"].any()
    np.testing.assert_array_equal(out["motor_speed_command_rad_s"][:3], 0.0)
    samples = np.arange(120)
    reset = np.where(samples < 100, 0.0, 1.0)
    for value in (1500.0, 16383.0):  # no linkage, no reading
        out = standing.run(120, encoder_count=np.where(samples < 3, value, 731.0), reset=reset)
        assert (out["safety_state"][:100] >= 2.0).all()
        assert (out["safety_reason"][:100] == REASONS.index("range")).all()
        assert not out["motor_speed_command_rad_s"][:100].any()
        assert out["safety_state"][-1] == 1.0


def test_drake_takes_hostile_inputs(standing):
    rows = np.tile(standing.row, (150, 1))
    standing.check(*hostile(standing.names, rows, 150, 5, ("encoder_count",)))


@pytest.mark.slow
def test_c_is_the_controller_in_drake(tmp_path, tool):
    program, standing = Program(tmp_path, tool, SCENARIO), Standing()
    for seed in range(5):
        starts, rows = hostile(program.names, program.good, 3000, seed, ("encoder_count",))
        found, (_, out) = standing.check(starts, rows), program.run(starts, rows)
        for name in ("safety_state", "safety_reason", "release"):
            np.testing.assert_array_equal(out[name], found[name])
        name = "motor_speed_command_rad_s"
        np.testing.assert_allclose(out[name], found[name], rtol=0, atol=1e-6)
