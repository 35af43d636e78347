"""A file that one process at a time reads and extends."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from io import FileIO
from pathlib import Path
from weakref import WeakValueDictionary, finalize

from diagramc import lock_file
from kneexo.common.files.reading import read_bytes


class LockedFile:
    """A regular file that only one object of one process reads and extends at a time.

    The constructor opens and locks the file, and creates a missing file. The lock ends when `close`
    or `delete` is called, or when the process ends. The lock also ends when this process makes
    another `LockedFile` of the same file. Otherwise a stored exception, which can keep the first
    object alive in a notebook, would keep the lock. `append` opens and locks the file again if
    necessary.

    Raises `BlockingIOError` if another process has locked the file, and `OSError` if the file is
    not regular or cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stream: FileIO | None = None
        self._open()

    def read(self, most_bytes: int) -> bytes:
        """Return the content; raise `OSError` if the file has more than ``most_bytes`` bytes."""
        return read_bytes(self._path, most_bytes)

    def append(self, data: bytes) -> None:
        """Write all of ``data`` at the end of the file.

        Raises `OSError` if writing fails. Then the file can contain a part of ``data``.
        """
        stream = self._open()
        while data:
            written = stream.write(data)  # can be less than all, if the disk is almost full
            data = data[written:]

    def clear(self) -> None:
        """Remove the content of the file."""
        self._open().truncate(0)

    @property
    def is_empty(self) -> bool:
        """Whether the file has no content."""
        return not os.fstat(self._open().fileno()).st_size

    def close(self) -> None:
        """Release the lock, and delete the file if it is empty. A second call does nothing."""
        if self._stream is not None and self.is_empty:
            self._path.unlink(missing_ok=True)
        self._release()

    def delete(self) -> None:
        """Delete the file and release the lock."""
        self._path.unlink(missing_ok=True)
        self._release()

    def _open(self) -> FileIO:
        """Return the open file. Open and lock the file before if necessary."""
        while self._stream is None:
            stream = FileIO(self._path, "a+")
            finalize(self, stream.close)
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise OSError("is not a regular file")
            inode = (status.st_dev, status.st_ino)
            if (former := _LOCKED.pop(inode, None)) is not None:
                former._release()
            lock_file(stream)
            # Another process can delete the file between opening and locking. Then the lock is
            # worth nothing, because the path names no file or a new one: open the path again.
            with suppress(FileNotFoundError):
                if self._path.stat().st_ino == status.st_ino:
                    self._stream = stream
                    _LOCKED[inode] = self
        return self._stream

    def _release(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None


_LOCKED: WeakValueDictionary[tuple[int, int], LockedFile] = WeakValueDictionary()
"""Dictionary from device and inode to the `LockedFile` of this process that holds the lock."""
