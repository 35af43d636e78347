"""The cache of machine code: sealed files, safe directories, bounded size."""

import errno
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
import warnings
from contextlib import contextmanager
from pathlib import Path

import pytest

from diagramc.errors import OutputError

HOUR_S = 3600.0
CACHE = importlib.util.find_spec("diagramc.native.cache")
cache = None  # of each test: the module as a new process has it


@pytest.fixture(autouse=True)
def directory(tmp_path, monkeypatch):
    """An empty cache, and in `cache` a module that has warned of nothing yet."""
    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("DIAGRAMC_CACHE_SIZE_MB", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    begin_process()
    return tmp_path / "cache"


def begin_process():
    global cache
    cache = importlib.util.module_from_spec(CACHE)
    CACHE.loader.exec_module(cache)


@pytest.fixture
def silent(recwarn):
    """The test must not warn."""
    yield
    assert [str(warning.message) for warning in recwarn] == []


def entry_path(key):
    """Path of a new entry of that key, with the content b"code"."""
    before = {entry.path for entry in cache.cache_entries()}
    cache.store(key, b"code")
    (path,) = {entry.path for entry in cache.cache_entries()} - before
    return path


def set_last_use(path, age_s):
    then = time.time() - age_s
    os.utime(path, (then, then))


# ----------------------------------------------------------------------------- entries


@pytest.mark.usefixtures("silent")
def test_content_comes_back_under_its_key_alone(directory):
    assert cache.load("key") is None
    assert cache.cache_entries() == []
    assert not directory.exists()
    for key, content in {"key": b"first", "other": b"", "": bytes(range(256)) * 999}.items():
        cache.store(key, content)
        assert cache.load(key) == content
    cache.store("key", b"second")
    assert cache.load("key") == b"second"
    assert cache.load("other") == b""
    assert cache.load("no key") is None


@pytest.mark.usefixtures("silent")
def test_keys_that_differ_only_in_their_end_are_different():
    start = "x" * 100_000
    for end in "ab":
        cache.store(start + end, end.encode())
    assert cache.load(start + "a") == b"a"
    assert cache.load(start + "b") == b"b"
    assert cache.load(start) is None


def test_no_damage_yields_wrong_content():
    """Each byte is changed, the file is cut at any place, grows, or is that of another key."""
    path, other = entry_path("key"), entry_path("other").read_bytes()
    sound = path.read_bytes()
    changed = [sound[:i] + bytes([sound[i] ^ 1]) + sound[i + 1 :] for i in range(len(sound))]
    cut = [sound[:i] for i in range(len(sound))]
    for damaged in (*changed, *cut, sound + b"\0", other):
        path.write_bytes(damaged)
        with pytest.warns(UserWarning, match=rf"^{path}: damaged; it is made anew$"):
            assert cache.load("key") is None, damaged
        assert cache.load("other") == b"code"
    cache.store("key", b"new")
    assert cache.load("key") == b"new"


def test_clear_deletes_a_link_to_a_directory_and_not_the_directory(tmp_path):
    path = entry_path("key")
    path.unlink()
    path.symlink_to(tmp_path)
    assert cache.clear_cache() == 1
    assert not path.is_symlink()
    assert tmp_path.is_dir()


def test_content_that_is_too_large_is_not_stored(directory):
    with pytest.warns(UserWarning, match="of 256 MiB: too large for the cache"):
        cache.store("large", bytes(2**28 - 45))  # one byte too many with the header
    assert not directory.exists()


def test_the_directory_is_closed_to_other_users(directory):
    mask = os.umask(0)
    try:
        entry_path("key")
    finally:
        os.umask(mask)
    assert directory.stat().st_mode & 0o777 == 0o700


# ----------------------------------------------------------------------------- all or nothing


def test_the_next_process_removes_what_a_killed_one_left_and_nothing_else(directory):
    entry_path("key")
    left = directory / ".diagramc-left"
    foreign = [directory / name for name in (".diagramc", "notes.diagramc", "0" * 32 + ".diagramc")]
    for path in foreign:
        path.mkdir()
    for end in (lambda: cache.store("other", b"code"), cache.clear_cache):
        left.mkdir()
        (left / "diagramc.lock").touch()
        begin_process()
        end()
        assert not left.exists()
    assert sorted(directory.iterdir()) == sorted(foreign)


WORKER = """
import random, sys, time
from diagramc.native import cache

assert not {"numpy", "pydrake", "llvmlite", "numba"} & set(sys.modules)
source = random.Random(int(sys.argv[1]))
hits = 0
for _ in range(150):
    key = str(source.randrange(8))
    if source.random() < 0.5:
        cache.store(key, key.encode() * 200_000)
    else:
        content = cache.load(key)
        assert content in (None, key.encode() * 200_000)
        hits += content is not None
    if source.random() < 0.02:
        cache.clear_cache()
print(hits)
"""


@pytest.mark.slow
def test_processes_store_load_shrink_and_clear_at_the_same_time(directory, monkeypatch):
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "1")
    workers = [
        subprocess.Popen(
            [sys.executable, "-W", "error", "-c", WORKER, str(seed)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for seed in range(4)
    ]
    for worker in workers:
        hits, error = worker.communicate()
        assert error == ""
        assert int(hits) > 0
    assert all(path.suffix == ".diagramc" for path in directory.iterdir())
    cache.store("last", b"")
    assert sum(entry.size_bytes for entry in cache.cache_entries()) <= 2**20


# ----------------------------------------------------------------------------- size


@pytest.mark.usefixtures("silent")
def test_the_entries_used_longest_ago_go_first(monkeypatch):
    paths = {}
    for age_s, key in enumerate("abcd"):
        paths[key] = entry_path(key)
        cache.store(key, bytes(300_000))
        set_last_use(paths[key], 1000.0 + age_s)
    cache.load("d")
    assert cache.cache_entries()[0].path == paths["d"]
    assert cache.cache_entries()[-1].path == paths["c"]
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "1")
    cache.store("e", bytes(300_000))
    remaining = [key for key in "abcde" if cache.load(key) is not None]
    assert remaining == ["a", "d", "e"]


@pytest.mark.usefixtures("silent")
def test_a_store_reads_the_directory_once_for_each_percent_of_the_limit(monkeypatch, directory):
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "1")
    reading = []
    monkeypatch.setattr(cache, "_entries_in", lambda which: reading.append(which) or [])
    counts = []
    for n in range(30):  # 1 % of 1 MiB is 10,486 bytes
        cache.store(str(n), bytes(1_000))
        counts.append(len(reading))
    assert counts == [1] * 11 + [2] * 11 + [3] * 8
    assert set(reading) == {directory}


