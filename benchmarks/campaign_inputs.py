"""Give damaged files and modules to the commands; none may cause a traceback, a hang or a nan.

This is the part *inputs* of ``campaign.py``. Each case is one command of kneexo in a folder of its
own, with

- a CSV file as reference, written with quotes, comments and blank lines, then damaged or not,
- a module that makes a controller, with mistakes of every kind,
- a folder of a finished run for ``kneexo view``, whose signals or scenario are damaged,
- a device, a pipe, a directory, a file of the kernel, a huge, sparse or binary file, a file in
  UTF-16, or a name that is long or has control characters, where a command reads a file, or
- a number or a name on the command line.

A case runs the function `main` of kneexo in a fork of this process, with limits of time and memory;
one in a hundred is a process of its own. It must end with exit code 0 or 2. On failure it prints
one short line of printable characters and leaves no new file. No number of a result is nan; the
samples of an undamaged CSV file arrive as they were written.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from kneexo.command_line.main import main
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import dump_scenario
from kneexo.simulation import simulate
from kneexo.view import page
from kneexo.view.legs import SIGNALS
from kneexo.view.mechanism import points

LIMIT_S = 120.0  # long enough for a busy machine
MEMORY_BYTES = 4 * 2**30
LONGEST_LINE = 1300
PROCESSES = 100  # one case in this number runs in a new process
BAD = ("traceback", "hang", "died", "exit code", "lines", "nan", "new file", "wrong samples")


@dataclass
class Case:
    """One command, run in a folder that has been filled."""

    kind: str
    command: list[str]
    note: str = ""
    samples: tuple[list[float], list[float]] | None = None
    """Times and angles that ``kneexo params --yaml`` must print."""
    exit_codes: tuple[int, ...] = (0, 2)
    environment: dict[str, str] = field(default_factory=dict)


# ------------------------------------------------------------------------------ CSV files

FIELDS = (
    *("", " ", "nan", "inf", "-inf", "1e308", "-1e308", "1e999", "5e-324", "1_0", "٣", "１", "0x1"),
    *("1,5", '"1"', '"', '"1', '1"2', "'1'", "\t3", "three", "-", "+", ".", "1e", "1 2", "\u2028"),
    *("\x00", "\ufeff", "9" * 400, "a" * 200_000, '"' + "b" * 200_000 + '"', "#", "−1", "1d0", ";"),
)


def csv_text(rng: random.Random) -> tuple[str, list[float], list[float]]:
    """A valid CSV file with its times and angles: quotes, comments, blank lines, any line end."""
    end = rng.choice(("\n", "\n", "\r\n", "\r"))
    count = rng.choice((3, 3, 4, 10, 50))
    times = np.round(np.cumsum([rng.uniform(0.01, 2.0) for _ in range(count)]), 6).tolist()
    angles = [round(rng.uniform(0.0, 90.0), 4) for _ in range(count)]
    columns = {"time_s": [f"{t!r}" for t in times], "knee_angle_deg": [f"{a!r}" for a in angles]}
    note = ("x", '"a ""b"" c"', f'"two{end}lines"', f'"{end}# no comment{end}{end}"')
    if rng.random() < 0.4:
        columns["note"] = [rng.choice(note) for _ in range(count)]
    names = list(columns)
    rng.shuffle(names)
    pad = rng.choice(("", "", " "))
    rows = [names, *([columns[name][i] for name in names] for i in range(count))]
    lines = []
    for row in rows:
        if rng.random() < 0.1:
            lines.append(rng.choice(("", "  ", "# comment", '# "quote', "#,,,")))
        # A space before a quotation mark makes it a character of the field.
        cells = [cell if cell.startswith('"') else pad + cell for cell in row]
        if rng.random() < 0.2:
            cells = [f'"{c}"' if not c.strip().startswith('"') else c for c in cells]
        lines.append(",".join(cells))
    text = end.join(lines) + rng.choice(("", end, end + end))
    return rng.choice(("", "", "\ufeff")) + text, times, angles


def damaged_csv(text: str, rng: random.Random) -> bytes:
    """A CSV file with damaged fields, lines or bytes."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        lines = text.split("\n")
        place, way = rng.randrange(len(lines)), rng.randrange(8)
        cells = lines[place].split(",")
        if way <= 2:
            cells[rng.randrange(len(cells))] = rng.choice(FIELDS)
        elif way == 3:
            del cells[rng.randrange(len(cells))]
        elif way == 4:
            cells.insert(rng.randrange(len(cells) + 1), rng.choice((*FIELDS, "time_s")))
        lines[place] = ",".join(cells)
        if way == 5:
            lines.insert(place, rng.choice(lines))
        elif way == 6:
            del lines[place]
        text = "\n".join(lines)
        if way == 7:
            place = rng.randrange(len(text) + 1)
            text = text[:place] + rng.choice(FIELDS) + text[place + rng.randrange(3) :]
    data = text.encode("utf-8", "surrogatepass")
    way = rng.randrange(12)
    if way == 0:
        return text.encode(rng.choice(("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-7")))
    if way == 1 and data:
        place = rng.randrange(len(data))
        return data[:place] + rng.randbytes(rng.choice((1, 4, 99))) + data[place:]
    if way == 2:
        return data[: rng.randrange(len(data) + 1)]
    return data


