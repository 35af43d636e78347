"""Generated modules on disk: written once, imported by every later process.

numba keeps its machine code beside a module (``__pycache__``). The directory is
``KNEEXO_CACHE_DIR``, else ``kneexo`` in ``XDG_CACHE_HOME``, else ``~/.cache/kneexo``; it may be
deleted at any time.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path
from types import ModuleType

_PREFIX = "kneexo_model_"


def cache_directory() -> Path:
    """Where generated modules are kept."""
    if chosen := os.environ.get("KNEEXO_CACHE_DIR"):
        return Path(chosen)
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "kneexo"
    return Path.home() / ".cache" / "kneexo"


@cache
def _own_directory() -> Path:
    """A directory of this process alone, where the user's cannot be written."""
    return Path(tempfile.mkdtemp(prefix="kneexo-"))


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def load_text(text: str) -> ModuleType:
    """The module with that text, from the cache where it is there."""
    name = _PREFIX + _hash(text)
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
    if name in sys.modules:
        return sys.modules[name]
    path = cache_directory() / f"{name}.py"
    return _import(name, path) if _is_sound(path) else None


def note_key(key: str, module: ModuleType) -> None:
    """Note that ``key`` means ``module``; nothing happens where the cache cannot be written."""
    if Path(module.__file__ or "").parent == cache_directory():
        _write(_key_path(key), module.__name__)


def _key_path(key: str) -> Path:
    return cache_directory() / f"{_hash(key)}.key"


def _is_sound(path: Path) -> bool:
    """Whether the file is there and has the text that its name promises."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        return False
    except UnicodeDecodeError:
        text = ""
    if _PREFIX + _hash(text) == path.stem:
        return True
    warnings.warn(f"{path}: damaged; it is written anew", stacklevel=2)
    return False


def _write(path: Path, text: str) -> Path:
    """Write all or nothing; where ``path`` cannot be written, into `_own_directory`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".kneexo-")
    except OSError as error:
        own = _own_directory() / path.name
        warnings.warn(
            f"{path.parent}: cannot be written ({error.strerror}); compiled models are not kept "
            f"and every process compiles anew",
            stacklevel=2,
        )
        own.write_text(text, encoding="utf-8")
        return own
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return path


def _import(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path}: cannot be imported")
    module = importlib.util.module_from_spec(spec)
    # numba finds a function's module by its name, also while the module is executed.
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
