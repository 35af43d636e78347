"""The name of the installed package, from which the compiler's files and variables get names.

So a copy of this folder in a package of another name has its own cache, its own environment
variables and its own mark in written files.
"""

from __future__ import annotations

ROOT = __name__.partition(".")[0]
"""Name of the top-level package that contains the compiler, such as ``kneexo``."""


def variable(name: str) -> str:
    """Return the full name of an environment variable, such as ``KNEEXO_CPU`` for ``CPU``."""
    return f"{ROOT.upper()}_{name}"
