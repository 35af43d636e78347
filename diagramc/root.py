"""The name of the package that contains the compiler, as a part of file and variable names.

If the compiler is copied into a package with another name, the copy has its own cache, environment
variables and mark in written files.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

ROOT = __name__.partition(".")[0]
"""Name of the top-level package that contains the compiler, such as ``kneexo``."""


def variable(name: str) -> str:
    """Return the name of an environment variable with its prefix: ``DIAGRAMC_CPU`` for ``CPU``."""
    return f"{ROOT.upper()}_{name}"


def tool() -> str:
    """Return `ROOT` and the version of the installed package, such as ``kneexo 0.2.0``.

    A package that is not installed, such as a copied folder, has no version.
    """
    try:
        return f"{ROOT} {version(ROOT)}"
    except PackageNotFoundError:
        return ROOT
