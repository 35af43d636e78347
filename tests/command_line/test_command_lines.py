"""What a command line answers: exit code, stdout, stderr and the files that it writes.

A new case is a row of `WRONG` or of `ANSWERS`.
"""

import json
import os
import re
import shlex
import stat
from pathlib import Path

import pytest

import kneexo
from kneexo.command_line.main import main
from kneexo.page import playground

LONGEST = 300
"""Largest number of characters of a line on stderr, if no name in this line is cut."""
MASS = "plant.cylinder.mass_kg"
LONG = "x" * 5000
NUMBERS = ("1_0", "٣", "nan", "inf", "1e999", "0x1", "")
"""Texts that Python or YAML would take as numbers, and the empty text."""
CHANGE = "simulation.duration_s=0.1"
SHORT = f"--set {CHANGE}"

SIMULATE = {
    # --set
    "--set mass_kg=2": rf"--set mass_kg: unknown name; did you mean {MASS}\?$",
    "--set plant.cylinder.mass=2": rf"did you mean {MASS}\?$",
    f"--set {MASS}": rf"--set {MASS}: must be NAME=VALUE$",
    f"--set {MASS}=": rf"--set {MASS} has no value: must be a number",
    f"--set {MASS}=2kg": rf"--set {MASS} = '2kg': must be a number, .* kg$",
    f"--set {MASS}=1,6": r"must be a number with a decimal point",
    f"--set {MASS}.value=2": rf"{MASS} is a single value",
    "--set =2": r"must be NAME=VALUE$",
    "--set 'a\nb'": r"^--set a\\nb: must be NAME=VALUE$",
    f"--set {LONG}=1": r"^--set x{150} … x{147}: .*: unknown name; known h",
    "--set controller.proportional_per_s=3": r"needs controller.kind = pid$",
    "--set controller=pd": r"did you mean pid\?$",
    "--set plant.full_order.entrained_air=0.1": r"unknown name; needs plant.full_order = true$",
    "--set nominal.cylinder.mass_kg=2": r"unknown name; needs nominal = {}$",
    "--set bus.latency_samples=1.5": r"must be a whole number, >= 0 and <= 10 samples$",
    "--set reference=no.csv": r"--set reference: no.csv: cannot be read: No such file",
    "--set plant.linkage=[": r"--set plant.linkage:1: YAML syntax",
    "--set plant.knee.flexion_max_deg=50": r"--set plant.knee.flexion_max_deg: reference = .* 50 d",
    "--set controller.mass_min_kg=2": r"--set controller.mass_min_kg: controller: mass_min_kg = 2",
    "--set preset=leg": r"--set preset: unknown name; known here: bus, controller",
    # other arguments
    "--preset legs": r"--preset = 'legs': must be paper, bench, .*protected; did you mean leg\?$",
    "--engine fast": r"--engine: 'fast' is unknown; known: compiled, drake",
    "--law law.py:contrl": r"--law 'law.py:contrl': .* did you mean control\?$",
    "--law nolaw.py:control": r"--law 'nolaw.py:control': there is no file",
    "--law law.py:control --set controller=pid": r"--law: --set replaces the law by controller.k",
    "--out notes.txt": r"--out notes.txt: cannot write there .*; choose another directory$",
    f"--out o/{LONG}": r"^--out o/x{148} … x{147}: cannot write there \(File name too long\)",
    "--out ''": r"--out: is empty; must be a path",
    "--ouut run": r"--ouut: unknown argument; did you mean --out\?",
    "other.yaml": r"other.yaml: unknown argument; see kneexo simulate --help$",
}
"""Words after ``simulate my.yaml``, which blame an argument and not the scenario file."""

