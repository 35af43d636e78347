import errno
import fcntl
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile

import pytest

from kneexo.common.files.writing import output_directory, write_file
from kneexo.errors import OutputError


def test_a_file_takes_the_place_of_an_earlier_one(tmp_path):
    path = tmp_path / "new" / "folder" / "file"
    for content in (b"first", b"second"):
        write_file(path, content)
        assert path.read_bytes() == content
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(("umask", "mode"), [(0o077, 0o600), (0o022, 0o644)])
def test_a_file_follows_the_umask(umask, mode, tmp_path):
    before = os.umask(umask)
    try:
        write_file(tmp_path / "file", b"content")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode


def test_a_failed_write_leaves_the_earlier_file_and_no_folder(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "file"
    path.write_bytes(b"earlier")
    monkeypatch.setattr("kneexo.common.files.writing.os.replace", full)
    for place in (path, tmp_path / "new" / "folder" / "file"):
        with pytest.raises(OutputError, match=f"--out {place}: .*No space left on device"):
            write_file(place, b"later")
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"earlier"


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="cannot write there") as error:
        write_file(tmp_path / "file" / "inner", b"content")
    assert "\n" not in str(error.value)
    with pytest.raises(OutputError, match="File name too long"):
        write_file(tmp_path / ("x" * 256) / "file", b"content")


def test_only_a_regular_file_is_replaced(tmp_path):
    (tmp_path / "notes").write_text("mine")
    write_file(tmp_path / "notes", b"page")
    assert (tmp_path / "notes").read_bytes() == b"page"
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputError, match=r"pipe is no regular file there; move it away"):
        write_file(tmp_path / "pipe", b"page")
    assert (tmp_path / "pipe").is_fifo()


# ----------------------------------------------------------------------- output_directory


def test_files_appear_when_the_body_ends(tmp_path):
    target = tmp_path / "a" / "b"
    with output_directory(target) as directory:
        (directory / "x.txt").write_text("1")
        assert not (target / "x.txt").exists()
    assert [file.name for file in target.iterdir()] == ["x.txt"]


def write_and_fail(target, text, error):
    with output_directory(target) as directory:
        (directory / "x.txt").write_text(text)
        raise error


def test_nothing_is_left_when_the_body_fails(tmp_path):
    target = tmp_path / "out"
    with pytest.raises(ZeroDivisionError):
        write_and_fail(target, "half", ZeroDivisionError())
    assert not target.exists()


def test_old_files_survive_a_failure(tmp_path):
    (tmp_path / "x.txt").write_text("old")
    with pytest.raises(KeyboardInterrupt):
        write_and_fail(tmp_path, "new", KeyboardInterrupt())
    assert [file.name for file in tmp_path.iterdir()] == ["x.txt"]
    assert (tmp_path / "x.txt").read_text() == "old"


@pytest.mark.parametrize("where", ["file", "file/below", "/proc/kneexo"])
def test_an_unwritable_directory_is_refused_before_the_body(tmp_path, where):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write there") as caught:
        write_and_fail(tmp_path / where, "", AssertionError("the body was entered"))
    assert f"{where}: cannot write there (" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_failing_write_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="No space"), output_directory(tmp_path / "out"):
        raise OSError(28, "No space left on device")
    assert not (tmp_path / "out").exists()


def write(target, text="new", names=("a.csv", "b.csv", "c.csv")):
    with output_directory(target) as directory:
        for name in names:
            (directory / name).write_text(text)


def texts(folder):
    return {file.name: file.read_text() for file in folder.iterdir() if file.is_file()}


