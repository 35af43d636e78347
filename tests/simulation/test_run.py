"""A run as columns: access by name, time first, a frame."""

import numpy as np
import pytest

from kneexo.errors import KneexoError
from kneexo.parameters import SimulationParameters
from kneexo.simulation.run import Run


@pytest.fixture
def run():
    data = {"knee_angle_rad": np.array([0.1, 0.2]), "rod_force_n": np.array([3.0, 4.0])}
    return Run(np.array([0.0, 0.002]), data, SimulationParameters())


def test_a_column_is_read_by_its_name(run):
    np.testing.assert_array_equal(run["rod_force_n"], [3.0, 4.0])
    np.testing.assert_array_equal(run["time_s"], [0.0, 0.002])


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ("knee", "column 'knee' is unknown; did you mean knee_angle_rad?"),
        (
            "load_pressure_pa",
            "column 'load_pressure_pa': the run has not logged it; add all_signals=True to track, "
            "or its signal to the signals of simulate",
        ),
        ("rod", "column 'rod' is unknown; did you mean rod_force_n?"),
        (3, "column 3 is unknown; the run has time_s, knee_angle_rad, rod_force_n"),
    ],
)
def test_an_unknown_column_is_answered_in_one_line(run, column, message):
    with pytest.raises(KeyError) as caught:
        run[column]
    assert isinstance(caught.value, KneexoError)
    assert str(caught.value) == message


def test_time_is_the_first_column(run):
    assert list(run.columns) == ["time_s", "knee_angle_rad", "rod_force_n"]
    assert "time_s" not in run.data


def test_a_frame_has_the_times_as_index(run):
    frame = run.to_dataframe()
    assert (frame.index.name, list(frame.index)) == ("time_s", [0.0, 0.002])
    assert frame.to_dict("list") == {"knee_angle_rad": [0.1, 0.2], "rod_force_n": [3.0, 4.0]}


def test_a_run_cannot_be_changed(run):
    with pytest.raises(AttributeError, match="time_s"):
        run.time_s = np.zeros(2)
