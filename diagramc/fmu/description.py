"""Writes the XML files of an FMU: modelDescription.xml, and buildDescription.xml of FMI 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ..c.printer import DOUBLE
from ..errors import escaped
from .units import BASE_UNITS
from .variables import Variable, VariableTable

_STANDARDS = {2: "2.0", 3: "3.0"}


@dataclass(frozen=True)
class Header:
    """The content of modelDescription.xml except the variables."""

    fmi: int
    """Version of the standard: 2 or 3."""
    name: str
    """Model identifier of the FMU."""
    token: str
    """GUID of FMI 2, instantiation token of FMI 3."""
    tool: str
    description: str
    stop_s: float
    """Default end of a run in s."""
    sample_time_s: float
    files: Sequence[str]
    """Names of the C files that an importer compiles to a binary."""


def model_description(header: Header, table: VariableTable) -> str:
    """Return the text of modelDescription.xml."""
    fmi = header.fmi
    root = Element("fmiModelDescription", fmiVersion=_STANDARDS[fmi], modelName=header.name)
    root.set("guid" if fmi == 2 else "instantiationToken", header.token)
    root.attrib |= {"description": header.description, "generationTool": header.tool}
    root.set("variableNamingConvention", "structured")
    kind = SubElement(root, "CoSimulation", modelIdentifier=header.name)
    # A step off the grid of sample times is refused, and FMI has no flag for steps on a grid.
    kind.set("canHandleVariableCommunicationStepSize", "false")
    if fmi == 2:
        # The C code calls malloc itself, and never the functions that the importer passes.
        kind.set("canNotUseMemoryManagementFunctions", "true")
        kind.attrib |= {"canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
        files = SubElement(kind, "SourceFiles")
        for file in header.files:
            SubElement(files, "File", name=file)
    else:
        kind.attrib |= {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
        kind.set("fixedInternalStepSize", repr(header.sample_time_s))
    _add_units(SubElement(root, "UnitDefinitions"), table.variables)
    SubElement(SubElement(root, "LogCategories"), "Category", name="logStatusError")
    SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(header.stop_s),
        stepSize=repr(header.sample_time_s),
    )
    parent = SubElement(root, "ModelVariables")
    for reference, variable in enumerate(table.variables):
        _add_variable(parent, fmi, reference, variable)
    _add_structure(SubElement(root, "ModelStructure"), fmi, table)
    return _text(root)


def build_description(header: Header) -> str:
    """Return the text of buildDescription.xml, which lists the C files of an FMU by FMI 3."""
    root = Element("fmiBuildDescription", fmiVersion=_STANDARDS[3])
    build = SubElement(root, "BuildConfiguration", modelIdentifier=header.name)
    files = SubElement(build, "SourceFileSet", language="C99")
    for file in header.files:
        SubElement(files, "SourceFile", name=file)
    return _text(root)


def _add_units(parent: Element, variables: Sequence[Variable]) -> None:
    units = {variable.unit for variable in variables}
    for unit in sorted(filter(None, units), key=lambda unit: unit.name):
        base = SubElement(SubElement(parent, "Unit", name=unit.name), "BaseUnit")
        exponents = zip(BASE_UNITS, unit.exponents, strict=True)
        base.attrib |= {name: str(exponent) for name, exponent in exponents if exponent}
        if unit.factor != 1.0:
            base.set("factor", repr(unit.factor))


def _add_variable(parent: Element, fmi: int, reference: int, variable: Variable) -> None:
    outer = SubElement(
        parent,
        "ScalarVariable" if fmi == 2 else "Float64",
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
    inner = SubElement(outer, "Real") if fmi == 2 else outer
    if variable.unit is not None:
        inner.set("unit", variable.unit.name)
    if variable.low > -DOUBLE.largest:
        inner.set("min", repr(variable.low))
    if variable.high < DOUBLE.largest:
        inner.set("max", repr(variable.high))
    if variable.start is not None:
        inner.set("start", repr(variable.start))


def _add_structure(parent: Element, fmi: int, table: VariableTable) -> None:
    """Add the lists of outputs, with their dependencies, from which importers order their calls.

    Between two steps, outputs depend on no variable, because a step alone changes them. During the
    initialization, outputs can depend on inputs and parameters.
    """
    outputs = table.references("output")
    initial = list(zip(outputs, table.initial_dependencies(), strict=True))
    if fmi == 3:
        for reference in outputs:
            SubElement(parent, "Output", valueReference=str(reference), dependencies="")
        for reference, knowns in initial:
            unknown = SubElement(parent, "InitialUnknown", valueReference=str(reference))
            unknown.set("dependencies", " ".join(map(str, knowns)))
        return
    after_step: list[tuple[int, list[int]]] = [(reference, []) for reference in outputs]
    for group, rows in (("Outputs", after_step), ("InitialUnknowns", initial)):
        # FMI 2 refuses an empty list, and counts variables by an index that begins with 1.
        unknowns = SubElement(parent, group) if rows else parent
        for reference, knowns in rows:
            unknown = SubElement(unknowns, "Unknown", index=str(reference + 1))
            unknown.set("dependencies", " ".join(str(known + 1) for known in knowns))


def _text(root: Element) -> str:
    for element in root.iter():  # XML has no control characters, not even escaped
        element.attrib = {name: escaped(text) for name, text in element.attrib.items()}
    ElementTree.indent(root)
    body = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'
