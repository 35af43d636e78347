"""A model in C as a functional mock-up unit (FMU) for co-simulation, by FMI 2.0 or 3.0.

``fmu.c`` is an instance of the model: its variables, modes, steps and saved states. ``fmi2.c`` and
``fmi3.c`` are the functions of the two standards on top of it. `CSource` gives the model itself.
"""

from __future__ import annotations

import hashlib
import io
import platform
import re
import sys
import uuid
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ..c.build import shared_library
from ..c.printer import DOUBLE, literal
from ..c.source import CSource
from ..c.template import filled
from ..equations.graph import Entry
from ..errors import CompilationError
from .units import BASE_UNITS, Unit, unit_of_name

VERSIONS = (2, 3)
"""Versions of the FMI standard."""

_STANDARDS = {2: "2.0", 3: "3.0"}
_PLATFORMS = {2: "linux64", 3: "x86_64-linux"}
_FIRST_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest of a zip file: equal FMUs have equal bytes
_ERRORS = "logStatusError"
_LONGEST_DESCRIPTION = 2**26

Causality = Literal["independent", "input", "parameter", "output", "local"]
"""What a variable of an FMU is to its importer."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of an FMU."""

    name: str
    start: float
    members: tuple[str, ...]
    """What it sets of the parameters in C: ``leaf.parameter`` or ``initial_x[1]``."""
    description: str = ""
    low: float = -DOUBLE.largest
    high: float = DOUBLE.largest
    divisor: float = 1.0
    """The members are set to the value divided by this."""
    tunable: bool = True
    """Whether it may change during a run; else only before its start."""


@dataclass(frozen=True)
class Variable:
    """A scalar variable of an FMU; its value reference is its place."""

    name: str
    causality: Causality
    variability: str
    start: float | None = None
    description: str = ""
    low: float = -DOUBLE.largest
    high: float = DOUBLE.largest

    @property
    def unit(self) -> Unit | None:
        """By the end of the name."""
        return unit_of_name("time_s" if self.causality == "independent" else self.name)


