"""Bars with the time left in terminals and notebooks, and nothing elsewhere."""

import io
import subprocess
import sys

import pytest

from kneexo import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def shown(monkeypatch, stream, description="runs"):
    monkeypatch.setattr(sys, "stderr", stream)
    with progress.progress_bar(4.0, description) as bar:
        if not bar.disable:  # ten seconds ago
            bar.start_t -= 10.0
            bar.last_print_t -= 10.0
        bar.update(1.0)
    return stream.getvalue()


def test_a_terminal_gets_a_bar_with_the_time_left(monkeypatch):
    text = shown(monkeypatch, Terminal())
    assert "runs:  25%|" in text
    assert "00:10, 00:30 left" in text
    assert "\x1b[3" not in text  # no colour


def test_no_bar_where_stderr_is_no_terminal(monkeypatch):
    assert shown(monkeypatch, io.StringIO()) == ""


def test_no_bar_without_a_description(monkeypatch):
    assert shown(monkeypatch, Terminal(), None) == ""


CODE = """
from kneexo.progress import progress_bar
with progress_bar(4.0, "runs") as bar:
    bar.update(4.0)
"""


@pytest.mark.slow
@pytest.mark.parametrize("widgets", [True, False])
def test_a_notebook_gets_a_widget_or_nothing(widgets, tmp_path, monkeypatch):
    pytest.importorskip("ipykernel")
    if widgets:
        pytest.importorskip("ipywidgets")
    nbclient = pytest.importorskip("nbclient", reason="needs pip install 'kneexo[docs]'")
    nbformat = pytest.importorskip("nbformat")
    hidden = (
        "import importlib.util as u\nreal = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'ipywidgets' else real(name, *a)\n"
    )
    cell = nbformat.v4.new_code_cell(CODE if widgets else hidden + CODE)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    notebook = nbformat.v4.new_notebook(cells=[cell])
    nbclient.NotebookClient(notebook, kernel_name="python3").execute()
    kinds = [output.output_type for output in cell.outputs]
    assert all(output.get("name") != "stderr" for output in cell.outputs)
    if not widgets:
        assert kinds == []
        return
    (output,) = cell.outputs
    assert "application/vnd.jupyter.widget-view+json" in output.data
    states = [w["state"] for w in notebook.metadata.widgets.popitem()[1]["state"].values()]
    assert any("left" in str(state.get("value", "")) for state in states)


def test_a_pipe_gets_no_bar():
    command = [sys.executable, "-c", CODE]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("", "")
