"""The XML files of an FMU: read by FMPy, and by a plain reader of XML."""

from xml.etree import ElementTree

import pytest

import diagramc
from diagramc.fmu.description import Header, build_description, model_description
from diagramc.fmu.variables import VariableTable


def test_description_is_valid(path):
    pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []


def test_variables_and_dependencies(fmu, path):
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install '.[fmu]'")
    description = fmpy.read_model_description(path)
    assert description.guid == fmu.token
    assert (description.modelName, description.description) == ("lag", "a lag")
    assert description.generationTool == f"diagramc {diagramc.__version__}"
    assert float(description.defaultExperiment.stopTime) == 5.0
    assert float(description.defaultExperiment.stepSize) == 0.1
    variables = {
        v.name: (v.causality, v.variability, v.unit, v.start, v.min, v.max)
        for v in description.modelVariables
    }
    assert variables == {
        "time": ("independent", "continuous", "s", None, None, None),
        "u_m_s": ("input", "continuous", "m/s", "0.25", None, None),
        "offset_m_s": ("parameter", "tunable", "m/s", "0.0", None, None),
        "initial.x_mm": ("parameter", "fixed", None, "500.0", "0.0", "2000.0"),
        "x_m": ("output", "continuous", "m", None, None, None),
        "late_m": ("output", "continuous", "m", None, None, None),
        "d_m_s": ("output", "continuous", "m/s", None, None, None),
        "sample_time_s": ("local", "constant", "s", "0.1", None, None),
    }
    assert [u.variable.name for u in description.outputs] == ["x_m", "late_m", "d_m_s"]
    assert all(not u.dependencies for u in description.outputs)
    initial = {
        u.variable.name: [v.name for v in u.dependencies] for u in description.initialUnknowns
    }
    assert initial == {"x_m": ["initial.x_mm"], "late_m": [], "d_m_s": ["u_m_s", "offset_m_s"]}
    units = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
    assert (units["m/s"].m, units["m/s"].s, units["m/s"].kg) == (1, -1, 0)


HEADER = Header(3, "lag", "token", "a <tool>", 'a "lag" & more', 5.0, 0.1, ["lag.c", "b.c"])


def test_texts_that_are_no_xml_are_escaped(lag_source, lag_parameters):
    table = VariableTable(lag_source().plan, lag_parameters, {})
    root = ElementTree.fromstring(model_description(HEADER, table).encode())
    assert (root.get("generationTool"), root.get("description")) == ("a <tool>", 'a "lag" & more')
    assert (root.get("fmiVersion"), root.get("instantiationToken")) == ("3.0", "token")
    names = [variable.get("name") for variable in root.find("ModelVariables")]
    assert names == [variable.name for variable in table.variables]


def test_a_build_description_lists_the_source_files():
    root = ElementTree.fromstring(build_description(HEADER).encode())
    assert [file.get("name") for file in root.iter("SourceFile")] == ["lag.c", "b.c"]