def csv_case(folder: Path, rng: random.Random) -> Case:
    """Return a case that prints a scenario whose reference is a CSV file."""
    text, times, angles = csv_text(rng)
    whole = rng.random() < 0.25
    data = text.encode() if whole else damaged_csv(text, rng)
    (folder / "reference.csv").write_bytes(data)
    reference = {"kind": "csv", "file": "reference.csv", "interpolation": "linear"}
    if rng.random() < 0.1:
        reference |= {rng.choice(("time", "angle")): rng.choice(("time_s", "x" * 5000, "a\nb"))}
        whole = False
    (folder / "scenario.yaml").write_text(json.dumps({"reference": reference}))
    case = Case("csv", ["params", "scenario.yaml", "--yaml"], repr(data[:2000]))
    if whole:
        case.samples, case.exit_codes = (times, angles), (0,)
    return case


# --------------------------------------------------------------------- controller modules

IMPORTS = (
    "from pydrake.systems.framework import LeafSystem, LeafSystem_, DiagramBuilder, BasicVector\n"
    "from pydrake.systems.primitives import Adder, ConstantVectorSource, ZeroOrderHold\n"
    "from kneexo.diagrams import make_controller, make_closed_loop\n"
    "from kneexo.parameters import Scenario\n"
)
AT_IMPORT = (
    *("1/0", "def f(: pass", "x = '", "  x = 1", "raise SystemExit", "import sys; sys.exit(5)"),
    *("import sys; sys.exit('two\\nlines')", "import nowhere", "import nowhere.at.all", "x"),
    *("from math import nothing", "from . import y", "from .y import z", "raise Exception"),
    *("raise Exception('a\\nb\\x1b[31m')", "raise Exception('x' * 5000)", "assert False", "exit()"),
    *("def f(): f()\nf()", "class E(BaseException): pass\nraise E('x')", "raise StopIteration"),
    *("class E(Exception):\n    def __str__(self): 1/0\nraise E", "raise MemoryError", "a\0b"),
    *(
        "raise KeyError",
        "raise OSError(2, 'gone', 'file')",
        "raise UnicodeDecodeError('a',b'',1,2,'')",
    ),
    *(
        "raise ExceptionGroup('g', [ValueError(1)])",
        "import importlib; importlib.import_module('.x')",
    ),
    *(
        "'\ud800'",
        "λ = 1\n1/0",
        "e = ValueError('x'); e.add_note('n\\nm'); raise e",
        "del make_controller",
    ),
    *(
        "raise GeneratorExit",
        "yield 1",
        "return 1",
        "await x",
        "(" * 300,
        "x = " + "-" * 50_000 + "1",
    ),
    *(
        "import warnings; warnings.warn('two\\nlines')",
        "print('hello')",
        "",
        "import m0",
        "import m1",
    ),
)
BODIES = (
    *("1/0", "pass", "return 42", "return s", "return make", "raise SystemExit(0)", "return None"),
    *("import sys; sys.exit(5)", "raise Exception('a\\nb')", "return make(s)", "exit('bye')"),
    *("return Adder(2, 1)", "return ZeroOrderHold(0.002, 1)", "return LeafSystem", "yield 1"),
    *(
        "return ConstantVectorSource([0.0])",
        "return make_closed_loop()",
        "return [make_controller()]",
    ),
    *("return DiagramBuilder()", "return DiagramBuilder().Build()", "assert s is None", "s.x"),
    *("s.plant.cylinder.mass_kg = 0", "return s.controller.values['none']", "raise GeneratorExit"),
    *("import m_missing", "import m1", "return make_controller(s)", "return Scenario(x=1)"),
    *(
        "b = DiagramBuilder(); b.AddNamedSystem('a', Adder(1, 1)); "
        "b.AddNamedSystem('a', Adder(1, 1)); "
        "return b.Build()",
    ),
    *("return make_controller(Scenario())", "return make_controller(Scenario(), open_law=True)"),
    *("return Broken('1/0')", "return Broken('import sys; sys.exit(5)')", "return Broken('pass')"),
    *("return Broken('o.SetAtIndex(0, float(\"nan\"))')", "return Broken('o.SetAtIndex(5, 1.0)')"),
    *("return Broken('o.SetAtIndex(0, \"x\")')", "return Broken('raise Exception(\"a\\\\nb\")')"),
    *("return Broken('raise RuntimeError')", "return Broken('raise ValueError(\"x\" * 5000)')"),
)
BROKEN = """
class Broken(LeafSystem):
    def __init__(self, code):
        super().__init__()
        self.code = code
        self.DeclareVectorOutputPort("motor_speed_command", 1, self.calc)
    def calc(self, context, o):
        exec(self.code, {"o": o})
"""
NAMES = (
    *("sys:exit", "os:abort_", "builtins:print", ".x:y", "..:y", "m0", "m0:", ":make", "m0:make.x"),
    *(
        "m0:x y",
        "m0.make",
        "m0:make:make",
        "__main__:make",
        "math:nan",
        "builtins:dict",
        "a" * 5000,
    ),
    *(f"{'a' * 5000}:make", f"m0:{'a' * 5000}", "a\nb:make", "m0:make\n", "a/b:make", "m-0:make"),
    *("m0:__class__", "os:getcwd", "builtins:exit", "builtins:type", "m0:__dict__", "\x1b[31m:x"),
    *("numpy:array", "kneexo.diagrams:make_plant", "kneexo.diagrams:make_closed_loop", "m\ud800:x"),
)


