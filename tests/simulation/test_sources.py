"""The key of a scenario's machine code changes with each file that makes its equations."""

import ast
import shutil
from pathlib import Path

import kneexo
from kneexo.parameters import Scenario
from kneexo.simulation.compiled import structure_key
from kneexo.simulation.sources import digest, sources

FOLDER = Path(kneexo.__file__).parents[1]


def imported(module, folder):
    """Names of the modules that a module of kneexo imports anywhere, by Python's own parser."""
    file = path_of(module, folder)
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, file  # the package imports by full names
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def path_of(module, folder):
    path = folder.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def closure(folder):
    """All files of kneexo that the loop imports, without the compiler and the root."""
    found, todo = set(), ["kneexo.simulation.compiled"]
    while todo:
        module = todo.pop()
        known = module in found or not module.startswith("kneexo.")
        if known or not path_of(module, folder).is_file():
            continue
        found.add(module)
        todo += [module.rpartition(".")[0], *imported(module, folder)]
    return {path_of(module, folder) for module in found}


def test_sources_are_the_files_that_pythons_parser_finds():
    found = sources(FOLDER)
    assert set(found) == closure(FOLDER)
    assert len(found) > 60
    names = [str(path.relative_to(FOLDER / "kneexo")) for path in found]
    assert {
        "systems/bldc_pump.py",
        "errors.py",
        "common/user_code.py",
        "parameters/task/gait.py",
    } <= set(names)
    assert not [name for name in names if name.startswith(("analysis", "view", "studies"))]


def test_a_changed_byte_in_each_of_them_changes_the_digest(tmp_path):
    files = [tmp_path / file.relative_to(FOLDER) for file in sources(FOLDER)]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(FOLDER / file.relative_to(tmp_path), file)
    assert sources(tmp_path) == files
    digests = {digest(files)}
    for file in files:
        text = file.read_bytes()
        file.write_bytes(text + b"\n")
        digests.add(digest(files))
        file.write_bytes(text)
    assert len(digests) == 1 + len(files)


def test_the_key_of_a_scenario_contains_the_digest():
    assert digest(sources(FOLDER)) in structure_key(Scenario())
