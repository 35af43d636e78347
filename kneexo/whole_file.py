"""A file that is written wholly, or not at all, and over no file of others."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from kneexo.errors import OutputError


def require_mark(path: Path, mark: str, kind: str) -> None:
    """Raise `OutputError` for a file that is no ``kind`` of ours, which have ``mark`` in them."""
    # A pipe or device may never end.
    if path.exists() and not (path.is_file() and mark in path.read_text("utf-8", "replace")):
        raise OutputError(f"{path} exists and is no {kind}; choose another --out")


def write_whole(path: Path, content: bytes) -> None:
    """Write a file in the place of an earlier one.

    Raises `OutputError` where that cannot be; then the earlier file stays, and no new folder.
    """
    missing = [folder for folder in path.parents if not folder.exists()]  # innermost first
    try:
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
        raise OutputError(f"--out {path}: cannot write there ({reason})") from None