def module_case(folder: Path, rng: random.Random) -> Case:
    """Return a case with a user's controller that has mistakes."""
    way = rng.randrange(3)
    top = rng.choice(AT_IMPORT) if way == 0 else ""
    body = rng.choice(BODIES) if way != 0 else "return make_controller(Scenario())"
    text = f"{IMPORTS}{top}\n{BROKEN}\ndef make(scenario):\n    s = scenario\n    {body}\n"
    if rng.random() < 0.05:
        place = rng.randrange(len(text))
        text = text[:place] + rng.choice(FIELDS) + text[place + rng.randrange(9) :]
    (folder / "m0.py").write_bytes(text.encode("utf-8", "surrogatepass"))
    (folder / "m1.py").write_text("import m0\nm0.nothing\n")
    name = rng.choice(NAMES) if rng.random() < 0.15 else "m0:make"
    short = {"duration_s": 0.02, "integrator": rng.choice(("exact_hold", "radau3"))}
    scenario = {"controller": {"kind": "law", "function": name}, "simulation": short}
    (folder / "scenario.yaml").write_text(json.dumps(scenario))
    commands = [["view", "scenario.yaml", "--out", "k.html"]] * 8
    commands += [["linearize", "scenario.yaml", "--out", "o"]]
    commands += [["export", "fmu", "scenario.yaml", "--out", "k.fmu"]]
    return Case("module", rng.choice(commands), f"{name!r:.99}\n{top}\n{body}")


