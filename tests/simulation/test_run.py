"""A run as columns: access by name, time first, a frame."""

import numpy as np
import pytest

from kneexo.parameters import SimulationParameters
from kneexo.simulation.run import Run


@pytest.fixture
def run():
    data = {"knee_angle_rad": np.array([0.1, 0.2]), "rod_force_n": np.array([3.0, 4.0])}
    return Run(np.array([0.0, 0.002]), data, SimulationParameters())


def test_a_column_is_read_by_its_name(run):
    np.testing.assert_array_equal(run["rod_force_n"], [3.0, 4.0])
    with pytest.raises(KeyError, match="time"):
        run["time"]


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
