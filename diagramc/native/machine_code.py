"""Gets each machine-code function of a model from the cache on disk, or compiles the function."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from threading import Event, RLock, Timer

from ..equations.equations import Equations
from ..equations.passes import Layout, Program
from . import cache as entries
from .llvm import Library, Processor, compile_text, processor
from .time_loop import rates_text, run_text, start_text

Source = Equations | Callable[[], Equations]
"""Equations, or a function that returns equations and is called only if the cache lacks code."""

ANNOUNCED_AFTER_S = 1.0
"""Time in s after which a line on stderr says that equations are being compiled."""

# Two threads may ask for the same code. The lock is reentrant, because `layout` reads `program`.
_lock = RLock()
_libraries: dict[str, Library] = {}
"""Code that was loaded last, by cache key. A function of a model keeps its own library."""
# A long session can run any number of diagrams and laws, and must not keep the code of each. A
# library has some 0.1 MiB, and a model has up to four: start, run, run at given times, rates.
_MOST_LIBRARIES = 128
_announcement = Event()  # set when this process has said that it compiles
_layouts: dict[str, Layout] = {}


class MachineCode:
    """The machine-code functions of one model, each loaded or compiled when it is first requested.

    ``key`` is a text that must differ between models with different equations. Pickle keeps only
    key and source, so another process loads the code from the cache or compiles the equations.
    """

    def __init__(self, key: str, source: Source) -> None:
        self.key, self._source = key, source
        self._program: Program | None = None

    def __reduce__(self) -> tuple[type[MachineCode], tuple[str, Source]]:
        return MachineCode, (self.key, self._source)

    @property
    def layout(self) -> Layout:
        """Names and sizes of the model, loaded from the cache or else taken from `program`."""
        with _lock:
            # The layout is an entry of its own, with which a process need not read the diagram.
            key = _entry(self.key, "layout")
            if key not in _layouts:
                content = entries.load(key)
                if content is None:
                    with _announced():
                        _layouts[key] = self.program.layout
                    entries.store(key, json.dumps(_layouts[key].plain()).encode())
                else:
                    _layouts[key] = Layout.from_plain(json.loads(content))
            return _layouts[key]

    @property
    def program(self) -> Program:
        """The equations, rewritten for machine code at the first access."""
        with _lock:
            if self._program is None:
                source = self._source
                self._program = Program(source if isinstance(source, Equations) else source())
            return self._program

    def start_function(self, name: str) -> Callable[..., None]:
        """Return the machine-code function ``name``, which is ``constants`` or ``initialize``.

        See `define_constants` and `define_initialize`.
        """
        arguments = {"constants": 2, "initialize": 5}[name]
        library = self._library("start", lambda: start_text(self.program))
        return library.function(name, arguments)

    def run_function(self, integrator: str, lanes: int, given_times: bool) -> Callable[..., None]:
        """Return the machine-code function ``run`` for an integrator. `RUN` lists its arguments.

        With ``given_times`` the function records at given times, not every ``record_every`` ticks.
        """
        part = f"run, {integrator}, {lanes} lanes" + ", given times" * given_times
        make = lambda: run_text(self.program, integrator, lanes, given_times)  # noqa: E731
        return self._library(part, make).function("run", 1)

    def rates_function(self) -> Callable[..., None]:
        """Return the machine-code function ``rates``. See `define_rates`."""
        library = self._library("rates", lambda: rates_text(self.program))
        return library.function("rates", 7)

    def _library(self, part: str, text: Callable[[], str]) -> Library:
        return library(self.key, part, text)


def library(key: str, part: str, text: Callable[[], str], level: int | None = None) -> Library:
    """Return machine code: the loaded code, else code from the cache, else compiled code.

    The function compiles the IR text ``text()``. ``key`` must differ between codes of the same
    ``part``. ``level`` is LLVM's optimization level, by default the level of `processor`.
    """
    target = processor() if level is None else replace(processor(), level=level)
    with _lock:
        key = _entry(key, part, target)
        if key not in _libraries:
            code = entries.load(key)
            if code is None:
                with _announced():
                    code = compile_text(text(), target)
                entries.store(key, code)
            _libraries[key] = Library(code)
            if len(_libraries) > _MOST_LIBRARIES:
                del _libraries[next(iter(_libraries))]
        return _libraries[key]


def _entry(key: str, part: str, target: Processor | None = None) -> str:
    """Return the cache key of a part of the code, which changes with whatever changes the code.

    That is the model, the sources of diagramc, LLVM with the processor, and the part.
    """
    return "\n".join((key, _sources(), (target or processor()).key, part))


@contextmanager
def _announced() -> Iterator[None]:
    """Context manager: print a line on stderr if its body takes more than `ANNOUNCED_AFTER_S`.

    A process prints the line once. Worker processes print nothing.
    """
    if parent_process() is not None or _announcement.is_set():
        yield
        return
    line = f"compiling equations; machine code is kept in {entries.cache_directory()}"

    def announce() -> None:
        _announcement.set()
        # A wait without a word looks like a hang; there is no logger to say it.
        print(line, file=sys.stderr, flush=True)  # noqa: T201

    timer = Timer(ANNOUNCED_AFTER_S, announce)
    timer.daemon = True  # an interrupted compilation does not keep the process alive
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@cache
def _sources() -> str:
    """Return a hash of all source files of the compiler; a changed file changes all cache keys."""
    # The version is not enough: sources change between two releases, and old code would run on.
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
