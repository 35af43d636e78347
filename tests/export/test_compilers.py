"""The exported C under two compilers, two sanitizers and impossible inputs; what it may contain."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.primitives import Gain, Integrator, LinearSystem, ZeroOrderHold

from diagramc import read_diagram
from diagramc.c.export import files_of
from diagramc.c.source import source_of
from kneexo.export.firmware import make_firmware
from kneexo.export.target import count_range, reference_range_rad
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed

pytestmark = pytest.mark.slow  # compilers, analysers and emulators

FUZZ_C = Path(__file__).with_name("fuzz.c")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wpedantic", "-Werror")
COMPILERS = {
    "gcc": ("gcc", "-std=c99", "-O2", *WARNINGS, "-c"),  # -O2: data flow
    "clang": ("clang", "-std=c99", *WARNINGS, "-fsyntax-only"),
}
SANITIZERS = ("-g", "-O1", "-ffp-contract=off", "-fno-sanitize-recover=all")
SANITIZERS += ("-fsanitize=address,undefined,float-cast-overflow",)
TARGETS = ("controller", "plant", "loop")
PRECISIONS = ("double", "float")

SAMPLED = {"kind": "samples", "times_s": [0.0, 1.0, 2.0], "angles_deg": [10.0, 30.0, 20.0]}
PID = {"controller": {"kind": "pid", "integral_per_s2": 100.0}}
STRUCTURES = {
    "pid": (PID, ("controller",)),
    "load": ({"plant.load": {"kind": "knee", "knee_torque_n_m": 3.0}}, ("plant", "loop")),
    "full_order": ({"plant.full_order": {"coulomb_friction_n": 40.0}}, ("plant", "loop")),
    "difference": (
        {"estimator": {"kind": "difference"}, "controller.switching": "signum"},
        ("controller",),
    ),
    "samples": ({"reference": SAMPLED, "bus": {"latency_samples": 2}}, ("controller", "loop")),
    "unquantized": ({"encoder.quantized": False, "plant.rod_map": "polynomial"}, TARGETS),
}
"""Changes of the default scenario, and the targets that they change."""


def write(folder, files):
    """Write files; the names of those in C."""
    for name, text in files.items():
        (folder / name).write_text(text)
    return sorted(name for name in files if name.endswith(".c"))


def with_harness(scenario, what, precision, **options):
    return files_of(*make_firmware(scenario, what, precision=precision, vectors_s=0.2, **options))


def run(folder, *command):
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def compiles(folder, tool, files):
    names = write(folder, files)
    for compiler, command in COMPILERS.items():
        done = run(folder, tool(compiler), *command[1:], *names)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("what", TARGETS)
def test_compilers_have_nothing_to_say(tmp_path, tool, what, precision):
    compiles(tmp_path, tool, with_harness(Scenario(), what, precision))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", STRUCTURES)
def test_compilers_have_nothing_to_say_of_other_structures(
    tmp_path, tool, exported, name, precision
):
    changes, targets = STRUCTURES[name]
    for what in targets:
        _, source = exported.exported_source(changed(Scenario(), changes), what, precision)
        compiles(tmp_path, tool, source.files())


@pytest.mark.parametrize("precision", PRECISIONS)
def test_compilers_have_nothing_to_say_of_stiff_plants_and_a_users_controller(
    tmp_path, tool, exported, backstepping, precision
):
    stiff = {"what": "plant", "integrator": "rosenbrock"}
    for scenario, options in (
        (Scenario(), stiff),
        (Scenario.preset("leg"), stiff),  # its rates depend on the time
        (backstepping, {"what": "controller"}),
    ):
        _, source = exported.exported_source(scenario, precision=precision, **options)
        compiles(tmp_path, tool, source.files())


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    "system",
    [
        Gain(2.0, 1),
        Integrator(1),
        ZeroOrderHold(0.1, 1),
        LinearSystem(0.01 - np.eye(40), np.ones((40, 1)), np.eye(1, 40), [[0.0]]),
    ],
    ids=["gain", "integrator", "hold", "many terms"],
)
def test_compilers_have_nothing_to_say_of_systems(tmp_path, tool, system, precision):
    (port,) = (system.get_input_port(i).get_name() for i in range(system.num_input_ports()))
    diagram = read_diagram(system, inputs=[port])
    tick_s = None if diagram.equations.updates else 0.1
    compiles(
        tmp_path, tool, source_of(diagram, "small", precision=precision, tick_s=tick_s).files()
    )


def test_a_warning_would_be_seen(tmp_path, tool):
    names = write(tmp_path, with_harness(Scenario(), "controller", "float"))
    code = (tmp_path / "controller.c").read_text()
    (tmp_path / "controller.c").write_text(code.replace("2.0f *", "2.0 *"))
    for compiler, command in COMPILERS.items():
        assert run(tmp_path, tool(compiler), *command[1:], *names).returncode != 0


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("what", [*TARGETS, "stiff plant"])
def test_sanitizers_find_nothing_in_the_harness(tmp_path, tool, what, precision):
    scenario, options = Scenario(), {}
    if what == "stiff plant":
        scenario = Scenario.preset("leg")
        what, options = "plant", {"integrator": "rosenbrock"}
    names = write(tmp_path, with_harness(scenario, what, precision, **options))
    done = run(tmp_path, tool("gcc"), *SANITIZERS, *names, "-o", "harness", "-lm")
    assert done.returncode == 0, done.stderr
    done = run(tmp_path, tmp_path / "harness")
    assert (done.returncode, done.stderr) == (0, "")
    assert "100 steps, 0 failures" in done.stdout


# ---------------------------------------------------------------------------- odd inputs

LARGEST = {"double": "DBL_MAX, DBL_MIN", "float": "FLT_MAX, FLT_MIN"}


def fuzz(folder, tool, scenario, precision, steps):
    """Run `fuzz.c`; how many steps were right, had a bad input, had a bad result."""
    names = write(folder, with_harness(scenario, "controller", precision))
    low, high = count_range(scenario)
    fields = [f"COUNT(encoder_count, {-int(-low // 1)}, {int(high // 1)})"]
    text = (folder / "controller.h").read_text()
    inputs = text.partition("typedef struct {\n    int32_t")[2].partition("}")[0]
    angle, *rates = re.findall(r"real_t (\w+);", inputs)
    low, high = reference_range_rad(scenario)
    fields += [f"RANGE({angle}, {low!r}, {high!r})", *(f"REAL({rate})" for rate in rates)]
    assert len(fields) == 5
    (folder / "fields.h").write_text("\n".join(fields) + "\n")
    largest, smallest = LARGEST[precision].split(", ")
    limit = scenario.controller.command_limit_rad_s * (1.0 + 1e-7)
    macros = ['-DHEADER="controller.h"', "-DOF(x)=controller_##x", f"-DSTEPS={steps}U"]
    macros += [f"-DLIMIT={limit!r}", f"-DLARGEST={largest}", f"-DSMALLEST={smallest}"]
    model = [name for name in names if name in ("controller.c", "controller_params.c")]
    done = run(
        folder, tool("gcc"), *SANITIZERS, "-I.", *macros, FUZZ_C, *model, "-o", "fuzz", "-lm"
    )
    assert done.returncode == 0, done.stderr
    done = run(folder, folder / "fuzz")
    assert done.returncode == 0, done.stdout + done.stderr
    return [int(count) for count in re.findall(r"\d+", done.stdout)]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    ("changes", "steps"),
    [
        ({}, 100_000),
        (PID, 100_000),
        pytest.param({}, 10_000_000, marks=pytest.mark.slow(gate=0)),
    ],
    ids=["smc", "pid", "smc, long"],
)
def test_bad_inputs_leave_no_trace(tmp_path, tool, changes, steps, precision):
    counts = fuzz(tmp_path, tool, changed(Scenario(), changes), precision, steps)
    assert sum(counts) == steps
    assert min(counts[:2]) > 10_000
    assert (counts[2] > 1e-3 * steps) == (not changes)  # a PID saturates where the SMC overflows


# ---------------------------------------------------------------------- what it may contain

DEVIATIONS = Path(__file__).parents[2] / "docs" / "firmware.md"
FORBIDDEN = re.compile(
    r"\b(u?int8_t|char|sizeof|[mc]alloc|free|goto|while|do|union|volatile)\b|\b(mem|str)\w+\("
)
"""A TI C2000 has no 8-bit types, and bytes of 16 bits; no loop but those with fixed bounds."""
CPPCHECK = ("--addon=misra", "--std=c99", "--enable=style", "--inconclusive", "--quiet")
CPPCHECK += ("-DDBL_MANT_DIG=53",)  # else it stops at the #error of double precision


MODELS = [
    (what, precision, integrator)
    for what, integrator in (*((what, "rk4") for what in TARGETS), ("plant", "rosenbrock"))
    for precision in PRECISIONS
]


@pytest.fixture(params=MODELS, ids=":".join)
def model(request, exported):
    """Files of a target without its harness, which does not run on a microcontroller."""
    what, precision, integrator = request.param
    return exported.exported_source(Scenario(), what, precision, integrator=integrator)[1].files()


def plain(text):
    """C without comments."""
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def misra_rules(folder, cppcheck):
    done = run(folder, cppcheck, *CPPCHECK, ".")
    assert done.returncode == 0
    return set(re.findall(r"\[misra-c2012-([\d.]+)\]", done.stderr))


def listed_rules(tables):
    (table,) = (t for t in tables(DEVIATIONS.read_text()) if t[0][0] == "rule")
    return {row[0] for row in table[1:]}


def test_misra_rules_are_kept_but_for_the_listed_ones(tmp_path, tool, model, tables):
    write(tmp_path, model)
    assert misra_rules(tmp_path, tool("cppcheck")) <= listed_rules(tables)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_each_listed_deviation_is_there_and_another_would_be_seen(
    tmp_path, tool, exported, tables, precision
):
    names = write(
        tmp_path, exported.exported_source(Scenario(), "controller", precision)[1].files()
    )
    assert misra_rules(tmp_path, tool("cppcheck")) == listed_rules(tables)
    with (tmp_path / names[0]).open("a") as file:
        file.write("int16_t f(int16_t a);\nint16_t f(int16_t a) { if (a) { a++; } return a; }\n")
    assert "14.4" in misra_rules(tmp_path, tool("cppcheck"))


def test_the_code_suits_processors_without_bytes(model):
    for name, text in model.items():
        code = plain(text)
        assert FORBIDDEN.search(code) is None, name
        assert not re.findall(r"\bstatic (?!const )[^(;]*;", code), name
        top = re.findall(r"^(?!typedef|extern const|const|static const|#|}| |$).*;$", code, re.M)
        assert all("(" in line for line in top), top  # prototypes, and no variables


def test_loops_are_bounded(model):
    (code,) = (plain(text) for name, text in model.items() if re.fullmatch(r"[a-z]+\.c", name))
    loops = re.findall(r"\bfor \(.*?\) \{", code)
    counted = r"for \(uint16_t (\w+) = 0U; \1 < (\d+U|count); \1\+\+\) \{"
    assert loops
    assert [loop for loop in loops if not re.fullmatch(counted, loop)] == []


def test_no_function_calls_itself(model):
    (code,) = (plain(text) for name, text in model.items() if re.fullmatch(r"[a-z]+\.c", name))
    bodies = re.findall(r"^[a-z][\w ]*?(\w+)\([^;{}]*\)\n\{\n(.*?)^\}", code, re.M | re.S)
    assert len(bodies) > 8
    defined = []
    for name, body in bodies:  # C wants a prototype for what comes later; none of these has one
        calls = set(re.findall(r"\b(\w+)\(", body)) & {other for other, _ in bodies}
        assert calls <= set(defined), name
        defined.append(name)