WRONG = {
    "simulat": r"'simulat' is unknown; did you mean simulate\?",
    "simulate": r"the following arguments are required: --out; see kneexo simulate --help$",
    "simulate my.yml --out run": r"my.yml: cannot be read: .*; did you mean my.yaml\?$",
    "simulate . --out run": r"cannot be read: Is a directory$",
    "simulate 'a\nb\x1b' --out run": r"^a\\nb\\x1b: cannot be read: No such file or directory$",
    f"simulate {LONG} --out run": r"^x{150} … x{147}: cannot be read: File name too long$",
    **{
        f"linearize --knee-angle '{number}' --out run": f"^argument --knee-angle: '{number}' must"
        for number in NUMBERS
    },
    # runs, which name the scenario file
    "simulate my.yaml --set simulation.integrator=runge_kutta3 --out run": r"^my.yaml: t = 0.002 s"
    r": runge_kutta3 with steps of 0.002 s cannot follow ",
    "simulate my.yaml --set simulation.duration_s=86400 --out run": r"^my.yaml: simulation.duration"
    r"_s = 86400 s .*: 43200000 samples .* at most 2 GiB; ",
    "simulate jump.yaml --out run": r"^jump.yaml: .*interpolation cubic passes the range of motion",
    "simulate module.yaml --out run": r"^module.yaml:1: .*law 'os:abort': must be NAME.py:function"
    r", .* with --law$",
    "linearize --knee-angle 200 --out run": r"--knee-angle = 200 deg .* >= 0 and <= 90 deg$",
    "linearize --knee-angle 40deg --out run": r"'40deg' must be a finite number .* without unit;",
    f"study bandwidth --set {MASS}=2 --out run": rf"unknown name; Scenario has {MASS}$",
    "study bandwidth --set amplitude_deg=3 --out run": r"did you mean amplitudes_deg\?$",
    "study bandwidth --set tolerance=3 --out run": r"did you mean estimate.tolerance\?$",
    "study bandwidth --set estimate.tol=9 --out run": r"name; known here: averaged_cycles",
    "study bandwidth --set estimate.tolerance=9 --out run": r"estimate.tolerance = 9 is out of",
    "study bandwidth --set frequencies_hz=[1,2,90] --out run": r"90 Hz is too high: .* <= 50 Hz",
    "study bandwidth --set amplitudes_deg=[1e-200] --out run": r">= 1e-06 and <= 46 deg$",
    "study bandwidth --workers 0 --out run": r"^--workers = 0: must be at least 1$",
    **{
        f"study bandwidth --workers '{number}' --out run": f"^argument --workers: '{number}' must"
        for number in NUMBERS
    },
    "study bandwidth --out run --resume": r"^--resume is gone: a study always goes on from "
    r"finished pieces without --restart; see kneexo study bandwidth --help$",
    "reproduce --set mass_min_kg=1.9 --out run": r"= 1.9 kg must not exceed mass_max_kg = 1.8 kg$",
    "study robustness --uncertainty no.yaml --out run": r"no.yaml: cannot be read: No such file",
    "study bandwidth --preset wearer --out run": r"controller.kind = torque: .* study wearer meas",
    "play --out my.py": r"my.py: the name of a page must end in .html$",
    "play --compare papr --out knee.html": r"preset = 'papr': .*; did you mean paper\?$",
    f"play {'my.yaml ' * 9}--out knee.html": r"^9 scenarios: a page has at least 1 and at most 8$",
    f"view {'my.yaml ' * 31}--out knee.html": r"^31 runs: a page shows 30 at most$",
    "view --out my.yaml": r"^my.yaml: the name of a page must end in .html$",
    f"view {SHORT} --out socket.html": r"socket.html is no regular file there",
    "view note.txt --out knee.html": r"cannot be read: .*; did you mean notes.txt\?$",
    "view loop --out knee.html": r"^loop: cannot be read: Too many levels of symbolic links$",
    "view my.yaml . --out knee.html": r"^.: has no scenario.yaml; must be a directory of kneexo s",
    "view a/run --set plant.linkage=G3 --out knee.html": r"^--set: a/run holds a finished run; ",
    "export c --what knee --out run": r"'knee' is unknown; known: controller, plant, loop",
    "export cc --out run": r"^argument FORM: 'cc' is unknown; did you mean c\?; known: c, sil, "
    r"fmu; see kneexo export --help$",
    "new my.yaml": r"^my.yaml exists already; choose another name$",
    "new walk.yaml": r"^walk.csv exists already; choose another name$",
    "new mine": r"^mine: the name must end in .yaml$",
    "new notes.txt/below/mine.yaml": r"^directory notes.txt/below: cannot write there \(Not a d",
    "params --find mas_kg": r"--find mas_kg: no parameter .*; did you mean mass_kg, ",
    "params my.yaml --find zzz": r"^--find zzz: no parameter has this text in its name, unit or p",
    f"params a 'b\n{LONG}'": r"^b\\nx{147} … x{147}: unknown argument; see kneexo params --he",
    "setup": r"^the following arguments are required: PART; see kneexo setup --help$",
    "setup completion fish": r"^argument shell: 'fish' is unknown; known: bash, zsh, tcsh; see kn",
    # names of before
    "bandwidth --out run": r"^'kneexo bandwidth' is now 'kneexo study bandwidth'; see kneexo --hel",
    "robustness": r"^'kneexo robustness' is now 'kneexo study robustness'; see kneexo --help$",
    "cache --clear": r"^'kneexo cache' is now 'kneexo setup cache'; see kneexo --help$",
    "completion bash": r"^'kneexo completion' is now 'kneexo setup completion'; see kneexo --help$",
}
"""Regular expression of the one line on stderr, after ``kneexo: ``. The exit code is 2."""
for words, remedy in SIMULATE.items():
    out = "" if "--ou" in words else " --out run"
    WRONG[f"simulate my.yaml {words}{out}"] = rf"^(?!.*my\.yaml).*?(?:{remedy})"

