"""Machine code on disk: one process compiles it, every later process loads it.

Each entry is one file with a format version, a SHA-256 seal over key and content, and the content.
The files are in ``DIAGRAMC_CACHE_DIR``, else in ``diagramc`` below ``XDG_CACHE_HOME``, else in
``~/.cache/diagramc``. A user can delete this directory at any time. Its size is limited to 512 MiB,
or to ``DIAGRAMC_CACHE_SIZE_MB`` MiB. A process that stores can exceed the limit by 1 % for a while.
The least recently used entries are deleted first. The names of the variables and of the directory
contain the name of the package (`root`).

The seal detects damage, but anybody can compute it. Trust rests on ownership: a directory in which
another user could write is never used.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import re
import shutil
import stat
import tempfile
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from ..errors import OutputError, shortened
from ..files import delete_leftovers, temporary_in
from ..root import ROOT, variable

_FORMAT = f"{ROOT} code 1\n".encode()  # raise the number when the layout of the files changes
_HEADER_BYTES = len(_FORMAT) + hashlib.sha256().digest_size
# Half of the default limit of the whole cache.
_LARGEST_ENTRY_BYTES = 256 * 2**20
_DEFAULT_LIMIT_MB = 512
_LARGEST_LIMIT_MB = 10**9
# Share of the limit that a process stores between two readings of the directory. With some thousand
# entries a reading at each store took half the time of a compilation.
_TIDY_SHARE = 0.01
_LONGEST_WARNING = 400  # characters
# 128 bits of the hash of a key. The seal covers the whole key, so two keys of one name do no harm.
_ENTRY = re.compile(rf"[0-9a-f]{{32}}\.{ROOT}")

_unwritable: set[Path] = set()
_bytes_since_tidy: dict[Path, int] = {}  # by directory
_warnings_given: set[str] = set()


# ----------------------------------------------------------------------------- entries


class CacheEntry(NamedTuple):
    """The path of the file of a cache entry, its size, and the time of its last use."""

    path: Path
    size_bytes: int
    last_use_s: float
    """Unix time of the last use in s. The modification time of the file records the last use."""


def load(key: str) -> bytes | None:
    """Return the content of the cache entry with this key; None if no such entry exists.

    If the entry is damaged, the call warns and returns None. Otherwise the call sets the time of
    the entry's last use.
    """
    # The private directory first: it has what this process could not write to the other one.
    for directory in reversed(_directories()):
        path = directory / _name(key)
        try:
            data = path.read_bytes()
        except OSError:
            continue
        content = data[_HEADER_BYTES:]
        if data[:_HEADER_BYTES] == _header(key, content):
            # The time of modification, because many file systems do not record that of access.
            with suppress(OSError):  # a read-only file system
                os.utime(path)
            return content
        warnings.warn(f"{path}: damaged; it is made anew", stacklevel=2)
    return None


def store(key: str, content: bytes) -> None:
    """Write a cache entry as a whole, and delete old entries beyond the size limit.

    Never raises `OSError`. If the directory cannot be written, one warning says so, and a private
    directory of this process replaces it. Content above 256 MiB is not stored.
    """
    if _HEADER_BYTES + len(content) > _LARGEST_ENTRY_BYTES:
        _warn_once(f"compiled model of {len(content) / 2**20:.0f} MiB: too large for the cache")
        return
    directory = cache_directory()
    path = directory / _name(key)
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        with temporary_in(directory) as new:
            (new / path.name).write_bytes(_header(key, content) + content)
            os.replace(new / path.name, path)
    except OSError as error:
        reason = f"cannot be written ({error.strerror or error})"
        if directory == _private_directory():
            _warn_once(f"{directory}: {reason}; compiled models are not kept")
            return
        _unwritable.add(directory)
        _warn_replaced(f"{directory}: {reason}")
        store(key, content)
    else:
        _tidy(path, len(content))


def cache_entries() -> list[CacheEntry]:
    """Return the files of all cache entries, the most recently used first."""
    entries = [entry for directory in _directories() for entry in _entries_in(directory)]
    return sorted(entries, key=lambda entry: entry.last_use_s, reverse=True)


def clear_cache() -> int:
    """Delete all cache entries and the temporary directories of killed processes.

    Returns the number of deleted entries.

    Raises `OutputError` if an entry cannot be deleted.
    """
    count = 0
    for directory in _directories():
        delete_leftovers(directory)
        for entry in _entries_in(directory):
            try:
                entry.path.unlink()
                count += 1
            except FileNotFoundError:  # another process deleted it
                pass
            except OSError as error:
                reason = error.strerror or error
                raise OutputError(f"{entry.path}: cannot be deleted ({reason})") from None
    return count


def cache_size_limit() -> int:
    """Return the largest total size of the cache entries in bytes.

    The environment variable ``DIAGRAMC_CACHE_SIZE_MB`` sets the size in MiB. If the variable has a
    wrong value, the call warns and returns the default size, 512 MiB.
    """
    setting = variable("CACHE_SIZE_MB")
    text = os.environ.get(setting) or str(_DEFAULT_LIMIT_MB)
    try:
        # int() also reads 1_000, and the digits of other scripts.
        limit_mb = int(text) if text.isascii() and "_" not in text else -1
    except ValueError:
        limit_mb = -1
    if not 0 <= limit_mb <= _LARGEST_LIMIT_MB:
        _warn_once(
            f"{setting} = {shortened(text)!r}: must be a whole number of MiB from 0 to "
            f"{_LARGEST_LIMIT_MB}; the limit is {_DEFAULT_LIMIT_MB} MiB"
        )
        limit_mb = _DEFAULT_LIMIT_MB
    return limit_mb * 2**20


# ----------------------------------------------------------------------------- files


def _name(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()[:32] + f".{ROOT}"


def _header(key: str, content: bytes) -> bytes:
    # The hash of the key has a fixed length, so no other key and content join to the same bytes.
    seal = hashlib.sha256(hashlib.sha256(key.encode()).digest())
    seal.update(content)
    return _FORMAT + seal.digest()


def _entries_in(directory: Path) -> list[CacheEntry]:
    """Return the entries of a directory; an empty list if the directory cannot be read."""
    entries = []
    with suppress(OSError), os.scandir(directory) as items:
        for item in items:
            if _ENTRY.fullmatch(item.name) and not item.is_dir(follow_symlinks=False):
                with suppress(FileNotFoundError):  # another process deleted it
                    status = item.stat(follow_symlinks=False)
                    entries.append(CacheEntry(Path(item.path), status.st_size, status.st_mtime))
    return entries


def _tidy(stored: Path, size_bytes: int) -> None:
    """Delete leftovers, and the least recently used entries until the rest is within the limit.

    The file ``stored``, which was just written, stays in any case. Reading a directory of thousands
    of files takes long. So a process reads it at its first store, and then once for each 1 % of the
    limit that it stores.
    """
    directory, limit = stored.parent, cache_size_limit()
    since = _bytes_since_tidy.get(directory, limit) + size_bytes
    _bytes_since_tidy[directory] = since
    if since < _TIDY_SHARE * limit:
        return
    _bytes_since_tidy[directory] = total = 0
    delete_leftovers(directory)
    entries = _entries_in(directory)
    for entry in sorted(entries, key=lambda entry: (entry.path != stored, -entry.last_use_s)):
        total += entry.size_bytes
        if total > limit and entry.path != stored:
            with suppress(OSError):
                entry.path.unlink()


# ----------------------------------------------------------------------------- directories


def cache_directory() -> Path:
    """Return the directory for new cache entries, which `store` creates if it is missing.

    The environment chooses the directory. In each of these cases the call warns and returns a
    private directory of this process: the path cannot be determined or is no directory, another
    user owns the directory, group or others may write to the directory, or an attempt to write to
    the directory has failed.
    """
    return _directories()[-1]


def _directories() -> list[Path]:
    """Return all directories that `load` searches. New entries go to the last directory."""
    try:
        chosen = _chosen_directory()
    except (RuntimeError, OSError) as error:  # no home directory, or no working directory
        _warn_replaced(f"cache directory: cannot be determined ({str(error).rstrip('.')})")
        return [_private_directory()]
    if reason := _refusal(chosen):
        _warn_replaced(f"{chosen}: {reason}")
        return [_private_directory()]
    return [chosen, _private_directory()] if chosen in _unwritable else [chosen]


def _chosen_directory() -> Path:
    if directory := os.environ.get(variable("CACHE_DIR")):
        return Path(directory).expanduser().absolute()
    base = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(base):  # the XDG base directory specification ignores relative paths
        return Path(base, ROOT)
    return Path.home().absolute() / ".cache" / ROOT


def _refusal(directory: Path) -> str:
    """Return the reason not to load machine code from a directory, or an empty text."""
    try:
        status = directory.stat()
    except OSError:  # absent; `store` says why when it cannot be made
        return ""
    if not stat.S_ISDIR(status.st_mode):
        return "is not a directory"
    if status.st_uid != os.geteuid():
        return f"belongs to another user (uid {status.st_uid})"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others may write to it (mode {stat.S_IMODE(status.st_mode):o}; use chmod go-w)"
    return ""


@cache
def _private_directory() -> Path:
    """Return a directory for this process alone, which is deleted at the end of the process."""
    try:
        directory = Path(tempfile.mkdtemp(prefix=f"{ROOT}-"))
    except OSError:  # no temporary directory either: a path that no file can have
        return Path(os.devnull, ROOT)
    atexit.register(_delete_directory, directory, os.getpid())
    return directory


def _delete_directory(directory: Path, process: int) -> None:
    if os.getpid() == process:  # not in a fork
        shutil.rmtree(directory, ignore_errors=True)


def _warn_replaced(reason: str) -> None:
    _warn_once(f"{reason}; this process keeps compiled models in {_private_directory()}")


def _warn_once(message: str) -> None:
    if len(message) > _LONGEST_WARNING:  # a value or a path of any length
        half = _LONGEST_WARNING // 2 - 2
        message = f"{message[:half]} … {message[-half:]}"
    if message not in _warnings_given:
        _warnings_given.add(message)
        warnings.warn(message, stacklevel=3)
