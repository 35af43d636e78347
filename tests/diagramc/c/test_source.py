"""Exported models against the compiled ones, their text and their refusals."""

import ctypes
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Gain, LinearSystem, Sine

from diagramc import read_diagram
from diagramc.c import functions
from diagramc.c.interface import Interface
from diagramc.c.source import CSource, source_of
from diagramc.c.vectors import recorded_vectors
from diagramc.equations.equations import Equations, Limit, Section, Update
from diagramc.errors import CompilationError
from diagramc.run_data import State


def accumulator(increment=0.0):
    """A sampled integrator: x⁺ = x + u every 10 ms, and its output 2 x."""
    return LinearSystem(A=[[1.0]], B=[[1.0]], C=[[2.0]], D=[[0.0]], time_period=0.01)


def oscillator():
    """A continuous plant of two states with an input."""
    system = LinearSystem(
        A=[[0.0, 1.0], [-400.0, -4.0]], B=[[0.0], [400.0]], C=[[1.0, 0.0]], D=[[0.0]]
    )
    system.set_name("plant")
    return system


def exported(diagram, name="model", inputs=(), **options):
    return source_of(read_diagram(diagram, inputs=inputs), name, **options)


def equations_of(graph_of, **fields):
    """Equations without a diagram: ``graph_of(graph)`` makes the fields."""
    equations = Equations(**fields)
    for name, value in graph_of(equations.graph).items():
        setattr(equations, name, value)
    return equations


# ------------------------------------------------------------------------------- results


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_discrete_step_takes_the_inputs_and_gives_what_follows(built, precision):
    model = built(exported(accumulator(), inputs=["u0"], precision=precision))
    outputs = model.replay([[1.0], [2.0], [4.0]])
    np.testing.assert_allclose(outputs[:, 0], [2.0, 6.0, 14.0])
    assert model.now([0.0]) == 0
    assert model.get() == [14.0]


@pytest.fixture(params=[functions._MOST_TERMS, 0], ids=["small", "large"])
def size(request, monkeypatch):
    """Lets small models be printed as large ones are."""
    monkeypatch.setattr(functions, "_MOST_TERMS", request.param)
    return request.param


@pytest.mark.usefixtures("size")
def test_a_continuous_diagram_is_that_of_rk4(built):
    source = exported(oscillator(), inputs=["u0"], tick_s=0.01, step_s=0.002)
    assert (source.plan.schedule.tick_s, source.plan.schedule.steps) == (0.01, 5)
    inputs = np.sin(np.arange(50.0))[:, None]
    vectors = recorded_vectors(oscillator(), source, inputs)
    outputs = built(source).replay(inputs)
    # Rounding of each of the 250 steps of 2 ms, of which the decay of 2/s forgets few.
    np.testing.assert_allclose(outputs, vectors.outputs, rtol=0, atol=250 * 2.2e-16)
    assert np.ptp(outputs) > 0.1
    # By hand: with u held, x = exp(A h) x + …; RK4 is its Taylor series up to h⁴.
    a, b = np.array([[0.0, 1.0], [-400.0, -4.0]]), np.array([0.0, 400.0])
    x, expected = np.zeros(2), []
    for (u,) in inputs:
        for _ in range(5):
            term = 0.002 * (a @ x + b * u)
            for power in range(2, 6):
                x = x + term
                term = 0.002 / power * (a @ term)
        expected.append(x[0])
    np.testing.assert_allclose(outputs[:, 0], expected, rtol=0, atol=1e-13)


@pytest.mark.usefixtures("size")
def test_each_stage_has_its_time(built):
    """RK4 integrates x' = 4 t³ as Simpson's rule does: exactly."""

    def graph_of(g):
        rate = g.multiply(g.constant(4.0), *[g.source("time")] * 3)
        return {"derivatives": [rate], "outputs": {"y": [g.source("state")]}}

    equations = equations_of(graph_of, states=["x"])
    state = State(np.zeros(1), np.zeros(0))
    source = CSource(equations, "m", np.zeros(0), state, tick_s=0.5, step_s=0.125)
    outputs = built(source).replay(np.zeros((4, 0)))
    np.testing.assert_allclose(outputs[:, 0], (0.5 * np.arange(1, 5)) ** 4, rtol=1e-14)


