"""JSON files that are read up to a limit, and checked entry by entry."""

import os
import re

import pytest

from kneexo.compiler import OutputError, ParameterError
from kneexo.compiler.json_files import (
    MOST_BYTES,
    document_text,
    number_of,
    read_document,
    write_document,
)


def test_a_document_returns_with_its_kind(tmp_path):
    path = tmp_path / "a.json"
    write_document(path, document_text("test", {"x": 0.1, "none": None, "text": "ü"}))
    document = read_document(path, "test")
    assert (document["x"], document["none"], document["text"]) == (0.1, None, "ü")
    with pytest.raises(ParameterError, match=r"a\.json: must be a file of \w+ with a other$"):
        read_document(path, "other")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "must be a file of"),
        (b"[1]", "must be a file of"),
        (b"[" * 100_000, "must be a file of"),
        (b"\xff\xfe{}", "must be a file of"),
        (b'{"kind": ' + b"1" * 5000 + b"}", "must be a file of"),
        (b" " * (MOST_BYTES + 1), "is too large, must have at most 67108864 bytes"),
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path, data, reason):
    path = tmp_path / "a.json"
    path.write_bytes(data)
    with pytest.raises(ParameterError, match=rf"a\.json: {re.escape(reason)}"):
        read_document(path, "test")


def test_only_a_document_is_replaced(tmp_path):
    text = document_text("run", {"number": 1.0})
    pipe, mine, path = tmp_path / "pipe", tmp_path / "mine.json", tmp_path / "run.json"
    os.mkfifo(pipe)
    mine.write_text("{}\n")
    for name in (pipe, mine, tmp_path, ""):
        with pytest.raises(OutputError, match=r"exists and is no document of .*; choose another"):
            write_document(name, text)
    assert pipe.is_fifo()
    assert mine.read_text() == "{}\n"
    for name in ("\x00", tmp_path / "no folder" / "run.json", tmp_path / ("x" * 300)):
        with pytest.raises(OutputError, match=r"cannot be written \("):
            write_document(name, text)
    for number in (1.0, 2.0):
        write_document(path, document_text("run", {"number": number}))
    assert read_document(path, "run")["number"] == 2.0
    assert sorted(tmp_path.iterdir()) == [mine, pipe, path]


def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", "absent", "."):
        with pytest.raises(ParameterError, match=r": cannot be read \(is no file\)$"):
            read_document(tmp_path / name, "test")
    with pytest.raises(ParameterError, match=r"^a\\x00b: cannot be read"):
        read_document("a\0b", "test")


def test_texts_stand_for_numbers_only_where_they_may():
    assert number_of("x", "-inf", finite=False) == float("-inf")
    assert number_of("x", 3) == 3.0
    for value in ("-inf", "1", None, [1.0], False, float("nan")):
        with pytest.raises(ParameterError, match=r"^x = .*: must be a number$"):
            number_of("x", value)
    with pytest.raises(ParameterError):
        number_of("x", "infinity", finite=False)