@pytest.mark.usefixtures("silent")
def test_the_entry_just_stored_stays(monkeypatch):
    future = entry_path("future")
    cache.store("future", bytes(700_000))
    set_last_use(future, -HOUR_S)
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "1")
    cache.store("key", bytes(700_000))
    assert cache.load("key") == bytes(700_000)
    assert not future.exists()
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "0")
    cache.store("other", b"code")
    assert cache.load("other") == b"code"
    assert len(cache.cache_entries()) == 1


@pytest.mark.usefixtures("silent")
def test_an_entry_that_another_process_deletes_meanwhile_is_skipped(monkeypatch):
    paths = {entry_path(key) for key in "abc"}

    @contextmanager
    def deleting(directory, scan=os.scandir):
        with scan(directory) as items:
            first, *others = items
        Path(first).unlink()
        paths.remove(Path(first))
        yield [first, *others]

    monkeypatch.setattr(os, "scandir", deleting)
    assert {entry.path for entry in cache.cache_entries()} == paths


@pytest.mark.parametrize("text", ["-1", "many", "1.5", "nan", " ", "9" * 400, "x" * 10_000])
def test_a_bad_size_limit_is_ignored_with_a_warning(monkeypatch, text):
    assert cache.cache_size_limit() == 512 * 2**20
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", text)
    with pytest.warns(UserWarning, match="^DIAGRAMC_CACHE_SIZE_MB = .* is 512 MiB$") as told:
        assert cache.cache_size_limit() == 512 * 2**20
    assert len(str(told[0].message)) <= 400
    with warnings.catch_warnings(action="error"):
        assert cache.cache_size_limit() == 512 * 2**20
    monkeypatch.setenv("DIAGRAMC_CACHE_SIZE_MB", "3")
    assert cache.cache_size_limit() == 3 * 2**20


# ----------------------------------------------------------------------------- directories


