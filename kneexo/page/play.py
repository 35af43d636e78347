"""Makes the page to play with for a notebook or a script."""

from __future__ import annotations

import os
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from os import PathLike
from pathlib import Path

from diagramc import write_files
from kneexo.errors import OutputError, ParameterError, shown
from kneexo.page.playground import playground_page
from kneexo.parameters import Scenario
from kneexo.parameters.presets import PRESETS
from kneexo.parameters.scenario_file import as_scenario
from kneexo.view.web_page import require_page_name


@dataclass(frozen=True)
class Playground:
    """A page on which closed loops run in the browser. A notebook shows the page in its cell."""

    names: tuple[str, ...]
    """Names of the scenarios on the page."""
    html: str = field(repr=False)
    """Text of the page, which needs no network and no other file."""
    height_px: int = 900
    """Height of the frame in a notebook, in CSS pixels."""

    def _repr_html_(self) -> str:
        """Return a frame with the page. Scripts of the page cannot reach the notebook."""
        return (
            f'<iframe srcdoc="{escape(self.html)}" title="{escape(", ".join(self.names))}" '
            f'sandbox="allow-scripts allow-downloads" allow="clipboard-write" width="100%" '
            f'height="{self.height_px}" style="border: 0"></iframe>'
        )

    def write(self, path: str | PathLike[str]) -> Path:
        """Write the page to a file, replace an earlier file, and return the path.

        Raises `OutputError` if the name does not end in .html, or if the file cannot be written.
        """
        path = Path(path)
        require_page_name(path)
        write_files(path.parent, {path.name: self.html}, f"file {shown(path)}")
        return path

    def open(self) -> Path:
        """Write the page to a temporary file, show the file in the browser, and return the path.

        Raises `OutputError` if this system has no browser. The message has the path of the file.
        """
        handle, name = tempfile.mkstemp(prefix="kneexo-", suffix=".html")
        os.close(handle)
        path = self.write(name)
        if not webbrowser.open(path.as_uri()):
            raise OutputError(f"no browser here; {shown(path)} has the page, open it elsewhere")
        return path


def play(
    scenario: Scenario | str | PathLike[str] = Scenario(),
    *others: Scenario | str | PathLike[str],
    names: Sequence[str] = (),
) -> Playground:
    """Make a page on which the closed loops of scenarios run in the browser.

    Sliders change the values, and curves, metrics, margins and the moving leg follow. In a notebook
    the result shows the page in its cell. ``write(path)`` writes the page to a file, ``open()``
    shows the page in the browser. The command ``kneexo play`` makes the same page.

    Parameters
    ----------
    scenario
        A scenario, or the path of a scenario file.
    others
        More scenarios or paths. The page compares two scenarios at a time.
    names
        Names of all scenarios on the page. Empty: a scenario is called by its file, its preset or
        its number.

    Raises
    ------
    ParameterError
        ``names`` has not a name for each scenario, there are more scenarios than
        `MOST_SCENARIOS`, or a scenario has a control law in Python.
    CompilationError
        The page needs a WebAssembly module that kneexo does not contain, and Zig, which compiles
        the module, is not installed. The message has the command that installs Zig.

    Examples
    --------
    >>> import kneexo as kx
    >>> page = kx.play(kx.Scenario.preset("paper"))
    >>> page.write("knee.html")
    PosixPath('knee.html')
    """
    given = (scenario, *others)
    scenarios = [as_scenario(item) for item in given]
    if names and len(names) != len(given):
        raise ParameterError(
            f"names: {len(names)} names for {len(given)} scenarios; must be one for each"
        )
    shown_names = tuple(names) or tuple(_name(item, number) for number, item in enumerate(given, 1))
    return Playground(shown_names, playground_page(scenarios, shown_names))


def _name(item: Scenario | str | PathLike[str], number: int) -> str:
    if not isinstance(item, Scenario):
        return Path(item).stem
    presets = (f"preset {name}" for name in PRESETS if Scenario.preset(name) == item)
    return next(presets, f"scenario {number}")