def test_a_directory_in_the_place_of_a_file_leaves_all_old_files(tmp_path):
    write(tmp_path, "old", ["a.csv", "c.csv"])
    (tmp_path / "b.csv").mkdir()
    with pytest.raises(OutputError, match=r"b\.csv is no regular file there; move it") as caught:
        write(tmp_path)
    assert "\n" not in str(caught.value)
    assert texts(tmp_path) == {"a.csv": "old", "c.csv": "old"}
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("links", [True, False])
def test_an_error_in_the_middle_restores_the_old_files(tmp_path, monkeypatch, links):
    write(tmp_path, "old", ["a.csv", "c.csv"])
    replace = os.replace

    def fail(source, target):
        if source.name == "c.csv" and source.read_text() == "new":
            assert texts(tmp_path) == {"a.csv": "new", "b.csv": "new", "c.csv": "old"}
            raise OSError(5, "Input/output error")
        replace(source, target)

    def no_links(*_, **__):
        raise PermissionError

    monkeypatch.setattr(os, "replace", fail)
    if not links:
        monkeypatch.setattr(os, "link", no_links)
    with pytest.raises(OutputError, match="Input/output error"):
        write(tmp_path)
    assert texts(tmp_path) == {"a.csv": "old", "c.csv": "old"}
    assert len(list(tmp_path.iterdir())) == 2


def test_an_interrupt_in_the_middle_comes_after_the_last_file(tmp_path, monkeypatch):
    replace, files_when_written = os.replace, []

    def interrupted(source, target):
        if source.name == "b.csv":
            signal.raise_signal(signal.SIGINT)
        replace(source, target)

    monkeypatch.setattr(os, "replace", interrupted)

    def write_it():
        with output_directory(
            tmp_path, lambda: files_when_written.append(texts(tmp_path))
        ) as directory:
            for name in ("a.csv", "b.csv", "c.csv"):
                (directory / name).write_text("new")

    with pytest.raises(KeyboardInterrupt):
        write_it()
    assert files_when_written == [{"a.csv": "new", "b.csv": "new", "c.csv": "new"}]
    assert texts(tmp_path) == files_when_written[0]
    assert len(list(tmp_path.iterdir())) == 3


KILLED = """
import os, signal, sys
from kneexo.common.files.writing import output_directory
with output_directory(sys.argv[1]) as directory:
    (directory / "a.csv").write_text("new")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_leftovers_of_the_dead_are_deleted_and_of_the_living_are_not(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)])
    (leftover,) = tmp_path.glob(".kneexo-*")
    (tmp_path / ".kneexo-mine").mkdir()
    (tmp_path / ".kneexo-mine" / "text").write_text("mine")
    (tmp_path / ".kneexo-file").write_text("mine")
    (tmp_path / ".kneexo-empty").mkdir()
    (tmp_path / ".kneexo-half").mkdir()  # killed while it was deleted
    (tmp_path / ".kneexo-half" / "kneexo.lock").touch()
    with output_directory(tmp_path) as directory:
        assert not leftover.exists()
        write(tmp_path)
        assert directory.exists()
    names = {".kneexo-mine", ".kneexo-file", "a.csv", "b.csv", "c.csv"}
    assert {file.name for file in tmp_path.iterdir()} == names


def test_the_lock_of_a_workspace_is_deleted_last(tmp_path, monkeypatch):
    deleted, delete = [], shutil.rmtree

    def note(folder, **options):
        deleted.append((folder.name, any(tmp_path.glob(".kneexo-*/kneexo.lock"))))
        delete(folder, **options)

    monkeypatch.setattr(shutil, "rmtree", note)
    write(tmp_path)
    *parts, (last, _) = deleted
    assert parts == [("new", True), ("old", True)]
    assert last.startswith(".kneexo-")


def test_a_directory_taken_for_a_leftover_is_made_again(tmp_path, monkeypatch):
    made, make = [], tempfile.mkdtemp

    def taken(**options):
        made.append(make(**options))
        (*_, latest) = made
        if len(made) == 1:
            with output_directory(tmp_path):  # another process, which deletes what nobody locks
                assert not os.path.exists(latest)
        return latest

    monkeypatch.setattr(tempfile, "mkdtemp", taken)
    write(tmp_path)
    assert len(made) == 3
    assert len(texts(tmp_path)) == 3


def test_it_works_where_there_are_no_locks(tmp_path, monkeypatch):
    def no_locks(*_):
        raise OSError(38, "Function not implemented")

    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)])
    monkeypatch.setattr(fcntl, "flock", no_locks)
    write(tmp_path)
    assert len(texts(tmp_path)) == 3
    assert any(tmp_path.glob(".kneexo-*"))  # nobody can tell whether it is at work
