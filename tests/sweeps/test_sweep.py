"""Sweeps: maps that share workers, checkpoint and progress bars."""

import math
import sys

import pytest

from kneexo.errors import SimulationError
from kneexo.sweeps import open_sweep
from kneexo.sweeps.checkpoint import Checkpoint


def test_a_sweep_maps_with_its_workers_and_its_checkpoint(tmp_path, at_once):
    executor, checkpoint = at_once(), Checkpoint(tmp_path / "pieces.jsonl")
    with open_sweep(workers=3, executor=executor, checkpoint=checkpoint) as sweep:
        assert sweep.map(math.sqrt, [4.0, 9.0]) == [2.0, 3.0]
        assert sweep.map(math.factorial, [3]) == [6]
    assert sum(executor.units) == len(checkpoint) == 3
    with open_sweep(executor=at_once(most=0), checkpoint=checkpoint) as sweep:
        assert sweep.map(math.sqrt, [9.0, 4.0]) == [3.0, 2.0]


@pytest.mark.parametrize("progress", [False, True])
def test_a_sweep_shows_the_bars_that_have_a_description(capsys, monkeypatch, progress):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with open_sweep(progress=progress) as sweep:
        sweep.map(math.sqrt, [4.0], "roots")
        sweep.map(math.sqrt, [4.0])
    assert ("roots: 100%" in capsys.readouterr().err) == progress


@pytest.mark.parametrize("key", ["failure", "tracking_failure"])
def test_a_sweep_in_which_every_run_fails_is_a_failure(key):
    def study():
        with open_sweep() as sweep:
            sweep.map(lambda text: {key: text}, ["too fast"])
            sweep.map(lambda text: {key: text}, ["too slow", "too hot"])
            sweep.map(str, ["no run"])

    with pytest.raises(SimulationError, match=r"^all 3 runs fail; the first: too fast$"):
        study()
    with open_sweep() as sweep:  # one run goes to its end, though its margins do not exist
        sweep.map(lambda text: {key: text}, ["too fast", ""])
    with open_sweep() as sweep:
        sweep.map(lambda text: {"tracking_failure": "", "failure": text}, ["no margins"])
