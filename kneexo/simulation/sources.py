"""Find the source files that make the equations of a scenario, for the key of its machine code."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path

from kneexo.common import PACKAGE

_START = "kneexo.simulation.compiled"
# A regular expression, because `ast` needs 0.15 s for these files, in each process; 5 ms so.
_IMPORT = re.compile(r"^ *from (kneexo[.\w]*) import (\([^)]*\)|.*)", re.MULTILINE)


@cache
def fingerprint() -> str:
    """Return the digest of the source files that make the equations of a scenario."""
    return digest(sources(PACKAGE.parent))


def digest(paths: Iterable[Path]) -> str:
    """Return a digest of Drake's version and of the content of files.

    Versions of kneexo do not count, because sources are edited at an unchanged version. The
    compiler adds the digest of its own files to each key.
    """
    digest = hashlib.sha256(version("drake").encode())
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def sources(folder: Path) -> list[Path]:
    """Return the files of kneexo that the loop of a scenario imports, directly or through others.

    ``folder`` is the folder that contains the package. ``kneexo/__init__.py`` is left out: it lists
    names from all layers of the package, but imports a module only when its name is used.
    """
    found: dict[str, Path] = {}
    modules = [_START]
    while modules:
        module = modules.pop()
        path = folder.joinpath(*module.split("."))
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if module in (*found, "kneexo"):
            continue
        if not path.is_file():  # a name inside a module
            continue
        found[module] = path
        modules.append(module.rpartition(".")[0])
        for parent, names in _IMPORT.findall(path.read_text(encoding="utf-8")):
            modules += [parent, *(f"{parent}.{name}" for name in re.findall(r"\w+", names))]
    return [found[module] for module in sorted(found)]
