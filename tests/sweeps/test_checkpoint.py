import hashlib
import math
import warnings
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from io import FileIO
from types import MappingProxyType

import pytest
from hypothesis import given, strategies as st

from kneexo.errors import OutputError
from kneexo.law import FunctionLaw
from kneexo.parameters import CylinderParameters, LawParameters, Scenario
from kneexo.sweeps import parallel_map
from kneexo.sweeps.checkpoint import Checkpoint, piece_keys


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
    resumed = Checkpoint(path)
    assert len(resumed) == 2
    # Another limit is another function: nothing of it is taken.
    again = parallel_map(partial(stop_at, 9.0), items, checkpoint=resumed)
    assert [result["square"] for result in again] == [value * value for value in items]
    CALLS.clear()
    assert parallel_map(partial(stop_at, 9.0), items, checkpoint=Checkpoint(path)) == again
    assert CALLS == []


def test_a_restart_begins_empty_and_remove_deletes_the_file(tmp_path):
    path = tmp_path / "sweep.jsonl"
    parallel_map(square, [1.0], checkpoint=Checkpoint(path))
    fresh = Checkpoint(path, resume=False)
    assert len(fresh) == 0
    parallel_map(square, [1.0], checkpoint=fresh)
    assert CALLS == [1.0, 1.0]
    fresh.remove()
    assert not path.exists()


@given(value=st.floats(allow_infinity=True, allow_nan=False))
def test_floats_come_back_bit_by_bit(tmp_path_factory, value):
    path = tmp_path_factory.mktemp("sweep") / "sweep.jsonl"
    checkpoint = Checkpoint(path)
    stored = checkpoint.keep("a", {"x": value, "none": None, "nan": math.nan})
    checkpoint.close()
    read = Checkpoint(path)["a"]
    assert read["x"] == stored["x"] == value
    assert math.isnan(read["nan"])


def lines_of(tmp_path, count):
    """A checkpoint of some pieces, and its lines."""
    path = tmp_path / "sweep.jsonl"
    checkpoint = Checkpoint(path)
    for n in range(count):
        checkpoint.keep(f"piece {n}", {"value": n + 0.5})
    checkpoint.close()
    lines = path.read_bytes().splitlines(keepends=True)
    assert len(lines) == count
    return path, lines


def sealed(payload):
    seal = hashlib.sha256(payload).hexdigest()
    return b'{"sha256": "%b", "piece": %b}\n' % (seal.encode(), payload)


