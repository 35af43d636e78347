"""Run the tests under the conditions of other machines.

    python benchmarks/machine_variants.py [--only NAME] [--margins FOLDER] [PYTEST ARGUMENT ...]

Each variant runs the tests in a copy of the tree, and prints the last line of pytest and the CPU
time. ``--only`` picks a variant and may be repeated. ``--margins`` records tolerances in
``FOLDER/NAME`` as ``benchmarks/tolerance_margins.py`` does, and shows the smallest margins at the
end. The exit code is 1 if a variant fails or a margin is below 10.

native
    This machine as it is.
old kernels
    Linear algebra for Nehalem, NumPy's functions without vectors, and the C library without AVX2
    and FMA, as on an old or emulated processor.
haswell, skylake
    OpenBLAS's kernels for Haswell and for SkylakeX, and machine code for x86-64-v3 and x86-64-v4.
without fma
    Machine code for x86-64-v2. Runs take many times as long, so only the tests of compilation and
    simulation run by default.
elsewhere
    Another user with another home (as root), a path with spaces and other letters, a Turkish
    locale, tests in random order (``--seed N``), at most 256 open files, one core.
load
    While stress-ng keeps every core busy four times over.
"""

from __future__ import annotations

import argparse
import os
import pwd
import random
import resource
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TREE = ("benchmarks", "docs", "examples", "kneexo", "tests")
SEED = "KNEEXO_TEST_ORDER"
"""Environment variable: seed of the random order."""


@dataclass(frozen=True)
class Variant:
    """The conditions of another machine, relative to this one."""

    environment: dict[str, str] = field(default_factory=dict)
    tests: tuple[str, ...] = ()
    """The tests to run if the command line names none."""
    elsewhere: bool = False
    load: bool = False


def numpy_features() -> str:
    """Return the processor features that NumPy can switch off, in the names of its version."""
    import numpy as np

    if np.lib.NumpyVersion(np.__version__) >= "2.4.0":
        return "X86_V3 X86_V4"
    return "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL"


VARIANTS = {
    "native": Variant(),
    "old kernels": Variant(
        {
            "OPENBLAS_CORETYPE": "Nehalem",
            "NPY_DISABLE_CPU_FEATURES": numpy_features(),
            "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4",
        }
    ),
    "haswell": Variant({"OPENBLAS_CORETYPE": "Haswell", "KNEEXO_CPU": "x86-64-v3"}),
    "skylake": Variant({"OPENBLAS_CORETYPE": "SkylakeX", "KNEEXO_CPU": "x86-64-v4"}),
    "without fma": Variant({"KNEEXO_CPU": "x86-64-v2"}, ("tests/compiler", "tests/simulation")),
    "elsewhere": Variant({SEED: "1"}, elsewhere=True),
    "load": Variant(load=True),
}


def pytest_collection_modifyitems(items: list[Any]) -> None:
    """Hook of pytest: put the files, and the tests in each file, in random order."""
    if SEED not in os.environ:
        return
    order = random.Random(int(os.environ[SEED]))
    rank = {path: order.random() for path in sorted({str(item.path) for item in items})}
    order.shuffle(items)
    items.sort(key=lambda item: rank[str(item.path)])


@contextmanager
def busy_cores() -> Iterator[None]:
    """Context manager: four processes of stress-ng for each core run during its body."""
    count = str(4 * (os.cpu_count() or 1))
    stress = subprocess.Popen(
        ["stress-ng", "--cpu", count, "--quiet"], stdout=subprocess.DEVNULL
    )  # fmt: skip
    try:
        yield
    finally:
        stress.terminate()
        stress.wait()


