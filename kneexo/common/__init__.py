"""What all packages of kneexo use: results, plots, progress, files, code of the user."""

from importlib.resources import files
from pathlib import Path

PACKAGE = Path(str(files("kneexo")))
"""Folder of the package, found by its name, so that a file which moves finds the same folder."""
