"""Identifies exported code: versions, checksums and compiler flags, as a file and as C data."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..diagram_equations import equations_key
from ..equations.equations import Equations
from .build import REQUIRED_FLAGS

FILE = "manifest.json"
"""Name of the manifest in an exported folder."""

REFUSED_FLAGS = ("-ffast-math", "-ffinite-math-only")
"""Flags with which exported code does not compile."""


def checksums(
    equations: Equations, numbers: NDArray[np.floating], origin_text: str | None
) -> dict[str, str]:
    """Return three checksums (SHA-256 as hexadecimal text) of a model.

    ``equations``
        Of the equations of the diagram and the version of Drake.
    ``parameters``
        Of ``numbers``, the members of the struct ``NAME_params``, as little-endian bytes.
    ``origin``
        Of ``origin_text``, the text of the file that the model was made from; zero if it is None.
    """
    little_endian = numbers.astype(numbers.dtype.newbyteorder("<"))
    return {
        "equations": equations_key(equations),
        "parameters": _sha256(little_endian.tobytes()),
        "origin": "0" * 64 if origin_text is None else _sha256(origin_text.encode()),
    }


def manifest_in_c(sums: Mapping[str, str], tool: str) -> dict[str, list[str]]:
    """Return the members of the struct ``NAME_manifest_t``, each as a list of C literals.

    ``sums`` is the result of `checksums`. A checksum has 8 words of 32 bits, the most significant
    word first. The first number with dots in ``tool`` is the version.
    """
    numbers = [int(number) for number in re.findall(r"\d+", tool)[:3]]
    members = {"version": [f"{number}U" for number in (*numbers, 0, 0, 0)[:3]]}
    for name, digest in sums.items():
        members[name] = [f"0x{digest[i : i + 8]}U" for i in range(0, 64, 8)]
    return members


def manifest(made_by: str, tool: str, content: Mapping[str, Any], files: Mapping[str, str]) -> str:
    """Return the text of the manifest, JSON with ``made_by`` in the first line.

    ``tool`` is the program with its version. ``content`` has the entries that describe the model.
    ``files`` maps the name of each other file of the folder to its text.
    """
    # No date: a second export on the same machine gives an equal manifest.
    versions = {"tool": tool, "drake": version("drake")}
    flags = {"compiler_flags": {"required": REQUIRED_FLAGS, "refused": REFUSED_FLAGS}}
    contents = {name: text.encode(errors="surrogateescape") for name, text in files.items()}
    sums = {"files": {name: _sha256(data) for name, data in sorted(contents.items())}}
    text = json.dumps({"made_by": made_by, **content, **versions, **flags, **sums}, indent=2)
    return "{ " + text.removeprefix("{\n  ") + "\n"


def exported_name(directory: Path) -> str | None:
    """Return the name of the model in an exported folder, or None without a manifest."""
    try:
        document = json.loads((directory / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(document, dict) or "made_by" not in document:  # of another program
        return None
    return str(document["name"])


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