def test_several_sample_times_with_offset_and_a_clock(built, multirate):
    source = exported(multirate)
    assert source.plan.schedule.tick_s == 0.001
    vectors = recorded_vectors(multirate, source, np.zeros((400, 0)))
    outputs = built(source).replay(np.zeros((400, 0)))
    np.testing.assert_allclose(outputs, vectors.outputs, rtol=0, atol=1e-12)
    fields = [field.name for field in source.plan.outputs]
    held = outputs[:, fields.index("held")]
    sampled = outputs[:, fields.index("sampled")]
    assert np.flatnonzero(np.diff(held))[:3].tolist() == [3, 7, 11]  # at 4, 8, 12 ms
    assert np.flatnonzero(np.diff(sampled))[:2].tolist() == [4, 14]  # at 5 and 15 ms


def test_time_is_that_of_the_end_of_a_step(built):
    sine = Sine(2.0, 3.0, 0.5, 1)
    outputs = built(exported(sine, outputs=["y0"], tick_s=0.1)).replay(np.zeros((5, 0)))
    np.testing.assert_allclose(outputs[:, 0], 2.0 * np.sin(0.3 * np.arange(1, 6) + 0.5))


def test_single_precision_keeps_what_a_sum_loses(built):
    source = exported(accumulator(), inputs=["u0"], precision="float")
    steps, small = 20_000, 1e-4
    model = built(source)
    model.init([0.0])
    model.step([1000.0])
    for _ in range(steps):
        model.step([small])
    right = 2.0 * (1000.0 + steps * small)
    assert model.get()[0] == pytest.approx(right, rel=2e-7)
    plain = np.float32(1000.0)
    for _ in range(steps):
        plain += np.float32(small)
    assert 2.0 * plain != pytest.approx(right, rel=1e-4)


def test_parameters_are_read_from_the_struct(built):
    def graph_of(g):
        gain, factor, output = (g.source("parameter", i) for i in range(3))
        held = g.source("discrete", 0)
        product = g.multiply(gain, factor, g.source("input", 0))
        return {
            "updates": [Update(0.1, 0.0, ((0, product),))],
            "outputs": {"y": [held, output]},
            "initial_discrete": [held],
        }

    equations = equations_of(
        graph_of,
        parameters=["a/law.gain", "a/law.0[0]", "b/law.gain"],
        discrete=["a/law.0[0]"],
        inputs={"u": 1},
    )
    source = CSource(equations, "m", np.array([2.0, 3.0, 5.0]), State(np.zeros(0), np.zeros(1)))
    assert source.plan.members == ("a_law.gain", "a_law.group_0[0]", "b_law.gain")
    assert built(source).replay([[7.0]]).tolist() == [[42.0, 5.0]]


# ------------------------------------------------------------------------------- failures


def guarded():
    """x⁺ = 1 / u, which must not leave its limit x <= 10: `Limit` looks at the state before."""

    def graph_of(g):
        x, u = g.source("discrete", 0), g.source("input", 0)
        return {
            "updates": [Update(0.1, 0.0, ((0, g.divide(g.one, u)),))],
            "outputs": {"y": [x]},
            "initial_discrete": [x],
            "limits": [Limit("law", g.subtract(g.constant(10.0), x))],
        }

    equations = equations_of(graph_of, discrete=["law.0[0]"], inputs={"u": 1})
    return CSource(equations, "m", np.zeros(0), State(np.zeros(0), np.array([0.5])))


@pytest.mark.parametrize("failed", [None, -3.5])
def test_each_failure_has_its_status_and_keeps_the_state(built, failed):
    """The output is then the last right one, or that of the interface."""
    interface = Interface(failed_outputs={"y": failed} if failed else {})
    model = built(replace(guarded(), interface=interface))
    assert (model.step([2.0]), model.get()) == (8, [failed or 0.0])
    assert (model.init([1.0]), model.step([2.0]), model.get()) == (0, 0, [0.5])
    before = bytes(model.state)
    for value, status in ((math.nan, 1), (math.inf, 1), (-math.inf, 1), (0.0, 2)):
        assert (model.step([value]), model.get()) == (status, [failed or 0.5])
        assert bytes(model.state) == before
    assert (model.step([0.05]), model.get()) == (0, [20.0])
    assert (model.step([1.0]), model.get()) == (4, [failed or 20.0])
    assert (model.now([math.nan]), model.get()) == (1, [failed or 20.0])