# ----------------------------------------------------------------------- folders of runs

HEAD = ("time_s", "knee_angle_rad", "knee_reference_rad", "load_pressure_pa")
NUMBERS = ("1e308", "-1e308", "nan", "inf", "5e-324", "0", "-0", "1e5", "-1", "3.2", "1e12", "1_0")


def signals_text(rng: random.Random) -> str:
    """The signals of a finished run that lasts some samples."""
    count = rng.choice((1, 2, 5, 20))
    rows = [
        [
            f"{0.05 * i:.10g}",
            *(f"{rng.uniform(0.0, 1.57):.10g}" for _ in range(2)),
            f"{rng.uniform(-1e6, 1e6):.10g}",
            "0.25",
        ]
        for i in range(count)
    ]
    return "\n".join(",".join(row) for row in [[*HEAD, "other_m"], *rows]) + "\n"


def folder_case(folder: Path, rng: random.Random) -> Case:
    """Return a case that views a folder with damaged files."""
    run = folder / rng.choice(("run", "run", "a b", "new\nline", "é\x1b", "x" * 250, "n\udcff"))
    run.mkdir()
    text = signals_text(rng)
    data = text.encode()
    way = rng.randrange(10)
    if 1 <= way <= 4:  # numbers
        lines = text.splitlines()
        for _ in range(rng.choice((1, 2, 5))):
            place = rng.randrange(1, len(lines))
            cells = lines[place].split(",")
            cells[rng.randrange(4)] = rng.choice(NUMBERS)
            lines[place] = ",".join(cells)
        data = "\n".join(lines).encode()
    elif way >= 5:
        data = damaged_csv(text, rng)
    (run / "signals.csv").write_bytes(data)
    scenario = dump_scenario(Scenario()).encode()
    if rng.random() < 0.2:
        scenario = damaged_csv(scenario.decode(), rng)
    (run / "scenario.yaml").write_bytes(scenario)
    if rng.random() < 0.1:
        (run / rng.choice(("signals.csv", "scenario.yaml"))).unlink()
    command = ["view", *[run.name] * rng.choice((1, 1, 1, 2)), "--out", "k.html"]
    command += rng.choice(([], [], [], ["--json"], ["--set", "a=1"]))
    return Case("folder", command, repr(data[:2000]))


# ------------------------------------------------------------------------- special files


def _link(target: str) -> Callable[[Path, random.Random], Any]:
    return lambda path, rng: path.symlink_to(target)


def _bytes(data: bytes) -> Callable[[Path, random.Random], Any]:
    return lambda path, rng: path.write_bytes(data)


def _sparse(size: int) -> Callable[[Path, random.Random], Any]:
    def make(path: Path, rng: random.Random) -> None:
        with path.open("wb") as file:
            file.truncate(size)

    return make


def _socket(path: Path, rng: random.Random) -> None:
    with socket.socket(socket.AF_UNIX) as server:  # the path of a socket has at most 107 bytes
        here = os.getcwd()
        os.chdir(path.parent)
        try:
            server.bind(path.name)
        finally:
            os.chdir(here)


def _no_permission(path: Path, rng: random.Random) -> None:
    path.write_text("plant: {}\n")
    path.chmod(0)


