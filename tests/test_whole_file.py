"""Files that are written wholly, or not at all."""

import errno
import os
import stat

import pytest

from kneexo.errors import OutputError
from kneexo.whole_file import require_mark, write_whole


def test_a_file_takes_the_place_of_an_earlier_one(tmp_path):
    path = tmp_path / "new" / "folder" / "file"
    for content in (b"first", b"second"):
        write_whole(path, content)
        assert path.read_bytes() == content
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(("umask", "mode"), [(0o077, 0o600), (0o022, 0o644)])
def test_a_file_follows_the_umask(umask, mode, tmp_path):
    before = os.umask(umask)
    try:
        write_whole(tmp_path / "file", b"content")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode


def test_a_failed_write_leaves_the_earlier_file_and_no_folder(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "file"
    path.write_bytes(b"earlier")
    monkeypatch.setattr("kneexo.whole_file.os.replace", full)
    for place in (path, tmp_path / "new" / "folder" / "file"):
        with pytest.raises(OutputError, match=f"--out {place}: .*No space left on device"):
            write_whole(place, b"later")
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"earlier"


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="cannot write there") as error:
        write_whole(tmp_path / "file" / "inner", b"content")
    assert "\n" not in str(error.value)
    with pytest.raises(OutputError, match="File name too long"):
        write_whole(tmp_path / ("x" * 256) / "file", b"content")


def test_only_a_file_with_the_mark_may_be_replaced(tmp_path):
    ours, other = tmp_path / "ours", tmp_path / "other"
    ours.write_text("<mark> and more")
    other.write_bytes(b"\xff no text")
    require_mark(ours, "<mark>", "page")
    require_mark(tmp_path / "missing", "<mark>", "page")
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "huge").open("wb") as huge:
        huge.truncate(2**40)
    for path in (other, tmp_path, tmp_path / "pipe", tmp_path / "huge"):
        with pytest.raises(OutputError) as error:
            require_mark(path, "<mark>", "page")
        assert str(error.value) == f"{path} exists and is no page; choose another --out"