NESTED = b"[" * 100_000 + b"]" * 100_000 + b"\n"
DAMAGE = {
    "digit": lambda line: line.replace(b"1.5", b"1.6"),
    "key": lambda line: line.replace(b"piece 1", b"piece 7"),
    "checksum": lambda line: line[:14] + bytes([line[14] ^ 1]) + line[15:],
    "zeros": lambda line: bytes(len(line) - 1) + b"\n",
    "no object": lambda line: b"5\n",
    "no pair": lambda line: sealed(b"5"),
    "no text": lambda line: sealed(b"[[], 5]"),
    "no JSON": lambda line: sealed(b"["),
    "nested": lambda line: NESTED,
    "nested and sealed": lambda line: sealed(NESTED[:-1]),
    "no UTF-8": lambda line: b"\xff\xfe\n",
    "without checksum": lambda line: b'["piece 1", {"value": 1.6}]\n',
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_line_is_skipped_and_counted_alone(tmp_path, name):
    path, lines = lines_of(tmp_path, 3)
    path.write_bytes(lines[0] + DAMAGE[name](lines[1]) + lines[2])
    with pytest.warns(UserWarning, match="1 damaged line is skipped") as caught:
        checkpoint = Checkpoint(path)
    # In random order, a file that an earlier test left open may be collected here, with a warning.
    (warning,) = [w for w in caught if w.category is not ResourceWarning]
    assert "\n" not in str(warning.message)
    assert [f"piece {n}" in checkpoint for n in range(3)] == [True, False, True]
    assert checkpoint["piece 2"] == {"value": 2.5}
    checkpoint.keep("piece 1", {"value": 1.5})
    checkpoint.close()
    with pytest.warns(UserWarning, match="1 damaged line is skipped"):
        checkpoint = Checkpoint(path)
    assert [checkpoint[f"piece {n}"]["value"] for n in range(3)] == [0.5, 1.5, 2.5]


@pytest.mark.filterwarnings("ignore:checkpoint")
def test_a_file_cut_anywhere_keeps_what_is_whole(tmp_path):
    path, lines = lines_of(tmp_path, 2)
    whole = path.read_bytes()
    for size in range(len(whole) + 1):
        path.write_bytes(whole[:size])
        checkpoint = Checkpoint(path)
        ends = (len(lines[0]) - 1, len(whole) - 1)
        assert len(checkpoint) == sum(size >= end for end in ends)
        checkpoint.keep("new", 3)
        checkpoint.close()
        again = Checkpoint(path)
        assert len(again) == len(checkpoint)
        assert again["new"] == 3
        again.close()


def test_a_cleared_file_has_no_damage(tmp_path):
    path, _ = lines_of(tmp_path, 2)
    path.write_bytes(path.read_bytes()[:-5])
    with warnings.catch_warnings(action="error"):
        checkpoint = Checkpoint(path, resume=False)
        checkpoint.keep("new", 3)
        checkpoint.close()
        assert list(map(Checkpoint(path).__contains__, ("new", "piece 0"))) == [True, False]


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "huge"
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(OutputError, match="huge: is too large, must have at most 4294967296 bytes"):
        Checkpoint(path)
    assert path.stat().st_size == 2**40


def test_pieces_of_other_settings_outlive_a_sweep_that_is_complete(tmp_path):
    path, _ = lines_of(tmp_path, 2)
    checkpoint = Checkpoint(path)
    assert parallel_map(square, [1.0, 2.0], checkpoint=checkpoint) == [square(1.0), square(2.0)]
    assert checkpoint.remove() == 2
    assert len(Checkpoint(path)) == 4


def test_the_key_depends_on_function_and_every_number():
    @dataclass(frozen=True)
    class Point:
        x: float

    heavy = Scenario().model_copy(
        update={"plant": Scenario().plant.model_copy(update={"cylinder": CylinderParameters()})}
    )
    assert len(set(piece_keys(square, [Scenario(), heavy]))) == 1
    items = [Scenario(), Scenario(bus={"latency_samples": 1}), Point(1.0), Point(2.0), (1.0, "a")]
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
    checkpoint._file._stream = FileIO("/dev/full", "ab")
    for _ in range(2):
        with pytest.raises(OutputError, match="No space left on device") as caught:
            checkpoint.keep("a", 1)
        assert "\n" not in str(caught.value)


def test_a_piece_that_was_cut_short_spoils_no_other(tmp_path):
    class Fails(FileIO):
        fail = True

        def write(self, data):
            if self.fail:
                super().write(data[:50])
                raise OSError(28, "No space left on device")
            return super().write(data)

    path = tmp_path / "sweep.jsonl"
    checkpoint = Checkpoint(tmp_path / "other.jsonl")
    checkpoint._file._stream = failing = Fails(path, "ab")
    with pytest.raises(OutputError, match="No space"):
        checkpoint.keep("a", 1)
    failing.fail = False
    checkpoint.keep("b", 2)
    with pytest.warns(UserWarning, match="1 damaged line"):
        read = Checkpoint(path)
    assert ("a" in read, read["b"]) == (False, 2)


def test_a_piece_is_in_the_file_at_once(tmp_path):
    path, copy = tmp_path / "sweep.jsonl", tmp_path / "copy.jsonl"
    checkpoint = Checkpoint(path)
    for n in range(3):
        checkpoint.keep(f"{n}", n)
        copy.write_bytes(path.read_bytes())
        read = Checkpoint(copy)
        assert len(read) == n + 1
        read.close()
    checkpoint.remove()
    checkpoint.keep("again", 1)
    checkpoint.close()
    assert len(Checkpoint(path)) == 1


def test_keys_tell_apart_what_json_does_not_know():
    tried = [
        {"a": 1.0},
        {"a": 1.5},
        MappingProxyType({"a": 2.0}),
        [Scenario(), {"a": 1.0}],
        [Scenario(bus={"latency_samples": 1}), {"a": 1.0}],
        partial(square, 1.0),
        partial(square, 2.0),
        square,
        math.nextafter(1.5, 2.0),
        None,
    ]
    assert len(set(piece_keys(square, tried))) == len(tried)
    assert piece_keys(square, [{"a": 1.0, "b": 2.0}]) == piece_keys(square, [{"b": 2.0, "a": 1.0}])


def law_with(value):
    def law(rod_extension):
        return float(value != 0) * rod_extension

    return law


def test_a_compiled_law_is_known_by_its_equations():
    def keys(value):
        return piece_keys(square, [Scenario().with_law(law_with(value))])

    assert keys(Fraction(1)) == keys(2)  # the law has only `value != 0`
    assert keys(Fraction(1)) != keys(0)
    systems = (lambda: Gained(2.0), lambda: Gained(2.0), lambda: Gained(3.0))
    one, same, other = (piece_keys(square, [Scenario().with_law(make)]) for make in systems)
    assert one == same
    assert one != other


def Gained(gain):
    """Return a compiled system, whose makers are all called `<lambda>`."""
    return FunctionLaw(LawParameters(function=lambda rod_extension: gain * rod_extension))


GAIN = 2.0


def python_law(rod_extension):
    return GAIN * float(rod_extension)


def test_a_law_in_python_is_known_by_its_files_and_values(tmp_path, monkeypatch):
    def keys(law):
        return piece_keys(square, [Scenario().with_law(law)])

    before = keys(python_law)
    assert keys(python_law) == before
    monkeypatch.setitem(globals(), "GAIN", 3.0)
    assert keys(python_law) != before
    file, helper = tmp_path / "my.py", tmp_path / "law_helper.py"
    file.write_text(
        "import law_helper\ndef law(knee_angle): return law_helper.K * float(knee_angle)\n"
    )
    helper.write_text("K = 2.0\n")
    before = keys(f"{file}:law")
    helper.write_text("K = 2.0  # K is the same\n")
    assert keys(f"{file}:law") != before
    file.rename(tmp_path / "moved.py")
    other = keys(f"{tmp_path / 'moved.py'}:law")
    assert other == keys(f"{tmp_path / 'moved.py'}:law") != before


def test_a_law_that_cannot_be_recognized_keeps_no_pieces(tmp_path):
    path = tmp_path / "sweep.jsonl"
    scenario = Scenario().with_law(lambda rod_extension: float(rod_extension))
    for _ in range(2):
        checkpoint = Checkpoint(path)
        with pytest.warns(UserWarning, match="law .*<lambda>: it is called as Python"):
            parallel_map(duration_of, [scenario], checkpoint=checkpoint)
        assert len(checkpoint) == 0
    assert CALLS == [30.0, 30.0]


def duration_of(scenario):
    CALLS.append(scenario.duration_s)
    return scenario.duration_s
