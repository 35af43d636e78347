"""Wrong inputs as newcomers type them: each answer is one short line that names the remedy.

Those of command lines are rows of `WRONG` in ``command_line/test_command_lines.py``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import kneexo as kx
from kneexo import analysis, diagrams, parameters, systems
from kneexo.command_line.main import main
from kneexo.diagrams.signals import SIGNALS, columns
from kneexo.errors import KneexoError
from kneexo.parameters import SimulationParameters
from kneexo.simulation import Run
from kneexo.studies import bandwidth

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
    "plant: {cylinder: {Mass_kg: 2}}": rf"did you mean {MASS}\?$",
    "plant:\n  cylinder:\n  mass_kg: 2": rf"my.yaml:3: plant.mass_kg: .* mean {MASS}\?",
    "cylinder: {mass_kg: 2}": r"cylinder: unknown name; did you mean plant.cylinder or parts",
    f"{MASS}: 2": r"nest the names: plant: {cylinder: {mass_kg: …}}$",
    "nominal: {cylinder: {mass: 1}}": r"did you mean nominal.cylinder.mass_kg\?$",
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
    WORN + "neutral_angle_deg: 20}": r"mean wearer.neutral_angle_rad\?$",
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

WORLD = {**vars(diagrams), **vars(analysis), **vars(parameters), **vars(bandwidth), **vars(systems)}
WORLD |= {"kx": kx, "np": np, "MASS": MASS, "scenario": kx.Scenario()}
"""Names of Python that the lines use."""
PYTHON = {
    # names
    "scenario.plant.cylinder.mass": r"did you mean mass_kg\?$",
    "scenario.controller = 'pid'": r"scenario.changed\({\"controller\": 'pid'}\)$",
    "CuffParameters().stiffness_n_m_per_rad = 2": r'\({"wearer.cuff.stiffness_n_m_per_rad": 2}\)$',
    "CylinderParameters(mass=2)": r"did you mean mass_kg\?$",
    "CylinderParameters(lag_s=2)": r"Scenario has plant.pump.lag_s$",
    "BandwidthSettings(amplitude_deg=3)": r"did you mean amplitudes_deg\?$",
    "PidParameters(3)": r"such as PidParameters\(sample_time_s=…\)$",
    "scenario.changed({'mass_kg': 2})": rf"did you mean {MASS}\?$",
    "scenario.changed({'plant.pomp.lag_s': 1})": r"mean plant.pump.lag_s\?",
    "scenario.changed('mass_kg')": r"must have a mapping from paths to",
    "scenario.model_copy(update={MASS: 2})": r"has no field .*; call changed\(\)",
    "kx.batch(scenario, {'mass_kg': [2.0]})": rf"did you mean {MASS}\?",
    "kx.batch(scenario, {MASS: 2})": r"must be a list of values$",
    # signals
    "run['knee']": r"did you mean knee_angle_rad",
    "make_closed_loop(signals=['knee'])": r"did you mean knee_reference, knee_an",
    "make_closed_loop(signals=['chamber_pressures'])": r"needs plant.full_order = true$",
    "simulate(scenario, signals='knee_angle')": r"signals = 'knee_angle': must be a list, such "
    r"as \[\"knee_angle\"\]$",
    # words and values
    "kx.Scenario(estimator='exat')": r"did you mean exact\?$",
    "kx.Scenario.preset('legs')": r"did you mean leg\?$",
    "kx.Scenario(reference={'kind': 'cvs'})": r"must be 'sine', 'step', 'ramp', 'samples', 'gait' "
    r"or 'csv'; did you mean csv\?$",
    "PlantParameters(full_order='on')": r"must be true, false or a mapping$",
    "SineReference(mean_deg=np.ones(2))": r"must be a number, .* deg$",
    "kx.Scenario(encoder={'phase_rad': 6.28319})": r"6.28319 rad is out of range: must be finite "
    r"and >= 0 and <= 6.283185 rad$",
    "make_closed_loop(scenario.changed({'initial_offset_m': 0.01}))": r"^initial_offset_m = 0.01 "
    r"m: starts at -1.67 deg, outside 0 … 90 deg; reduce",
    "linearize_plant(knee_angle_deg='40')": r"knee_angle_deg = '40': must be a number in deg$",
    "linearize_loop(scenario, knee_angle_deg=200)": r"knee_angle_deg = 200 deg is out of range: "
    r"must be >= 0 and <= 90 deg$",
    "gait_reference(20)": r"must be finite and > 0 and <= 10 Hz$",
    "Uncertainty(low=1.0)": r"must have either low and high, or options$",
    "scenario.with_law(later)": r"later: is async; remove the word async$",
    # another object
    "kx.Scenario('my.yaml')": r"load_scenario\(path\) reads a file$",
    "kx.Scenario(controller=PidParameters)": r"the class PidParameters: must be an object, such as "
    r"PidParameters\(\)$",
    "kx.Scenario(plant=CylinderParameters())": r"must be an object of PlantParameters$",
    "kx.track('my.yml')": r"my.yml: cannot be read: .*; did you mean my.yaml\?$",
    "kx.track({})": r"{}: must be an object of Scenario, such as Sc.*path\)$",
    "kx.track('bench')": r"'bench': must be an object of Scenario, such as "
    r"Scenario.preset\(\"bench\"\) or load",
    "make_closed_loop('leg')": r"such as Scenario.preset\(\"leg\"\) or",
    "make_plant('leg')": r"such as Scenario.preset\(\"leg\"\).plant$",
    "BldcPump({'lag_s': 0.01})": r"^parameters = .*: must be an object of BldcPumpParameters, such "
    r"as BldcPumpPa",
    "linearize_plant(scenario)": r"must be an object of PlantParamet",
    "linearize_loop(scenario.plant)": r"must be an object of Scenario",
    "detector_thresholds(3)": r"scenario = 3: must be an object of S",
    "fault_survival('leg', [], [])": r"must be an object of Scenario",
}


async def later(rod_extension):
    return 0.0


@pytest.mark.parametrize("line", PYTHON)
def test_a_line_of_python(directory, line):
    run = Run(
        np.arange(3.0), {name: np.zeros(3) for name in columns([*SIGNALS])}, SimulationParameters()
    )
    with pytest.raises((KneexoError, AttributeError)) as caught:
        exec(line, WORLD | {"run": run, "later": later})
    assert_helps(str(caught.value), PYTHON[line])
