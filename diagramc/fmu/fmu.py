"""A model in C as a functional mock-up unit (FMU) for co-simulation, by FMI 2.0 or 3.0.

The FMU has the source files of `CSource` and three more. ``NAME_fmu.h`` and ``NAME_fmu.c``
implement an instance of the model: its variables, modes, steps and saved states. ``NAME_fmi2.c`` or
``NAME_fmi3.c`` implements the functions of the standard.
"""

from __future__ import annotations

import hashlib
import io
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from ..c.checks import require_positive, require_type
from ..c.cross import PLATFORMS
from ..c.source import CSource
from ..c.template import rendered
from ..errors import CompilationError, shown
from .description import Header, build_description, model_description
from .variables import FmuParameter, VariableTable

FMI_VERSIONS = (2, 3)
"""Versions of the FMI standard that `Fmu` supports."""

_FOLDERS = {"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-darwin": "darwin64"}
"""Folders of binaries in FMI 2. FMI 2.0.4 names all other folders as FMI 3 does."""

_FIRST_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest of a zip file: equal FMUs have equal bytes


def require_fmi(what: str, version: Any) -> None:
    """Raise `CompilationError` unless a version of FMI is the whole number 2 or 3."""
    if not isinstance(version, int) or version not in FMI_VERSIONS:
        raise CompilationError(f"{what} = {shown(f'{version!r:.60}')}: must be one of 2, 3")


@dataclass(frozen=True)
class Fmu:
    """A functional mock-up unit (FMU) of a model.

    Parameters
    ----------
    source
        The model, in double precision and with real inputs only. Its name is the model identifier.
    parameters
        Parameters of the FMU. A Context parameter keeps its value if no parameter of the FMU sets
        it.
    fmi
        Version of the standard: 2 or 3.
    description
        A short text about the model.
    starts
        Start values of inputs by name; every other input starts at zero.
    stop_s
        Default end of a run in s.

    Raises `CompilationError` if the source is in single precision or has an int32_t input, if
    ``fmi`` is neither 2 nor 3, if ``stop_s`` is not finite and positive, or if `VariableTable`
    raises it.
    """

    source: CSource
    parameters: Sequence[FmuParameter] = ()
    fmi: int = 3
    description: str = ""
    starts: Mapping[str, float] = field(default_factory=dict)
    stop_s: float = 1.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        source = self.source
        require_fmi("fmi", self.fmi)
        require_type("description", self.description, str, "a text")
        if self.name.lower() == f"fmi{self.fmi}":
            raise CompilationError(f"name = {self.name!r}: is a prefix of FMI; choose another name")
        require_positive("stop_s", self.stop_s, "s")
        if source.precision != "double":
            raise CompilationError(f"precision = {source.precision!r}: must be double in an FMU")
        if source.interface.integers:
            port = min(source.interface.integers)
            raise CompilationError(f"{port}: is int32_t; the inputs of an FMU must be real")
        _ = self.table

    @property
    def name(self) -> str:
        """The model identifier."""
        return self.source.name

    @cached_property
    def table(self) -> VariableTable:
        """All variables of the FMU, with their value references."""
        return VariableTable(self.source.plan, self.parameters, self.starts)

    @cached_property
    def token(self) -> str:
        """GUID of FMI 2 or instantiation token of FMI 3: a hash that is the same for equal FMUs."""
        numbers = (self.fmi, self.source.tool, self.description, self.stop_s)
        table = self.table
        # Not a random number, as usual for a GUID, because equal models give equal files.
        digest = hashlib.sha256(repr((numbers, table.variables, table.parameters)).encode())
        for text in self._texts("").values():
            digest.update(text.encode())
        return str(uuid.UUID(bytes=digest.digest()[:16]))

    @cached_property
    def sources(self) -> dict[str, str]:
        """Dictionary from file name to text, for all C sources and headers."""
        return self._texts(self.token)

    def _texts(self, token: str) -> dict[str, str]:
        plan, table, name = self.source.plan, self.table, self.name
        first_tunable = 1 + len(plan.inputs)
        first_output = first_tunable + len(table.parameters)
        tunable = sum(parameter.tunable for parameter in table.parameters)
        data = self.source.template_data | {
            "token": token,
            "variables": table.variables,
            "assignments": table.assignments(),
            "limits": list(dict.fromkeys(limit.system for limit in plan.equations.limits)),
            "first_tunable": first_tunable,
            "first_fixed": first_tunable + tunable,
            "first_output": first_output,
            "first_constant": first_output + len(plan.outputs),
        }
        templates = {f"{name}_{file}": file for file in ("fmu.h", "fmu.c", f"fmi{self.fmi}.c")}
        return self.source.files() | {
            file: rendered(__package__, template, **data) for file, template in templates.items()
        }

    @property
    def _header(self) -> Header:
        return Header(
            self.fmi,
            self.name,
            self.token,
            self.source.tool,
            self.description,
            self.stop_s,
            self.source.plan.schedule.tick_s,
            sorted(file for file in self.sources if file.endswith(".c")),
        )

    def model_description(self) -> str:
        """Return the text of modelDescription.xml."""
        return model_description(self._header, self.table)

    def archive(self, libraries: Mapping[str, bytes]) -> bytes:
        """Return the bytes of the FMU, a zip file. Equal content gives equal bytes.

        ``libraries`` has the binary for each platform, as `shared_libraries` returns them. Without
        binaries the FMU has C sources alone.
        """
        files: dict[str, str | bytes] = {"modelDescription.xml": self.model_description()}
        files |= {f"sources/{file}": text for file, text in self.sources.items()}
        if self.fmi == 3:
            files["sources/buildDescription.xml"] = build_description(self._header)
        for platform, library in libraries.items():
            folder = _FOLDERS.get(platform, platform) if self.fmi == 2 else platform
            files[f"binaries/{folder}/{self.name}{PLATFORMS[platform].suffix}"] = library
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name in sorted(files):
                archive.writestr(zipfile.ZipInfo(name, _FIRST_DATE), files[name])
        return stream.getvalue()
