"""A file that is written wholly, or not at all."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from kneexo.errors import OutputError


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
