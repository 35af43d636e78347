"""Traceability of exported C: lines and the systems, sources and outputs that belong to them."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain, LinearSystem, Sine

from diagramc import export_c, read_diagram, source_of
from diagramc.c import build as c_build
from diagramc.c.source import CSource
from diagramc.c.traceability import Trace, _ranges, spans
from diagramc.equations.equations import Equations, Limit, Section, Update
from diagramc.run_data import State


def two_branches(memory=0.5):
    """Two branches without connection: a wave through a lag, and x⁺ = ``memory`` x + 2.5 u."""
    builder = DiagramBuilder()
    wave = builder.AddNamedSystem("wave", Sine(1.0, 20.0, 0.3, 1))
    lag = builder.AddNamedSystem("lag", LinearSystem([[-7.0]], [[7.0]], [[3.0]], [[0.0]]))
    gain = builder.AddNamedSystem("gain", Gain(2.5, 1))
    system = LinearSystem([[memory]], [[1.0]], [[1.0]], [[0.0]], 0.01)
    memory = builder.AddNamedSystem("memory", system)
    builder.Connect(wave.get_output_port(0), lag.get_input_port())
    builder.Connect(gain.get_output_port(), memory.get_input_port())
    builder.ExportInput(gain.get_input_port(), "u")
    builder.ExportOutput(lag.get_output_port(), "filtered")
    builder.ExportOutput(wave.get_output_port(0), "wave")
    builder.ExportOutput(memory.get_output_port(), "memory")
    return builder.Build()


def exported(diagram, **options):
    return source_of(read_diagram(diagram, inputs=["u"]), "m", tick_s=0.01, **options)


def trace_of(source):
    files = source.files()
    return Trace(source.plan, source.equations, source.output_ports, files["m.c"])


def test_each_line_has_its_system_and_what_depends_on_it():
    trace = trace_of(exported(two_branches()))
    rows = {(row[1], row[2]): row[3:] for row in trace.lines}
    assert rows["update_at", "memory: discrete update"] == ("LinearSystem.", "", "3")
    assert rows["outputs_at", "wave: output port y0"] == ("Sine.", "", "1-2")
    assert rows["outputs_at", "memory: output port y0"] == ("LinearSystem.", "", "3")
    assert rows["outputs_at", "lag: output port y0"] == ("LinearSystem.", "", "1")
    names = dict(trace.names)
    assert names["out->memory"] == "output port memory, output 3 of the test vectors"
    assert names["in->u"] == "input port u"
    assert names["x[0]"] == "state lag.x[0]"
    assert names["d[0]"] == "state memory.0[0]"
    numbers = {path: (kind, values) for path, kind, values in trace.frozen}
    assert numbers["wave"] == ("Sine", "0.3, 20")
    assert numbers["gain"] == ("Gain", "2.5")
    assert numbers["lag"] == ("LinearSystem", "-7, 3, 7")
    assert numbers["memory"] == ("LinearSystem", "0.5")


def test_constants_are_traced_to_the_line_that_computes_them():
    """Y = (a² + 1) u, whose factor is a constant."""
    equations = Equations(parameters=["law.a"], inputs={"u": 1})
    g = equations.graph
    square = g.multiply(g.source("parameter", 0), g.source("parameter", 0))
    y = g.multiply(g.add(square, g.one), g.source("input", 0))
    equations.outputs = {"y": [y]}
    equations.sections = [Section("law: output port y", "", (y,))]
    state = State(np.zeros(0), np.zeros(0))
    trace = trace_of(CSource(equations, "m", np.ones(1), state, tick_s=0.1))
    text = dict(trace.names)["c[0]"]
    number = re.fullmatch(r"line (\d+), law: output port y", text)[1]
    assert "c[0] = " in trace.text.splitlines()[int(number) - 1]


def test_a_margin_is_tested_by_the_status_and_by_what_reads_its_values():
    """The margin has the root of the state, which the output reads; the start depends on p."""
    equations = Equations(parameters=["law.p"], discrete=["law.0[0]"])
    g = equations.graph
    x = g.source("discrete", 0)
    root, start = g.node("sqrt", x), g.node("exp", g.source("parameter", 0))
    margin = g.subtract(g.constant(9.0), root)
    y = g.multiply(root, g.constant(3.0))
    equations.outputs = {"one": [g.constant(1.0)], "y": [y]}
    equations.limits = [Limit("law", margin)]
    equations.initial_discrete = [start]
    equations.updates = [Update(0.1, 0.0, ((0, x),))]
    equations.sections = [
        Section("law: margin", "", (margin,)),
        Section("law: output port y", "", (y,)),
        Section("law: initialization", "", (start,)),
    ]
    state = State(np.zeros(0), np.ones(1))
    trace = trace_of(CSource(equations, "m", np.ones(1), state))
    numbers = {row[1:3]: row[-1] for row in trace.lines}
    assert numbers["margins_at", "law: margin"] == "2, status"
    assert numbers["outputs_at", "law: output port y"] == "2"
    assert numbers["constants_of", "law: initialization"] == "2"


def changed_text(text, span):
    """C text with 0.01 more in the first value that the lines of a span compute."""
    lines = text.splitlines()
    for place in range(span.first - 1, span.last):
        start = re.match(r"\s*(?:const real )?[\w\[\]>-]+ = ", lines[place])
        if start:
            end = next(i for i in range(place, span.last) if lines[i].endswith(";"))
            value = " ".join(lines[place : end + 1])[start.end() :].rstrip(";")
            lines[place : end + 1] = [f"{start[0]}({value}) + 0.01f;"]
            return "\n".join(lines) + "\n"
    raise AssertionError(f"no value in the lines of {span}")


def numbers_of(text):
    """Numbers of outputs in a row: ``1-3, 5`` gives 1, 2, 3, 5."""
    ends = [part.split("-") for part in text.split(", ")]
    return [n for part in ends for n in range(int(part[0]), int(part[-1]) + 1)]


def test_wrong_lines_change_the_outputs_of_their_row_and_no_others(built):
    """A system that several functions compute is wrong in each of them."""
    source = exported(two_branches())
    inputs = np.full((6, 1), 1.3)
    expected = built(source).replay(inputs)
    files, sections = source.files(), source.equations.sections
    fields = {key: getattr(source, key) for key in ("name", "plan", "precision", "state_bytes")}
    rows = {row[2]: row[-1] for row in trace_of(source).lines}
    for where, numbers in rows.items():
        text = files["m.c"]
        for span in reversed([s for s in spans(text, sections) if s.section.where == where]):
            text = changed_text(text, span)
        mutant = SimpleNamespace(files=lambda text=text: files | {"m.c": text}, **fields)
        changes = np.abs(built(mutant).replay(inputs) - expected).max(axis=0) > 1e-12
        assert (np.flatnonzero(changes) + 1).tolist() == numbers_of(numbers), where
    assert {"1", "1-2", "3"} <= set(rows.values())


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("diagram", ["multirate", "two_branches"])
def test_each_statement_of_the_equations_is_in_one_row(request, diagram, precision):
    """The discrete state of `two_branches` is a compensated sum in single precision."""
    if diagram == "multirate":
        read = read_diagram(request.getfixturevalue("multirate"))
    else:
        read = read_diagram(two_branches(memory=1.0), inputs=["u"])
    source = source_of(read, "m", precision=precision)
    assert bool(source.plan.sums) == (diagram == "two_branches" and precision == "float")
    text = source.files()["m.c"]
    traced = [
        line
        for span in spans(text, source.equations.sections)
        for line in range(span.first, span.last + 1)
    ]
    assert len(traced) == len(set(traced))
    lines = text.splitlines()
    for name in ("update_at", "outputs_at", "initial_at"):
        first = next(n for n, line in enumerate(lines, 1) if f" {name}(" in line)
        body = range(first + 1, lines.index("}", first) + 1)
        values = [n for n in body if re.search(r" = (?!at->)", lines[n - 1])]
        assert set(values) <= set(traced), name
        assert values

    def matching(pattern):
        return {n for n, line in enumerate(lines, 1) if re.match(pattern, line)}

    rates = matching(r"\s+(const real held|rate)\d = ")
    assert rates
    assert rates <= set(traced)
    assert not matching(r"\s+(for|total|x\d) .*=") & set(traced)


def test_a_span_ends_before_the_next_comment_or_block():
    sections = [
        Section("a: output port y", "A: Long equation of the first system.", (1,)),
        Section("b: output port y", "B.", (2,)),
    ]
    text = (
        "/* Made by a tool. */\n"  # line 1
        "static void f(real *y)\n{\n"
        "    /* a: output port y. A: Long equation of the\n"  # line 4
        "     * first system. */\n"
        "    y[0] = 1.0 +\n"
        "        2.0;\n"  # line 7
        "    /* b: output port y. B. */\n"
        "    y[1] = 1.0;\n"  # line 9
        "}\n\n"
        "uint16_t m_step(real *y)\n{\n"
        "    if (true) {\n"
        "        /* b: output port y. B. */\n"  # line 15
        "        y[1] = 1.0;\n"
        "        /* Something else. */\n"
        "        y[2] = 1.0;\n"
        "    }\n}\n"
    )
    assert [(s.first, s.last, s.function, s.section.where[0]) for s in spans(text, sections)] == [
        (4, 7, "f", "a"),
        (8, 9, "f", "b"),
        (15, 16, "m_step", "b"),
    ]


def test_numbers_become_ranges():
    assert _ranges([1, 2, 3, 5, 8, 9]) == ["1-3", "5", "8-9"]
    assert _ranges([]) == []


def tables_of(text):
    """Return each Markdown table of a text as rows of cells, the head first."""
    blocks = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    rows = [[line[1:-1].split("|") for line in block.splitlines()] for block in blocks]
    cells = [[[cell.strip() for cell in row] for row in table] for table in rows]
    return [[table[0], *table[2:]] for table in cells]  # the second row is a line of dashes


def test_the_table_is_a_file_of_the_export(tmp_path, no_targets, monkeypatch):
    monkeypatch.setattr(c_build, "COMPILERS", ())
    samples = np.full((3, 1), 1.3)
    options = {"name": "m", "inputs": ["u"], "samples": samples, "tick_s": 0.01}
    export_c(two_branches(), tmp_path, **options)
    text = (tmp_path / "traceability.md").read_text()
    lines, names = tables_of(text)
    trace = trace_of(exported(two_branches()))
    assert [tuple(row) for row in lines[1:]] == trace.lines
    assert [row[0].strip("`") for row in names[1:]] == [row[0] for row in trace.names]
    (frozen,) = (t for t in tables_of((tmp_path / "README.md").read_text()) if "class" in t[0])
    assert [tuple(row) for row in frozen[1:]] == trace.frozen