LAW = '/[^"]*/a folder/law.py:control'
FILES = {
    "new your.yaml": "your.csv your.yaml",
    "new your.yml --json": "your.csv your.yml",
    "new below/your.yaml": "below/your.csv below/your.yaml",
    "simulate": "run/metrics.json run/scenario.yaml run/signals.csv",
    "linearize": "run/linearization.json",
    "diagram": "run/closed_loop.png run/closed_loop.svg",
}
"""Files that a command line writes, by its beginning, if it is no page."""
ANSWERS = {
    "": (
        r"^[^.]*\. Try: kneexo view .* kneexo simulate .* kneexo new .* kneexo reproduce .*all c",
    ),
    "--version": (rf"^kneexo {re.escape(kneexo.__version__)}$",),
    "export c --help": (r" the controller, from encoder count and knee reference",),
    "export fmu --help": (r" the controller, from encoder reading \(rad\) and knee reference",),
    # scenario files and parameters
    "new your.yaml": (r"^your.yaml is .* kneexo simulate your.yaml --out run",),
    "new your.yml --json": (r'"files": \["your.yml", "your.csv"\]}$',),
    "new below/your.yaml": (r"^below/your.yaml",),
    "params": (
        r"^plant.pump: speed_limit_rad_s = 523.5987756 rad/s \[0.1 … 5000\] Tab"
        rf".* uncertainty: {MASS} = \[1.4, 1.8\]",
    ),
    "params --schema": (r'"properties": { "plant": ',),
    "params --law law.py:control": (rf" function = {LAW} ", "^kneexo: runs Python of law.py$"),
    "params --law law.py:control --json": (
        rf'"controller.function", "value": "{LAW}", .*"controller.values", "value": {{ "gain": 1.5',
        "^kneexo: runs Python of law.py$",
    ),
    f"params my.yaml --find {MASS}": (rf"^{MASS} = 2 kg \[0.01 … 1000\] yours \(paper: 1.6; ",),
    "params my.yaml --find yours": (rf"^{MASS} = 2 kg [^=]* simulation.duration_s = 0.1 s [^=]*$",),
    "params my.yaml --find yours --json": (
        rf'"parameters": \[ {{ "parameter": "{MASS}", "value": 2.0, "default": 1.6, [^{{]*}}, '
        r'{ "parameter": "simulation.duration_s", "value": 0.1, [^{]*} \] }$',
    ),
    "params --json": (
        rf'^(?!.*"provenance": "")(?=.*{{ "parameter": "{MASS}", "value": 1.6, "default": 1.6, '
        r'"unit": "kg", [^{}]*"provenance": "Table)(?=.*"controller\(pid\).integral_per_s2")'
        r'(?=.*"study bandwidth: amplitudes_deg")(?=.*"reproduce, Fig. 13: trials")',
    ),
    "params pid.yaml --json": (
        r'^(?!.*"parameter": "[^"]*[(:]).*"parameter": "controller.integral_per_s2"',
    ),
    "params --yaml": (r"^plant: pump: .* mass_kg: 1.6 ",),
    "params --preset bench --find segment_mass": (r"^plant[^=]*segment_mass_kg = 1.6 kg [^=]*$",),
    "params bench.yaml --preset leg --find segment_mass": (r"segment_mass_kg = 2.5 kg .* yours",),
    "params bench.yaml --preset leg --find 'preset leg'": (r"coulomb_friction_n = 40 N",),
    "params module.yaml --law law.py:control --find controller.function": (
        rf"^controller.function = {LAW} ",
        "^kneexo: runs Python of law.py$",
    ),
    # runs
    "simulate my.yaml --out run": (
        r" error \(root mean square\) [0-9.]+ deg .* In run: metrics.json, scenario.yaml, sig",
    ),
    "simulate my.yaml --out run --engine compiled --set simulation.integrator=radau1 --json": (
        r'"duration_s": 0.1, "integrator": "exact_hold"',
    ),
    "simulate my.yaml --out run --engine drake --json": (
        r'"duration_s": 0.1, "integrator": "radau3"',
    ),
    "simulate --out run --preset wearer --set simulation.duration_s=1 "
    "--set 'reference={kind: gait, frequency_hz: 0.5}'": (
        r"^Interaction torque [0-9.]+ N·m rms, .* relief valves open for .* of the cap falls to -0"
        r".* rms from the reference +[0-9.]+ deg (?!.*\(root mean square\))",
    ),
    "simulate csv.yaml --out run --json": (r'"duration_s": 0.4, .*"notices": \[\] }',),
    "simulate csv.yaml --out run --set simulation.duration_s=0.6 --json": (
        r'"duration_s": 0.6, .*"notices": \[ "the reference ends at 0.4 s',
    ),
    "linearize --out run --set estimator=exact --set controller.phi_m_s2=24.4 --json": (
        r'"lines": \[ "Not stable at 40°[^]]*\], "stable": false }.*"margins": { ("[a-z_]*": null, '
        r')*"stable": false(, "[a-z_]*": null)* }, "bandwidth_hz": null, "[a-z_]*_hz": null }$',
    ),
    "linearize my.yaml --knee-angle 20 --out run --json": (
        r'"mass_kg": 2.0.*"settings": { "knee_angle_deg": 20.0 }',
    ),
    "diagram my.yaml --out run --json": (
        r'"mass_kg": 2.0.*"files": \["closed_loop.png", "closed_loop.svg"\]}$',
    ),
    # pages
    f"view --out knee.html {SHORT} --json": (rf'"runs": \[ "the paper\'s setup, {CHANGE}" \]',),
    f"view --out knee.html {SHORT} --preset bench --json": (rf'\[ "preset bench, {CHANGE}" \]',),
    f"view --out before.html {SHORT}": (r"^before.html: .*; open it in a browser$",),
    "view --out knee.html a/run b/run link --json": (r'\[ "a/run", "b/run", "walk" \]',),
    "view --out knee.html a/run a/run.yaml b/run --json": (
        r'\[ "a/run", "a/run.yaml", "b/run" \]',
    ),
    "view --out knee.html a/run.yaml a/run.yaml --json": (r'"a/run.yaml", "a/run.yaml \(2\)" \]',),
    f"view --out 'my knee.html' {SHORT} --open": (r"^my knee.html: ",),
    f"view --out none.html {SHORT} --open": (
        r"^none.html: ",
        r"^kneexo: --open: no browser here; none.html is written, open it elsewhere$",
        2,
    ),
    f"view --out ctrl-c.html {SHORT} --open": (
        r"^ctrl-c.html: ",
        r"^kneexo: interrupted; the results are in ctrl-c.html$",
        130,
    ),
    "play --out knee.html --json": (r'"scenarios": \[ "the paper\'s setup" \]',),
    "play --out knee.html --set simulation.duration_s=60": (r"^knee.html ",),
    "play --out knee.html --set simulation.duration_s=61": (
        r"^knee.html ",
        r"^kneexo: the paper's setup, simulation.duration_s=61: a run on the page has the first 60 "
        r"of 61 s$",
    ),
}
"""Regular expressions of stdout, whose white space is one blank each, and of stderr; the exit code.

Left out: nothing on stderr, 0.
"""


