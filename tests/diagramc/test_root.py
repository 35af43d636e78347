"""The name of the package, which a copy under another name must not share."""

import importlib.util

import pytest

from diagramc import compile_diagram, root


def test_the_root_is_the_package_that_holds_the_compiler():
    assert compile_diagram.__module__.split(".")[0] == root.ROOT


@pytest.mark.parametrize("package", ["other", "other.compiler.root"])
def test_a_copy_under_another_name_has_its_own_variables(package):
    spec = importlib.util.spec_from_file_location(package, root.__file__)
    copy = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(copy)
    assert copy.ROOT == "other"
    assert copy.variable("CPU") == "OTHER_CPU"
    assert copy.tool() == "other"


def test_the_tool_is_the_package_with_its_version(monkeypatch):
    monkeypatch.setattr(root, "version", {root.ROOT: "1.2.3"}.__getitem__)
    assert root.tool() == f"{root.ROOT} 1.2.3"
