"""The tutorials as notebooks: plain Markdown for Jupyter, and run from an installed wheel."""

import os
import re
import resource
from pathlib import Path

import pytest
from elsewhere import module_of

ROOT = Path(__file__).parents[1]
TUTORIALS = [p for p in sorted((ROOT / "docs/tutorials").glob("*.md")) if p.stem != "index"]


@pytest.fixture(scope="module")
def notebooks():
    return module_of("notebooks", ROOT / "docs/notebooks.py")


def junk(text):
    """What Jupyter would show as it is written, and links that lead to no file beside it."""
    links = re.findall(r"\]\(([^)]+)\)", text)
    beside = {f"{page.stem}.ipynb" for page in TUTORIALS}
    dead = [link for link in links if "://" not in link and link not in beside]
    return re.findall(r"\{[\w:-]+\}`[^`]*`|^:::.*|^%.*|^\([\w-]+\)=", text, re.MULTILINE) + dead


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_notebook_has_no_markup_of_the_site(page, notebooks):
    source = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert junk(source)  # the page has some
    plain = notebooks.plain_markdown(source)
    assert junk(plain) == []
    assert len(plain) > 0.8 * len(source)


def test_links_and_roles_become_plain(notebooks):
    text = "It runs. Notebook: {nb-download}`a.ipynb`.\n\n[x](../theory.md#y), [z](margins.md)."
    plain = notebooks.plain_markdown(text)
    assert plain == "It runs.\n\nx (page `theory` of the documentation), [z](margins.ipynb)."
    assert notebooks.plain_markdown(plain) == plain


def cpu_seconds_of_children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.slow(gate=0)
@pytest.mark.parametrize("name", ["firmware", "wearer"])
def test_a_notebook_runs_from_the_wheel(name, notebooks, wheel, tmp_path):
    """Those that read files of the package; the build of the site runs the code of all."""
    nbclient = pytest.importorskip("nbclient", reason="needs pip install '.[docs]'")
    nbformat = pytest.importorskip("nbformat")
    read = pytest.importorskip("myst_nb.core.read").read_myst_markdown_notebook
    pytest.importorskip("ipykernel")
    file = tmp_path / f"{name}.ipynb"
    nbformat.write(read((ROOT / f"docs/tutorials/{name}.md").read_text("utf-8")), file)
    notebooks.make_plain(file)
    notebook = nbformat.read(file, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            assert junk(cell.source) == []
    where = nbformat.v4.new_code_cell("import kneexo; print(kneexo.__file__)")
    notebook.cells.insert(0, where)
    empty = tmp_path / "empty"
    empty.mkdir()
    environment = os.environ | {"PYTHONPATH": str(wheel), "IPYTHONDIR": str(tmp_path / "ipython")}
    environment.pop("MPLBACKEND", None)  # a command run by an earlier test leaves it
    client = nbclient.NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(empty)}}
    )
    before = cpu_seconds_of_children()
    client.execute(env=environment)
    assert where.outputs[0].text.startswith(str(wheel))
    outputs = [output for cell in notebook.cells[1:] for output in cell.get("outputs", ())]
    words = "".join(o.text for o in outputs if o.get("name") == "stderr").splitlines()
    assert [line for line in words if not line.startswith("compiling equations;")] == []
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 1
    assert 1.0 < cpu_seconds_of_children() - before < 60.0
    *_, last = (cell for cell in notebook.cells if cell.cell_type == "code")
    assert any(re.search(r"\d", output.get("text", "")) for output in last.outputs)
    assert any("image/png" in output.get("data", {}) for output in last.outputs)
