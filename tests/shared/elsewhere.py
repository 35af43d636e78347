"""Modules of files that no package holds."""

import importlib.util
import sys


def module_of(name, path):
    """The module of a file."""
    spec = importlib.util.spec_from_file_location(name, path)
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]
