"""Generated modules on disk: written once, imported by every later process.

numba keeps its machine code beside a module (``__pycache__``); a seal tells whether it is still
what was written, for numba would run anything. The directory is
``KNEEXO_CACHE_DIR``, else ``kneexo`` in ``XDG_CACHE_HOME``, else ``~/.cache/kneexo``; it may be
deleted at any time.
"""

from __future__ import annotations

import atexit
import fcntl
import hashlib
import importlib.util
import json
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any

_PREFIX = "kneexo_model_"
_lock = RLock()  # a module is there before it is complete


def cache_directory() -> Path:
    """Where generated modules are kept."""
    if chosen := os.environ.get("KNEEXO_CACHE_DIR"):
        return Path(chosen).expanduser().absolute()
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "kneexo"
    return Path.home() / ".cache" / "kneexo"


@cache
def _own_directory() -> Path:
    """A directory of this process alone, where the user's cannot be written."""
    directory = Path(tempfile.mkdtemp(prefix="kneexo-"))
    atexit.register(shutil.rmtree, directory, ignore_errors=True)
    return directory


def text_hash(text: str) -> str:
    """Name of a text by its content."""
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def load_text(text: str) -> ModuleType:
    """The module with that text, from the cache where it is there."""
    name = _PREFIX + text_hash(text)
    with _lock:
        if name in sys.modules:
            return sys.modules[name]
        path = cache_directory() / f"{name}.py"
        if not _is_sound(path):
            path = _write(path, text)
        return _import(name, path)


def load_key(key: str) -> ModuleType | None:
    """The module that was noted under ``key``; None when there is none, or a damaged one."""
    try:
        name = _key_path(key).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    if not name.startswith(_PREFIX) or not name.removeprefix(_PREFIX).isalnum():
        return None
    with _lock:
        if name in sys.modules:
            return sys.modules[name]
        path = cache_directory() / f"{name}.py"
        return _import(name, path) if _is_sound(path) else None


def note_key(key: str, module: ModuleType) -> None:
    """Note that ``key`` means ``module``; nothing happens where the cache cannot be written."""
    if Path(module.__file__ or "").parent == cache_directory():
        _write(_key_path(key), module.__name__)


def _key_path(key: str) -> Path:
    return cache_directory() / f"{text_hash(key)}.key"


def _is_sound(path: Path) -> bool:
    """Whether the file is there and has the text that its name promises."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        return False
    except UnicodeDecodeError:
        text = ""
    if _PREFIX + text_hash(text) == path.stem:
        return True
    warnings.warn(f"{path}: damaged; it is written anew", stacklevel=2)
    return False


def _write(path: Path, text: str) -> Path:
    """Write all or nothing; where ``path`` cannot be written, into `_own_directory`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".kneexo-")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            os.replace(temporary, path)
        except BaseException:  # KeyboardInterrupt too: no half file stays
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        _warn_unwritable(path.parent, error)
        path = _own_directory() / path.name
        path.write_text(text, encoding="utf-8")
    return path


def _warn_unwritable(directory: Path, error: OSError) -> None:
    warnings.warn(
        f"{directory}: cannot be written ({error.strerror}); compiled models are not kept and "
        f"every process compiles anew",
        stacklevel=3,
    )


def _import(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path}: cannot be imported")
    module = importlib.util.module_from_spec(spec)
    # numba finds a function's module by its name, also while the module is executed.
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:  # KeyboardInterrupt too: no half module stays
        del sys.modules[name]
        raise
    return module


# --------------------------------------------------------------------------- machine code


def make_ready(function: Any, arguments: Sequence[Any]) -> None:
    """Compile a jitted function of a generated module for such ``arguments``, or load it.

    ``arguments`` must be quick to run. Processes that need the same module wait for each other.
    Damaged machine code is removed, with a warning, and made anew.
    """
    if not hasattr(function, "signatures") or function.signatures:  # plain Python, or known
        return
    module = sys.modules[function.__module__]
    path = Path(module.__file__ or "")
    code = Path(function._cache.cache_path)  # elsewhere with NUMBA_CACHE_DIR, or in a read-only one
    with _alone(path):
        _remove_unsound_code(path, code)
        for _ in vars(module):  # at most once for each function that cannot be kept
            try:
                function(*arguments)
                break
            except OSError as error:
                _warn_unwritable(path.parent, error)
        seal = json.dumps(_code_hashes(path, code))
        with suppress(OSError):  # unsealed code is made anew by the next process
            if not _seal_path(path).exists() or _seal_path(path).read_text() != seal:
                _write(_seal_path(path), seal)


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """One process at a time, where the file system has locks."""
    with ExitStack() as stack:
        with suppress(OSError):
            file = stack.enter_context(path.with_suffix(".lock").open("a"))
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _seal_path(path: Path) -> Path:
    return path.with_suffix(".seal")


def _code_hashes(path: Path, code: Path) -> dict[str, str]:
    """Hashes of numba's files of a module, in the directory ``code``."""
    files = sorted(code.glob(f"{path.stem}.*.nb[ci]"))
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def _remove_unsound_code(path: Path, code: Path) -> None:
    """Delete machine code that is not as it was sealed, or was never."""
    found = _code_hashes(path, code)
    try:
        sealed = json.loads(_seal_path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        sealed = {}
    unsound = [name for name, content in found.items() if sealed.get(name) != content]
    if not unsound:
        return
    if any(name in sealed for name in unsound):  # the others are of a process that was killed
        warnings.warn(f"{code}: machine code is damaged; it is made anew", stacklevel=3)
    for name in found:
        (code / name).unlink(missing_ok=True)
