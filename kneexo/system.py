"""Check that the system has the libraries that pip cannot install: ``python3 -m kneexo.system``.

This module imports no package, so that it runs in a clone before anything is installed.
"""

from __future__ import annotations

import ctypes
import importlib.util
import sys
from collections.abc import Iterable

LIBRARIES = {"libglib-2.0.so.0": "libglib2.0-0"}
"""Libraries that Drake loads but no wheel contains, with their packages in Debian and Ubuntu."""


def lacking(modules: Iterable[str] = ()) -> str:
    """Return a line that lists missing libraries and how to install them, or an empty text.

    ``modules`` are modules of the standard library that are checked too. On Debian they are in the
    package ``python3-venv``.
    """
    missing = {name: package for name, package in LIBRARIES.items() if not _loads(name)}
    missing |= {name: "python3-venv" for name in modules if not importlib.util.find_spec(name)}
    if not missing:
        return ""
    packages = " ".join(dict.fromkeys(missing.values()))
    return (
        f"this system lacks {', '.join(missing)}; Debian, Ubuntu (as root): "
        f"apt-get update && apt-get install -y {packages}"
    )


def _loads(library: str) -> bool:
    """Return whether a shared library can be loaded. On systems other than Linux return True."""
    if sys.platform != "linux":  # Drake for macOS does not need it
        return True
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def main() -> int:
    """Return 0, or print which libraries or modules are missing and return 2."""
    if line := lacking(("ensurepip", "venv")):
        print(f"kneexo: {line}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
