"""Runs as files: what is written repeats the run bit for bit, and what is damaged is refused."""

import json
import math
import re

import numpy as np
import pytest
from pydrake.symbolic import Variable
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import SymbolicVectorSystem, ZeroOrderHold

from kneexo.compiler import (
    STEP_S,
    InputTable,
    OutputError,
    ParameterError,
    SimulationError,
    compile_diagram,
    read_run,
    record_run,
)

OPTIONS = {"record_period_s": 0.01, "integrator": "rk4", "step_s": 0.001}
X0 = 0.7


def blow_up(factor=1.0, name="growth"):
    """dx/dt = a x² + u and the held h: with u = 0, x = x₀/(1 − a x₀ t) ends at t = 1/(a x₀)."""
    x, u, a = Variable("x"), Variable("u"), Variable("a")
    growth = SymbolicVectorSystem(
        state=[x], input=[u], parameter=[a], dynamics=[factor * a * x * x + u], output=[x]
    )
    builder = DiagramBuilder()
    builder.AddNamedSystem(name, growth)
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.01, 1))
    builder.Connect(growth.get_output_port(), hold.get_input_port())
    builder.ExportInput(growth.get_input_port(), "u")
    builder.ExportOutput(growth.get_output_port(), "x")
    builder.ExportOutput(hold.get_output_port(), "h")
    return builder.Build()


@pytest.fixture(scope="module")
def model():
    return compile_diagram(blow_up(), inputs=["u"])


@pytest.fixture(scope="module")
def batch(model):
    """Nine runs, of which those with a > 1/(2 s x₀) end early; lanes of a batch share calls."""
    rates = np.linspace(0.1, 2.5, 9)[:, None]
    state = model.state()
    state.continuous[:] = X0
    runs = model.simulate_batch(rates, state, 2.0, failures="return", **OPTIONS)
    return rates, state, runs


def test_an_error_of_a_batch_has_the_time_of_the_blow_up_and_the_state(batch):
    rates, _, runs = batch
    failed = [1.0 / (rate * X0) < 2.0 for (rate,) in rates]
    assert 0 < sum(failed) < len(failed)
    assert [isinstance(run, SimulationError) for run in runs] == failed
    for (rate,), run in zip(rates, runs, strict=True):
        if isinstance(run, SimulationError):
            # RK4 with 1 ms overflows some steps after the pole, and a tick is checked at its end.
            assert 0.0 <= run.time_s - 1.0 / (rate * X0) < 0.03
            assert run.time_s == pytest.approx(0.01 * round(run.time_s / 0.01), abs=1e-14)
            assert list(run.state) == ["growth.x[0]", "hold.0[0]"]
            assert not all(map(math.isfinite, run.state.values()))
            assert str(run).startswith(f"t = {run.time_s:.6g} s: growth.x[0] is not finite")


def test_a_file_repeats_each_run_of_a_batch_bit_for_bit(model, batch, tmp_path):
    rates, state, runs = batch
    for number in (0, 4, 8):
        path = tmp_path / f"run {number}.json"
        note = {"seed": 3, "run": number}
        record_run(model, rates[number], state, 2.0, note=note, **OPTIONS).write(path)
        run = read_run(path)
        assert run.note == note
        again = run.replay(compile_diagram(blow_up(), inputs=["u"]))
        assert again.same, again.difference
        assert again.changes == ()
        if isinstance(runs[number], SimulationError):
            assert again.end.message == str(runs[number])
            assert again.end.time_s == runs[number].time_s
            assert repr(again.end.state) == repr(runs[number].state)
            with pytest.raises(SimulationError, match=re.escape(str(runs[number]))):
                run.simulate(model)
            assert str(again) == f"{runs[number]}\nsame end, with the same bits of all states"
        else:
            final = runs[number].final
            expected = [*final.continuous, *final.discrete]
            assert list(again.end.state.values()) == expected
            np.testing.assert_array_equal(run.simulate(model)["x"], runs[number]["x"])
            assert str(again).startswith("t = 2 s: the run succeeds\nsame end")


def test_inputs_and_solver_are_part_of_the_run(model, tmp_path):
    """With a = 0, x' = 0.1, and 0.25 + 0.3 t after a break at 0.5 s; h starts at 2."""
    table = InputTable(np.array([0.5]), np.array([[[0.1, 0.0]], [[0.25, 0.3]]]))
    state = model.state()
    state.discrete[:] = 2.0
    path = tmp_path / "run.json"
    options = {"record_period_s": 0.02, "outputs": ("h",), "integrator": None}
    record_run(model, [0.0], state, 1.0, inputs=table, **options).write(path)
    run = read_run(path)
    assert (run.options["integrator"], run.options["outputs"]) == ("exact_hold", ["h"])
    assert run.input_ports == {"u": 1}
    records = run.simulate(model)
    assert set(records.outputs) == {"h"}
    assert records["h"][0] == 2.0
    assert records.time_s == pytest.approx(0.02 * np.arange(51))
    expected = 0.1 * 0.5 + 0.25 * 0.5 + 0.15 * 0.5**2
    assert records.final.continuous == pytest.approx([expected], rel=1e-9)
    assert run.replay(model).same


def test_the_defaults_are_those_of_a_run(model, batch):
    """At this rate a step of twice the length gives another state in its last digits."""
    rates, state, _ = batch
    for integrator in ("rk4", "exact_hold"):
        run = record_run(model, rates[1], state, 1.0, integrator=integrator)
        final = model.simulate(rates[1], state, 1.0, integrator=integrator).final
        assert list(run.end.state.values()) == [*final.continuous, *final.discrete]
        twice = model.simulate(rates[1], state, 1.0, integrator="rk4", step_s=2.0 * STEP_S).final
        assert run.end.state["growth.x[0]"] != twice.continuous[0]


