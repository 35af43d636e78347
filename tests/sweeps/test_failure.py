"""Failed runs of scenarios as files, which hold every bit and no code."""

import dataclasses
import json
import math
import os

import pytest

from kneexo.compiler import RunEnd
from kneexo.errors import OutputError, ParameterError, ResultError, SimulationError
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.simulation import simulate
from kneexo.simulation.engines import RunRequest, serve_runs
from kneexo.sweeps.failure import read_failure, record_failure

SHORT = changed(
    Scenario(),
    {
        "reference": {"kind": "sine", "mean_deg": 3.0, "amplitude_deg": 2.9, "frequency_hz": 1.0},
        "controller": {"kind": "pid"},
        "simulation.duration_s": 0.2,
    },
)
GAIN = "controller.integral_per_s2"
FAILING = changed(SHORT, {GAIN: 1e5})
"""The integral overshoots the end of the range of motion after some tenths of a second."""
LAW = """\
def law(rod_extension, rod_reference, gain={gain}):
    error = rod_reference[0] - rod_extension
    return gain * error if error > 0.0 else gain * error  # called as Python, as it branches
"""


@pytest.fixture
def wrong_sign(tmp_path):
    """A scenario whose law drives the knee out of its range, with its file."""
    file = tmp_path / "laws" / "my.py"
    file.parent.mkdir()
    file.write_text(LAW.format(gain=-1e5), encoding="utf-8")
    return changed(SHORT, {"simulation.duration_s": 1.0}).with_law(f"{file}:law"), file


def runs_of_a_sweep(scenarios):
    """What the engine answers to runs that share a batch."""
    return dict(serve_runs({n: RunRequest(scenario) for n, scenario in enumerate(scenarios)}))


def test_a_run_recorded_alone_ends_as_in_the_batch_with_the_same_bits(tmp_path):
    variants = [changed(SHORT, {GAIN: gain}) for gain in (1e5, 10.0, 0.9e5)]
    runs = runs_of_a_sweep(variants)
    assert [isinstance(runs[n], SimulationError) for n in range(3)] == [True, False, True]
    for number in (0, 2):
        path = tmp_path / f"{number}.json"
        record_failure(variants[number], note={"run": number}).write(path)
        failure = read_failure(path)
        assert failure.note == {"run": number}
        assert failure.scenario == variants[number]
        assert failure.end == RunEnd.of(runs[number])
        assert 0.0 < failure.end.time_s < 0.2
        assert len(failure.end.state) == 7
        again = failure.replay()
        assert (again.difference, again.changes) == ("", ())
        with pytest.raises(SimulationError, match=r"left the range of motion"):
            failure.simulate()
    assert runs[0].time_s <= runs[2].time_s
    assert repr(runs[0].state) != repr(runs[2].state)
    with pytest.raises(ResultError, match=r"^the run does not fail: there is no failure to write$"):
        record_failure(variants[1])


def test_the_error_of_the_sweep_must_be_that_of_the_run_alone():
    error = record_failure(FAILING).end.message
    assert record_failure(FAILING, error=error).end.message == error
    with pytest.raises(ResultError, match=r"^the run alone fails in another way: t = .*; not oth"):
        record_failure(FAILING, error="other")


SAMPLES = {"kind": "samples", "times_s": [0.0, 0.1, 1 / 3], "angles_deg": [0.1, 5.0, 9.0]}


@pytest.mark.parametrize("values", [{}, {"reference": SAMPLES}])
def test_each_scenario_returns_with_all_its_bits(tmp_path, values):
    """The run cannot start, so its error is no `SimulationError`."""
    failing = changed(FAILING, {"initial_offset_m": 0.15, GAIN: 1e4 / 3.0} | values)
    path = tmp_path / "failure.json"
    record_failure(failing).write(path)
    failure = read_failure(path)
    assert failure.end.error == "ParameterError"
    assert failure.scenario == failing
    assert failure.replay().same


def test_the_engine_drake_repeats_its_runs_too(tmp_path):
    scenario = changed(FAILING, {"simulation.integrator": "radau3"})
    path = tmp_path / "failure.json"
    record_failure(scenario).write(path)
    failure = read_failure(path)
    assert failure.end.message.startswith("t = 0.")
    assert (math.isnan(failure.end.time_s), failure.end.state) == (True, {})
    assert failure.replay().same


