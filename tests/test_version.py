"""The version of the package, against the metadata of the installed one."""

import importlib.metadata

import kneexo
from kneexo.version import __version__


def test_the_installed_package_has_this_version():
    assert importlib.metadata.version("kneexo") == __version__
    assert kneexo.__version__ is __version__
