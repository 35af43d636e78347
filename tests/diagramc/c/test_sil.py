"""The program that closes the loop of two exported models, against a loop by hand."""

import shutil
import subprocess

import numpy as np
import pytest
from pydrake.systems.primitives import LinearSystem

from diagramc import Interface, Sil, Vectors, read_diagram, source_of, write_sil
from diagramc.c import build as c_build
from diagramc.errors import CompilationError, OutputError

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs the C compiler gcc")

TICK_S, STEPS = 0.01, 40
COUNT = 0.25


START = 0.4
"""Angle of the motor before the first step."""


def linear(name, a, b, fields, start=0.0):
    """X⁺ = a x + b u from ``start``; the output after a step is x⁺. Ports have names in C."""
    system = LinearSystem([[a]], [b], [[1.0]], [[0.0] * len(b)], TICK_S)
    system.set_name(name)
    context = system.CreateDefaultContext()
    context.SetDiscreteState([start])
    read = read_diagram(system, inputs=["u0"])
    return source_of(read, name, context, interface=Interface(fields))


def law(name="law", reading="angle"):
    """The command is the state: x⁺ = 0.5 x + 2 reference − reading."""
    return linear(name, 0.5, [2.0, -1.0], {"u0": ("reference", reading), "y0": ("command",)})


def motor(name="motor"):
    """The angle is the state: x⁺ = 0.9 x + 0.1 command + 0.3 load."""
    fields = {"u0": ("command", "load"), "y0": ("angle",)}
    return linear(name, 0.9, [0.1, 0.3], fields, START)


def loop_by_hand(size=0.0):
    """Vectors of both models in their loop; a count of the angle has this size, 0: no counts."""
    reference, load = np.sin(0.3 * np.arange(STEPS)), np.linspace(0.0, 1.0, STEPS)
    command, angle, rows = 0.0, START, []
    for r, f in zip(reference, load, strict=True):
        reading = np.round(angle / size) if size else angle
        command = 0.5 * command + 2.0 * r - reading
        angle = 0.9 * angle + 0.1 * command + 0.3 * f
        rows.append(((r, reading), command, (command, f), angle))
    inputs, commands, actuated, angles = (np.array(column) for column in zip(*rows, strict=True))
    return Vectors(inputs, commands[:, None]), Vectors(actuated, angles[:, None])


@needs_compiler
def test_the_loop_in_c_is_the_loop_by_hand(tmp_path, no_targets):
    commands, angles = loop_by_hand()
    commands.inputs[:, 1] = 99.0  # the program computes this input, so it does not read the vector
    angles.inputs[:, 0] = -99.0
    measured = write_sil(tmp_path / "out", Sil((law(), commands), (motor(), angles), {}))
    assert measured.replay.passed
    assert measured.replay.difference["command"] <= 1e-13
    assert measured.replay.difference["angle"] <= 1e-13
    assert measured.replay.largest["angle"] == pytest.approx(np.abs(angles.outputs).max(), 1e-5)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("law", "motor", "sil.c", "Makefile", "manifest.json")
    }
    assert (tmp_path / "out" / "motor" / "manifest.json").exists()
    angles.outputs[7] += 0.01
    wrong = write_sil(tmp_path / "out", Sil((law(), commands), (motor(), angles), {}))
    assert not wrong.replay.passed
    assert wrong.replay.difference["angle"] == pytest.approx(0.01, rel=1e-2)


@needs_compiler
def test_counts_are_rounded_readings(tmp_path, no_targets):
    commands, angles = loop_by_hand(COUNT)
    controller = law(reading="count")
    counts = {"count": ("angle", COUNT)}
    measured = write_sil(tmp_path, Sil((controller, commands), (motor(), angles), counts))
    assert measured.replay.passed
    assert len(np.unique(commands.inputs[:, 1])) >= 5


@pytest.mark.slow
@needs_compiler
def test_make_builds_the_loop_in_a_folder_with_spaces(tmp_path, no_targets):
    out = tmp_path / "a loop"
    commands, angles = loop_by_hand()
    write_sil(out, Sil((law(), commands), (motor(), angles), {}))
    warnings = "CFLAGS=-O2 -Wall -Wextra -Wconversion -Wpedantic -Wdouble-promotion -Werror"
    for compiler in ("gcc", "clang"):
        if shutil.which(compiler):
            command = ["make", f"CC={compiler}", warnings]
            made = subprocess.run(command, cwd=out, capture_output=True, text=True, check=True)
            assert f"{STEPS} steps, 0 failures" in made.stdout
            assert (out / "build" / compiler / "sil").exists()
    (out / "law" / "law_vectors.c").write_text("")
    assert subprocess.run(["make"], cwd=out, capture_output=True).returncode != 0


def test_without_a_compiler_the_loop_is_written(tmp_path, no_targets, monkeypatch):
    monkeypatch.setattr(c_build, "COMPILERS", ())
    commands, angles = loop_by_hand()
    measured = write_sil(tmp_path, Sil((law(), commands), (motor(), angles), {}))
    assert measured.replay is None
    assert "differences" in measured.controller.not_measured
    assert "measured.angle = (law_real_t)signals.angle;" in (tmp_path / "sil.c").read_text()


def slow_motor():
    system = LinearSystem([[0.9]], [[0.1]], [[1.0]], [[0.0]], 2.0 * TICK_S)
    system.set_name("motor")
    return source_of(read_diagram(system, inputs=["u0"]), "motor")


@pytest.mark.parametrize(
    ("controller", "plant", "line"),
    [
        (law("motor"), motor(), "motor, motor: two models need different names"),
        (law(), slow_motor(), "law, motor: have ticks of 0.01 and 0.02 s"),
        (law(reading="speed"), motor(), "law, motor: no output of one is an input of the other"),
    ],
)
def test_models_that_form_no_loop_are_refused(controller, plant, line):
    commands, angles = loop_by_hand()
    with pytest.raises(CompilationError, match=line):
        Sil((controller, commands), (plant, angles), {})


def test_vectors_of_different_length_are_refused():
    commands, angles = loop_by_hand()
    shorter = Vectors(angles.inputs[:-1], angles.outputs[:-1])
    with pytest.raises(CompilationError, match="law, motor: have test vectors of different length"):
        Sil((law(), commands), (motor(), shorter), {})


@pytest.mark.parametrize("file", ["main.c", "motor/main.c", "motor"])
def test_files_of_others_are_not_touched(tmp_path, no_targets, monkeypatch, file):
    monkeypatch.setattr(c_build, "COMPILERS", ())
    commands, angles = loop_by_hand()
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("int main(void) { return 0; }\n")
    with pytest.raises(OutputError, match="has other files and no export; choose another"):
        write_sil(tmp_path, Sil((law(), commands), (motor(), angles), {}))
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [tmp_path / file]
