"""Wrong inputs as newcomers type them: each answer is one short line that names the remedy.

Those of command lines are rows of `WRONG` in ``command_line/test_command_lines.py``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import kneexo as kx
from kneexo.analysis import detector_thresholds, fault_survival, linearize_loop, linearize_plant
from kneexo.command_line.main import main
from kneexo.diagrams import make_closed_loop, make_plant
from kneexo.diagrams.signals import SIGNALS, columns
from kneexo.errors import KneexoError
from kneexo.parameters import (
    CuffParameters,
    CylinderParameters,
    PidParameters,
    PlantParameters,
    SimulationParameters,
    SineReference,
    Uncertainty,
    gait_reference,
)
from kneexo.simulation import Run, simulate
from kneexo.studies.bandwidth import BandwidthSettings
from kneexo.systems import BldcPump

LONGEST = 300
MASS = "plant.cylinder.mass_kg"


def assert_helps(line: str, remedy: str) -> None:
    assert line.isprintable(), line
    assert len(line) <= LONGEST, line
    assert re.search(remedy, line), line


@pytest.fixture
def directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    Path("my.yaml").write_text(f"simulation: {{duration_s: 0.1}}\n{nested(MASS, 2)}\n")
    Path("notes.txt").write_text("")
    Path("law.py").write_text("def control(rod_extension):\n    return 0.0\n")
    return tmp_path


def nested(path: str, value: object) -> str:
    """A line of YAML with a value at a dotted path."""
    first, *names = path.split(".")
    return f"{first}: {{{': {'.join(names)}: {value}{'}' * len(names)}"


# ------------------------------------------------------------------------ scenario files

WORN = "preset: wearer\nwearer: {"
FILES = {
    # names
    "mass_kg: 2": rf"my.yaml:1: mass_kg: unknown name; did you mean {MASS}\?$",
    "mass: 2": rf"did you mean {MASS}, .* or plant.load.segment_mass_kg \(needs plant.load.kind",
    "plant: {mass_kg: 2}": rf"plant.mass_kg: unknown name; did you mean {MASS}\?$",
    "plant: {cylinder: {mass: 2}}": rf"did you mean {MASS}\?$",
    "plant: {cylinder: {Mass_kg: 2}}": rf"did you mean {MASS}\?$",
    "plant:\n  cylinder:\n  mass_kg: 2": rf"my.yaml:3: plant.mass_kg: .* mean {MASS}\?",
    "cylinder: {mass_kg: 2}": r"cylinder: unknown name; did you mean plant.cylinder\?",
    f"{MASS}: 2": r"nest the names: plant: {cylinder: {mass_kg: …}}$",
    "nominal: {cylinder: {mass: 1}}": r"did you mean nominal.cylinder.mass_kg\?$",
    "controller: {lambda: 3}": r"did you mean controller.lambda_per_s\?$",
    "controller: {proportional_per_s: 3}": r"unknown name; needs controller.kind = pid$",
    "controller: {type: pid}": r"known here: area_uncertainty, .* kind, ",
    "plant: {load: {segment_mass_kg: 3}}": r"needs plant.load.kind = knee$",
    "reference: {file: walk.csv}": r"needs reference.kind = csv$",
    "simulation: {duration: 5}": r"did you mean simulation.duration_s\?$",
    "duration: 5": r"did you mean simulation.duration_s or push.duration_s \(needs push = {}\)\?$",
    "reference: {csv: walk.csv}": r"did you mean reference.kind = csv\?$",
    "colour: red": r"known here: bus, controller, encoder",
    # words and kinds
    "controller: PID": r"must be smc, pid, .* or a mapping; did you mean pid\?$",
    "controller: lqr": r"controller = 'lqr': must be smc, pid, torque, law",
    "controller:\n  kind: lqr": r"my.yaml:2: controller.kind = 'lqr': must be 'smc', 'pid'",
    "controller: [pid]": r"must be smc, pid, .* or a mapping$",
    "bus: canbus": r"must be none, cia402, can or a mapping; did you mean can\?$",
    "bus: {kind: can}": r"must be 'none' or 'cia402'; did you mean cia402\?$",
    "plant: {linkage: g1}": r"must be G1, G2, G3, G4, G5, hinge or a mapping; did you mean G1\?$",
    "plant: {full_order: yes}": r"must be true, false or a mapping$",
    "reference: walk": r"must be sine, step, ramp, samples, gait, csv or a mapping",
    "preset: legs": r"must be paper, bench, leg, wearer or protected; did you mean leg\?$",
    # values
    "plant: {cylinder: {mass_kg: 2 kg}}": r"= '2 kg': must be a number, .* <= 1000 kg$",
    "plant: {cylinder: {mass_kg: 1,6}}": r"write a decimal point",
    "plant:\n  cylinder:\n    mass_kg: 1,6": r"= '1,6': must be a number with a decimal point",
    "plant: {cylinder: 2}": r"must be a mapping of names to values, such as {bore_m: …}$",
    "reference: {amplitude_deg: 46}": r"leaves the range of motion 0 … 90 deg; reduce it$",
    "reference: {kind: samples, times_s: [0, 1, 2], angles_deg: [9, -5, 9]}": r"-5 … 9 deg leaves "
    r"the range of motion 0 … 90 deg; reduce it, or set clip: true in reference: {…}$",
    "controller: law": r"controller.function: is missing; must be .* FILE.py:NAME",
    "controller: {kind: pid, anti_windup_s: 1e-3}": r"= 0.001 s must be at least sample_time_s = ",
    "reference: {kind: samples, times_s: [0, 1, 1e6], angles_deg: [1, 2, 3]}": r"±100000 s$",
    # wearer and torque control
    "preset: wearer\nplant: {load: none}": r"wearer.kind = leg needs .* add plant: {load: knee}$",
    "wearer: leg": r"wearer.kind = leg needs plant.load.kind = knee",
    "controller: {kind: torque, mode: assist}": r"assist needs wearer.moment; add a wearer$",
    WORN + "inertia_kg_m2: 0}": r"2: wearer.inertia_kg_m2 = 0 kg·m² .* >= 0.001 and <= 10 kg·m²$",
    WORN + "inertia_kg_m2: }": r"wearer.inertia_kg_m2 has no value: must be a number, >= 0.001 ",
    WORN + "moment: {times_s: [0, 9], moments_n_m: [0, 5]}}": r"covers 0 … 9 s, .* from 0 to 30 s",
    WORN
    + "moment: {times_s: [1, 30], moments_n_m: [0, 5]}}": r"covers 1 … 30 s, .*; sub.*, and ext",
    WORN + "}\nreference: step": r"my.yaml:1: wearer.motion = prescribed: .*kind = step; choose",
    WORN + "moment: no.csv}": r"wearer.moment: no.csv: cannot be read: No such file",
    WORN + "moment: gate}": r"path of a .csv file or a mapping; did you mean gait\?$",
    WORN
    + "moment: law.py}": r"wearer.moment = 'law.py': must be gait, csv, the path of a .csv file",
    WORN + "moment: .}": r"wearer.moment = '.': must be gait, csv, the path of a .csv file or ",
    "load_cell: {noise_n: 2}": r"my.yaml:1: load_cell: noise_n = 2 N: seed .*; add seed: 1$",
    # units of angle
    WORN + "stiffness_n_m_per_deg: 1}": r"did you mean wearer.stiffness_n_m_per_rad\?$",
    WORN + "cuff: {stiffness_nm_deg: 26}}": r"wearer.cuff.stiffness_n_m_per_rad\?$",
    WORN + "damping_nm_s_per_deg: 1}": r"mean wearer.damping_n_m_s_per_rad\?$",
    WORN + "neutral_angle_deg: 20}": r"mean wearer.neutral_angle_rad\?$",
    "controller: {kind: torque, stiffness_nm_deg: 1}": r"controller.stiffness_n_m_per_rad\?$",
    "controller: {kind: torque, band_deg: 5}": r"did you mean controller.band_rad\?$",
    "controller: {kind: torque, proportional_deg_s_per_n: 5}": r"proportional_rad_s_per_n\?$",
    "plant: {knee: {flexion_max_rad: 1}}": r"did you mean plant.knee.flexion_max_deg or ",
}


@pytest.mark.usefixtures("parser_once")
@pytest.mark.parametrize("text", FILES)
def test_a_scenario_file(directory, capsys, text):
    Path("my.yaml").write_text(text)
    assert main(["params", "my.yaml", "--yaml"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("kneexo: my.yaml:")
    assert_helps(line, FILES[text])


# -------------------------------------------------------------------------------- Python

SCENARIO = kx.Scenario()
RUN = Run(
    np.arange(3.0), {name: np.zeros(3) for name in columns([*SIGNALS])}, SimulationParameters()
)


def assigned(part, name, value):
    return lambda: setattr(part, name, value)


async def later(rod_extension):
    return 0.0


CALLS = {
    "attribute of a part": (lambda: SCENARIO.plant.cylinder.mass, r"did you mean mass_kg\?$"),
    "assignment to the scenario": (
        assigned(SCENARIO, "controller", "pid"),
        r"scenario.changed\({\"controller\": 'pid'}\)$",
    ),
    "assignment to a part": (
        assigned(CuffParameters(), "stiffness_n_m_per_rad", 2),
        r'scenario.changed\({"wearer.cuff.stiffness_n_m_per_rad": 2}\)$',
    ),
    "keyword": (lambda: CylinderParameters(mass=2), r"did you mean mass_kg\?$"),
    "keyword of another class": (
        lambda: CylinderParameters(lag_s=2),
        r"Scenario has plant.pump.lag_s$",
    ),
    "keyword of settings": (
        lambda: BandwidthSettings(amplitude_deg=3),
        r"did you mean amplitudes_deg\?$",
    ),
    "value without name": (lambda: PidParameters(3), r"such as PidParameters\(sample_time_s=…\)$"),
    "file as scenario": (lambda: kx.Scenario("my.yaml"), r"load_scenario\(path\) reads a file$"),
    "class as value": (
        lambda: kx.Scenario(controller=PidParameters),
        r"the class PidParameters: must be an object, such as PidParameters\(\)$",
    ),
    "part at the wrong place": (
        lambda: kx.Scenario(plant=CylinderParameters()),
        r"must be an object of PlantParameters$",
    ),
    "array as number": (lambda: SineReference(mean_deg=np.ones(2)), r"must be a number, .* deg$"),
    "word": (lambda: kx.Scenario(estimator="exat"), r"did you mean exact\?$"),
    "switch": (lambda: PlantParameters(full_order="on"), r"must be true, false or a mapping$"),
    "preset": (lambda: kx.Scenario.preset("legs"), r"did you mean leg\?$"),
    "path": (lambda: SCENARIO.changed({"mass_kg": 2}), rf"did you mean {MASS}\?$"),
    "misspelt path": (
        lambda: SCENARIO.changed({"plant.pomp.lag_s": 1}),
        r"mean plant.pump.lag_s\?",
    ),
    "no mapping": (lambda: SCENARIO.changed("mass_kg"), r"must have a mapping from paths to"),
    "copy": (lambda: SCENARIO.model_copy(update={MASS: 2}), r"has no field .*; call changed\(\)"),
    "column": (lambda: RUN["knee"], r"did you mean knee_angle_rad"),
    "signal": (lambda: make_closed_loop(signals=["knee"]), r"did you mean knee_reference, knee_an"),
    "signal of another plant": (
        lambda: make_closed_loop(signals=["chamber_pressures"]),
        r"needs plant.full_order = true$",
    ),
    "signal as text": (
        lambda: simulate(SCENARIO, signals="knee_angle"),
        r"signals = 'knee_angle': must be a list, such as \[\"knee_angle\"\]$",
    ),
    "preset as scenario": (
        lambda: kx.track("bench"),
        r"'bench': must be an object of Scenario, such as Scenario.preset\(\"bench\"\) or load",
    ),
    "preset as loop": (lambda: make_closed_loop("leg"), r"such as Scenario.preset\(\"leg\"\) or"),
    "preset as plant": (lambda: make_plant("leg"), r"such as Scenario.preset\(\"leg\"\).plant$"),
    "mapping as parameters": (
        lambda: BldcPump({"lag_s": 0.01}),
        r"^parameters = .*: must be an object of BldcPumpParameters, such as BldcPumpPa",
    ),
    "scenario as plant": (lambda: linearize_plant(SCENARIO), r"must be an object of PlantParamet"),
    "plant as scenario": (lambda: linearize_loop(SCENARIO.plant), r"must be an object of Scenario"),
    "number as scenario": (lambda: detector_thresholds(3), r"scenario = 3: must be an object of S"),
    "scenario of faults": (lambda: fault_survival("leg", [], []), r"must be an object of Scenario"),
    "posture as text": (
        lambda: linearize_plant(knee_angle_deg="40"),
        r"knee_angle_deg = '40': must be a number in deg$",
    ),
    "misspelt kind": (
        lambda: kx.Scenario(reference={"kind": "cvs"}),
        r"must be 'sine', 'step', 'ramp', 'samples', 'gait' or 'csv'; did you mean csv\?$",
    ),
    "bound that is rounded up": (
        lambda: kx.Scenario(encoder={"phase_rad": 6.28319}),
        r"6.28319 rad is out of range: must be finite and >= 0 and <= 6.283185 rad$",
    ),
    "start beyond full extension": (
        lambda: make_closed_loop(SCENARIO.changed({"initial_offset_m": 0.01})),
        r"^initial_offset_m = 0.01 m: starts at -1.67 deg, outside 0 … 90 deg; reduce",
    ),
    "async law": (lambda: SCENARIO.with_law(later), r"later: is async; remove the word async$"),
    "file": (lambda: kx.track("my.yml"), r"my.yml: cannot be read: .*; did you mean my.yaml\?$"),
    "no scenario": (
        lambda: kx.track({}),
        r"{}: must be an object of Scenario, such as Sc.*path\)$",
    ),
    "no list": (lambda: kx.batch(SCENARIO, {MASS: 2}), r"must be a list of values$"),
    "path of a batch": (lambda: kx.batch(SCENARIO, {"mass_kg": [2.0]}), rf"did you mean {MASS}\?"),
    "posture": (
        lambda: linearize_loop(SCENARIO, knee_angle_deg=200),
        r"knee_angle_deg = 200 deg is out of range: must be >= 0 and <= 90 deg$",
    ),
    "frequency": (lambda: gait_reference(20), r"must be finite and > 0 and <= 10 Hz$"),
    "interval": (lambda: Uncertainty(low=1.0), r"must have either low and high, or options$"),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_call_in_python(directory, name):
    call, remedy = CALLS[name]
    with pytest.raises((KneexoError, AttributeError)) as caught:
        call()
    assert_helps(str(caught.value), remedy)