@dataclass(frozen=True)
class Fmu:
    """An FMU of a model.

    Parameters
    ----------
    source
        The model, in double precision and with real inputs only. Its name is the model identifier.
    parameters
        What may be set from outside. Context parameters that none of them sets keep their values.
    fmi
        Version of the standard: 2 or 3.
    tool, description
        What made the FMU, and what it is.
    starts
        Start values of inputs by their fields; zero for others.
    stop_s
        Default end of a run in s.

    Raises `CompilationError` where one of these is wrong.
    """

    source: CSource
    parameters: Sequence[Parameter] = ()
    fmi: int = 3
    tool: str = ""
    description: str = ""
    starts: Mapping[str, float] = field(default_factory=dict)
    stop_s: float = 1.0

    def __post_init__(self) -> None:
        """Check all that is given."""
        source = self.source
        if self.fmi not in VERSIONS:
            raise CompilationError(f"fmi = {self.fmi!r}: must be one of 2, 3")
        if source.precision != "double":
            raise CompilationError(f"precision = {source.precision!r}: must be double in an FMU")
        if source.interface.integers:
            port = min(source.interface.integers)
            raise CompilationError(f"{port}: is int32_t; the inputs of an FMU must be real")
        known = {*source.parameter_fields, *self._states}
        members = [member for parameter in self.parameters for member in parameter.members]
        for member in members:
            if member not in known or members.count(member) > 1:
                how = "is unknown" if member not in known else "is set by two parameters"
                raise CompilationError(f"{source.name}: the parameter {member} in C {how}")
        names = [variable.name for variable in self.variables]
        for name in names:
            if names.count(name) > 1:
                raise CompilationError(f"{name}: two variables of the FMU have this name")

    # -------------------------------------------------------------------------- variables

    @property
    def name(self) -> str:
        """The model identifier."""
        return self.source.name

    @property
    def _states(self) -> list[str]:
        return [f"initial_x[{i}]" for i in range(len(self.source.equations.states))]

    @cached_property
    def variables(self) -> list[Variable]:
        """All variables, in the order of their value references.

        The time, inputs, tunable parameters, fixed parameters, outputs, constants.
        """
        source = self.source
        inputs = [
            Variable(name, "input", "continuous", self.starts.get(name, 0.0))
            for _, name in source.input_fields
        ]
        parameters = [
            Variable(
                parameter.name,
                "parameter",
                "tunable" if parameter.tunable else "fixed",
                parameter.start,
                parameter.description,
                parameter.low,
                parameter.high,
            )
            for parameter in self._ordered_parameters
        ]
        outputs = [Variable(name, "output", "continuous") for _, name in source.output_fields]
        sample_time = Variable(
            "sample_time_s",
            "local",
            "constant",
            source.sample_time_s,
            "every communication step is a whole multiple of it",
        )
        time = Variable("time", "independent", "continuous")
        return [time, *inputs, *parameters, *outputs, sample_time]

    @cached_property
    def _ordered_parameters(self) -> list[Parameter]:
        return sorted(self.parameters, key=lambda parameter: not parameter.tunable)

    def _references(self, causality: Causality) -> list[int]:
        return [i for i, of in enumerate(self.variables) if of.causality == causality]

    @cached_property
    def _reference_of_member(self) -> dict[str, int]:
        references = zip(self._references("parameter"), self._ordered_parameters, strict=True)
        return {member: place for place, of in references for member in of.members}

    def _initial_dependencies(self, node: int) -> list[int]:
        """References of the inputs and parameters that an output depends on at the start."""
        equations = self.source.equations
        graph = equations.graph
        sources = [graph.nodes[n] for n in graph.reachable([node])]
        held = [index for kind, index, *_ in _sources(sources) if kind == "discrete"]
        initial = graph.reachable([equations.initial_discrete[index] for index in held])
        inputs = self._references("input")
        references = set()
        for kind, index in _sources([*sources, *(graph.nodes[n] for n in initial)]):
            if kind == "input":
                references.add(inputs[index])
            elif kind in ("parameter", "state"):
                members = self.source.parameter_fields if kind == "parameter" else self._states
                references |= {self._reference_of_member.get(members[index], 0)}
        return sorted(references - {0})

    # ---------------------------------------------------------------------------- sources

    @cached_property
    def token(self) -> str:
        """Of equal FMUs the same: GUID of FMI 2, instantiation token of FMI 3."""
        told = (self.fmi, self.tool, self.description, self.stop_s)
        digest = hashlib.sha256(repr((told, self.variables, self._ordered_parameters)).encode())
        for text in self._texts("").values():
            digest.update(text.encode())
        return str(uuid.UUID(bytes=digest.digest()[:16]))

    @cached_property
    def sources(self) -> dict[str, str]:
        """Name and text of each file in C."""
        return self._texts(self.token)

    def _texts(self, token: str) -> dict[str, str]:
        source, name = self.source, self.name
        first = {kind: self._references(kind) for kind in ("input", "parameter", "output")}
        fixed = [i for i in first["parameter"] if self.variables[i].variability == "fixed"]
        outputs_begin = len(self.variables) - 1 - len(first["output"])
        names = {
            **source.names,
            "VARIABLES": str(len(self.variables)),
            "FIRSTTUNABLE": str(1 + len(first["input"])),
            "FIRSTFIXED": str(outputs_begin - len(fixed)),
            "FIRSTOUTPUT": str(outputs_begin),
            "FIRSTCONSTANT": str(len(self.variables) - 1),
        }
        systems = ", ".join(dict.fromkeys(limit.system for limit in source.equations.limits))
        limits = f": the state is outside the limits of {systems}"
        words = {"token": token, "limits": _quoted(limits)}
        blocks = {
            "variables": [f"    {_row(variable)}," for variable in self.variables],
            "parameters": list(self._assigned_parameters()) or ["    (void)v;", "    (void)p;"],
            "inputs": [f"    in->{self.variables[i].name} = v[{i}];" for i in first["input"]]
            or ["    (void)v;", "    (void)in;"],
            "outputs": [f"    v[{i}] = out->{self.variables[i].name};" for i in first["output"]]
            or ["    (void)v;", "    (void)out;"],
        }
        conditions = {"limits"} if source.equations.limits else set()
        templates = {
            f"{name}_fmu.h": "fmu/templates/fmu.h",
            f"{name}_fmu.c": "fmu/templates/fmu.c",
            f"{name}_fmi{self.fmi}.c": f"fmu/templates/fmi{self.fmi}.c",
        }
        return source.files() | {
            file: f"{source.head}\n{filled(path, names, words, blocks, conditions)}\n"
            for file, path in templates.items()
        }

    def _assigned_parameters(self) -> Iterator[str]:
        for reference, parameter in zip(
            self._references("parameter"), self._ordered_parameters, strict=True
        ):
            divisor = parameter.divisor
            scale = "" if divisor == 1.0 else f" / {literal(divisor, DOUBLE, parameter.name)}"
            for member in parameter.members:
                yield f"    p->{member} = v[{reference}]{scale};"

    # ------------------------------------------------------------------------------- XML

    def model_description(self) -> str:
        """The file modelDescription.xml."""
        fmi, source = self.fmi, self.source
        root = Element("fmiModelDescription", fmiVersion=_STANDARDS[fmi], modelName=self.name)
        root.set("guid" if fmi == 2 else "instantiationToken", self.token)
        root.attrib |= {"description": self.description, "generationTool": self.tool}
        root.set("variableNamingConvention", "structured")
        kind = SubElement(root, "CoSimulation", modelIdentifier=self.name)
        kind.set("canHandleVariableCommunicationStepSize", "true")
        if fmi == 2:
            kind.set("canNotUseMemoryManagementFunctions", "true")
            kind.attrib |= {"canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
            files = SubElement(kind, "SourceFiles")
            for file in self._compiled:
                SubElement(files, "File", name=file)
        else:
            kind.attrib |= {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
            kind.set("fixedInternalStepSize", repr(source.sample_time_s))
        self._add_units(SubElement(root, "UnitDefinitions"))
        SubElement(SubElement(root, "LogCategories"), "Category", name=_ERRORS)
        SubElement(
            root,
            "DefaultExperiment",
            startTime="0.0",
            stopTime=repr(self.stop_s),
            stepSize=repr(source.sample_time_s),
        )
        variables = SubElement(root, "ModelVariables")
        for reference, variable in enumerate(self.variables):
            self._add_variable(variables, reference, variable)
        self._add_structure(SubElement(root, "ModelStructure"))
        return _text(root)

    @property
    def _compiled(self) -> list[str]:
        return sorted(file for file in self.sources if file.endswith(".c"))

    def _add_units(self, parent: Element) -> None:
        units = {variable.unit for variable in self.variables} - {None}
        for unit in sorted(filter(None, units), key=lambda unit: unit.name):
            base = SubElement(SubElement(parent, "Unit", name=unit.name), "BaseUnit")
            exponents = zip(BASE_UNITS, unit.exponents, strict=True)
            base.attrib |= {name: str(exponent) for name, exponent in exponents if exponent}
            if unit.factor != 1.0:
                base.set("factor", repr(unit.factor))

    def _add_variable(self, parent: Element, reference: int, variable: Variable) -> None:
        outer = SubElement(
            parent,
            "ScalarVariable" if self.fmi == 2 else "Float64",
            name=variable.name,
            valueReference=str(reference),
            causality=variable.causality,
            variability=variable.variability,
        )
        if variable.description:
            outer.set("description", variable.description)
        if variable.causality == "output":
            outer.set("initial", "calculated")
        elif variable.causality in ("parameter", "local"):
            outer.set("initial", "exact")
        inner = SubElement(outer, "Real") if self.fmi == 2 else outer
        if variable.unit is not None:
            inner.set("unit", variable.unit.name)
        if variable.low > -DOUBLE.largest:
            inner.set("min", repr(variable.low))
        if variable.high < DOUBLE.largest:
            inner.set("max", repr(variable.high))
        if variable.start is not None:
            inner.set("start", repr(variable.start))

    def _add_structure(self, parent: Element) -> None:
        """After a step no output depends on an input before the next step; at the start some do."""
        outputs = self._references("output")
        dependencies = [self._initial_dependencies(node) for node in self.source.output_nodes]
        initial = list(zip(outputs, dependencies, strict=True))
        if self.fmi == 3:
            for reference in outputs:
                SubElement(parent, "Output", valueReference=str(reference), dependencies="")
            for reference, knowns in initial:
                unknown = SubElement(parent, "InitialUnknown", valueReference=str(reference))
                unknown.set("dependencies", " ".join(map(str, knowns)))
            return
        for group, rows in (("Outputs", [(i, []) for i in outputs]), ("InitialUnknowns", initial)):
            unknowns = SubElement(parent, group) if rows else parent
            for reference, knowns in rows:
                unknown = SubElement(unknowns, "Unknown", index=str(reference + 1))
                unknown.set("dependencies", " ".join(str(known + 1) for known in knowns))

    def build_description(self) -> str:
        """The file buildDescription.xml of FMI 3."""
        root = Element("fmiBuildDescription", fmiVersion=_STANDARDS[3])
        build = SubElement(root, "BuildConfiguration", modelIdentifier=self.name)
        files = SubElement(build, "SourceFileSet", language="C99")
        for file in self._compiled:
            SubElement(files, "SourceFile", name=file)
        return _text(root)

    # ------------------------------------------------------------------------------ archive

    def library(self) -> bytes | None:
        """The binary of Linux on x86-64; None on another machine, and without a C compiler."""
        if (sys.platform, platform.machine()) != ("linux", "x86_64"):
            return None
        return shared_library(self.sources)

    def archive(self, library: bytes | None) -> bytes:
        """The zip file, whose bytes depend on the content alone; ``library`` as from `library`."""
        files: dict[str, str | bytes] = {"modelDescription.xml": self.model_description()}
        files |= {f"sources/{file}": text for file, text in self.sources.items()}
        if self.fmi == 3:
            files["sources/buildDescription.xml"] = self.build_description()
        if library is not None:
            files[f"binaries/{_PLATFORMS[self.fmi]}/{self.name}.so"] = library
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name in sorted(files):
                archive.writestr(zipfile.ZipInfo(name, _FIRST_DATE), files[name])
        return stream.getvalue()


def generation_tool(archive: bytes) -> str | None:
    """Return the name of the tool that made an FMU, "" for none given; None if it is no FMU."""
    try:
        with (
            zipfile.ZipFile(io.BytesIO(archive)) as files,
            files.open("modelDescription.xml") as file,
        ):
            # A short archive may unpack to a long text.
            root = ElementTree.fromstring(file.read(_LONGEST_DESCRIPTION))
    except Exception:  # a damaged or encrypted archive may raise any error
        return None
    return root.get("generationTool", "") if root.tag == "fmiModelDescription" else None


def _sources(nodes: Sequence[Entry]) -> Iterator[tuple[str, int]]:
    for kind, *rest in nodes:
        if kind in ("input", "parameter", "state", "discrete"):
            yield str(kind), int(rest[0])


def _row(variable: Variable) -> str:
    """A row of the table of variables in C."""
    unit = f" {variable.unit.name}" if variable.unit else ""
    numbers = (variable.start or 0.0, variable.low, variable.high)
    texts = [_quoted(variable.name), _quoted(unit)]
    return f"{{{', '.join([*texts, *(literal(n, DOUBLE, variable.name) for n in numbers)])}}}"


def _quoted(text: str) -> str:
    """Text in C; FMI 2 takes it for a format, so that a percent sign would ask for more."""
    return '"' + re.sub(r'[^ -~]|[\\"%?]', "_", text) + '"'


def _text(root: Element) -> str:
    ElementTree.indent(root)
    body = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'
