import fcntl
import os
from io import FileIO

import pytest

from diagramc import lock_file
from kneexo.common.files.locking import LockedFile


def test_locking_does_nothing_where_the_file_system_has_no_locks(tmp_path, monkeypatch):
    def no_locks(*_):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    LockedFile(tmp_path / "file").append(b"x")
    assert (tmp_path / "file").read_bytes() == b"x"


def test_data_are_appended_to_what_is_in_the_file(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"old,")
    file = LockedFile(path)
    file.append(b"new")
    assert path.read_bytes() == file.read(7) == b"old,new"
    with pytest.raises(OSError, match="is too large"):
        file.read(6)
    file.clear()
    assert file.is_empty
    file.append(b"newest")
    assert path.read_bytes() == b"newest"


def test_a_file_that_another_process_has_locked_is_refused(tmp_path):
    path = tmp_path / "file"
    with path.open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(BlockingIOError):
            LockedFile(path)
    LockedFile(path)


def test_a_second_object_of_this_process_takes_the_lock_and_the_first_gets_it_back(tmp_path):
    path = tmp_path / "file"
    first = LockedFile(path)
    first.append(b"a")
    second = LockedFile(path)
    second.append(b"b")
    first.append(b"c")
    assert path.read_bytes() == b"abc"


def test_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is not a regular file"):
        LockedFile(tmp_path / "pipe")


def test_a_closed_file_stays_unless_it_is_empty(tmp_path):
    path = tmp_path / "file"
    file = LockedFile(path)
    file.close()
    assert not path.exists()
    file.append(b"x")
    file.close()
    file.close()
    assert path.read_bytes() == b"x"
    with path.open("rb") as other:
        lock_file(other)


def test_a_deleted_file_is_created_again_by_the_next_append(tmp_path):
    path = tmp_path / "file"
    file = LockedFile(path)
    file.append(b"x")
    file.delete()
    assert not path.exists()
    file.append(b"y")
    assert path.read_bytes() == b"y"


def test_a_disk_that_accepts_data_in_parts_gets_all_of_it(tmp_path):
    class Slow(FileIO):
        def write(self, data):
            return super().write(data[:7])

    file = LockedFile(tmp_path / "file")
    file._stream = Slow(tmp_path / "file", "ab")
    file.append(b"0123456789" * 3)
    assert (tmp_path / "file").read_bytes() == b"0123456789" * 3