def rows(table):
    """The command lines of a table, of which some take more than a fast test may."""
    slow = re.compile("diagram|simulate .*(runge_kutta3|wearer)")
    return [
        pytest.param(words, marks=pytest.mark.slow if slow.match(words) else (), id=words[:60])
        for words in table
    ]


@pytest.fixture
def opened(tmp_path, monkeypatch, undrawn):
    """The addresses that a browser opens, in a folder with files, and with finished runs."""
    folder = tmp_path / "a folder"
    runs = [folder / run for run in ("a/run", "b/run", "c/walk")]
    for run in runs:
        run.mkdir(parents=True)
        (run / "scenario.yaml").write_text("simulation: {duration_s: 0.5}\n")
        (run / "signals.csv").write_text(
            "time_s,knee_angle_rad,knee_reference_rad,load_pressure_pa\n0,0.5,0.5,1e6\n"
        )
    monkeypatch.chdir(folder)
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    short = "simulation: {duration_s: 0.1}\n"
    for name, text in {
        "my.yaml": f"{short}plant: {{cylinder: {{mass_kg: 2}}}}\n",
        "pid.yaml": "controller: {kind: pid}\n",
        "csv.yaml": "reference: {kind: csv, file: steps.csv}\n",
        "steps.csv": "time_s,knee_angle_deg\n0,30\n0.2,31\n0.4,30\n",
        "bench.yaml": "preset: bench\nplant: {load: {segment_mass_kg: 2.5}}\n",
        "jump.yaml": "reference: {kind: samples, times_s: [0, 1, 2], angles_deg: [5, 89, 89]}",
        "module.yaml": "controller: {kind: law, function: 'os:abort'}\n",
        "a/run.yaml": short,
        "law.py": "def control(rod_extension, gain=1.5):\n    return 0.0\n",
        **dict.fromkeys(("notes.txt", "walk.csv", "before.html"), "mine"),
    }.items():
        Path(name).write_text(text)
    Path("loop").symlink_to("loop")
    Path("link").symlink_to("c/walk")
    os.mknod("socket.html", stat.S_IFSOCK | 0o600)
    opened = []

    def browser(url):
        opened.append(url)
        if url.endswith("ctrl-c.html"):
            raise KeyboardInterrupt
        return not url.endswith("none.html")

    monkeypatch.setattr("webbrowser.open", browser)
    return opened