def copy_tree(target: Path) -> None:
    """Copy the folders of `TREE` and the files beside them, without Python's bytecode."""
    for name in TREE:
        shutil.copytree(ROOT / name, target / name, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ROOT.iterdir():
        if file.is_file() and file.name != ".git":
            shutil.copy(file, target)


def turkish_locale(folder: Path) -> dict[str, str]:
    """Return environment variables for tr_TR.UTF-8, after making this locale in ``folder``."""
    result = subprocess.run(
        ["localedef", "-i", "tr_TR", "-f", "UTF-8", str(folder / "tr_TR.UTF-8")],
        capture_output=True,
    )
    if result.returncode not in (0, 1):  # 1: warnings
        print("   no Turkish locale: localedef failed")
    return {"LC_ALL": "tr_TR.UTF-8", "LOCPATH": str(folder)}


def public_python() -> str:
    """Return a Python of this version that other users can run."""
    if any(not folder.stat().st_mode & 1 for folder in Path(sys.executable).resolve().parents):
        name = f"python{sys.version_info.major}.{sys.version_info.minor}"
        public = shutil.which(name, path="/usr/local/bin:/usr/bin")
        if public is None:
            sys.exit(f"no {name} that another user can run")
        return public
    return sys.executable


def limits(identity: tuple[int, int] | None) -> Callable[[], None]:
    """Return a function that a process of "elsewhere" calls before it starts."""

    def apply() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        if identity is not None:
            os.setgroups([])
            os.setgid(identity[1])
            os.setuid(identity[0])

    return apply


def run(name: str, variant: Variant, arguments: list[str], margins: Path | None, seed: int) -> bool:
    """Run the tests under a variant; return whether they pass."""
    # Turkish: dotted and dotless i; Greek, as in the messages.
    folder = "knee ıİ θ's" if variant.elsewhere else "knee"
    with tempfile.TemporaryDirectory() as scratch:
        os.chmod(scratch, 0o755)
        tree, home, temporary = (Path(scratch, folder, part) for part in ("tree", "home", "tmp"))
        for path in (tree, home, temporary):
            path.mkdir(parents=True)
        copy_tree(tree)
        environment = os.environ | variant.environment
        packages = [str(tree), str(tree / "benchmarks"), sysconfig.get_path("purelib")]
        environment["PYTHONPATH"] = os.pathsep.join(packages)
        if "KNEEXO_CPU" in variant.environment or variant.elsewhere:
            environment["KNEEXO_CACHE_DIR"] = str(home / "cache")
        python, prepare = sys.executable, None
        if variant.elsewhere:
            identity = None
            if os.getuid() == 0:
                nobody = pwd.getpwnam("nobody")
                identity, python = (nobody.pw_uid, nobody.pw_gid), public_python()
                for path in (Path(scratch), *Path(scratch).rglob("*")):
                    os.chown(path, *identity)
            environment |= {"HOME": str(home), "TMPDIR": str(temporary), SEED: str(seed)}
            environment |= turkish_locale(Path(scratch))
            prepare = limits(identity)
        records = margins and (margins / name).resolve()
        if records:
            records.mkdir(parents=True, exist_ok=True)
            records.chmod(0o777)
        pytest = (
            ["benchmarks/tolerance_margins.py", "run", str(records)]
            if records
            else ["-m", "pytest"]
        )
        tests = arguments or list(variant.tests)
        command = [python, *pytest, "-p", "machine_variants", "-p", "no:cacheprovider", "-q"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with busy_cores() if variant.load else nullcontext():
            result = subprocess.run(
                [*command, *tests],
                cwd=tree,
                env=environment,
                preexec_fn=prepare,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    lines = result.stdout.splitlines()
    for line in lines:
        if line.startswith(("FAILED", "ERROR", "SKIPPED")):
            print(f"   {line}")
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    load = " (stress-ng among it)" if variant.load else ""
    print(
        f"{name}: {lines[-1] if lines else result.returncode}; CPU {cpu_s:.0f} s{load}", flush=True
    )
    if result.returncode and not any(line.startswith("FAILED") for line in lines):
        print("\n".join(lines[-30:]))
    return result.returncode == 0


def main() -> int:
    """Run the variants of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=VARIANTS, metavar="NAME")
    parser.add_argument("--margins", type=Path, help="folder for the records of tolerances")
    parser.add_argument("--seed", type=int, default=1, help="of the random order")
    options, rest = parser.parse_known_args()
    names = options.only or list(VARIANTS)
    passed = [run(name, VARIANTS[name], rest, options.margins, options.seed) for name in names]
    enough = True
    if options.margins:
        from tolerance_margins import show

        enough = show([options.margins / name for name in names], worst=20) == 0
    return int(not (all(passed) and enough))


if __name__ == "__main__":
    sys.exit(main())
