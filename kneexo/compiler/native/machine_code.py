"""The machine code of a model, one function at a time: from the cache, or compiled."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from threading import RLock, Timer

from ..equations.equations import Equations
from ..equations.passes import Layout, Program
from . import cache as entries
from .llvm import Library, compile_text, processor
from .time_loop import between_text, run_text, start_text

Source = Equations | Callable[[], Equations]
"""Equations, or a function that reads them; it is called when the cache lacks machine code."""

ANNOUNCED_AFTER_S = 1.0
"""Time in s after which a line on stderr says that equations are being compiled."""

_lock = RLock()  # two threads may ask for the same code
_libraries: dict[str, Library] = {}
_layouts: dict[str, Layout] = {}


class MachineCode:
    """The functions of one model.

    ``key`` is text that is equal for equal equations alone. A pickled object holds key and source,
    so another process loads the code from the cache or compiles it.
    """

    def __init__(self, key: str, source: Source) -> None:
        self.key, self._source = key, source
        self._program: Program | None = None

    def __reduce__(self) -> tuple[type[MachineCode], tuple[str, Source]]:
        return MachineCode, (self.key, self._source)

    @property
    def layout(self) -> Layout:
        """Names and sizes; from the cache, or of the program."""
        with _lock:
            key = self._entry("layout")
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
        """The program that is printed; made when it is first needed."""
        with _lock:
            if self._program is None:
                source = self._source
                self._program = Program(source if isinstance(source, Equations) else source())
            return self._program

    def start(self, name: str) -> Callable[..., None]:
        """Return the function ``constants`` or ``initialize`` of `printer`."""
        arguments = {"constants": 2, "initialize": 5}[name]
        return self._library("start", lambda: start_text(self.program)).function(name, arguments)

    def run(self, integrator: str, lanes: int) -> Callable[..., None]:
        """Return the function ``run`` of `time_loop`."""
        part = f"run, {integrator}, {lanes} lanes"
        library = self._library(part, lambda: run_text(self.program, integrator, lanes))
        return library.function("run", 1)

    def between(self) -> Callable[..., None]:
        """Return the function ``between`` of `time_loop`."""
        library = self._library("between", lambda: between_text(self.program))
        return library.function("between", 1)

    def _library(self, part: str, text: Callable[[], str]) -> Library:
        with _lock:
            key = self._entry(part)
            if key not in _libraries:
                code = entries.load(key)
                if code is None:
                    with _announced():
                        code = compile_text(text())
                    entries.store(key, code)
                _libraries[key] = Library(code)
            return _libraries[key]

    def _entry(self, part: str) -> str:
        """Return the key of a part in the cache: all that its bytes depend on."""
        return "\n".join((self.key, _sources(), processor().key, part))


@contextmanager
def _announced() -> Iterator[None]:
    """Context manager: print a line on stderr if its body takes more than `ANNOUNCED_AFTER_S`.

    Worker processes print nothing.
    """
    if parent_process() is not None:
        yield
        return
    line = f"compiling equations; machine code is kept in {entries.cache_directory()}"
    # A wait without a word looks like a hang; there is no logger to say it.
    timer = Timer(ANNOUNCED_AFTER_S, lambda: print(line, file=sys.stderr, flush=True))  # noqa: T201
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@cache
def _sources() -> str:
    """Return a fingerprint of the compiler's own source files."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
