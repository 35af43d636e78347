"""What a notebook shows for parameters."""

import sys
from types import SimpleNamespace

import pytest

import kneexo as kx
from kneexo.parameters import G1, PlantParameters
from kneexo.view import notebook


@pytest.fixture
def show(monkeypatch):
    """The HTML that IPython's own formatter makes of an object, or None."""
    formatters = pytest.importorskip("IPython.core.formatters", reason="needs IPython")
    shell = SimpleNamespace(display_formatter=formatters.DisplayFormatter())
    module = SimpleNamespace(get_ipython=lambda: shell)
    monkeypatch.setitem(sys.modules, "IPython", module)
    notebook.register()
    return shell.display_formatter.formatters["text/html"]


@pytest.mark.parametrize(
    ("parameters", "text"),
    [(kx.Scenario(), "Scenario()"), (PlantParameters(), "PlantParameters()"), (G1, "G1")],
)
def test_parameters_have_a_drawing_and_their_repr(show, parameters, text):
    html = show(parameters)
    assert html.count("<svg ") == 1
    assert ">O" in html
    assert f">{text}</pre>" in html


def test_the_drawing_is_that_of_the_linkage_of_the_scenario(show):
    html = show(kx.Scenario().changed({"plant.linkage": "G3"}))
    assert "47.9 mm, on the shank" in html  # a_3 of G3
    assert "linkage=G3" in html


def test_a_linkage_that_cannot_be_assembled_gives_the_reason(show):
    html = show(kx.Scenario().changed({"plant.linkage.a_2_m": 0.3}))
    assert "<svg" not in html
    assert "No drawing: the linkage cannot be assembled at knee angle 35 deg" in html


def test_names_are_escaped(show):
    html = show(kx.Scenario().with_law(lambda rod_extension: 0.0))
    assert "&lt;lambda&gt;" in html
    assert "<lambda>" not in html


def test_other_parameters_keep_their_text(show):
    assert show(kx.Scenario().encoder) is None


@pytest.mark.parametrize("module", [None, SimpleNamespace(get_ipython=lambda: None)])
def test_outside_a_notebook_nothing_happens(module, monkeypatch):
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    if module:
        monkeypatch.setitem(sys.modules, "IPython", module)
    notebook.register()


@pytest.mark.slow
def test_a_kernel_shows_the_mechanism_of_a_scenario():
    nbclient = pytest.importorskip("nbclient", reason="needs pip install '.[docs]'")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    cell = nbformat.v4.new_code_cell("import kneexo as kx\nkx.Scenario.preset('leg')")
    book = nbformat.v4.new_notebook(cells=[cell])
    nbclient.NotebookClient(book, kernel_name="python3", timeout=60).execute()  # else: for ever
    (output,) = book.cells[0].outputs
    assert output.data["text/html"].count("<svg ") == 1
    assert output.data["text/plain"].startswith("Scenario(plant=")
