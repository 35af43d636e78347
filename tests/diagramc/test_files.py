"""Files that appear all or not at all, and folders that killed processes leave."""

import errno
import fcntl
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from io import FileIO

import pytest

from diagramc import OutputError, lock_file, output_directory, write_files
from diagramc.files import require_empty, temporary_folder

# A shell starts jobs in the background without this handler, and a Python keeps it so.
signal.signal(signal.SIGINT, signal.default_int_handler)

NAMES = ("a.csv", "b.csv", "c.csv")


def write(target, text="new", names=NAMES):
    write_files(target, dict.fromkeys(names, text))


def texts(folder):
    return {file.name: file.read_text() for file in folder.iterdir() if file.is_file()}


def test_a_folder_gets_the_files_and_keeps_the_others(tmp_path):
    target = tmp_path / "new" / "folder"
    write_files(target, {"a": b"\xff", "b": "2"})
    with ThreadPoolExecutor() as pool:  # only the main thread may handle signals
        pool.submit(write_files, target, {"b": "α\udcff"}).result()
    assert {file.name: file.read_bytes() for file in target.iterdir()} == {
        "a": b"\xff",
        "b": "α".encode() + b"\xff",  # a user's file in Latin-1, read with surrogate escapes
    }


@pytest.mark.parametrize(("umask", "mode"), [(0o077, 0o600), (0o022, 0o644)])
def test_a_file_follows_the_umask(umask, mode, tmp_path):
    before = os.umask(umask)
    try:
        write_files(tmp_path, {"file": b"content"})
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_only_a_regular_file_is_replaced(tmp_path, make):
    write(tmp_path, "old", ["a.csv", "c.csv"])
    make(tmp_path / "b.csv")
    line = r"^directory .*: b\.csv is no regular file there; move it away or choose another direc"
    with pytest.raises(OutputError, match=line) as caught:
        write(tmp_path)
    assert "\n" not in str(caught.value)
    assert texts(tmp_path) == {"a.csv": "old", "c.csv": "old"}
    assert len(list(tmp_path.iterdir())) == 3


def write_and_fail(target, error, place=""):
    with output_directory(target, place) as directory:
        (directory / "x.txt").write_text("new")
        raise error


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_after_a_failure_of_the_body_all_is_as_before(tmp_path, error):
    (tmp_path / "x.txt").write_text("old")
    for target in (tmp_path, tmp_path / "a" / "b"):
        with pytest.raises(error):
            write_and_fail(target, error)
    assert texts(tmp_path) == {"x.txt": "old"}
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("where", ["file", "file/below", "/proc/diagramc", "x" * 256])
def test_an_unwritable_directory_is_refused_before_the_body(tmp_path, where):
    (tmp_path / "file").write_text("")
    line = r"^--out run: cannot write there \([\w ]+\); choose another directory$"
    with pytest.raises(OutputError, match=line):
        write_and_fail(tmp_path / where, AssertionError("the body was entered"), "--out run")
    assert texts(tmp_path) == {"file": ""}


def test_a_full_disk_is_an_output_error(tmp_path):
    target = tmp_path / "out"
    line = rf"^directory {target}: cannot write there \(No space left on device\); choose another"
    with pytest.raises(OutputError, match=line):
        write_and_fail(target, OSError(errno.ENOSPC, "No space left on device"))
    assert not target.exists()


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

    def note():
        files_when_written.append(texts(tmp_path))

    def write_it():
        with output_directory(tmp_path, when_written=note) as directory:
            for name in NAMES:
                (directory / name).write_text("new")
            assert texts(tmp_path) == {}

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_it()
    assert files_when_written == [dict.fromkeys(NAMES, "new")]
    assert texts(tmp_path) == files_when_written[0]
    assert len(list(tmp_path.iterdir())) == 3


def test_only_an_empty_folder_is_empty(tmp_path):
    require_empty(tmp_path / "none")
    require_empty(tmp_path)
    (tmp_path / "a").touch()
    line = rf"^directory {tmp_path}: has other files and no export; choose another directory$"
    with pytest.raises(OutputError, match=line):
        require_empty(tmp_path)
    with pytest.raises(OutputError, match=r"a: cannot be read \(Not a directory\); choose another"):
        require_empty(tmp_path / "a")


# ------------------------------------------------------------------- temporary directories


KILLED = """
import os, signal, sys
from diagramc import output_directory
with output_directory(sys.argv[1]) as directory:
    (directory / "a.csv").write_text("new")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_leftovers_of_the_dead_are_deleted_and_of_the_living_are_not(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)])
    (leftover,) = tmp_path.iterdir()
    require_empty(tmp_path)
    mine, file, empty, half = (tmp_path / f".diagramc-{n}" for n in ("mine", "file", "empty", "x"))
    mine.mkdir()
    (mine / "text").write_text("mine")
    file.write_text("mine")
    empty.mkdir()
    half.mkdir()  # killed while it was deleted
    (half / "diagramc.lock").touch()
    with output_directory(tmp_path) as directory:
        assert not leftover.exists()
        write(tmp_path)
        assert directory.exists()
    assert {path.name for path in tmp_path.iterdir()} == {mine.name, file.name, *NAMES}


def test_an_interrupt_before_the_lock_leaves_nothing(tmp_path, monkeypatch):
    lock = fcntl.flock

    def interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        lock(*arguments)

    monkeypatch.setattr(fcntl, "flock", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_workspace_is_deleted_last(tmp_path, monkeypatch):
    deleted, delete = [], shutil.rmtree

    def note(folder, **options):
        deleted.append((folder.name, any(tmp_path.glob(".diagramc-*/diagramc.lock"))))
        delete(folder, **options)

    monkeypatch.setattr(shutil, "rmtree", note)
    write(tmp_path)
    *parts, (last, _) = deleted
    assert parts == [("new", True), ("old", True)]
    assert last.startswith(".diagramc-")


def test_a_directory_taken_for_a_leftover_is_made_again(tmp_path, monkeypatch):
    made, make = [], tempfile.mkdtemp

    def taken(**options):
        made.append(make(**options))
        (*_, latest) = made
        if len(made) == 1:
            with output_directory(tmp_path):  # another process, which deletes what nobody locks
                assert not os.path.exists(latest)
        elif len(made) == 3:  # another process has locked it, and is about to delete it
            lock_file(at_work.enter_context(FileIO(f"{latest}/diagramc.lock", "wb")))
        return latest

    monkeypatch.setattr(tempfile, "mkdtemp", taken)
    with ExitStack() as at_work:
        write(tmp_path)
    assert len(made) == 4
    assert len(texts(tmp_path)) == 3


def test_it_works_where_there_are_no_locks(tmp_path, monkeypatch):
    def no_locks(*_):
        raise OSError(38, "Function not implemented")

    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)])
    monkeypatch.setattr(fcntl, "flock", no_locks)
    write(tmp_path)
    assert len(texts(tmp_path)) == 3
    assert any(tmp_path.glob(".diagramc-*"))  # nobody can tell whether it is at work


def test_an_open_file_can_be_locked_once(tmp_path):
    path = tmp_path / "file"
    with path.open("wb") as first, path.open("rb") as second:
        lock_file(first)
        with pytest.raises(BlockingIOError):
            lock_file(second)


def test_a_temporary_folder_holds_the_files_and_ends_with_the_body():
    with temporary_folder({"a": "α"}) as folder:
        assert (folder / "a").read_text(encoding="utf-8") == "α"
    assert not folder.exists()
