"""Exported C under a compiler: a replay, sizes on a target, failed builds."""

import shutil

import pytest

from diagramc.c.build import BuildError, CodeSize, Replay, code_sizes, replay
from diagramc.errors import CompilationError

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs the C compiler gcc")


def test_sizes_are_those_of_the_tools(tmp_path, monkeypatch, script):
    """A compiler and a ``size`` in the place of those for ARM: 100 + 20 bytes, frames 40, 8, 9."""
    frames = {"m_step": 40, "update_at": 8, "m_init": 9}
    usage = "\\n".join(f"m.c:1:2:{name}\\t{size}\\tstatic" for name, size in frames.items())
    tools = {
        "gcc": f'for f; do case $f in *.c) printf "{usage}" > "${{f%.c}}.su";; esac; done',
        "size": 'echo "text data bss"; echo "100 0 0 x.o"; echo "20 0 0 y.o"',
    }
    for name, text in tools.items():
        script(tmp_path / f"arm-none-eabi-{name}", text)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    sizes = code_sizes("m", {"m.c": "", "m_params.c": ""})
    assert sizes == {target: CodeSize(120, 48) for target in ("Cortex-M4F", "Cortex-M7")}


@needs_compiler
def test_code_that_does_not_build_is_one_line():
    with pytest.raises(CompilationError) as error:
        replay("m", {"m.c": "int main(void) { return x; }\n"})
    assert "\n" not in str(error.value)
    with pytest.raises(CompilationError, match="m: the harness printed no difference"):
        replay("m", {"m.c": "int main(void) { return 0; }\n"})


def test_the_error_of_a_compiler_is_the_line_that_says_so(tmp_path, monkeypatch, script):
    script(tmp_path / "cc", "echo 'm.c: In function f:' >&2; echo 'm.c:1: error: odd' >&2; exit 1")
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(BuildError, match=r"^cc: m.c:1: error: odd$"):
        replay("m", {"m.c": ""})
    script(tmp_path / "cc", "echo 'no licence' >&2; echo 'bye' >&2; exit 1")
    with pytest.raises(BuildError, match=r"^cc: no licence$"):
        replay("m", {"m.c": ""})
    script(tmp_path / "cc", "exit 0")
    with pytest.raises(BuildError, match=r"^harness: No such file or directory$"):
        replay("m", {"m.c": ""})


@needs_compiler
def test_a_replay_reads_every_row():
    text = (
        '#include <stdio.h>\nint main(void) { puts("a: difference 1e-3, largest value 2"); '
        'puts("b_rad: difference 0, largest value 0.5"); return 1; }\n'
    )
    assert replay("m", {"m.c": text}) == Replay(
        {"a": 1e-3, "b_rad": 0.0}, {"a": 2.0, "b_rad": 0.5}, passed=False
    )
