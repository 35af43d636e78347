import json
import math
from dataclasses import dataclass
from functools import partial
from io import FileIO
from types import MappingProxyType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kneexo.analysis import parallel_map
from kneexo.analysis.checkpoint import Checkpoint, piece_keys
from kneexo.errors import OutputError
from kneexo.parameters import CylinderParameters, Scenario


def square(value):
    CALLS.append(value)
    return {"square": value * value}


def stop_at(limit, value):
    if value >= limit:
        raise KeyboardInterrupt
    return square(value)


CALLS: list[float] = []


@pytest.fixture(autouse=True)
def _no_calls():
    CALLS.clear()


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path):
    path = tmp_path / "sweep.jsonl"
    items = [0.1, 0.2, 0.3, 0.4]
    with pytest.raises(KeyboardInterrupt):
        parallel_map(partial(stop_at, 0.3), items, checkpoint=Checkpoint(path))
    assert CALLS == [0.1, 0.2]
    resumed = Checkpoint(path, resume=True)
    assert len(resumed) == 2
    # Another limit is another function: nothing of it is taken.
    again = parallel_map(partial(stop_at, 9.0), items, checkpoint=resumed)
    assert [result["square"] for result in again] == [value * value for value in items]
    CALLS.clear()
    assert (
        parallel_map(partial(stop_at, 9.0), items, checkpoint=Checkpoint(path, resume=True))
        == again
    )
    assert CALLS == []


def test_without_resume_the_file_starts_empty_and_remove_deletes_it(tmp_path):
    path = tmp_path / "sweep.jsonl"
    parallel_map(square, [1.0], checkpoint=Checkpoint(path))
    fresh = Checkpoint(path)
    assert len(fresh) == 0
    parallel_map(square, [1.0], checkpoint=fresh)
    assert CALLS == [1.0, 1.0]
    fresh.remove()
    assert not path.exists()


@given(value=st.floats(allow_infinity=True, allow_nan=False))
def test_floats_come_back_bit_by_bit(tmp_path_factory, value):
    path = tmp_path_factory.mktemp("sweep") / "sweep.jsonl"
    kept = Checkpoint(path).keep("a", {"x": value, "none": None, "nan": math.nan})
    read = Checkpoint(path, resume=True)["a"]
    assert read["x"] == kept["x"] == value
    assert math.isnan(read["nan"])


@pytest.mark.parametrize("tail", ['["b", 2', '["b", 2]', "\x00\x00"])
def test_a_torn_last_line_is_dropped_and_overwritten(tmp_path, tail):
    path = tmp_path / "sweep.jsonl"
    path.write_text(json.dumps(["a", 1]) + "\n" + tail)
    checkpoint = Checkpoint(path, resume=True)
    assert "a" in checkpoint
    assert "b" not in checkpoint
    checkpoint.keep("c", 3)
    assert Checkpoint(path, resume=True)["c"] == 3


def test_the_key_depends_on_function_and_every_number():
    @dataclass(frozen=True)
    class Point:
        x: float

    heavy = Scenario().model_copy(
        update={"plant": Scenario().plant.model_copy(update={"cylinder": CylinderParameters()})}
    )
    assert len(set(piece_keys(square, [Scenario(), heavy]))) == 1
    items = [Scenario(), Scenario(can_delay_samples=1), Point(1.0), Point(2.0), (1.0, "a")]
    keys = [
        key
        for function in (square, partial(stop_at, 1.0), partial(stop_at, 2.0))
        for key in piece_keys(function, items)
    ]
    assert len(set(keys)) == 15
    with pytest.raises(TypeError, match="object cannot be part"):
        piece_keys(square, [object()])


def test_a_file_that_cannot_be_written_is_one_line(tmp_path):
    with pytest.raises(OutputError, match=r"checkpoint .*: "):
        Checkpoint(tmp_path / "no" / "sweep.jsonl").keep("a", 1)
    with pytest.raises(OutputError, match="checkpoint"):
        Checkpoint(tmp_path)


def test_a_full_disk_is_one_line(tmp_path):
    path = tmp_path / "sweep.jsonl"
    checkpoint = Checkpoint(path)
    path.symlink_to("/dev/full")
    for _ in range(2):
        with pytest.raises(OutputError, match="No space left on device") as caught:
            checkpoint.keep("a", 1)
        assert "\n" not in str(caught.value)


def test_a_piece_that_the_disk_takes_in_parts_is_whole(tmp_path):
    class Slow(FileIO):
        def write(self, data):
            return super().write(data[:7])

    path = tmp_path / "sweep.jsonl"
    checkpoint = Checkpoint(path)
    checkpoint._file = Slow(path, "ab")
    for n in range(3):
        checkpoint.keep(f"piece {n}", {"value": n + 0.5})
    kept = Checkpoint(path, resume=True)
    assert [kept[f"piece {n}"]["value"] for n in range(3)] == [0.5, 1.5, 2.5]
    checkpoint.remove()


def test_many_pieces_are_kept_while_the_file_is_open(tmp_path):
    path = tmp_path / "sweep.jsonl"
    checkpoint = Checkpoint(path)
    for n in range(3):
        checkpoint.keep(f"{n}", n)
        assert len(Checkpoint(path, resume=True)) == n + 1
    checkpoint.remove()
    checkpoint.keep("again", 1)
    assert len(Checkpoint(path, resume=True)) == 1


def test_keys_tell_apart_what_json_does_not_know():
    tried = [
        {"a": 1.0},
        {"a": 1.5},
        MappingProxyType({"a": 2.0}),
        [Scenario(), {"a": 1.0}],
        [Scenario(can_delay_samples=1), {"a": 1.0}],
        partial(square, 1.0),
        partial(square, 2.0),
        square,
        math.nextafter(1.5, 2.0),
        None,
    ]
    assert len(set(piece_keys(square, tried))) == len(tried)
    assert piece_keys(square, [{"a": 1.0, "b": 2.0}]) == piece_keys(square, [{"b": 2.0, "a": 1.0}])
