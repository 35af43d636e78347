"""diagramc is a package of its own: it knows no knee, and its tests need no other package."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import diagramc
from kneexo.version import __version__

ROOT = Path(__file__).parents[1]
FOLDER, TESTS = ROOT / "diagramc", ROOT / "tests" / "diagramc"


def project(folder):
    return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))


def imports(folder, pattern):
    """Absolute imports below a folder whose module begins with a pattern, with their file."""
    line = re.compile(rf"^ *(?:from|import) (?={pattern}).*", re.MULTILINE)
    return [(p.name, found) for p in folder.rglob("*.py") for found in line.findall(p.read_text())]


def test_it_imports_itself_by_relative_imports_alone():
    assert imports(FOLDER, r"(kneexo|diagramc)\b") == []


def test_its_tests_import_no_knee():
    assert imports(TESTS, r"kneexo\b") == []
    assert len(imports(TESTS, r"diagramc\b")) > 50


def test_its_project_lists_each_folder():
    tables = project(FOLDER)["tool"]["setuptools"]
    folders = {path.parent.relative_to(ROOT) for path in FOLDER.rglob("__init__.py")}
    assert set(tables["packages"]) == {".".join(folder.parts) for folder in folders}
    assert tables["package-dir"] == {"diagramc": "."}
    data = project(ROOT)["tool"]["setuptools"]["package-data"]
    assert tables["package-data"]["diagramc"] == data["diagramc"]


def test_kneexo_requires_what_diagramc_requires_and_both_have_one_version_and_licence():
    needed, held = (set(project(f)["project"]["dependencies"]) for f in (FOLDER, ROOT))
    assert needed <= held
    assert diagramc.__version__ == __version__
    assert (FOLDER / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


@pytest.mark.slow
def test_the_lines_of_its_readme_print_what_it_shows(tmp_path):
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    blocks = dict(re.findall(r"```(python|text)\n(.*?)```", text, re.DOTALL))
    command = [sys.executable, "-W", "error", "-c", blocks["python"]]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert ended.stdout == blocks["text"], ended.stderr