def test_a_model_that_accepts_its_inputs_fails_until_the_next_start(built):
    interface = Interface(failed_outputs={"y": -3.5}, accepts_inputs=True)
    model = built(replace(guarded(), interface=interface))
    assert (model.init([math.inf]), model.step([math.inf]), model.get()) == (0, 0, [0.0])
    assert (model.now([math.nan]), model.get()) == (0, [0.0])
    assert (model.step([2.0]), model.step([math.nan]), model.get()) == (0, 2, [-3.5])
    assert (model.step([2.0]), model.now([2.0]), model.get()) == (8, 8, [-3.5])
    assert (model.init([2.0]), model.step([2.0]), model.get()) == (0, 0, [0.5])
    right, model.params = model.params, (ctypes.c_double * 1)(math.nan)  # the start of the state
    assert (model.now([2.0]), model.step([2.0]), model.get()) == (16, 16, [-3.5])
    model.params = right
    assert (model.step([2.0]), model.init([2.0]), model.step([2.0])) == (8, 0, 0)


@pytest.mark.usefixtures("size")
@pytest.mark.parametrize("second", [False, True])
def test_a_state_that_overflows_while_it_is_integrated_is_a_bad_result(built, second):
    """One of the states has the derivative u², the other u; the output is the other."""

    def graph_of(g):
        u = g.source("input")
        rates = [u, g.multiply(u, u)] if second else [g.multiply(u, u), u]
        return {"derivatives": rates, "outputs": {"y": [g.source("state", 1 - second)]}}

    equations = equations_of(graph_of, states=["x", "y"], inputs={"u": 1})
    state = State(np.zeros(2), np.zeros(0))
    model = built(CSource(equations, "m", np.zeros(0), state, tick_s=1.0, step_s=1.0))
    assert (model.init([0.0]), model.step([2.0])) == (0, 0)
    before = bytes(model.state)
    assert model.get() == pytest.approx([2.0])
    assert model.step([1e200]) == 2
    assert bytes(model.state) == before
    assert model.get() == pytest.approx([2.0])


@pytest.mark.usefixtures("size")
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_mode_that_is_too_fast_for_rk4_has_its_status(built, precision):
    """Dx/dt = λ (u - x), with another λ after the export, and four steps of RK4 in a tick."""

    def graph_of(g):
        x, per_s, u = g.source("state"), g.source("parameter"), g.source("input")
        error = g.subtract(u, x)
        return {"derivatives": [g.multiply(per_s, error)], "outputs": {"y": [x]}}

    names = {"states": ["x"], "parameters": ["m.rate"], "inputs": {"u": 1}}
    start, times = State(np.zeros(1), np.zeros(0)), {"tick_s": 4e-3, "step_s": 1e-3}
    source = CSource(equations_of(graph_of, **names), "m", np.ones(1), start, precision, **times)
    for product, status in ((1.7, 0), (1.9, 32)):
        model = built(replace(source, parameters=np.array([product * 1e3])))
        assert (model.init([0.0]), model.step([1.0])) == (0, status)
        assert model.step([model.get()[0]]) == 0  # nothing moves
    unchecked = built(replace(source, parameters=np.array([5e3]), checks_steps=False))
    assert (unchecked.init([0.0]), unchecked.step([1.0])) == (0, 0)


def test_a_start_with_bad_inputs_or_parameters_says_so(built):
    assert built(guarded()).init([math.nan]) == 1

    def graph_of(g):
        return {"outputs": {"y": [g.node("log", g.source("parameter", 0))]}}

    equations = equations_of(graph_of, parameters=["m.a"])
    source = CSource(equations, "m", np.array([-1.0]), State(np.zeros(0), np.zeros(0)), tick_s=0.1)
    assert built(source).init() == 2


def test_a_model_whose_start_failed_is_not_started(built):
    model = built(guarded())
    assert (model.step([2.0]), model.now([2.0])) == (8, 8)
    assert model.init([1.0]) == 0
    assert model.step([0.05]) == 0
    assert model.init([math.nan]) == 1
    assert (model.step([2.0]), model.now([2.0])) == (8, 8)
    assert model.get() == [0.0]
    assert model.init([1.0]) == 0
    assert (model.step([2.0]), model.now([2.0])) == (0, 0)
    assert model.get() == [0.5]
    header = guarded().files()["m.h"]
    assert "#define M_NOT_STARTED 8U" in header
    assert "#define M_BAD_PARAMETER 16U" in header


