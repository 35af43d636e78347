"""The compiler copied out of the package under another name, with its tests."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMPILER, TESTS = ROOT / "kneexo" / "compiler", ROOT / "tests" / "compiler"
NAME = "drakecompiler"
CONFTEST = """
import sys

import hypothesis

sys.modules["kneexo"] = None  # an import of it fails
hypothesis.settings.register_profile("loaded machine", deadline=None)
hypothesis.settings.load_profile("loaded machine")
"""


def copied_text(text):
    """The text of a test with the name of the copy in place of that of the package."""
    text = text.replace("diagramc", NAME)
    return text.replace("kneexo", NAME).replace("KNEEXO", NAME.upper())


@pytest.fixture
def copy(tmp_path):
    """A folder with a space in its path that holds the compiler and its tests."""
    folder = tmp_path / "a copy"
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(COMPILER, folder / NAME, ignore=ignore)
    shutil.copytree(TESTS, folder / "tests", ignore=ignore)
    for test in (folder / "tests").rglob("*.py"):
        test.write_text(copied_text(test.read_text()))
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    return folder


def run(copy, *arguments):
    command = [sys.executable, "-m", "pytest", "-q", "--import-mode=importlib", *arguments]
    environment = {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": str(copy)}
    environment |= {"PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1"}
    environment |= {f"{NAME.upper()}_LLVM_LEVEL": "0"}
    return subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True)


def imports(folder, pattern):
    """Absolute imports below a folder whose module begins with a pattern, with their file."""
    line = re.compile(rf"^ *(?:from|import) (?={pattern}).*", re.MULTILINE)
    return [(p.name, found) for p in folder.rglob("*.py") for found in line.findall(p.read_text())]


def test_the_compiler_imports_itself_by_relative_imports_alone():
    assert imports(COMPILER, r"kneexo\b") == []


def test_the_tests_of_the_compiler_import_no_knee():
    assert imports(TESTS, r"kneexo(?!\.compiler\b)") == []
    assert len(imports(TESTS, r"kneexo\.compiler\b")) > 50


@pytest.mark.slow(gate=0)
def test_a_copy_passes_its_tests_without_the_package(copy):
    ended = run(copy, "-m", "not slow", "-n", "2", "tests")
    assert ended.returncode == 0, ended.stdout[-4000:]
    assert int(re.search(r"(\d+) passed", ended.stdout)[1]) > 500


@pytest.mark.slow
def test_a_copy_has_names_of_its_own(copy):
    (copy / "test_names.py").write_text(
        "import sys\n\n"
        "import pytest\n"
        "from pydrake.systems.primitives import Gain\n\n"
        f"from {NAME} import Fmu, cache_directory, export_c, read_diagram, source_of\n\n\n"
        "def test_names(tmp_path):\n"
        "    with pytest.raises(ImportError):\n"
        "        import kneexo\n"
        f"    assert cache_directory().name == '{NAME}'\n"
        "    gain = Gain(2.0, 1)\n"
        "    export_c(gain, tmp_path / 'out', name='gain', inputs=['u0'], steps=5, tick_s=0.1)\n"
        f"    line = 'Made by {NAME} from a Drake diagram.'\n"
        "    assert all(line in file.read_text() for file in (tmp_path / 'out').iterdir())\n"
        "    source = source_of(read_diagram(gain, inputs=['u0']), 'gain', tick_s=0.1)\n"
        f"    assert Fmu(source).tool == '{NAME}'\n"
        "    assert not [name for name in sys.modules if name.startswith('kneexo.')]\n"
    )
    ended = run(copy, "test_names.py")
    assert ended.returncode == 0, ended.stdout[-4000:]
