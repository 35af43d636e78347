"""What the system must have before pip installs the rest: ``python3 -m kneexo.system`` checks it.

Needs no package, so that it runs in a clone before anything is installed.
"""

from __future__ import annotations

import ctypes
import importlib.util
import sys
from collections.abc import Iterable

LIBRARIES = {"libglib-2.0.so.0": "libglib2.0-0"}
"""Each library that Drake loads and no wheel brings, and its package in Debian and Ubuntu."""


def lacking(modules: Iterable[str] = ()) -> str:
    """What is missing and how to install it, in one line; empty when nothing is.

    ``modules``: modules of the standard library, which Debian has in ``python3-venv``.
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
    if sys.platform != "linux":  # Drake for macOS needs none
        return True
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def main() -> int:
    """Check for an installation."""
    if line := lacking(("ensurepip", "venv")):
        print(f"kneexo: {line}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
