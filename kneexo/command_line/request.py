"""The request: a command with its arguments. The parser fills it, and the command reads it."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from kneexo.command_line.outcome import Outcome
from kneexo.common.progress import Stage
from kneexo.errors import (
    KneexoError,
    OutputError,
    PackageError,
    ParameterError,
    ScenarioError,
    WorkerError,
    shown,
)
from kneexo.version import __version__

if TYPE_CHECKING:
    from kneexo.parameters import Scenario
    from kneexo.parameters.fields.quantity import Parameters
    from kneexo.sweeps.checkpoint import Checkpoint

_P = TypeVar("_P", bound="Parameters")


class Request(argparse.Namespace):
    """A command with its arguments.

    The parser sets an attribute for each argument of the command. Listed here are the arguments
    that this class and the delivery read. `kneexo.command_line.delivery.deliver` runs a request
    once, and notes here what an interrupt would leave.
    """

    run: Callable[[Request], Outcome]
    """The function of the command."""
    parser: argparse.ArgumentParser
    """The parser of the command."""
    uses_drake: bool = True
    """Whether the command always imports Drake."""
    fills_directory: bool = False
    """Whether `out` is the directory for the files and figures of the outcome."""
    first: Callable[[Request], Request | None] = staticmethod(lambda request: None)
    """Returns a smaller request, whose outcome is written as a first answer, or None without one.

    The finished pieces of the smaller request stay, because this request needs them too.
    """
    first_answer: str = ""
    """Of what a smaller request is the answer, such as ``samples=50``. Empty: of everything."""
    stages: Sequence[Stage] = ()
    """The parts of the progress bar of the whole command, or nothing for no such bar."""
    resumable: bool = False
    """Whether the command keeps its finished pieces until its results are written."""

    json: bool = False
    """Whether to print the results as JSON."""
    scenario: str | None = None
    """Path of the scenario file, or None without a file. Error messages begin with the path."""
    preset: str | None = None
    """Name of the preset from which the scenario starts, or None."""
    law: str | None = None
    """The control law in place of that of the scenario, FILE.py:NAME, or None."""
    engine: Literal["compiled", "drake"] | None = None
    """The engine in place of that of the scenario, or None."""
    values: Sequence[str] = ()
    """Changes of the scenario, each NAME=VALUE."""
    settings: Sequence[str] = ()
    """Changes of the settings of a study, each NAME=VALUE."""
    out: Path
    """The file or directory of the results, if the command has ``--out``."""
    browser: bool = False
    """Whether the browser opens the page that is written to `out`."""

    checkpoint: Checkpoint | None = None
    """The finished pieces, from when the command opens their file."""
    unused_pieces: int = 0
    """Number of finished pieces of other settings, which stay in the file."""
    written: bool = False
    """Whether the results are written."""
    answered: str = ""
    """The ``first_answer`` of the smaller request, as soon as its results are written."""

    @property
    def command(self) -> str:
        """The name of the command, without that of its group."""
        return self.parser.prog.split()[-1]

    @property
    def title(self) -> str:
        """The words of the command and of the arguments that change its results."""
        changes = [f"--preset={self.preset}"] if self.preset else []
        changes += [f"--law={self.law}"] if self.law else []
        changes += [f"--set={text}" for text in (*self.values, *self.settings)]
        scenario = [self.scenario] if self.scenario else []
        return shlex.join([*self.parser.prog.split(), *scenario, *changes])

    @property
    def checkpoint_path(self) -> Path | None:
        """The file of the finished pieces, or None if the command keeps none."""
        return self.out / f"{self.command}.checkpoint.jsonl" if self.resumable else None

    def load(
        self, path: str | None, default: Scenario | None = None, *, runs_law: bool = True
    ) -> Scenario:
        """Return the scenario of the file ``path``, changed by the arguments.

        Without a file and a preset, start from ``default`` (None: the paper's setup). If the
        scenario file names a law in a file of Python, this file is imported unless ``runs_law`` is
        False. A line on stderr names the file whose code runs.
        """
        from kneexo.parameters import Scenario
        from kneexo.parameters.presets import with_preset
        from kneexo.parameters.scenario_file import load_scenario

        if self.preset is not None:
            with _argument():
                with_preset(self.preset, {})
        if path is not None:
            scenario = load_scenario(path, self.preset, without_law=self.law is not None)
        elif self.preset is not None:
            scenario = Scenario.preset(self.preset)
        else:
            scenario = default or Scenario()
        if self.law is not None:
            with _argument():
                scenario = scenario.with_law(self.law)
        scenario = with_values(scenario, self.values)
        if self.law is not None and scenario.controller.kind != "law":
            raise ParameterError(
                f"--law: --set replaces the law by controller.kind = {scenario.controller.kind}; "
                f"leave out one of them"
            )
        scenario = scenario.with_engine(self.engine)
        for code in scenario.users_code().values():
            if runs_law or code.is_loaded:
                file = shown(code.short_name.rpartition(":")[0])
                sys.stderr.write(f"kneexo: runs Python of {file}\n")
                scenario = scenario.with_loaded_law()
        return scenario


@contextmanager
def _argument() -> Iterator[None]:
    """Context manager: put ``--`` before an error that begins with the name of an argument."""
    try:
        yield
    except ParameterError as error:
        raise ParameterError(f"--{error}") from None


def with_values(parameters: _P, texts: Sequence[str]) -> _P:
    """Return changed parameters. ``texts`` are the arguments NAME=VALUE of ``--set``."""
    from kneexo.parameters.scenario_file import read_value

    values = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator or not name:
            raise ParameterError(f"--set {shown(text)}: must be NAME=VALUE")
        values[name] = read_value(f"--set {name}", value)
    if not values:
        return parameters
    try:
        return parameters.changed(values)
    except ParameterError as error:
        line = str(error).removeprefix(f"{type(parameters).__name__}: ")
        place = re.split("[ =:]", line, maxsplit=1)[0]
        if not any(f"{place}.".startswith(f"{name}.") for name in values):
            line = f"{shown(', '.join(values))}: {line}"
        raise ParameterError(f"--set {line}") from None


def origin_of(scenario: Scenario, settings: Parameters | None = None) -> dict[str, Any]:
    """Return the items that begin every JSON result: version of kneexo, scenario, settings.

    The scenario has explicit duration and polynomials, also where its user left them out.
    """
    from kneexo.geometry.rod_polynomial import completed

    origin = {"kneexo": __version__, "scenario": completed(scenario).model_dump(mode="json")}
    return origin if settings is None else origin | {"settings": settings.model_dump(mode="json")}


@contextmanager
def named_in_errors(path: str | None) -> Iterator[None]:
    """Context manager: put ``path``, the scenario file, before the message of an error.

    The message stays as it is if it begins with an argument such as ``--set``, or if the scenario
    cannot be the cause, for example because an output cannot be written.
    """
    try:
        yield
    except KneexoError as error:
        elsewhere = isinstance(error, ScenarioError | OutputError | PackageError | WorkerError)
        named = shown(path) in str(error) or str(error).startswith("--")
        if path and not elsewhere and not named:
            error.args = (f"{shown(path)}: {error}",)
        raise
