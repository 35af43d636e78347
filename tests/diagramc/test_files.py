"""Files that appear whole or not at all, and folders of them."""

import os
import re
from pathlib import Path

import pytest

from diagramc.errors import OutputError
from diagramc.files import (
    delete_stale,
    files_in,
    require_empty,
    temporary_folder,
    write_folder,
    write_whole,
)


@pytest.mark.parametrize("interrupted", ["write", "replace"])
def test_an_interrupt_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch, interrupted):
    file = tmp_path / "a"
    write_whole(file, b"old")

    def interrupt(*_):
        raise KeyboardInterrupt

    def write_a_part(path, content):
        path.write_text("n")
        interrupt()

    with monkeypatch.context() as patch:
        if interrupted == "replace":
            patch.setattr(os, "replace", interrupt)
        else:
            patch.setattr(Path, "write_bytes", write_a_part)
        with pytest.raises(KeyboardInterrupt):
            write_whole(file, b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert file.read_bytes() == b"old"
    write_whole(file, b"new")
    assert file.read_bytes() == b"new"


def test_only_old_temporary_files_of_a_name_are_deleted(tmp_path):
    names = [".a.0123456789abcdef", ".b.0123456789abcdef", ".a.0123", "a"]
    for name in names:
        (tmp_path / name).touch()
    delete_stale(tmp_path, "a")
    assert len(list(tmp_path.iterdir())) == 4
    for name in names:
        os.utime(tmp_path / name, (0.0, 0.0))
    delete_stale(tmp_path, "a")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])


def test_files_are_listed_by_their_whole_name(tmp_path):
    (tmp_path / "ab").write_bytes(b"123")
    (tmp_path / "abc").touch()
    (tmp_path / "a").mkdir()
    (entry,) = files_in(tmp_path, re.compile("ab?"))
    assert (entry.path, entry.size_bytes) == (tmp_path / "ab", 3)
    assert files_in(tmp_path / "none", re.compile(".*")) == []


def test_a_folder_gets_the_files_and_keeps_the_others(tmp_path):
    folder = tmp_path / "new" / "out"
    write_folder(folder, {"a": "1", "b": "2"})
    (folder / ".diagramc_x").mkdir()  # of a killed process
    write_folder(folder, {"b": "3"})
    assert sorted(path.name for path in folder.iterdir()) == ["a", "b"]
    assert [(folder / name).read_text() for name in "ab"] == ["1", "3"]


def test_only_an_empty_folder_is_empty(tmp_path):
    require_empty(tmp_path / "none")
    (tmp_path / ".diagramc_x").mkdir()  # of a killed process
    require_empty(tmp_path)
    (tmp_path / "a").touch()
    line = rf"^directory {tmp_path}: has other files and no export; choose another directory$"
    with pytest.raises(OutputError, match=line):
        require_empty(tmp_path)
    with pytest.raises(OutputError, match=r"a: cannot be read \(Not a directory\); choose another"):
        require_empty(tmp_path / "a")


def test_a_temporary_folder_holds_the_files_and_ends_with_the_body():
    with temporary_folder({"a": "α"}) as folder:
        assert (folder / "a").read_text(encoding="utf-8") == "α"
    assert not folder.exists()


def test_a_file_in_the_place_of_the_folder_is_one_line(tmp_path):
    path = tmp_path / "out"
    path.write_text("")
    with pytest.raises(OutputError, match="cannot write there") as error:
        write_folder(path, {"a.c": ""})
    assert "\n" not in str(error.value)
