"""Libraries for other machines: which compiler runs, with which options; what is refused."""

import pytest

from diagramc.c import build, cross
from diagramc.c.cross import PLATFORMS, native_platform, require_platforms, shared_libraries
from diagramc.errors import CompilationError

FILES = {"m.c": "int m(void) { return 1; }\n", "m.h": ""}


def test_zig_gets_the_target_of_each_platform(zig):
    zig()
    libraries = shared_libraries("m", FILES, ["x86_64-windows", "aarch64-linux"])
    assert list(libraries) == ["aarch64-linux", "x86_64-windows"]  # in the order of the table
    for platform, file in {"x86_64-windows": "m.dll", "aarch64-linux": "m.so"}.items():
        arguments = libraries[platform].decode().split(" ")
        assert arguments[:3] == ["cc", "-target", PLATFORMS[platform].target]
        assert arguments[arguments.index("-o") + 1] == file
        assert "m.c" in arguments
        assert "m.h" not in arguments
        assert {"-shared", "-O2", "-ffp-contract=off", "-fvisibility=hidden"} < {*arguments}


def test_the_error_of_zig_is_one_line(zig):
    zig(fails=True)
    with pytest.raises(CompilationError, match=r"^ziglang: m\.c:1:1: error: odd$"):
        shared_libraries("m", FILES, "all")


def test_names_of_platforms(zig):
    zig()
    assert require_platforms("all") == tuple(PLATFORMS)
    assert require_platforms("aarch64-darwin") == ("aarch64-darwin",)
    assert require_platforms(["x86_64-darwin", "x86_64-linux"] * 2) == (
        "x86_64-linux",
        "x86_64-darwin",
    )


KNOWN = "; must be all, or of x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin, "


@pytest.mark.parametrize(
    ("platforms", "message"),
    [
        ("win64", f"platforms: 'win64' is unknown{KNOWN}aarch64-darwin"),
        (["x86_64-linux", "amiga\n"], rf"platforms: 'amiga\n' is unknown{KNOWN}aarch64-darwin"),
        ([7], f"platforms: '7' is unknown{KNOWN}aarch64-darwin"),
        ([], f"platforms: has no name{KNOWN}aarch64-darwin"),
    ],
)
def test_unknown_platforms_are_refused(platforms, message, zig):
    zig()
    with pytest.raises(CompilationError) as error:
        require_platforms(platforms)
    assert str(error.value) == message


def test_without_zig_the_remedy_is_said(monkeypatch):
    monkeypatch.setattr(cross, "find_spec", lambda name: None)
    with pytest.raises(CompilationError, match=r"^platforms: .* not installed; pip install zigla"):
        shared_libraries("m", FILES, "all")


@pytest.mark.parametrize(
    ("system", "machine", "platform"),
    [
        ("linux", "x86_64", "x86_64-linux"),
        ("linux", "aarch64", "aarch64-linux"),
        ("linux", "armv7l", None),
        ("darwin", "x86_64", None),
        ("win32", "AMD64", None),
    ],
)
def test_the_platform_of_this_machine(system, machine, platform, monkeypatch, tmp_path):
    compiler = tmp_path / "compiler"
    compiler.write_text('#!/bin/sh\nwhile [ "$1" != -o ]; do shift; done; echo "$2" > "$2"\n')
    compiler.chmod(0o755)
    monkeypatch.setattr(build, "COMPILERS", (str(compiler),))
    monkeypatch.setattr("sys.platform", system)
    monkeypatch.setattr("platform.machine", lambda: machine)
    assert native_platform() == platform
    assert shared_libraries("m", FILES) == ({platform: b"m.so\n"} if platform else {})


def test_without_a_compiler_there_is_no_library(monkeypatch):
    monkeypatch.setattr(build, "COMPILERS", ("no_such_compiler",))
    assert shared_libraries("m", FILES) == {}
