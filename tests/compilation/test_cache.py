"""The cache of compiled modules, and what a run of a known structure does not do."""

import errno
import subprocess
import sys

import numpy as np
import pytest

from kneexo.compilation import cache
from kneexo.parameters import (
    CylinderParameters,
    EncoderParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
)
from kneexo.simulation import compiled, simulate_compiled

SHORT = Scenario(
    encoder=EncoderParameters(quantized=False), simulation=SimulationParameters(duration_s=0.05)
)


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("KNEEXO_CACHE_DIR", str(tmp_path))
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("kneexo_model_")]:
        file = sys.modules[name].__file__
        if file and file.startswith(str(tmp_path)):
            del sys.modules[name]


def forget(module):
    del sys.modules[module.__name__]


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"KNEEXO_CACHE_DIR": "/a"}, "/a"),
        ({"XDG_CACHE_HOME": "/b", "HOME": "/c"}, "/b/kneexo"),
        ({"HOME": "/c"}, "/c/.cache/kneexo"),
    ],
)
def test_directory_of_the_cache(variables, expected, monkeypatch):
    for name in ("KNEEXO_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert str(cache.cache_directory()) == expected


def test_equal_text_is_one_module_and_one_file(empty_cache):
    first = cache.load_text("VALUE = 1\n")
    assert cache.load_text("VALUE = 1\n") is first
    assert cache.load_text("VALUE = 2\n").VALUE == 2
    assert len(list(empty_cache.glob("*.py"))) == 2
    cache.note_key("structure", first)
    forget(first)
    again = cache.load_key("structure")
    assert again.VALUE == 1
    assert again is not first
    assert cache.load_key("another") is None


def test_a_damaged_module_is_written_anew(empty_cache):
    module = cache.load_text("VALUE = 1\n")
    cache.note_key("structure", module)
    (path,) = empty_cache.glob("*.py")
    for damage in (b"VALUE = 3\n", b"", b"\xff\xfe"):
        forget(module)
        path.write_bytes(damage)
        with pytest.warns(UserWarning, match="damaged"):
            assert cache.load_key("structure") is None
        with pytest.warns(UserWarning, match="damaged"):
            module = cache.load_text("VALUE = 1\n")
        assert module.VALUE == 1
        assert path.read_text() == "VALUE = 1\n"


def test_a_damaged_key_counts_as_missing(empty_cache):
    module = cache.load_text("VALUE = 1\n")
    cache.note_key("structure", module)
    (path,) = empty_cache.glob("*.key")
    for damage in (b"../../etc/passwd", b"\xff", b"kneexo_model_0", b""):
        path.write_bytes(damage)
        assert cache.load_key("structure") is None


def test_a_cache_that_cannot_be_written_is_told_and_replaced(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("KNEEXO_CACHE_DIR", str(blocked / "below"))
    with pytest.warns(UserWarning, match="cannot be written"):
        module = cache.load_text("VALUE = 4\n")
    assert module.VALUE == 4
    cache.note_key("structure", module)
    assert cache.load_key("structure") is None


JITTED = """
from numba import njit

@njit(cache=True)
def double(x):
    return 2.0 * x
"""


def ready(text=JITTED):
    module = cache.load_text(text)
    cache.make_ready(module.double, (1.0,))
    return module


def loaded_from_disk(module):
    return sum(module.double.stats.cache_hits.values()) == 1


def test_machine_code_is_kept_and_taken_again(empty_cache):
    module = ready()
    assert module.double(2.0) == 4.0
    assert not loaded_from_disk(module)
    forget(module)
    assert loaded_from_disk(ready())


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [b"", b"not a pickle", "flip"])
def test_damaged_machine_code_is_made_anew(empty_cache, kind, damage):
    forget(ready())
    (path,) = (empty_cache / "__pycache__").glob(f"*.{kind}")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content if damage == "flip" else damage)
    with pytest.warns(UserWarning, match="machine code is damaged; it is made anew"):
        module = ready()
    assert module.double(2.0) == 4.0
    assert not loaded_from_disk(module)
    forget(module)
    assert loaded_from_disk(ready())


def test_machine_code_of_a_process_that_was_killed_is_made_anew(empty_cache, recwarn):
    forget(ready())
    (seal,) = empty_cache.glob("*.seal")
    for left in ("", None):
        seal.unlink() if left is None else seal.write_text(left)
        module = ready()
        assert not loaded_from_disk(module)
        forget(module)
    assert not recwarn
    for path in (empty_cache / "__pycache__").iterdir():
        path.unlink()
    assert not loaded_from_disk(ready())
    assert not recwarn


def test_a_full_disk_is_told_and_the_code_runs(empty_cache, monkeypatch):
    def full(*_args, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    module = cache.load_text(JITTED)
    monkeypatch.setattr(type(module.double._cache), "save_overload", full)
    monkeypatch.setattr(cache.tempfile, "mkstemp", full)
    with pytest.warns(UserWarning, match=r"cannot be written \(No space left on device\)"):
        cache.make_ready(module.double, (1.0,))
    assert module.double(2.0) == 4.0
    with pytest.warns(UserWarning, match="cannot be written"):
        assert cache.load_text("VALUE = 5\n").VALUE == 5


def test_two_processes_compile_once(empty_cache):
    code = (
        "from kneexo.compilation import cache\n"
        f"module = cache.load_text({JITTED!r})\n"
        "cache.make_ready(module.double, (1.0,))\n"
        "print(sum(module.double.stats.cache_hits.values()))\n"
    )
    both = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    assert sorted(process.communicate(timeout=120)[0].strip() for process in both) == ["0", "1"]


def test_a_known_structure_needs_no_diagram_and_no_symbolic_work(monkeypatch):
    first = simulate_compiled(SHORT, signals=["rod_velocity"])

    def refuse(*_args, **_options):
        raise AssertionError("not needed")

    monkeypatch.setattr(compiled, "read_equations", refuse)
    monkeypatch.setattr(compiled, "make_closed_loop", refuse)
    monkeypatch.setattr(compiled, "_modules", {})
    heavier = SHORT.model_copy(
        update={"plant": PlantParameters(cylinder=CylinderParameters(mass_kg=3.0))}
    )
    second = simulate_compiled(heavier, signals=["rod_velocity"])
    assert np.max(np.abs(first["rod_velocity_m_s"] - second["rod_velocity_m_s"])) > 1e-6


def test_importing_kneexo_imports_neither_numba_nor_drake():
    code = (
        "import sys, kneexo; assert not {'numba', 'pydrake'} & set(sys.modules);"
        "import kneexo.compilation; assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