@pytest.mark.parametrize("precision", ["double", "float"])
def test_every_number_of_the_parameters_must_be_finite(built, precision):
    """Y = (k₁ k₂) g₀ g₁ x with x⁺ = x: a change of any of them acts, unless it is not finite."""

    def graph_of(g):
        p = [g.source("parameter", i) for i in range(4)]
        x = g.source("discrete", 0)
        return {
            "updates": [Update(0.1, 0.0, ((0, x),))],
            "outputs": {"y": [g.multiply(g.multiply(*p), x)]},
            "initial_discrete": [x],
        }

    names = ["law.k_1", "law.k_2", "law.0[0]", "law.0[1]"]
    equations = equations_of(graph_of, parameters=names, discrete=["law.1[0]"])
    state = State(np.zeros(0), np.array([7.0]))
    source = CSource(equations, "m", np.array([1.0, 2.0, 3.0, 5.0]), state, precision=precision)
    model = built(source)
    real = {"double": ctypes.c_double, "float": ctypes.c_float}[precision]
    right = model.params = (real * 5)(1.0, 2.0, 3.0, 5.0, 7.0)
    for place in range(5):
        for value in (math.nan, math.inf, -math.inf):
            model.params = (real * 5)(*right)
            model.params[place] = value
            assert model.init() == 16
            assert model.step() == 8
            wrong, model.params = model.params, right
            assert model.init() == 0
            before = bytes(model.state)
            assert model.update(wrong) == 16
            assert bytes(model.state) == before
            assert model.step() == 0
            assert model.get() == [210.0]
    model.params = (real * 5)(10.0, 2.0, 3.0, 5.0, 7.0)
    assert model.update(model.params) == 0
    assert model.step() == 0
    assert model.get() == [2100.0]


# ----------------------------------------------------------------------------------- text


def test_equal_diagrams_give_equal_text(multirate):
    sources = [exported(oscillator(), inputs=["u0"], tick_s=0.01) for _ in range(2)]
    assert sources[0].files() == sources[1].files()
    assert exported(multirate).files() == exported(multirate).files()


def test_text_names_leaf_systems_and_is_ascii(multirate):
    files = exported(multirate).files()
    assert "/* inner/plant: time derivatives. LinearSystem." in files["model.c"]
    assert "x" in files["model.h"]
    for text in files.values():
        assert text.isascii()
        assert text.startswith("/* Made by diagramc")
        assert "@" not in text
        assert not re.search(r"\b(NAME|UPPER|REAL|STATES|HELD)\b", text)


def test_a_double_needs_53_bits():
    assert "DBL_MANT_DIG" in exported(accumulator(), inputs=["u0"]).files()["model.h"]
    single = exported(accumulator(), inputs=["u0"], precision="float").files()["model.h"]
    assert "DBL_MANT_DIG" not in single
    assert "typedef float model_real_t;" in single


@pytest.mark.parametrize("precision", ["double", "float"])
def test_state_bytes_are_those_of_the_compiler(c_text, multirate, precision):
    clocked = exported(multirate, precision=precision)
    unclocked = exported(accumulator(), inputs=["u0"], precision=precision)
    assert (clocked.plan.counts_steps, unclocked.plan.counts_steps) == (True, False)
    stiff = exported(
        oscillator(), inputs=["u0"], tick_s=0.01, integrator="rosenbrock", precision=precision
    )
    for source in (clocked, unclocked, stiff):
        files = source.files()
        text = files["model.h"] + "unsigned long size(void) { return sizeof(model_state_t); }\n"
        assert c_text(text).size() == source.state_bytes


@pytest.mark.parametrize("name", ["initial_x", "initial_d", "d", "x", "a*/b", "a\\", "a＼", "??/"])
def test_any_name_of_a_leaf_system_compiles(built, name):
    def graph_of(g):
        x = g.source("discrete", 0)
        y = g.multiply(g.source("parameter", 0), x)
        section = Section(f"{name}: output. {name}", f"x = d * p; {name}\n*/ /* of it", (y,))
        updates = [Update(0.1, 0.0, ((0, x),))]
        return {"outputs": {"y": [y]}, "initial_discrete": [x], "updates": updates} | {
            "sections": [section]
        }

    equations = equations_of(graph_of, parameters=[f"{name}.k"], discrete=[f"{name}.0[0]\n*/"])
    state = State(np.zeros(0), np.array([3.0]))
    source = CSource(equations, "m", np.array([2.0]), state, subject=f"{name}\nall: */")
    assert built(source).replay(np.zeros((1, 0))).tolist() == [[6.0]]
    assert "\n" not in source.first_line
    assert "\\" not in source.first_line


