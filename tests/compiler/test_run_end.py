"""The comparison of two ends of a run, number by number and bit by bit."""

import json
import math
from dataclasses import replace

import pytest

from kneexo.compiler import ParameterError, Replay, RunEnd, SimulationError, version_changes

END = RunEnd("SimulationError", "t = 0.1 s: x is not finite", 0.1, {"x": math.nan, "d": -0.0})


def test_an_end_survives_json_with_every_bit():
    state = {"x": math.nan, "y": -math.inf, "z": -0.0, "w": 0.1 + 0.2, "v": 5e-324}
    end = replace(END, state=state)
    text = json.dumps(end.plain(), allow_nan=False)
    read = RunEnd.from_plain(json.loads(text))
    assert repr(read) == repr(end)
    assert math.copysign(1.0, read.state["z"]) == -1.0
    assert end.difference(read) == ""


def test_an_error_without_time_and_state_is_an_end_too():
    end = RunEnd.of(ParameterError("mass = -1 kg: must be > 0"))
    assert (end.error, end.message) == ("ParameterError", "mass = -1 kg: must be > 0")
    assert math.isnan(end.time_s)
    assert end.state == {}
    assert end.difference(RunEnd.from_plain(end.plain())) == ""
    error = SimulationError("t = 2 s: left")
    error.time_s, error.state = 2.0, {"x": 1.0}
    assert RunEnd.of(error) == RunEnd("SimulationError", "t = 2 s: left", 2.0, {"x": 1.0})


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ({}, ""),
        ({"error": "StiffnessError"}, "the run now ends with StiffnessError: t = 0.1 s: x is"),
        ({"message": "t = 0.1 s: y"}, "the run now ends with SimulationError: t = 0.1 s: y, not"),
        ({"error": "", "message": ""}, "the run now ends with success, not with SimulationError"),
        (
            {"time_s": math.nextafter(0.1, 1.0)},
            "the run now ends at t = 0.10000000000000002 s",
        ),
        ({"state": {"x": math.nan}}, "the run now has other states"),
        ({"state": {"x": math.nan, "d": 0.0}}, "d now ends at 0.0, not at -0.0"),
        ({"state": {"x": math.inf, "d": -0.0}}, "x now ends at inf, not at nan"),
    ],
)
def test_each_difference_has_its_line(change, difference):
    line = END.difference(replace(END, **change))
    assert line.startswith(difference)
    assert bool(line) == bool(difference)


def test_a_replay_says_what_changed():
    changes = version_changes({"drake": "1.51.0"}, {"drake": "1.58.0", "processor": "x"})
    assert changes == (
        "drake changed since the file was written: 1.51.0, now 1.58.0",
        "processor changed since the file was written: None, now x",
    )
    assert version_changes({"drake": "1", "other": "2"}, {"drake": "1"}) == ()
    for damaged in (None, [1], {"drake": [1.58]}, {"drake": "\x1b[2J\n"}):
        (line,) = version_changes(damaged, {"drake": "1.58.0"})
        assert line.endswith(", now 1.58.0")
        assert line.isprintable()
    assert str(Replay(END, "d now ends at 0.0", changes[:1])).splitlines() == [
        END.message,
        "d now ends at 0.0",
        changes[0],
    ]
