"""The name of the installed package, which names files and environment variables of the compiler.

A copy of this folder under another name has its own cache, its own variables and its own mark.
"""

from __future__ import annotations

ROOT = __name__.partition(".")[0]
"""First part of the name of this package."""


def variable(name: str) -> str:
    """Return the name of an environment variable, such as ``KNEEXO_CPU`` for ``CPU``."""
    return f"{ROOT.upper()}_{name}"
