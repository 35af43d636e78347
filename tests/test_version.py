"""The version of the package, against the metadata of the installed one."""

import importlib.metadata
import re

import kneexo
from kneexo.version import __version__


def test_the_installed_package_has_this_version():
    assert importlib.metadata.version("kneexo") == __version__
    assert kneexo.__version__ is __version__


def test_the_version_has_three_numbers():
    assert re.fullmatch(r"\d+\.\d+\.\d+", __version__)
