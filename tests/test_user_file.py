"""Files of the user: what is read, and one short line for what is not."""

import os
import tracemalloc

import pytest

from kneexo import user_file
from kneexo.errors import ScenarioError
from kneexo.user_file import read_bytes, read_table, read_text


@pytest.fixture
def write(tmp_path):
    """Write a file; returns its path."""

    def make(content):
        path = tmp_path / "table.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


def fault(function, *arguments):
    with pytest.raises(ScenarioError) as caught:
        function(*arguments)
    message = str(caught.value)
    assert message.isprintable()
    return message.rpartition("/")[2]


# --------------------------------------------------------------------------------- bytes


def test_a_file_may_have_its_limit_and_no_more(write):
    path = write(b"x" * 100)
    assert read_bytes(path, 100) == b"x" * 100
    with pytest.raises(OSError, match="is too large, must have at most 99 bytes"):
        read_bytes(path, 99)


def test_a_file_whose_size_is_not_told_ends_at_the_limit():
    path = "/proc/self/maps"
    assert os.stat(path).st_size == 0
    assert b"[stack]" in read_bytes(path, 2**24)
    with pytest.raises(OSError, match="is too large"):
        read_bytes(path, 10)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2**40)
    tracemalloc.start()
    with pytest.raises(OSError, match="is too large"):
        read_bytes(tmp_path / "sparse", 2**38)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_what_may_never_end_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "zero").symlink_to("/dev/zero")
    for name, told in (
        ("pipe", "is not a regular file"),
        ("zero", "is not a regular file"),
        ("loop", "Too many levels of symbolic links"),
        ("missing", "No such file or directory"),
        ("", "Is a directory"),
    ):
        for read in (lambda path: read_text(path, 100), lambda path: read_table(path, ("t",))):
            with pytest.raises(ScenarioError, match=f"cannot be read: {told}$"):
                read(tmp_path / name)


def test_a_pipe_that_replaces_a_file_does_not_hang(tmp_path, monkeypatch, write):
    os.mkfifo(tmp_path / "pipe")
    status = os.stat(write("t\n"))
    monkeypatch.setattr(user_file.os, "stat", lambda path: status)
    assert read_bytes(tmp_path / "pipe", 10) == b""


def test_too_little_memory_names_the_file(monkeypatch, write):
    def full(*_):
        raise MemoryError

    path = write("t\n1\n")
    monkeypatch.setattr(user_file.os, "fstat", full)
    told = "table.csv: cannot be read: is too large for the free memory"
    assert fault(read_text, path, 100) == told
    monkeypatch.undo()
    monkeypatch.setattr(user_file, "_number", full)
    told = "table.csv: cannot be read: has too many rows for the free memory"
    assert fault(read_table, path, ("t",)) == told


# ---------------------------------------------------------------------------------- text


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_text_has_no_mark(write, encoding):
    assert read_text(write("λ\n".encode(encoding)), 100) == "λ\n"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("t\n1\n".encode("utf-16"), "table.csv: is in UTF-16 or UTF-32; save it as UTF-8"),
        ("t\n1\n".encode("utf-32"), "table.csv: is in UTF-16 or UTF-32; save it as UTF-8"),
        ("t\n1\n".encode("utf-16-le"), "table.csv:1: has a null byte; must be text in UTF-8"),
        (b"t\n1\n2\0", "table.csv:3: has a null byte; must be text in UTF-8"),
        (b"\xef\xbb\xbft\n\xe9", "table.csv:2: is not UTF-8: byte 0xe9; save it as UTF-8"),
    ],
)
def test_another_encoding_has_its_remedy(write, content, told):
    assert fault(read_text, write(content), 100).startswith(told)


def test_names_are_short_and_on_one_line(tmp_path):
    line = fault(read_text, tmp_path / "a\n\x1b\udcff", 1)
    assert line.startswith("a\\n\\x1b\\udcff: cannot be read")
    for name in ("x" * 5000, "a\0b"):
        with pytest.raises(ScenarioError) as caught:
            read_text(name, 1)
        assert len(str(caught.value)) < 400


# -------------------------------------------------------------------------------- tables


def test_columns_are_read_by_name(write):
    path = write('# measured\n\n b , "a",note\r\n1,2,"x,y"\n#,,,\n\n3e1, -.5 ,"two\n# lines"\n')
    table = read_table(path, ("a", "b"))
    assert table.columns == {"a": [2.0, -0.5], "b": [1.0, 30.0]}
    assert table.lines == [4, 7]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_are_counted_after_a_quoted_newline(write, end):
    rows = ["t,note", f'0,"a{end}b{end}#c{end}{end}d"', "", "x,y"]
    assert fault(read_table, write(end.join(rows)), ("t",)).startswith("table.csv:8: t: 'x'; must")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "table.csv: is empty"),
        ("# t\n\n", "table.csv: is empty"),
        ("a,b\n", "table.csv: has no column 't'; it has a, b"),
        ("t,a,t\n0,1,2\n", "table.csv: has 2 columns 't'; must have one column of this name"),
        ("t,a\n0,1\n\n0,1,5\n", "table.csv:4: has 3 values; must have 2, one of each column"),
        ('t\n0\n"1\n2\n', "table.csv:3: a quotation mark opens a field that does not end"),
        ('t,a\n0,"' + "x" * 140_000, "table.csv:2: a field has more than 131072 characters"),
        ('t,a\n0,"1"2\n', "table.csv:2: ',' expected after '\"'; must be a record of CSV"),
        *(
            (f"t\n0\n{number}\n", f"table.csv:3: t: {number!a}; must be a finite number".rstrip())
            for number in ("1_0", "nan", "inf", "1e999", "0x1", "1 0")
        ),
        ("t,a\n٣,1\n", "table.csv:2: t: '٣'; must be a finite number in the digits 0-9"),
        ("a,t\n1\n", "table.csv:2: t: no value; must be"),
        (f"{'t' * 9000}\n", "table.csv: has no column 't'; it has tttt"),
        (f"t\n{'x' * 9000}\n", "table.csv:2: t: 'xxx"),
    ],
)
def test_a_fault_of_a_table_is_one_short_line(write, content, told):
    line = fault(read_table, write(content), ("t",))
    assert line.startswith(told)
    assert len(line) < 500


def test_blank_fields_after_the_last_column_are_no_values(write):
    assert read_table(write("t,a\n0,1,, \n"), ("t",)).columns == {"t": [0.0]}


def test_limits_of_a_column_name_line_and_range(write):
    table = read_table(write("t\n0\n\n1\n0.5\n"), ("t",))
    table.require("t", 0.0, 1.0, "s")
    told = "table.csv:4: t = 1 s is out of range: must be >= 0 and <= 0.9 s"
    assert fault(table.require, "t", 0.0, 0.9, "s") == told
    told = "table.csv:5: t = 0.5 s after 1 s: must increase by at least 0.1 s from row to row"
    assert fault(table.require_increase, "t", 0.1, "s") == told
