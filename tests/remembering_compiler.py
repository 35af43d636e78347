"""A C compiler that remembers, as ccache does, and links too: the same sources and options again
give the files of the first time.

``python remembering_compiler.py STORE COMPILER ARGUMENT…`` is COMPILER with those arguments; what
it wrote and said is kept in the directory STORE.
"""

import hashlib
import os
import pickle
import subprocess
import sys
from contextlib import suppress

LIMIT = 1500
"""Compilations in a store; those that were used last stay."""


def main(store, compiler, *arguments):
    if not can_be_remembered(arguments):
        os.execv(compiler, [compiler, *arguments])
    entry = os.path.join(store, _key(compiler, arguments))
    try:
        with open(entry, "rb") as file:
            code, output, error, files = pickle.load(file)
        os.utime(entry)
    except FileNotFoundError:
        before = _files()
        done = subprocess.run([compiler, *arguments], capture_output=True)
        code, output, error = done.returncode, done.stdout, done.stderr
        files = {name: _read(name) for name, state in _files().items() if before.get(name) != state}
        if code in (0, 1):  # not where the compiler was stopped
            _write(entry, pickle.dumps((code, output, error, files)))
    else:
        for name, (mode, content) in files.items():
            with open(name, "wb") as file:
                file.write(content)
            os.chmod(name, mode)
    sys.stdout.buffer.write(output)
    sys.stderr.buffer.write(error)
    return code


def can_be_remembered(arguments):
    """Sources are files, and what is made of them stays below the working directory."""
    targets = [arguments[n + 1] for n, argument in enumerate(arguments[:-1]) if argument == "-o"]
    return (
        any(argument.endswith((".c", ".cpp")) for argument in arguments)
        and "-" not in arguments
        and not any(os.path.isabs(target) for target in targets)
    )


def _key(compiler, arguments):
    """Of the compiler, its arguments, and every file that it may read but those of the system."""
    status = os.stat(compiler)
    here = os.getcwd()
    folders = {here}
    for argument in arguments:
        path = os.path.abspath(argument.removeprefix("-I"))
        if os.path.exists(path):
            folders.add(path if os.path.isdir(path) else os.path.dirname(path))
    parts = [
        *(os.path.realpath(compiler), str(status.st_size), str(status.st_mtime_ns)),
        *(argument.replace(here, ".") for argument in arguments),
    ]
    seal = hashlib.sha256("\0".join(parts).encode())
    for folder in sorted(folders, key=lambda path: path.replace(here, ".")):
        for file in sorted(os.scandir(folder), key=lambda file: file.name):
            if file.is_file() and file.name.endswith((".c", ".cpp", ".h", ".o")):
                with open(file.path, "rb") as content:
                    digest = hashlib.sha256(content.read()).hexdigest()
                seal.update(f"\0{file.name}\0{digest}".encode())
    return seal.hexdigest()


def _files():
    """Regular files below the working directory with what changes when one is written."""
    paths = (os.path.join(folder, name) for folder, _, names in os.walk(".") for name in names)
    return {path: ((s := os.stat(path)).st_mtime_ns, s.st_size, s.st_ino) for path in paths}


def _read(name):
    with open(name, "rb") as file:
        return os.stat(name).st_mode, file.read()


def _write(entry, content):
    temporary = f"{entry}.{os.getpid()}"
    with open(temporary, "wb") as file:
        file.write(content)
    os.replace(temporary, entry)
    used = []
    for file in os.scandir(os.path.dirname(entry)):
        with suppress(FileNotFoundError):  # another process has removed the file
            if "." not in file.name:  # one that another process writes has its number
                used.append((file.stat().st_mtime, file.path))
    for _, old in sorted(used)[:-LIMIT]:
        with suppress(FileNotFoundError):
            os.unlink(old)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