def contents():
    """The bytes of each file by its path."""
    return {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def printed(words, capsys):
    """Return exit code, stdout and the lines on stderr, without those about a compilation."""
    try:
        code = main(shlex.split(words))
    except SystemExit as end:  # of the parser
        code = end.code
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if not line.startswith("compiling")]
    return code, captured.out, lines


@pytest.mark.usefixtures("opened", "parser_once")
@pytest.mark.parametrize("words", rows(WRONG))
def test_a_wrong_command_line_has_one_line_with_the_remedy_and_writes_nothing(words, capsys):
    before = contents()
    code, out, (line,) = printed(words, capsys)
    assert (code, out) == (2, "")
    assert contents() == before
    assert line.isprintable()
    assert len(line) <= (1000 if LONG in words else LONGEST)
    assert re.match("kneexo: ", line)
    assert re.search(WRONG[words], line.removeprefix("kneexo: ")), line


@pytest.mark.usefixtures("parser_once")
@pytest.mark.parametrize("words", rows(ANSWERS))
def test_a_command_line_has_its_answer(words, capsys, opened, monkeypatch):
    monkeypatch.setattr(playground, "playground_page", lambda *_: "a page")  # takes 1 s
    stdout, stderr, code = (*ANSWERS[words], *("", "^$", 0)[len(ANSWERS[words]) :])
    page = shlex.split(words)[2:3] if words.startswith(("view", "play")) else []
    others = " ".join(files for start, files in FILES.items() if words.startswith(start))
    before = contents()
    found, out, lines = printed(words, capsys)
    assert found == code, lines
    assert re.search(stdout, " ".join(out.split())), out
    assert re.search(stderr, "\n".join(lines))
    after = contents()
    texts = [name for name in others.split() if name.endswith(("csv", "json"))]
    assert before.keys() <= after.keys()
    assert {name for name in after if before.get(name) != after[name]} == {*page, *others.split()}
    assert not re.search(rb"\bnan\b", b"".join([out.encode(), *(after[name] for name in texts)]))
    if "--json" in words:
        assert json.loads(out, parse_constant=pytest.fail)["kneexo"] == kneexo.__version__
        assert {after[name].decode() for name in texts if name.endswith("json")} <= {out}
    assert opened == [Path(name).resolve().as_uri() for name in page if "--open" in words]
