"""Shared by the tests of the compiler: IR text as functions, an interpreter, and diagrams."""

import ctypes
import hashlib
import itertools
import math
import shutil
import subprocess
import sys
from collections import Counter
from fractions import Fraction
from functools import reduce
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pydrake.math as drake_math
import pytest
from hypothesis import strategies as st
from pydrake.systems.framework import BasicVector_, DiagramBuilder, LeafSystem_
from pydrake.systems.primitives import (
    Adder,
    Gain,
    LinearSystem,
    LogVectorOutput,
    Saturation,
    Sine,
    ZeroOrderHold,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from diagramc import SimulationError, compile_diagram
from diagramc.equations.graph import SOURCES, Graph
from diagramc.equations.operations import COMPARISONS, UNARY
from diagramc.equations.passes import ALWAYS, Group
from diagramc.native import cache, llvm as native_code
from diagramc.native.arguments import MEMO_LINES
from diagramc.native.ir import Array, Module
from diagramc.native.llvm import Library, compile_text, processor
from diagramc.native.printer import Printer, Storage
from diagramc.native.types import BYTE, DOUBLE, POINTER

# ------------------------------------------------------------------------- the interpreter

_OPERATIONS = {
    "add": lambda *a: reduce(np.add, a),
    "multiply": lambda *a: reduce(np.multiply, a),
    "divide": np.divide,
    "power": np.power,
    "atan2": np.arctan2,
    "min": lambda a, b: np.where(b < a, b, a),
    "max": lambda a, b: np.where(a < b, b, a),
    "where": np.where,
    "gt": np.greater,
    "ge": np.greater_equal,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": lambda *a: reduce(np.logical_and, a),
    "or": lambda *a: reduce(np.logical_or, a),
    "not": np.logical_not,
} | {
    name: getattr(
        np, name.replace("asin", "arcsin").replace("acos", "arccos").replace("atan", "arctan")
    )
    for name in UNARY
}


def _interpreted(graph, roots, *, operations=(), number=np.float64, **values_of):
    """Values of nodes, computed node by node.

    ``values_of``: elements of each kind of source. ``operations`` and ``number``, of a constant,
    may be those of another arithmetic.
    """
    functions = _OPERATIONS | dict(operations)
    values = {}
    with np.errstate(all="ignore"):
        for node in graph.reachable(roots):
            kind, *arguments = graph.nodes[node]
            if kind == "constant":
                values[node] = number(arguments[0])
            elif kind in SOURCES:
                values[node] = values_of[kind][arguments[0]]
            else:
                values[node] = functions[kind](*(values[argument] for argument in arguments))
    return [values[root] for root in roots]


def _fma(a, b, c):
    if not all(map(math.isfinite, (a, b, c))):
        return c if math.isinf(c) and math.isfinite(a) and math.isfinite(b) else a * b + c
    total = Fraction(a) * Fraction(b) + Fraction(c)
    if not total:
        return a * b + c
    try:
        return float(total)
    except OverflowError:
        return math.inf if total > 0 else -math.inf


def _fused(graph, roots):
    """A graph and its roots where sums absorb their products, by the operation ``fma``.

    A product that a single sum uses alone is added last, its last factor fused; a factor of -1 is
    the sign of the others.
    """
    nodes = graph.reachable(roots)
    uses = Counter(argument for node in nodes for argument in graph.arguments(node))
    uses.update(roots)
    result, new = Graph(), {}

    def fusible(node):
        return graph.nodes[node][0] == "multiply" and uses[node] == 1

    def signed_factors(node):
        factors = graph.arguments(node)
        negative = sum(graph.value(factor) == -1.0 for factor in factors) % 2
        kept = [new[factor] for factor in factors if graph.value(factor) != -1.0]
        *most, last = kept or [result.one]
        if negative:
            most = [result.constant(-1.0), *most]
        return result.node("multiply", *(most or [result.one])), last

    for node in nodes:
        kind, *arguments = graph.nodes[node]
        if kind == "add":
            terms = [new[term] for term in arguments if not fusible(term)]
            products = [signed_factors(term) for term in arguments if fusible(term)]
            if not terms:
                terms, products = [result.node("multiply", *products[0])], products[1:]
            total = result.node("add", *terms)
            for product in products:
                total = result.node("fma", *product, total)
            new[node] = total
        elif kind in SOURCES:
            new[node] = result.node(kind, *arguments)
        else:
            new[node] = result.node(kind, *(new[argument] for argument in arguments))
    return result, [new[root] for root in roots]


@pytest.fixture(scope="session")
def interpreted():
    """The function ``interpreted(graph, roots, state=…, …)``: values of nodes, by NumPy."""
    return _interpreted


@pytest.fixture(scope="session")
def interpreted_fused():
    """The same, with sums that are fused as the printer fuses them."""
    fma = {"fma": np.vectorize(_fma, otypes=[float])}

    def interpret(graph, roots, *, operations=(), **values_of):
        return _interpreted(*_fused(graph, roots), operations=fma | dict(operations), **values_of)

    return interpret


# ---------------------------------------------------------------------------- random graphs

EDGES = (
    *(0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, 3.0, 0.1, math.inf, -math.inf, math.nan),
    *(5e-324, -5e-324, 1e-310, 2.2250738585072014e-308, -1.7976931348623157e308, 1e200, 1e-200),
    *(math.pi, -math.pi / 2, 1e5, -1e9, 1.0000001e9, 1e22, 1e300, -7e18, 2.0**52 + 1.0, 2.0**31),
)
SIZES = {"time": 1, "parameter": 3, "state": 3, "discrete": 2, "input": 2}
"""Elements of each kind of source in a random graph."""

EXACT = ("add", "multiply", "divide", "sqrt", "abs", "floor", "ceil", "min", "max", "where")
"""Operations whose result IEEE 754 fixes."""


@st.composite
def _graphs(draw, kinds=EXACT, *, nodes=25, roots=6, constants=EDGES, sizes=None):
    """A graph of operations of ``kinds`` and of conditions, and the numbers of its last roots."""
    graph = Graph()

    def pick(among):
        return among[-1 - draw(st.integers(0, len(among) - 1))]

    numbers = [
        graph.source(kind, i) for kind, size in (sizes or SIZES).items() for i in range(size)
    ]
    plain = list(numbers)
    numbers += [graph.constant(draw(st.sampled_from(constants))) for _ in range(3)]
    conditions = [graph.node("lt", *numbers[:2])]
    all_kinds = (*kinds, "add", "multiply", "negative", "condition", "logic")
    for _ in range(nodes):
        kind = draw(st.sampled_from(all_kinds))
        if kind == "condition":
            name = draw(st.sampled_from(tuple(COMPARISONS)))
            conditions.append(graph.node(name, pick(numbers), pick(numbers)))
        elif kind == "logic":
            name = draw(st.sampled_from(("and", "or", "not")))
            count = 1 if name == "not" else draw(st.integers(2, 3))
            conditions.append(graph.simplified(name, *(pick(conditions) for _ in range(count))))
        elif kind == "where":
            arguments = pick(conditions), pick(numbers), pick(numbers)
            numbers.append(graph.node("where", *arguments))
        elif kind in UNARY:
            numbers.append(graph.node(kind, pick(numbers)))
        elif kind == "power":  # LLVM knows better than the C library what constant exponents do
            numbers.append(graph.node(kind, pick(plain), pick(plain)))
        elif kind == "negative":
            factors = [pick(numbers) for _ in range(draw(st.integers(0, 3)))]
            factors += [graph.constant(-1.0)] * draw(st.integers(1, 2))
            numbers.append(graph.node("multiply", *draw(st.permutations(factors))))
        elif kind in ("add", "multiply"):
            count = draw(st.integers(2, 4))
            numbers.append(graph.node(kind, *(pick(numbers) for _ in range(count))))
        else:
            numbers.append(graph.node(kind, pick(numbers), pick(numbers)))
    return graph, numbers[-roots:]


def _samples(seed, count, edges=EDGES, sizes=None):
    """Values of all sources, (elements, count) each: edges and normal numbers."""
    rng = np.random.default_rng(seed)
    return {
        kind: np.where(
            rng.random((size, count)) < 0.3,
            rng.choice(edges, (size, count)),
            rng.normal(size=(size, count)) * 10.0 ** rng.integers(-3, 4, (size, count)),
        )
        for kind, size in (sizes or SIZES).items()
    }


@pytest.fixture(scope="session")
def random_graphs():
    """Strategies and samples of random graphs, and the edge values among them."""
    return SimpleNamespace(graphs=_graphs, samples=_samples, edges=EDGES, exact=EXACT, sizes=SIZES)


# ---------------------------------------------------------------------------- machine code


def remembered(text):
    """Machine code of IR text: that of an earlier test or run where there is one.

    The key holds the file that compiles, so that a change of it counts.
    """
    maker = hashlib.sha256(Path(native_code.__file__).read_bytes()).hexdigest()
    key = repr((text, processor().key, maker))
    code = cache.load(key)
    if code is None:
        code = compile_text(text)
        cache.store(key, code)
    return code


@pytest.fixture(scope="session")
def native():
    """``native(text)(name, result, *arguments)``: a function of IR text, with ctypes' types."""

    def load(text):
        library = Library(remembered(text))

        def function(name, result, *arguments):
            return ctypes.cast(library.function(name, 0), ctypes.CFUNCTYPE(result, *arguments))

        return function

    return load


# ---------------------------------------------------------------------------- printed code


class _Outputs(Storage):
    """Stores results of every kind in ``out``; the array ``fires`` has the conditions of groups."""

    def store(self, place, value):
        self.arrays["out"][place[1]] = value

    def condition(self, condition):
        return self.arrays["fires"][condition[1]].differs(0)


class _Code:
    """Groups of a program as machine code, for each of several numbers of lanes."""

    def __init__(self, program, groups, *, lanes=(1,), memory=False, target=None):
        self.program, self.groups = program, groups
        widths = [len(memo.nodes) for memo in program.memos] if memory else []
        self.memory = {
            count: [
                values
                for width in widths
                for values in (
                    np.full((MEMO_LINES, count), np.nan),
                    np.full((MEMO_LINES, count, width), 1e99),
                )
            ]
            for count in lanes
        }
        """For each memo its tags, (lines, lanes), and its values, (lines, lanes, nodes)."""
        module = Module()
        for count in lanes:
            self._define(module, count)
        self.text = module.text()
        code = (
            compile_text(self.text, target)  # which may warn
            if target
            else remembered(self.text)
        )
        self.library = Library(code)

    def _define(self, module, lanes):
        type_ = DOUBLE.of(lanes)
        memory = [f"memory{i}" for i in range(len(self.memory[lanes]))]
        names = (*SOURCES, "fires", "out", *memory)
        f = module.function(f"f{lanes}", dict.fromkeys(names, POINTER), internal=False)
        arrays = {name: Array(f.arguments[name], type_) for name in names}
        arrays["fires"] = Array(f.arguments["fires"], BYTE)
        storage = _Outputs(arrays.pop("time")[0], **arrays)
        tables = [Array(f.arguments[name], DOUBLE) for name in memory] or None
        Printer(f, self.program, storage, memory=tables).emit_groups(self.groups)

    def __call__(self, lanes=1, fires=(1,) * 8, **values_of):
        """Targets (targets, samples) from sources (elements, samples); 77.0 if not stored."""
        samples = values_of["time"].shape[1]
        count = 1 + max(place[1] for group in self.groups for place, _ in group.targets)
        out = np.full((samples // lanes, count, lanes), 77.0)
        function = self.library.function(f"f{lanes}", len(SOURCES) + 2 + len(self.memory[lanes]))
        flags = np.array(fires, dtype=np.uint8)
        for block in range(samples // lanes):
            some = slice(block * lanes, (block + 1) * lanes)
            arrays = [
                np.ascontiguousarray(values_of[kind][:, some]) if kind in values_of else out
                for kind in SOURCES
            ]
            arrays += [flags, out[block], *self.memory[lanes]]
            function(*(array.ctypes.data for array in arrays))
        return out.swapaxes(0, 1).reshape(count, -1)


def _plain_code(graph, roots, *, deciding=(), **options):
    """Roots of a graph, printed as they are: nothing is hoisted or kept in tables."""
    program = SimpleNamespace(graph=graph, hoisted={}, memos=(), deciding=set(deciding))
    targets = tuple((("output", i), root) for i, root in enumerate(roots))
    return _Code(program, [Group(ALWAYS, targets)], **options)


@pytest.fixture(scope="session")
def printed():
    """The class of printed ``groups`` of a program, and the function for a ``plain`` graph."""
    return SimpleNamespace(groups=_Code, plain=_plain_code)


# -------------------------------------------------------------------------------- diagrams


@pytest.fixture
def multirate():
    """A sine, held every 4 ms, through a plant, sampled every 10 ms from 5 ms on; nested."""
    inner = DiagramBuilder()
    plant = inner.AddNamedSystem(
        "plant",
        LinearSystem(A=[[0.0, 1.0], [-400.0, -4.0]], B=[[0.0], [400.0]], C=[[1.0, 0.0]], D=[[0.0]]),
    )
    limit = inner.AddNamedSystem("limit", Saturation(min_value=[-0.7], max_value=[0.7]))
    inner.Connect(limit.get_output_port(), plant.get_input_port())
    inner.ExportInput(limit.get_input_port(), "u")
    inner.ExportOutput(plant.get_output_port(), "y")
    inner = inner.Build()
    inner.set_name("inner")
    builder = DiagramBuilder()
    sine = builder.AddNamedSystem("sine", Sine(1.0, 10.0, 0.3, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.004, 1))
    builder.AddNamedSystem("inner", inner)
    sampler = builder.AddNamedSystem("sampler", ZeroOrderHold(0.010, 1, offset_sec=0.005))
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    builder.Connect(sine.get_output_port(0), hold.get_input_port())
    builder.Connect(hold.get_output_port(), inner.get_input_port())
    builder.Connect(inner.get_output_port(), sampler.get_input_port())
    builder.Connect(sampler.get_output_port(), gain.get_input_port())
    for name, system in (("y", inner), ("sampled", gain), ("held", hold)):
        builder.ExportOutput(system.get_output_port(), name)
        log = LogVectorOutput(system.get_output_port(), builder, publish_period=0.002)
        log.set_name(f"log_{name}")
    return builder.Build()


@pytest.fixture(scope="session")
def leaf():
    """``leaf(name, construct)``: a leaf of all scalars that ``construct(self, T)`` declares.

    The function may set ``self.rates(context, derivatives)``, which computes the derivatives.
    """

    def make(name, construct):
        def template(T):
            class Impl(LeafSystem_[T]):
                rates = staticmethod(lambda context, derivatives: None)  # without continuous states

                def _construct(self, *, converter=None):
                    LeafSystem_[T].__init__(self, converter)
                    construct(self, T)

                def _construct_copy(self, other, converter=None):
                    Impl._construct(self, converter=converter)

                def DoCalcTimeDerivatives(self, context, derivatives):
                    self.rates(context, derivatives)

            return Impl

        scope = sys.modules[__name__]
        return TemplateSystem.define(f"{name}_", scope=scope)(template)[float]()

    return make


ARM = {"lag_s": 0.01, "mass_kg": 1.6, "stiffness_kn_m": 1.25e4, "limit_m": 0.15}
"""Parameters of the arm of `servo`."""


def _servo_arm(leaf, T):
    """Construct a mass on a stiff drive, behind a motor with lag; limits of its position.

    States: motor speed v in rad/s, position x in m, velocity w in m/s, force f in kN. With the
    command u: v' = (u - v)/lag, x' = w, w' = 1000 f/m - d w, f' = k (c v - w).
    """
    leaf.DeclareContinuousState(4)
    leaf.parameter_names = tuple(ARM)
    leaf.DeclareNumericParameter(BasicVector_[T](list(ARM.values())))
    command = leaf.DeclareVectorInputPort("command", 1)
    for index, name in enumerate(("speed", "position", "velocity", "force")):
        leaf.DeclareVectorOutputPort(
            name,
            1,
            lambda context, out, i=index: out.SetAtIndex(
                0, context.get_continuous_state_vector()[i]
            ),
            {leaf.all_state_ticket()},
        )

    def rates(context, derivatives):
        v, _, w, f = context.get_continuous_state_vector().CopyToVector()
        lag, mass, stiffness, _ = context.get_numeric_parameter(0).CopyToVector()
        (u,) = command.Eval(context)
        rate = [(u - v) / lag, w, 1e3 * f / mass - 20.0 * w, stiffness * (0.01 * v - w)]
        derivatives.get_mutable_vector().SetFromVector(rate)

    def margin(context):
        limit = context.get_numeric_parameter(0)[3]
        return limit - drake_math.abs(context.get_continuous_state_vector()[1])

    def check(context):
        if not margin(context) >= 0.0:
            position = context.get_continuous_state_vector()[1]
            raise SimulationError(
                f"t = {context.get_time():.6g} s: arm: position = {position:.6g} m"
            )

    leaf.rates = rates
    leaf.margin, leaf.check = margin, check


@pytest.fixture(scope="session")
def servo(leaf):
    """A model of a sampled position loop, its parameters and its initialized state."""
    builder = DiagramBuilder()
    reference = builder.AddNamedSystem("reference", Sine(0.05, 6.0, 0.3, 1))
    error = builder.AddNamedSystem("error", Adder(2, 1))
    law = builder.AddNamedSystem("law", Gain(4000.0, 1))
    limit = builder.AddNamedSystem("limit", Saturation([-60.0], [60.0]))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.002, 1))
    arm = builder.AddNamedSystem("arm", leaf("Arm", _servo_arm))
    back = builder.AddNamedSystem("back", Gain(-1.0, 1))
    builder.Connect(reference.get_output_port(0), error.get_input_port(0))
    builder.Connect(arm.GetOutputPort("position"), back.get_input_port())
    builder.Connect(back.get_output_port(), error.get_input_port(1))
    for first, second in ((error, law), (law, limit), (limit, hold), (hold, arm)):
        builder.Connect(first.get_output_port(), second.get_input_port())
    builder.ExportOutput(reference.get_output_port(0), "reference")
    builder.ExportOutput(hold.get_output_port(), "command")
    for name in ("speed", "position", "velocity", "force"):
        builder.ExportOutput(arm.GetOutputPort(name), name)
    model = compile_diagram(builder.Build())
    parameters = model.parameters()
    return model, parameters, model.initialized(parameters, model.state())


# ---------------------------------------------------------------------------- exported code


class _Built:
    """An exported model as shared library: one instance of it."""

    def __init__(self, source, folder):
        self.source = source
        for name, text in source.files().items():
            (folder / name).write_text(text)
        real = {"double": ctypes.c_double, "float": ctypes.c_float}[source.precision]

        def structure(fields):
            kinds = [(f.name, ctypes.c_int32 if f.is_integer else real) for f in fields]
            return type("Structure", (ctypes.Structure,), {"_fields_": kinds or [("none", real)]})

        self.inputs = structure(source.plan.inputs)()
        self.outputs = structure(source.plan.outputs)()
        self.library = c_library(folder, *(name for name in source.files() if name.endswith(".c")))
        self.state = ctypes.create_string_buffer(2 * source.state_bytes + 64)
        self.params = ctypes.c_char.in_dll(self.library, f"{source.name}_params")

    def _call(self, name, *arguments):
        return getattr(self.library, f"{self.source.name}_{name}")(*map(ctypes.byref, arguments))

    def set(self, values):
        """Take the inputs in their order."""
        for field, value in zip(self.source.plan.inputs, values, strict=True):
            setattr(self.inputs, field.name, int(value) if field.is_integer else value)

    def get(self):
        """The outputs in their order."""
        return [getattr(self.outputs, field.name) for field in self.source.plan.outputs]

    def init(self, values=()):
        """Start with these inputs; returns the status."""
        self.set(values)
        return self._call("init", self.state, self.params, self.inputs)

    def update(self, params):
        """Take what follows from other parameters; returns the status."""
        return self._call("update_parameters", self.state, params)

    def step(self, values=()):
        """Go over a tick with these inputs; returns the status."""
        self.set(values)
        return self._call("step", self.params, self.state, self.inputs, self.outputs)

    def now(self, values=()):
        """Set the outputs at the present state; returns the status."""
        self.set(values)
        return self._call("outputs", self.params, self.state, self.inputs, self.outputs)

    def replay(self, inputs):
        """Outputs of each step (steps, output elements); every status must be 0."""
        assert self.init(inputs[0]) == 0
        rows = []
        for values in inputs:
            assert self.step(values) == 0
            rows.append(self.get())
        return np.array(rows)


def c_library(folder, *sources, options=("-O1", "-Wall", "-Wextra", "-Werror")):
    """C files of a folder as a shared library, without contraction of products and sums."""
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("needs a C compiler, gcc or clang")
    flags = ("-std=c99", "-ffp-contract=off", "-shared", "-fPIC", *options)
    command = [compiler, *flags, *sources, "-o", "library.so", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "library.so"))


@pytest.fixture
def built(tmp_path):
    """``built(source)``: an exported model as a library."""
    folders = (tmp_path / f"model{number}" for number in itertools.count())

    def build(source):
        folder = next(folders)
        folder.mkdir()
        return _Built(source, folder)

    return build


@pytest.fixture
def c_text(tmp_path):
    """``c_text(text)``: a C file as a library."""
    numbers = itertools.count()

    def build(text):
        number = next(numbers)
        folder = tmp_path / f"text{number}"
        folder.mkdir()
        (folder / "text.c").write_text(text)
        return c_library(folder, "text.c")

    return build
