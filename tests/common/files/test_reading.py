import os
import tracemalloc

import pytest

from kneexo.common.files.reading import read_bytes, read_text
from kneexo.common.files.table import read_table
from kneexo.errors import ScenarioError

# --------------------------------------------------------------------------------- bytes


def test_a_file_may_have_its_limit_and_no_more(write):
    path = write(b"x" * 100)
    assert read_bytes(path, 100) == b"x" * 100
    with pytest.raises(OSError, match="is too large, must have at most 99 bytes"):
        read_bytes(path, 99)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2**40)
    tracemalloc.start()
    with pytest.raises(OSError, match="is too large"):
        read_bytes(tmp_path / "sparse", 2**38)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_only_regular_files_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "zero").symlink_to("/dev/zero")
    for name, reason in (
        ("pipe", "is not a regular file"),
        ("zero", "is not a regular file"),
        ("loop", "Too many levels of symbolic links"),
        ("missing", "No such file or directory"),
        ("", "Is a directory"),
    ):
        for read in (lambda path: read_text(path, 100), lambda path: read_table(path, ("t",))):
            with pytest.raises(ScenarioError, match=f"cannot be read: {reason}$"):
                read(tmp_path / name)


# ---------------------------------------------------------------------------------- text


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_text_comes_without_byte_order_mark(write, encoding):
    assert read_text(write("λ\n".encode(encoding)), 100) == "λ\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("t\n1\n".encode("utf-16"), "table.csv:1: is not UTF-8: byte 0xff; save it as UTF-8"),
        (b"\xef\xbb\xbft\n\xe9", "table.csv:2: is not UTF-8: byte 0xe9; save it as UTF-8"),
    ],
)
def test_the_error_of_another_encoding_names_the_remedy(write, fault, content, message):
    assert fault(read_text, write(content), 100).startswith(message)


def test_file_names_in_messages_are_short_and_on_one_line(tmp_path, fault):
    line = fault(read_text, tmp_path / "a\n\x1b\udcff", 1)
    assert line.startswith("a\\n\\x1b\\udcff: cannot be read")
    for name in ("x" * 5000, "a\0b"):
        with pytest.raises(ScenarioError) as caught:
            read_text(name, 1)
        assert len(str(caught.value)) < 400
