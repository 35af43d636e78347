"""The compiler of the tests that remembers, around a compiler that counts its calls."""

import os
from pathlib import Path

import pytest
from elsewhere import module_of

PATH = Path(__file__).with_name("remembering_compiler.py")
remembering_compiler = module_of("remembering_compiler", PATH)

COMPILER = """#!/bin/sh
echo >> "{calls}"
cat m.c m.h > "$3"
echo said
echo warned >&2
exit $(grep -c error m.c)
"""


@pytest.fixture
def calls(tmp_path):
    """Each call of the compiler adds a line to this file."""
    (tmp_path / "calls").touch()
    (tmp_path / "cc").write_text(COMPILER.format(calls=tmp_path / "calls"))
    (tmp_path / "cc").chmod(0o755)
    (tmp_path / "store").mkdir()
    return tmp_path / "calls"


@pytest.fixture
def compile_in(tmp_path, calls, monkeypatch, capsysbinary):
    """``compile_in(name, source, header, target)``: exit code, target and what was said."""

    def run(name, source, header="int y;", target="m.so"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "m.c").write_text(source)
        (folder / "m.h").write_text(header)
        monkeypatch.chdir(folder)
        store, compiler = str(tmp_path / "store"), str(tmp_path / "cc")
        code = remembering_compiler.main(store, compiler, "m.c", "-o", target)
        return code, (folder / target).read_text(), capsysbinary.readouterr()

    return run


def test_equal_sources_in_another_folder_are_compiled_once(calls, compile_in):
    first = compile_in("a", "int x;")
    assert first == (0, "int x;int y;", (b"said\n", b"warned\n"))
    assert compile_in("b", "int x;") == first
    assert calls.read_text() == "\n"


@pytest.mark.parametrize(
    "other",
    [("int z;",), ("int x;", "int z;"), ("int x;", "int y;", "other.so")],
    ids=["source", "header", "target"],
)
def test_whatever_differs_is_compiled(calls, compile_in, other):
    compile_in("a", "int x;")
    assert compile_in("b", *other)[1] == "".join([*other, "int y;"][:2])
    assert calls.read_text() == "\n\n"


def test_another_compiler_compiles_anew(calls, compile_in, tmp_path):
    compile_in("a", "int x;")
    with (tmp_path / "cc").open("a") as file:
        file.write("# a new version\n")
    compile_in("b", "int x;")
    assert calls.read_text() == "\n\n"


def test_errors_are_remembered_too(calls, compile_in):
    first, second = (compile_in(name, "error;") for name in "ab")
    assert first == second
    assert first[0] == 1
    assert calls.read_text() == "\n"


def test_files_that_other_processes_write_and_remove_meanwhile_do_not_matter(tmp_path, monkeypatch):
    monkeypatch.setattr(remembering_compiler, "LIMIT", 1)
    written, removed = tmp_path / "other.1", tmp_path / "removed"
    for file in (written, removed):
        file.touch()
        os.utime(file, (0, 0))  # the oldest
    entries = list(os.scandir(tmp_path))
    removed.unlink()
    monkeypatch.setattr(remembering_compiler.os, "scandir", lambda folder: entries)
    remembering_compiler._write(str(tmp_path / "entry"), b"x")
    assert set(os.listdir(tmp_path)) == {"entry", "other.1"}


@pytest.mark.parametrize(
    "arguments",
    [("--version",), ("-x", "c", "-", "m.c"), ("m.c", "-o", "/tmp/m.so"), ("m.o", "-o", "m.so")],
)
def test_what_is_no_compilation_in_its_folder_goes_to_the_compiler(arguments):
    assert not remembering_compiler.can_be_remembered(arguments)