def changed(path, place, value):
    """Change an entry of a file; ``place`` has the keys that lead to the entry."""
    document = json.loads(path.read_text("utf-8"))
    inner = document
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    path.write_text(json.dumps(document), encoding="utf-8")


@pytest.fixture
def file(model, batch, tmp_path):
    path = tmp_path / "run.json"
    record_run(model, [2.0], batch[1], 2.0, **OPTIONS).write(path)
    return path


@pytest.mark.parametrize(
    ("place", "value", "difference"),
    [
        (("parameters", "growth.0[0]"), float(np.nextafter(2.0, 3.0)), "hold.0[0] now ends at 1"),
        (("parameters", "growth.0[0]"), 1.9, "the run now ends with SimulationError: t = "),
        (("parameters", "growth.0[0]"), 0.1, "the run now ends with success, not with Simul"),
        (("end", "time_s"), 0.5, "the run now ends at t = 0.7"),
        (("end", "error"), "StiffnessError", "the run now ends with SimulationError: t = "),
        (("end", "state", "hold.0[0]"), -1.0, "hold.0[0] now ends at "),
        (("end", "state"), {}, "the run now has other states"),
    ],
)
def test_a_replay_sees_every_difference(model, file, place, value, difference):
    changed(file, place, value)
    again = read_run(file).replay(model)
    assert not again.same
    assert again.difference.startswith(difference)
    assert again.difference in str(again)


def test_other_equations_run_and_are_named(file):
    changed(file, ("versions", "drake"), "0.1")
    again = read_run(file).replay(compile_diagram(blow_up(0.01), inputs=["u"]))
    assert again.difference.startswith("the run now ends with success")
    drake, equations = again.changes
    assert drake.startswith("drake changed since the file was written: 0.1, now 1.")
    assert equations.startswith("equations changed since the file was written: ")


def test_a_model_with_other_names_is_refused(file):
    run = read_run(file)
    with pytest.raises(ParameterError, match=r"^state: the run lacks other\.x\[0\], has growth"):
        run.replay(compile_diagram(blow_up(name="other"), inputs=["u"]))
    with pytest.raises(ParameterError, match=r"^inputs: the run has u \(1\), the model has none; "):
        run.replay(compile_diagram(without_input()))


def without_input():
    """A diagram with the names of `blow_up`, and no input port."""
    builder = DiagramBuilder()
    x, a = Variable("x"), Variable("a")
    growth = SymbolicVectorSystem(state=[x], parameter=[a], dynamics=[a * x], output=[x])
    builder.AddNamedSystem("growth", growth)
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.01, 1))
    builder.Connect(growth.get_output_port(), hold.get_input_port())
    builder.ExportOutput(hold.get_output_port(), "h")
    return builder.Build()


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("kind",), "other", "must be a file of "),
        (("parameters",), [1.0], "parameters: must be an object"),
        (("parameters", "growth.0[0]"), "2", "parameters.growth.0[0] = '2': must be a number"),
        (("parameters", "growth.0[0]"), True, "parameters.growth.0[0] = True: must be a number"),
        (("parameters", "growth.0[0]"), 10**400, "parameters.growth.0[0] = 1000"),
        (("state", "growth.x[0]"), "nan", "state.growth.x[0] = 'nan': must be a number"),
        (("duration_s",), None, "duration_s = None: must be a number"),
        (("inputs",), {"breaks": [0.0]}, "inputs: "),
        (("inputs", "coefficients"), [[1.0], [2.0, 3.0]], "inputs: "),
        (("inputs", "coefficients"), [1.0], "inputs: must be arrays"),
        (("options", "threads"), 4, "options.threads: is unknown, must be one of outputs, "),
        (("options", "step_s"), "1", "options.step_s: has a value of the wrong type"),
        (("end", "message"), 1, "end.message: must be a text"),
        (("end", "state", "hold.0[0]"), "one", "end.state.hold.0[0] = 'one': must be a number"),
        (("equations",), None, "equations: must be a text"),
        (("versions",), 1, "versions: must be an object"),
        (("note",), 1, "note: must be an object"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(file, place, value, message):
    changed(file, place, value)
    with pytest.raises(ParameterError) as caught:
        read_run(file)
    assert str(caught.value).startswith(f"{file}: {message}")
    assert len(str(caught.value)) < 400 + len(str(file))


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("options", "integrator"), "euler", "the run cannot start: integrator = 'euler': must be"),
        (("options", "step_s"), -1.0, "the run cannot start: step_s = -1"),
        (("options", "outputs"), ["y"], "the run cannot start: output"),
        (("duration_s",), -1.0, "the run cannot start: duration_s = -1.0 s"),
        (("duration_s",), 1e300, "the run cannot start: "),
    ],
)
def test_arguments_that_no_run_has_are_refused_in_one_line(model, file, place, value, message):
    changed(file, place, value)
    with pytest.raises(ParameterError) as caught:
        read_run(file).replay(model)
    assert str(caught.value).startswith(message)


def test_a_note_that_is_no_json_leaves_no_file(model, batch, tmp_path):
    run = record_run(model, [0.1], batch[1], 0.1, note={"law": print}, **OPTIONS)
    with pytest.raises(ParameterError, match=r"^note: cannot be written as JSON"):
        run.write(tmp_path / "run.json")
    with pytest.raises(OutputError, match=r"no-folder/run\.json: cannot be written \(No such file"):
        record_run(model, [0.1], batch[1], 0.1, **OPTIONS).write(tmp_path / "no-folder/run.json")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_option_is_refused(model, batch):
    with pytest.raises(ParameterError, match=r"^options\.threads: is unknown"):
        record_run(model, [0.1], batch[1], 0.1, threads=2)
