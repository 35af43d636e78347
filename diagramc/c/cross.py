"""Compiles exported C to shared libraries for this machine, or for other machines by Zig.

Zig is a compiler with the C libraries of many systems. The package ``ziglang`` installs it.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from ..errors import CompilationError, shown
from .build import BuildError, native_compiler, shared_library
from .checks import require_type


@dataclass(frozen=True)
class Platform:
    """A kind of machine that runs shared libraries."""

    target: str
    """Zig's name of architecture and system, with C library and oldest version where Zig has them.

    An example is ``x86_64-linux-gnu.2.17``.
    """
    suffix: str
    """End of the file name of a shared library."""


# glibc 2.17 is the first for aarch64, and macOS 11 the first for Apple silicon.
PLATFORMS = {
    "x86_64-linux": Platform("x86_64-linux-gnu.2.17", ".so"),
    "aarch64-linux": Platform("aarch64-linux-gnu.2.17", ".so"),
    "x86_64-windows": Platform("x86_64-windows-gnu", ".dll"),
    "x86_64-darwin": Platform("x86_64-macos.11.0", ".dylib"),
    "aarch64-darwin": Platform("aarch64-macos.11.0", ".dylib"),
}
"""Dictionary from the name of a platform to its data. The names are those of FMI 3."""


def require_platforms(platforms: str | Iterable[str]) -> tuple[str, ...]:
    """Return the names of platforms in the order of `PLATFORMS`, each name once.

    ``platforms`` has names of `PLATFORMS`, or is one name, or is ``all``. Raises
    `CompilationError` if a name is unknown or if there is no name, and its subclass `BuildError` if
    Zig is not installed.
    """
    require_type("platforms", platforms, Iterable, "all, or names of platforms")
    if platforms == "all":
        names = set(PLATFORMS)
    else:
        names = {platforms} if isinstance(platforms, str) else set(map(str, platforms))
    unknown = sorted(name for name in names if name not in PLATFORMS)
    if unknown or not names:
        problem = f"{shown(repr(unknown[0]))} is unknown" if unknown else "has no name"
        raise CompilationError(f"platforms: {problem}; must be all, or of {', '.join(PLATFORMS)}")
    zig_command("platforms", ", or leave out platforms for the library of this machine alone")
    return tuple(name for name in PLATFORMS if name in names)


def zig_command(subject: str, alternative: str = "") -> tuple[str, ...]:
    """Return the command of Zig's C compiler.

    Raises `BuildError` if Zig is not installed. The message begins with ``subject`` and ends with
    ``alternative``.
    """
    if find_spec("ziglang") is None:
        raise BuildError(
            f"{subject}: the compiler Zig is not installed; pip install ziglang{alternative}"
        )
    return sys.executable, "-m", "ziglang", "cc"


def native_platform() -> str | None:
    """Return this machine's name in `PLATFORMS` if it is Linux on x86-64 or aarch64, else None."""
    name = f"{platform.machine()}-{sys.platform}"
    return name if sys.platform == "linux" and name in PLATFORMS else None


def shared_libraries(
    name: str, files: Mapping[str, str], platforms: str | Iterable[str] | None = None
) -> dict[str, bytes]:
    """Compile C files to shared libraries. Return a dictionary from platform to library.

    Parameters
    ----------
    name
        File name of the libraries without its end.
    files
        Dictionary from file name to text. Each file that ends in ``.c`` is compiled.
    platforms
        The platforms, see `require_platforms`, for which Zig compiles. With None, the C compiler
        of this machine compiles for this machine. The dictionary is empty if there is no such
        compiler, or if `native_platform` is None.

    Raises `CompilationError` as `require_platforms` does, or if a compiler fails.
    """
    commands: dict[str, tuple[str, ...]] = {}
    if platforms is not None:
        names = require_platforms(platforms)
        zig = zig_command("platforms")
        commands = {key: (*zig, "-target", PLATFORMS[key].target) for key in names}
    elif (native := native_platform()) and (compiler := native_compiler()):
        commands = {native: (compiler,)}
    return {
        key: shared_library(name + PLATFORMS[key].suffix, files, *command)
        for key, command in commands.items()
    }
