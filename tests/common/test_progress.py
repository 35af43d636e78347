"""Bars with the time left in terminals and notebooks, and nothing elsewhere."""

import io
import subprocess
import sys

import pytest

from kneexo.common import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def _terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")


def shown(monkeypatch, stream, description="runs"):
    monkeypatch.setattr(sys, "stderr", stream)
    with progress.progress_bar(4.0, description) as bar:
        bar.update(1.0)
        bar.update(2.0)
    assert bar.n == 3.0
    return stream.getvalue()


def test_a_terminal_gets_a_bar_with_the_time_left(monkeypatch):
    text = shown(monkeypatch, Terminal())
    assert "runs:  75%" in text
    assert "left" in text
    assert text.endswith("\n\x1b[?25h")  # the bar stays, and the cursor is visible again


def test_no_bar_where_stderr_is_no_terminal(monkeypatch):
    assert shown(monkeypatch, io.StringIO()) == ""


def test_no_bar_without_a_description(monkeypatch):
    assert shown(monkeypatch, Terminal(), None) == ""


STAGES = (
    progress.Stage("runs", 6.0),
    progress.Stage("searches", 2.0, repeats=True),
    progress.Stage("figures", 2.0),
)


@pytest.fixture
def positions(monkeypatch):
    """The positions in s of the bar of `STAGES`, within its body."""
    positions = []
    whole = progress._Whole(STAGES, lambda share: positions.append(round(10.0 * share, 9)))
    monkeypatch.setattr(progress, "_whole", whole)
    return positions


def test_bars_of_the_stages_advance_the_bar_of_the_whole_by_their_shares(positions):
    with progress.progress_bar(4.0, "runs") as runs:
        runs.update(1.0)
        assert runs.n == 1.0
        runs.update(3.0)
    assert positions == [1.5, 6.0]
    for _ in range(2):  # half of what is left, then half of the rest
        with progress.progress_bar(1.0, "searches") as search:
            search.update(1.0)
    with progress.progress_bar(5.0, "of no stage") as unknown:
        unknown.update(5.0)
    with progress.progress_bar(4.0, "figures") as figures:
        figures.update(2.0)
        figures.update(5.0)  # more than the total
    assert positions == [1.5, 6.0, 7.0, 7.5, 8.0, 9.0, 10.0]


def test_a_stage_without_work_ends_at_once(positions):
    with progress.progress_bar(0.0, "runs") as runs:
        runs.update(0.0)
    assert positions == [6.0]


def test_a_command_shows_one_bar_and_lines_above_it(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with progress.whole_bar("study", STAGES):
        with progress.progress_bar(4.0, "runs") as runs:
            runs.update(4.0)
        print("a warning", file=sys.stderr)
        assert "a warning\n" in stream.getvalue()
    text = stream.getvalue()
    assert "study:  60%" in text
    assert "runs:" not in text
    assert text.endswith("\r\x1b[1A\x1b[2K")  # the bar disappears
    assert sys.stderr is stream
    with progress.progress_bar(1.0, "alone") as alone:
        alone.update(1.0)
    assert "alone: 100%" in stream.getvalue()


def test_an_error_ends_the_bar(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with pytest.raises(KeyboardInterrupt), progress.whole_bar("study", STAGES):
        raise KeyboardInterrupt
    assert progress._whole is None


def test_the_whole_shows_nothing_where_stderr_is_no_terminal(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with progress.whole_bar("study", STAGES), progress.progress_bar(4.0, "runs") as runs:
        runs.update(4.0)
    assert stream.getvalue() == ""


CODE = """
from kneexo.common.progress import progress_bar
with progress_bar(4.0, "runs") as bar:
    bar.update(4.0)
"""


@pytest.mark.slow
@pytest.mark.parametrize("widgets", [True, False])
def test_a_notebook_gets_a_widget_or_nothing(widgets, tmp_path, monkeypatch):
    pytest.importorskip("ipykernel")
    if widgets:
        pytest.importorskip("ipywidgets")
    nbclient = pytest.importorskip("nbclient", reason="needs pip install '.[docs]'")
    nbformat = pytest.importorskip("nbformat")
    hidden = (
        "import importlib.util as u\nreal = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'ipywidgets' else real(name, *a)\n"
    )
    cell = nbformat.v4.new_code_cell(CODE if widgets else hidden + CODE)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    notebook = nbformat.v4.new_notebook(cells=[cell])
    # Without a time limit nbclient waits for ever, if its asyncio misses the kernel's reply. With a
    # limit it finds the reply at the end: 13 of 350 kernels on two cores, six at a time.
    nbclient.NotebookClient(notebook, kernel_name="python3", timeout=60).execute()
    kinds = [output.output_type for output in cell.outputs]
    assert all(output.get("name") != "stderr" for output in cell.outputs)
    if not widgets:
        assert kinds == []
        return
    assert "application/vnd.jupyter.widget-view+json" in cell.outputs[0].data
    states = [w["state"] for w in notebook.metadata.widgets.popitem()[1]["state"].values()]
    assert any("runs: 100%" in str(state.get("outputs", "")) for state in states)


def test_a_pipe_gets_no_bar():
    command = [sys.executable, "-c", CODE]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("", "")
