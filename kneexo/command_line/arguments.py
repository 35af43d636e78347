"""Adds commands to the parser, and defines the arguments that several commands share."""

from __future__ import annotations

import argparse
import inspect
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from kneexo.command_line.html_page import ReportPage
from kneexo.command_line.outcome import Outcome, Request
from kneexo.errors import ParameterError, shown
from kneexo.files.table import NUMBER
from kneexo.studies.catalogue import PAPER
from kneexo.version import __version__

if TYPE_CHECKING:
    from kneexo.parameters import Scenario
    from kneexo.parameters.quantity import Parameters

_P = TypeVar("_P", bound="Parameters")


class HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Adds the default value to each help text, except the values None, False and empty list."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, False, []):
            return action.help
        return super()._get_help_string(action)


# --------------------------------------------------------------------- adding arguments


def add_command(
    group: Any,
    name: str,
    command: Callable[..., Outcome],
    summary: str,
    detail: str = "",
    **attributes: Any,
) -> argparse.ArgumentParser:
    """Add a command to a group of subparsers.

    Each parameter of ``command`` gets the parsed argument of the same name. ``choice`` gets a
    `ScenarioChoice`, and ``page`` a `ReportPage` or None. ``attributes`` are attributes of the
    `Request`. An attribute can be a function that computes the value from all parsed arguments.
    """
    parser: argparse.ArgumentParser = group.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}. {detail}".strip(),
        formatter_class=HelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.set_defaults(request=partial(_request, parser.prog, command, attributes))
    return parser


def _request(
    program: str,
    command: Callable[..., Outcome],
    attributes: dict[str, Any],
    options: argparse.Namespace,
) -> Request:
    """Return the request that runs a command with the parsed arguments ``options``.

    ``program`` is ``kneexo`` and the name of the command, such as ``kneexo export c``.
    """
    values = vars(options)
    path, texts = values.get("scenario"), values.get("values", ())
    choice = ScenarioChoice(path, texts, values.get("engine"))
    page = None
    if values.get("html"):
        changes = [f"--set={text}" for text in (*texts, *values.get("settings", ()))]
        words = program.split()
        name = f"{words[-1]}.html"
        page = ReportPage([*words, *([path] if path else []), *changes], options.out, name)
    values = values | {"choice": choice, "page": page}
    names = inspect.signature(command).parameters.keys() & values.keys()
    computed = {
        name: value(options) if callable(value) else value for name, value in attributes.items()
    }
    run = partial(command, **{name: values[name] for name in names})
    return Request(run, json=options.json, scenario=path, **computed)


def out(options: argparse.Namespace) -> Path:
    """Return the parsed argument of ``--out``. Serves as an attribute in `add_command`."""
    path: Path = options.out
    return path


def add_scenario(parser: argparse.ArgumentParser, default: str = PAPER) -> None:
    """Add the argument for a scenario file. Its help text says that ``default`` is the default."""
    parser.add_argument(
        "scenario",
        nargs="?",
        metavar="SCENARIO.yaml",
        help=f"scenario file; left out: {default}",
    )


def add_engine(parser: argparse.ArgumentParser) -> None:
    """Add ``--engine``, which chooses compiled equations or Drake's Simulator."""
    parser.add_argument(
        "--engine",
        choices=("compiled", "drake"),
        help="run on compiled equations, or through Drake's Simulator, a thousand times "
        "slower; left out: as the integrator in the scenario says",
    )


def add_set(parser: argparse.ArgumentParser, description: str, destination: str) -> None:
    """Add ``--set NAME=VALUE``. The parsed argument ``destination`` is the list of all texts."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest=destination,
        help=f"{description}. VALUE is YAML: 3, [1, 2]. May be given several times",
    )


def add_values(parser: argparse.ArgumentParser) -> None:
    """Add ``--set``, which changes values of the scenario."""
    example = "a value of the scenario, such as plant.cylinder.mass_kg=1.7, in place of the file's"
    add_set(parser, f"{example}; `kneexo params SCENARIO.yaml` lists them", "values")


def add_out(parser: argparse.ArgumentParser, files: str) -> None:
    """Add ``--out DIR``. ``files`` describes what the command writes to DIR, for the help text."""
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        required=True,
        help=f"directory for {files}; made when missing, files of the same name are replaced",
    )


def add_html(parser: argparse.ArgumentParser) -> None:
    """Add ``--html``, which requests the report as an HTML page too."""
    parser.add_argument(
        "--html",
        action="store_true",
        help="write the report as one HTML page too, with tables, pictures and scenario",
    )


def decimal(text: str) -> float:
    """Parse a finite decimal number. Refuse ``nan`` and ``1_0``, which `float` accepts."""
    if NUMBER.fullmatch(text) and math.isfinite(value := float(text)):
        return value
    raise argparse.ArgumentTypeError(f"{shown(text)!r} must be a finite number in the digits 0-9")


def integer(text: str) -> int:
    """Parse an integer of at most nine digits."""
    if re.fullmatch(r"[-+]?[0-9]{1,9}", text):
        return int(text)
    raise argparse.ArgumentTypeError(f"{shown(text)!r} must be an integer in the digits 0-9")


# -------------------------------------------------------------------- reading arguments


@dataclass(frozen=True)
class ScenarioChoice:
    """The scenario of a command, from a file or the default, with ``--set`` and ``--engine``."""

    path: str | None = None
    values: Sequence[str] = ()
    engine: Literal["compiled", "drake"] | None = None

    def load(self, default: Scenario | None = None) -> Scenario:
        """Return the scenario. Without a file, start from ``default`` (None: the paper's setup)."""
        from kneexo.parameters import Scenario
        from kneexo.parameters.scenario_file import load_scenario

        scenario = (default or Scenario()) if self.path is None else load_scenario(self.path)
        return with_values(scenario, self.values).with_engine(self.engine)


def with_values(parameters: _P, texts: Sequence[str]) -> _P:
    """Return changed parameters. ``texts`` are the arguments NAME=VALUE of ``--set``."""
    from kneexo.parameters.paths import changed
    from kneexo.parameters.scenario_file import read_value

    values = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator:
            raise ParameterError(f"--set {shown(text)}: must be NAME=VALUE")
        values[name] = read_value(f"--set {name}", value)
    return changed(parameters, values)


def origin_of(scenario: Scenario, settings: Parameters | None = None) -> dict[str, Any]:
    """Return the items that begin every JSON result: version of kneexo, scenario, settings."""
    origin = {"kneexo": __version__, "scenario": scenario.model_dump(mode="json")}
    return origin if settings is None else origin | {"settings": settings.model_dump(mode="json")}
