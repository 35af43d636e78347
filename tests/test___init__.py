"""The short names of `import kneexo as kx`, for users, editors and type checkers."""

import ast
import doctest
import inspect
import pydoc
from pathlib import Path

import pytest

import kneexo
from kneexo import analysis, parameters, simulation
from kneexo.analysis import batches, responses
from kneexo.analysis.identification import experiment, fit as fit_module
from kneexo.page import play

HOMES = {
    "Scenario": parameters,
    "batch": batches,
    "bode": responses,
    "compile": simulation,
    "design_experiment": experiment,
    "design_linkage": analysis,
    "fit": fit_module,
    "linearize": responses,
    "play": play,
    "step": responses,
    "track": analysis,
}
FUNCTIONS = sorted(set(HOMES) - {"Scenario"})
SLOW = ("design_experiment", "design_linkage", "play")  # 6 s, 3 s, 5 s
EXAMPLES = [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in HOMES]


def test_only_the_public_names_are_listed():
    assert {name for name in dir(kneexo) if name[:2] != "__"} == set(HOMES) == set(kneexo.__all__)


@pytest.mark.parametrize("name", HOMES)
def test_a_name_is_that_of_its_package(name):
    assert getattr(kneexo, name) is getattr(HOMES[name], name)


def test_type_checkers_read_the_same_names():
    tree = ast.parse(Path(kneexo.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    assert not [node for node in block.body if not isinstance(node, ast.ImportFrom)]
    assert not [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    imported = {name.name: node.module for node in block.body for name in node.names}
    assert imported == {name: module.__name__ for name, module in HOMES.items()}


def test_an_unknown_name_is_answered_with_the_known_ones():
    with pytest.raises(AttributeError, match="'kneexo' has no attribute 'tracks'; it has Scenario"):
        kneexo.__getattr__("tracks")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_shows_the_types_of_arguments_and_result(name):
    function = getattr(kneexo, name)
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        assert parameter.annotation is not parameter.empty
        assert not isinstance(parameter.annotation, str)
    result = inspect.signature(function, eval_str=True).return_annotation
    assert result.__module__.startswith(("diagramc.", "kneexo."))
    text = pydoc.render_doc(function, renderer=pydoc.plaintext)
    assert f"\n{name}(" in text
    assert f"-> '{result.__name__}'" in text


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_prints_what_it_shows(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    examples = doctest.DocTestFinder().find(getattr(kneexo, name), name)
    results = [doctest.DocTestRunner().run(example) for example in examples]
    assert sum(result.attempted for result in results) >= 2
    assert sum(result.failed for result in results) == 0