# ------------------------------------------------------------------------------ bad input


ALL_COUNTS = Interface(integers=frozenset(["u0"]), ranges={"u0": (0, 9)}, accepts_inputs=True)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"name": "2nd"}, "name = '2nd': must be a C identifier"),
        ({"name": "a b"}, "must be a C identifier"),
        ({"name": "a" * 32}, "at most 31"),
        ({"name": "while"}, r"^name = 'while': is reserved in C or C\+\+; choose another name"),
        ({"name": "xor"}, "name = 'xor': is reserved in C"),
        ({"name": None}, "name = None: must be a C identifier"),
        ({"precision": ["float"]}, r"precision = \['float'\]: must be one of double, float"),
        ({"outputs": 3}, "outputs = 3: must be names"),
        ({"outputs": [3]}, "an element of outputs = 3: must be a name"),
        ({"look_up": "no"}, "look_up = 'no': must be True or False"),
        ({"subject": 3}, "subject = 3: must be a text"),
        *(
            ({"origin": origin}, r"^origin = .*: must be a pair of texts \(file name, text\)")
            for origin in ("a.yaml", ("a",), (1, 2))
        ),
        ({"tick_s": 1e-300}, "tick_s = 1e-300 s: is too short beside the sample times of model"),
        ({"step": 1e-3}, "option 'step': is unknown; known: precision, outputs, interface, tick_s"),
        ({"context": 3}, "context = 3: must be a Context of the diagram"),
        (
            {"context": Gain(1.0, 1).CreateDefaultContext()},
            "context = .*: must be a Context of the diagram; create it by CreateDefaultContext",
        ),
        ({"interface": 3}, "interface = 3: must be an Interface"),
        ({"tick_s": "x"}, "tick_s = 'x': must be finite and > 0 s"),
        *(
            ({"name": name}, f"name = '{name}': is a header of C; choose another name")
            for name in ("math", "stdint", "float", "Time", "stdio", "errno", "string")
        ),
        ({"precision": "half"}, "precision = 'half': must be one of double, float"),
        ({"outputs": ["speed"]}, "output 'speed' is unknown; known: y0"),
        ({"outputs": ["y0", "y0"]}, "outputs: has 'y0' twice; give each name once"),
        ({"step_s": 0.0}, "step_s = 0 s: must be finite and > 0 s"),
        ({"interface": Interface({"u0": ["a", "b"]})}, "u0: has 2 names in C; must be 1"),
        ({"interface": Interface(integers=frozenset(["y"]))}, "y: is no input"),
        ({"interface": Interface({"u": ["a"]})}, "fields: the port 'u' is unknown; known: u0, y0"),
        (
            {"interface": Interface({"u0": ["a"]}, ranges={"u0": (0, 1)})},
            "ranges: the element 'u0' is unknown; known: a",
        ),
        (
            {"interface": Interface({"y0": ["a"]}, failed_outputs={"y0": 1.0})},
            "failed_outputs: the element 'y0' is unknown; known: a",
        ),
        (
            {"look_up": True, "interface": ALL_COUNTS},
            "look_up: nothing depends on an integer input with a range alone",
        ),
        *(
            (
                {"interface": Interface(integers=frozenset(["u0"]), ranges={"u0": ends})},
                r"interface: range of u0 = .*: must have a whole number, and lie in -2147483648 … ",
            )
            for ends in ((0.2, 0.8), (0, 2**31), (-(2**31) - 1, 0))
        ),
    ],
)
def test_bad_options_are_one_line(options, match):
    with pytest.raises(CompilationError, match=match) as error:
        exported(accumulator(), **{"inputs": ["u0"], **options})
    assert "\n" not in str(error.value)


def test_a_single_output_may_be_a_string():
    assert list(exported(accumulator(), inputs=["u0"], outputs="y0").output_ports) == ["y0"]


def test_numbers_beyond_single_precision_are_refused():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1e60]))
    gain = builder.AddNamedSystem("gain", Gain(1e-60, 1))
    builder.Connect(source.get_output_port(), gain.get_input_port())
    builder.ExportOutput(gain.get_output_port(), "y")
    diagram = builder.Build()
    exported(diagram, tick_s=0.1).files()
    with pytest.raises(CompilationError, match=r"= 1e[+-]60: lies outside 1.17549e-38"):
        exported(diagram, tick_s=0.1, precision="float").files()
