"""A file that is written wholly, or not at all, and over no file of others."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from kneexo.errors import OutputError, shown
from kneexo.user_file import MIB, read_bytes

_MOST_BYTES = 256 * MIB  # no page of kneexo is larger


def require_mark(path: Path, mark: str, kind: str) -> None:
    """Raise `OutputError` for a file without our ``mark``; ``kind`` names it in the message."""
    try:
        marked = mark.encode() in read_bytes(path, _MOST_BYTES)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError:
        marked = False
    if not marked:
        raise OutputError(f"{shown(path)} exists and is no {kind}; choose another --out")


def write_whole(path: Path, content: bytes) -> None:
    """Write a file in the place of an earlier one.

    Raises `OutputError` where that cannot be; then the earlier file stays, and no new folder.
    """
    missing: list[Path] = []
    try:
        missing = [folder for folder in path.parents if not folder.exists()]  # innermost first
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".kneexo-") as folder:
            whole = Path(folder, path.name)
            whole.write_bytes(content)
            os.replace(whole, path)
    except OSError as error:
        for empty in missing:
            with suppress(OSError):
                empty.rmdir()
        reason = error.strerror or error
        raise OutputError(f"--out {shown(path)}: cannot write there ({reason})") from None
