"""Random scenarios: signals and margins are finite, or one line says why there are none."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from kneexo.analysis import linearize_loop, track
from kneexo.errors import KneexoError
from kneexo.parameters import Scenario
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import with_preset

LONGEST_LINE = 1200
SAMPLES = {"kind": "samples", "times_s": (0.0, 0.1, 0.6), "angles_deg": (10.0, 30.0, 20.0)}
STRUCTURES = {
    "paper": {},
    "pid": {"controller": {"kind": "pid"}, "reference": {"kind": "step"}},
    "weight": {"plant.load": {"kind": "knee"}},
    "ideal": {
        "plant.ideal_motor": True,
        "estimator": {"kind": "exact"},
        "controller": {"kind": "smc", "continuous": True},
    },
    "bus": {
        "plant.linkage": "G3",
        "plant.rod_map": "polynomial",
        "nominal": {"linkage": "G3", "cylinder": {"mass_kg": 1.7}},
        "controller": {"kind": "smc", "switching": "signum"},
        "estimator": {"kind": "difference"},
        "bus": {"kind": "cia402", "latency_samples": 2},
        "reference": SAMPLES,
    },
    "wearer": with_preset("wearer", {"plant": {"full_order": False}}),
}
"""All of reduced order: at some ends of the ranges a run of full order takes minutes."""

CHOSEN = ("sample_time_s", "duration_s", "step_s", "velocity_unit_rpm")
"""Numbers that decide the length of a run, or that have a few values alone."""


def scenario_of(name):
    """A short scenario of `STRUCTURES`."""
    return changed(Scenario(), STRUCTURES[name] | {"simulation.duration_s": 0.02})


def numbers(holder, path=""):
    """Path, value, lower and upper bound of each number that may vary."""
    for name, field in type(holder).model_fields.items():
        value = getattr(holder, name)
        if isinstance(value, Parameters):
            yield from numbers(value, f"{path}{name}.")
        elif isinstance(value, float) and name not in CHOSEN:
            low = max(getattr(b, "ge", getattr(b, "gt", -math.inf)) for b in field.metadata)
            high = min(getattr(b, "le", math.inf) for b in field.metadata)
            yield path + name, value, low, high


def is_sound(scenario, values, *measurements):
    """Run a varied scenario and call ``measurements``; return whether none of them is refused."""
    line = ""
    try:
        varied = changed(scenario, values)
        for name, signal in track(varied, all_signals=True).run.data.items():
            assert np.isfinite(signal).all(), name
        for measure in measurements:
            measure(varied)
    except KneexoError as error:
        line = str(error)
    assert line.isprintable()
    assert len(line) <= LONGEST_LINE
    return not line


@st.composite
def some_numbers(draw, scenario):
    """A few numbers of a scenario: near their value, anywhere in their range, or at its ends."""
    values = {}
    for path, value, low, high in draw(st.lists(st.sampled_from([*numbers(scenario)]), max_size=5)):
        near = st.floats(-1.0, 1.0).map(lambda e, v=value: v * 10.0**e)
        drawn = draw(near | st.floats(low, high))
        values[path] = min(max(drawn, low), high)
    return values


@settings(max_examples=7, derandomize=True)  # another draw may be stiff and take seconds
@given(values=some_numbers(scenario_of("paper")))
def test_a_random_run_is_finite_or_one_line(values):
    is_sound(scenario_of("paper"), values)


@pytest.mark.slow
@pytest.mark.parametrize("name", STRUCTURES)
@settings(max_examples=30)
@given(data=st.data())
def test_random_runs_and_margins_of_each_structure_are_finite_or_one_line(name, data):
    scenario = scenario_of(name)
    is_sound(scenario, data.draw(some_numbers(scenario)), linearize_loop)


@pytest.mark.slow
@pytest.mark.parametrize("name", STRUCTURES)
def test_each_number_at_both_ends_of_its_range_is_finite_or_one_line(name):
    scenario = scenario_of(name)
    ends = [{path: end} for path, _, low, high in numbers(scenario) for end in (low, high)]
    assert sum(is_sound(scenario, values) for values in ends) > len(ends) / 4