SPECIAL: dict[str, Callable[[Path, random.Random], Any]] = {
    **{
        name: _link(name)
        for name in (
            *("/dev/zero", "/dev/full", "/dev/null", "/dev/random", "/dev/tty", "/dev/stdin"),
            *("/proc/self/mem", "/proc/kcore", "/proc/self/environ", "/proc/version"),
            *("/proc/self/fd/0", "/proc/self/maps", "/proc/self/cmdline", "/proc", "/proc/1/mem"),
            *("/sys/kernel/profiling", "/proc/self/clear_refs", "/nowhere"),
        )
    },
    "pipe": lambda path, rng: os.mkfifo(path),
    "socket": _socket,
    "directory": lambda path, rng: path.mkdir(),
    "loop": lambda path, rng: path.symlink_to(path.name),
    "empty": _bytes(b""),
    "sparse 1 TiB": _sparse(2**40),
    "sparse 200 MiB": _sparse(200 * 2**20),
    "1.5 MiB without line ends": _bytes(b"a" * 1_500_000),
    "quotation mark and 1.5 MiB": _bytes(b'time_s,knee_angle_deg\n0,"' + b"1\n" * 750_000),
    "binary": lambda path, rng: path.write_bytes(rng.randbytes(5000)),
    "zip": _bytes(b"PK\x03\x04" + bytes(200)),
    "UTF-16": _bytes("time_s,knee_angle_deg\n0,1\n".encode("utf-16")),
    "UTF-16 without mark": _bytes("time_s,knee_angle_deg\n0,1\n".encode("utf-16-le")),
    "UTF-32": _bytes("time_s,knee_angle_deg\n0,1\n".encode("utf-32")),
    "Latin-1": _bytes("# Füße\nplant: {}\n".encode("latin-1")),
    "no permission": _no_permission,
    "missing": lambda path, rng: None,
}
PLACES: dict[str, tuple[str, list[str]]] = {
    "scenario": ("s.yaml", ["params", "s.yaml", "--yaml"]),
    "scenario of a run": ("s.yaml", ["view", "s.yaml", "--out", "k.html"]),
    "uncertainty": (
        "u.yaml",
        ["study", "robustness", "--uncertainty", "u.yaml", "--out", "o"],
    ),
    "CSV": ("r.csv", ["params", "csv.yaml", "--yaml"]),
    "signals": ("run/signals.csv", ["view", "run", "--out", "k.html"]),
    "scenario of results": ("run/scenario.yaml", ["view", "run", "--out", "k.html"]),
    "page": ("k.html", ["view", "run", "--out", "k.html"]),
    "FMU": ("k.fmu", ["export", "fmu", "--out", "k.fmu"]),
    "results": ("o", ["linearize", "--out", "o", "--knee-angle", "1000"]),
    "checkpoint": (
        "o/bandwidth.checkpoint.jsonl",
        ["study", "bandwidth", "--out", "o", "--workers", "1"],
    ),
    "report": ("o/linearize.html", ["linearize", "--html", "--out", "o"]),
}


def special_case(folder: Path, rng: random.Random) -> Case:
    """Return a case with a special file where a command reads a file."""
    place = rng.choice(list(PLACES))
    name, command = PLACES[place]
    what = rng.choice(list(SPECIAL))
    if place in ("page", "report", "checkpoint", "results", "FMU") and what in (
        "missing",
        "/nowhere",
    ):
        what = "pipe"  # nothing would be wrong
    if place == "FMU" and what in ("directory", "/proc"):
        what = "binary"  # a folder for the file
    if place == "checkpoint" and what == "empty":
        what = "binary"
    path = folder / name
    (folder / "run").mkdir()
    if "run/" in name or place == "page":
        (folder / "run" / "signals.csv").write_text(signals_text(rng))
        (folder / "run" / "scenario.yaml").write_text("{}\n")
    (folder / "csv.yaml").write_text("reference: {kind: csv, file: r.csv}\n")
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    SPECIAL[what](path, rng)
    return Case("special", command, f"{place}: {what}")


# --------------------------------------------------------------------------- command line

