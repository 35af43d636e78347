"""Names of diagramc in files and in the environment."""

from __future__ import annotations

import os
import warnings

from .version import __version__

ROOT = "diagramc"
"""First letters of the names of caches and of temporary folders."""

TOOL = f"{ROOT} {__version__}"
"""The program that makes C and FMUs, with its version."""


def variable(name: str) -> str:
    """Return the name of the environment variable for a setting: ``DIAGRAMC_CPU`` for ``CPU``.

    If only the name of before is set, such as ``KNEEXO_CPU``, the call warns and returns this name.
    """
    new, old = f"{ROOT.upper()}_{name}", f"KNEEXO_{name}"
    if new in os.environ or old not in os.environ:
        return new
    warnings.warn(f"{old}: is accepted in this release only; set {new} instead", stacklevel=2)
    return old