@pytest.mark.usefixtures("silent")
@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"DIAGRAMC_CACHE_DIR": "/a", "XDG_CACHE_HOME": "/b", "HOME": "/c"}, "/a"),
        ({"DIAGRAMC_CACHE_DIR": "~/a", "HOME": "/c"}, "/c/a"),
        ({"DIAGRAMC_CACHE_DIR": "", "XDG_CACHE_HOME": "/b", "HOME": "/c"}, "/b/diagramc"),
        ({"XDG_CACHE_HOME": "b", "HOME": "/c"}, "/c/.cache/diagramc"),
        ({"XDG_CACHE_HOME": "", "HOME": "/c"}, "/c/.cache/diagramc"),
        ({"HOME": "/c"}, "/c/.cache/diagramc"),
    ],
)
def test_directory_of_the_cache(variables, expected, monkeypatch):
    for name in ("DIAGRAMC_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert str(cache.cache_directory()) == expected


def test_a_relative_directory_is_of_the_working_directory(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", "here")
    assert cache.cache_directory() == tmp_path / "here"
    for name in ("DIAGRAMC_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "home")
    assert cache.cache_directory() == tmp_path / "home/.cache/diagramc"


def store_with_one_warning(match):
    """Store and load an entry from the private directory, with one warning in all."""
    with pytest.warns(UserWarning, match=match) as warned:
        cache.store("key", b"new")
    with warnings.catch_warnings(action="error"):
        cache.store("other", b"")
        assert cache.load("key") == b"new"
        private = cache.cache_directory()
    (message,) = [str(warning.message) for warning in warned]
    assert message.endswith(f"; this process keeps compiled models in {private}")
    assert "\n" not in message
    assert private.stat().st_mode & 0o777 == 0o700
    assert {entry.path.parent for entry in cache.cache_entries()} >= {private}
    return private


def no_home(monkeypatch):
    for name in ("DIAGRAMC_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)

    def no_entry(uid):
        raise KeyError(uid)

    monkeypatch.setattr("pwd.getpwuid", no_entry)


def no_working_directory(monkeypatch):
    def deleted():
        raise FileNotFoundError(errno.ENOENT, "No such file or directory")

    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", "here")
    monkeypatch.setattr(os, "getcwd", deleted)


@pytest.mark.parametrize("cause", [no_home, no_working_directory])
def test_a_directory_that_cannot_be_determined_is_replaced(monkeypatch, cause):
    cause(monkeypatch)
    store_with_one_warning("^cache directory: cannot be determined")


@pytest.mark.parametrize("mode", [0o720, 0o702, 0o1777])
def test_a_directory_that_others_may_write_is_refused(directory, mode):
    path = entry_path("key")
    directory.chmod(mode)
    store_with_one_warning(rf"^{directory}: others may write to it \(mode {mode:o}; use chmod go-w")
    assert path.read_bytes().endswith(b"code")
    assert path not in [entry.path for entry in cache.cache_entries()]
    directory.chmod(0o755)
    assert cache.load("key") == b"code"


def test_a_directory_of_another_user_is_refused(directory, monkeypatch):
    directory.mkdir()
    uid = os.geteuid()
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: uid + 1)
        with pytest.warns(UserWarning, match=rf"belongs to another user \(uid {uid}\)"):
            cache.store("key", b"code")
    assert list(directory.iterdir()) == []


def test_a_file_in_the_way_is_replaced_by_a_private_directory(directory, monkeypatch):
    directory.write_text("")
    store_with_one_warning(f"^{directory}: is not a directory")
    monkeypatch.setenv("DIAGRAMC_CACHE_DIR", str(directory / "below"))
    store_with_one_warning(rf"^{directory}/below: cannot be written \(.*\)")


@pytest.mark.parametrize("reason", [errno.EACCES, errno.ENOSPC, errno.EROFS])
def test_a_directory_that_cannot_be_written_serves_what_it_has(directory, monkeypatch, reason):
    cache.store("key", b"old")
    cache.store("kept", b"kept")
    replace = os.replace

    def fail(source, target=directory / "file"):
        if Path(target).parent == directory:
            raise OSError(reason, os.strerror(reason))
        replace(source, target)

    monkeypatch.setattr(os, "replace", fail)
    monkeypatch.setattr(os, "utime", fail)
    store_with_one_warning(rf"^{directory}: cannot be written \({os.strerror(reason)}\)")
    assert cache.load("kept") == b"kept"
    assert len(list(directory.iterdir())) == 2
    assert len(cache.cache_entries()) == 4


def test_where_nothing_can_be_written_nothing_is_kept(directory, monkeypatch):
    def fail(*_args, **_options):
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory")

    directory.write_text("")
    monkeypatch.setattr(tempfile, "mkdtemp", fail)
    with warnings.catch_warnings(record=True, action="always") as warned:
        cache.store("key", b"code")
    refused, unwritable = [str(warning.message) for warning in warned]
    assert "is not a directory" in refused
    assert unwritable.endswith("compiled models are not kept")
    with warnings.catch_warnings(action="error"):
        cache.store("key", b"code")
    assert cache.load("key") is None
    assert cache.cache_entries() == []
    assert cache.clear_cache() == 0


def test_the_private_directory_ends_with_its_process_and_not_with_a_fork(directory):
    directory.write_text("")
    code = (
        "import os, sys\n"
        "from diagramc.native import cache\n"
        "directory = cache.cache_directory()\n"
        "if not (process := os.fork()):\n"
        "    sys.exit()\n"
        "os.waitpid(process, 0)\n"
        "print(directory)\n"
        "assert directory.is_dir()\n"
    )
    command = [sys.executable, "-W", "ignore", "-c", code]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "diagramc-" in out
    assert not Path(out.strip()).exists()


def test_clear_says_what_it_cannot_delete(monkeypatch):
    path = entry_path("key")

    def fail(*_args):
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", fail)
        with pytest.raises(OutputError, match=rf"^{path}: cannot be deleted \(Permission denied\)"):
            cache.clear_cache()
    assert cache.clear_cache() == 1