ODD_NAMES = (
    *("a\nb", "\x1b[31m", "x" * 255, "x" * 256, "x" * 5000, "/" * 5000, "d/" * 2500, " ", "", "."),
    *(
        "\udcff",
        "é",
        "\u202e",
        "-",
        "--",
        "~",
        "*",
        "a\tb",
        "\r",
        "λ" * 2000,
        "/dev/fd/99",
        "nul\\0",
    ),
)
COMMANDS: tuple[list[str], ...] = (
    ["params", "NAME", "--yaml"],
    ["view", "NAME", "--out", "k.html"],
    ["view", "run", "NAME", "--out", "k.html"],
    ["simulate", "NAME", "--out", "o"],
    ["study", "robustness", "--uncertainty", "NAME", "--out", "o"],
    ["view", "--set", "NAME", "--out", "k.html"],
    ["view", "--set", "NAME=1", "--out", "k.html"],
    ["view", "--set", "plant.pump.lag_s=NAME", "--out", "k.html"],
    ["view", "--set", "reference={kind: csv, file: 'NAME'}", "--out", "k.html"],
    ["linearize", "--knee-angle", "NUMBER", "--out", "missing/\n"],
    [
        "export",
        "c",
        "--vectors-s",
        "NUMBER",
        "--what",
        "loop",
        "--set",
        "reference=gait",
        "--out=o",
    ],
    ["export", "c", "--step-s", "NUMBER", "--what", "loop", "--set", "reference=gait", "--out=o"],
    ["study", "bandwidth", "--workers", "NUMBER", "--set", "nothing=1", "--out", "o"],
    ["study", "bandwidth", "--set", "amplitudes_deg=[NUMBER]", "--set", "nothing=1", "--out", "o"],
    ["NAME"],
    ["view", "--NAME", "--out", "k.html"],
    ["export", "NAME"],
)


def command_case(folder: Path, rng: random.Random) -> Case:
    """Return a case with odd names and numbers on the command line."""
    (folder / "run").mkdir()
    (folder / "run" / "signals.csv").write_text(signals_text(rng))
    (folder / "run" / "scenario.yaml").write_text("{}\n")
    name, number = rng.choice(ODD_NAMES), rng.choice((*NUMBERS, *FIELDS[:24], "9" * 4000))
    number = number.replace("\x00", "0")
    template = rng.choice(COMMANDS)
    command = [w.replace("NAME", name).replace("NUMBER", number) for w in template]
    return Case("command", command)


# ------------------------------------------------------------------------------ outcomes

KINDS: dict[Callable[[Path, random.Random], Case], int] = {
    csv_case: 40,
    module_case: 15,
    folder_case: 20,
    special_case: 17,
    command_case: 8,
}
"""Cases of each kind in a hundred."""


def inputs(count: int, seed: int) -> Iterator[tuple[str, str, str]]:
    """Yield outcome, message and text of each case."""
    warm_up()
    for number in range(count):
        yield one_case(number, seed)


def one_case(number: int, seed: int) -> tuple[str, str, str]:
    """Run a case, which its number and the seed decide; return outcome, message and text."""
    rng = random.Random(f"{seed} {number}")
    make = rng.choices(list(KINDS), list(KINDS.values()))[0]
    folder = Path(tempfile.mkdtemp(prefix="campaign-"))
    try:
        case = make(folder, rng)
        kind, message = outcome(case, folder, alone=number % PROCESSES == 0)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    label = f"case {number} of seed {seed}: kneexo {case.command!r:.500}\n{case.note}"
    return (kind if kind in BAD else f"{case.kind}: {kind}"), message, label


def warm_up() -> None:
    """Import modules and compile models that the forks share."""
    import matplotlib.pyplot  # noqa: F401

    import kneexo.analysis
    import kneexo.export.firmware
    import kneexo.export.fmu
    import kneexo.studies.bandwidth.study  # noqa: F401

    for integrator in ("exact_hold", "radau3"):
        short = {"simulation.duration_s": 0.02, "simulation.integrator": integrator}
        simulate(changed(Scenario(), short), signals=SIGNALS)