def test_the_file_names_the_law_relative_to_itself(tmp_path, wrong_sign):
    """So the file, and the law beside it, can move to another folder."""
    scenario, _ = wrong_sign
    path = tmp_path / "failures" / "a b.json"
    path.parent.mkdir()
    record_failure(scenario).write(path)
    text = path.read_text(encoding="utf-8")
    assert str(tmp_path) not in text
    assert "rod_reference" not in json.dumps(json.loads(text)["scenario"])
    name, digest = json.loads(text)["scenario"]["controller"]["function"].split("#")
    assert name == os.path.join("..", "laws", "my.py:law")
    assert scenario.controller.function.fingerprint.startswith(digest)
    (tmp_path / "failures").rename(tmp_path / "moved")
    assert read_failure(tmp_path / "moved" / "a b.json").replay().same


def test_a_changed_law_is_refused_unless_the_law_of_today_is_asked_for(tmp_path, wrong_sign):
    scenario, file = wrong_sign
    path = tmp_path / "failure.json"
    record_failure(scenario).write(path)
    file.write_text(LAW.format(gain=-1e5).replace("gain *", "-gain *"), encoding="utf-8")
    with pytest.raises(
        ParameterError, match=r"failure\.json: .*'\.\./.*|the code has changed since"
    ):
        read_failure(path)
    today = read_failure(path, same_law=False)
    assert today.scenario.controller.values == {"gain": -1e5}  # the gains are those of the run
    assert today.simulate().time_s[-1] == pytest.approx(1.0)


def test_a_law_that_no_file_has_cannot_be_written(tmp_path):
    def law(rod_extension, rod_reference):
        return 1e5 * (rod_extension - rod_reference[0])

    path = tmp_path / "failure.json"
    failure = record_failure(SHORT.with_law(law))
    with pytest.raises(ParameterError, match=r"existed only in the Python session that made it"):
        failure.write(path)
    with pytest.raises(OutputError, match=r"absent/failure\.json: cannot be written \("):
        record_failure(changed(SHORT, {"initial_offset_m": 0.15})).write(
            tmp_path / "absent" / "failure.json"
        )
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "failure.json"
    record_failure(changed(SHORT, {"initial_offset_m": 0.15})).write(path)
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "x"}, "must be a file of kneexo with a failed run of a scenario"),
        ({"scenario": []}, "scenario: must be an object"),
        ({"scenario": {"mass": 1.0}}, "Scenario: mass: unknown name"),
        ({"scenario": {"initial_offset_m": 7}}, "Scenario: initial_offset_m = 7 m is out of range"),
        ({"scenario": {"controller": {"kind": "law", "function": 3}}}, "Scenario: controller.fun"),
        ({"end": {"error": "x"}}, "end.message: must be a text"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(file, changes, message):
    document = json.loads(file.read_text("utf-8"))
    file.write_text(json.dumps(document | changes), encoding="utf-8")
    with pytest.raises(ParameterError) as caught:
        read_failure(file)
    assert str(caught.value).startswith(f"{file}: {message}")
    assert "\n" not in str(caught.value)


def test_a_replay_names_what_changed(file):
    document = json.loads(file.read_text("utf-8"))
    document["versions"] |= {"kneexo": "0.0.1", "equations": "0" * 64}
    document["end"]["message"] = "another"
    file.write_text(json.dumps(document), encoding="utf-8")
    again = read_failure(file).replay()
    assert again.difference.startswith("the run now ends with ParameterError: the rod starts at")
    version, equations = again.changes
    assert version.startswith("kneexo changed since the file was written: 0.0.1, now ")
    assert equations.startswith("equations changed since the file was written: 0000")
    document |= {"versions": None, "note": None}
    file.write_text(json.dumps(document), encoding="utf-8")
    assert len(read_failure(file).replay().changes) == 4


def test_a_repaired_run_is_a_difference(file):
    failure = read_failure(file)
    repaired = dataclasses.replace(failure, scenario=SHORT)
    assert repaired.replay().difference.startswith("the run now ends with success, not with Param")
    assert repaired.replay().end.time_s == simulate(SHORT, signals=("knee_angle",)).time_s[-1]