def outcome(case: Case, folder: Path, *, alone: bool) -> tuple[str, str]:
    """Run a case in ``folder``; return its outcome and message."""
    before = _names(folder)
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as error:
        run = _run_process if alone else _run_fork
        code = run(case, folder, out.fileno(), error.fileno())
        texts = []
        for stream in (out, error):
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "replace"))
    printed, said = texts
    lines = [
        line for line in said.splitlines() if not line.startswith(("compiling", "ERROR:drake"))
    ]
    if code is None:
        return "hang", said
    if "Traceback" in said or "Traceback" in printed:
        return "traceback", said[-3000:]
    if code < 0:
        return "died", f"signal {-code}: {said[-2000:]}"
    if code not in case.exit_codes:
        return "exit code", f"{code}: {said[-2000:]}"
    if code == 2:
        message = lines[-1] if lines else ""
        usage = bool(lines) and lines[0].startswith("usage: ")  # of argparse
        if (
            not (usage or len(lines) == 1)
            or not message.startswith("kneexo")
            or (len(message) > LONGEST_LINE or not message.isprintable())
        ):
            return "lines", said[:5000]
        if new := _names(folder) - before:
            return "new file", f"{new}: {message}"
        if "out of memory" in message:
            return "died", message
        return "refused", message
    if re.search(r"\bnan\b", printed, re.IGNORECASE):
        return "nan", printed[:2000]
    if case.samples is not None:
        reference = yaml.safe_load(printed)["reference"]
        if (reference["times_s"], reference["angles_deg"]) != case.samples:
            return "wrong samples", f"{reference} in place of {case.samples}"
    return "valid", ""


def _names(folder: Path) -> set[str]:
    """Return the paths in a folder, without Python's bytecode."""
    return {str(path) for path in folder.rglob("*") if "__pycache__" not in str(path)}


def _run_process(case: Case, folder: Path, out: int, error: int) -> int | None:
    command = [sys.executable, "-m", "kneexo", *case.command]
    try:
        return subprocess.run(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=error, timeout=LIMIT_S
        ).returncode
    except subprocess.TimeoutExpired:
        return None


def _run_fork(case: Case, folder: Path, out: int, error: int) -> int | None:
    """Run a case in a fork of this process; return its exit code, None for a hang."""
    sys.stdout.flush()
    child = os.fork()
    if not child:
        try:
            os._exit(_child(case, folder, out, error))
        except BaseException:  # counted as a traceback
            os.write(error, traceback.format_exc().encode("utf-8", "replace"))
            os._exit(1)
    end = time.monotonic() + LIMIT_S
    while time.monotonic() < end:
        number, status = os.waitpid(child, os.WNOHANG)
        if number:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _child(case: Case, folder: Path, out: int, error: int) -> int:
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(out, 1)
    os.dup2(error, 2)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(io.FileIO(1, "w")),
        io.TextIOWrapper(io.FileIO(2, "w")),
    )
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES,) * 2)
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    page_of = page.view_page
    page.view_page = lambda legs, *rest: page_of(_finite(legs), *rest)
    try:
        code = main(case.command)
    except SystemExit as exit_of_argparse:
        code = int(exit_of_argparse.code or 0)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    return code


def _finite(legs: Any) -> Any:
    """Return the legs of a page; raise `AssertionError` for one that would show nan."""
    for leg in legs:
        for values in (leg.time_s, leg.knee_angle_rad, leg.reference_rad, leg.pressure_pa):
            assert np.isfinite(values).all()
        times = np.linspace(0.0, leg.time_s[-1], 9)
        for values in (leg.knee_angle_rad, leg.reference_rad):
            for place in points(leg.linkage, np.interp(times, leg.time_s, values)).values():
                assert np.isfinite(place).all()
        assert np.isfinite(np.interp(times, leg.time_s, leg.pressure_pa)).all()
    return legs
