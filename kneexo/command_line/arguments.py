"""Adds commands to the parser, and defines the arguments that several commands share."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from kneexo.command_line.outcome import Outcome
from kneexo.command_line.request import Request
from kneexo.common.files.table import NUMBER
from kneexo.common.progress import line_width
from kneexo.errors import shown

PAPER = "the paper's setup (see `kneexo params`)"
"""Description of the default `Scenario` in the help of the commands."""


class HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Adds the default value to each help text, except the values None, False and empty list.

    A line has `line_width` characters, which is at most 100.
    """

    def __init__(self, prog: str, **options: Any) -> None:
        super().__init__(prog, **{"width": line_width()} | options)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, False, []):
            return action.help
        return super()._get_help_string(action)


def add_command(
    group: Any,
    name: str,
    command: Callable[[Request], Outcome],
    summary: str,
    detail: str = "",
    duration_s: float = 1.0,
    **attributes: Any,
) -> argparse.ArgumentParser:
    """Add a command to a group of subparsers.

    ``attributes`` are attributes of the `Request` that ``command`` gets, besides the arguments.
    The help names ``duration_s``, the typical duration in s on two cores.
    """
    duration = f"Takes about {rounded(duration_s)} on two cores."
    parser: argparse.ArgumentParser = group.add_parser(
        name,
        help=summary,
        description=" ".join(
            filter(None, (f"{summary[0].upper()}{summary[1:]}.", detail, duration))
        ),
        formatter_class=HelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.set_defaults(run=command, parser=parser, **attributes)
    return parser


def rounded(duration_s: float) -> str:
    """Return a duration as text: seconds below 1.5 minutes, minutes below 1.5 hours, else hours."""
    for unit_s, unit in ((1.0, "s"), (60.0, "min")):
        if duration_s < 90.0 * unit_s:
            return f"{max(duration_s / unit_s, 1.0):.0f} {unit}"
    return f"{duration_s / 3600.0:.0f} h"


def add_group(subparsers: Any, name: str, summary: str, metavar: str) -> Any:
    """Add a group of commands, such as ``export``, and return the subparsers of its commands.

    ``metavar`` stands for the name of a command in the usage line of the group.
    """
    parser = subparsers.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        formatter_class=HelpFormatter,
    )
    return parser.add_subparsers(title="commands", required=True, metavar=metavar)


def add_scenario(parser: argparse.ArgumentParser, default: str = PAPER) -> None:
    """Add the argument for a scenario file. The help text describes the ``default`` scenario."""
    parser.add_argument(
        "scenario",
        nargs="?",
        metavar="SCENARIO.yaml",
        help=f"scenario file; left out: {default}",
    )
    add_preset(parser)
    add_law(parser)


def add_law(parser: argparse.ArgumentParser) -> None:
    """Add ``--law``, which replaces the control law of the scenario."""
    parser.add_argument(
        "--law",
        metavar="FILE.py:NAME",
        help="a control law of yours in place of that of the scenario: a Python function such as "
        "def law(rod_extension, rod_reference), or a Drake system (docs/your_controller.md)",
    )


def add_preset(parser: argparse.ArgumentParser) -> None:
    """Add ``--preset``, the scenario that a scenario file and ``--set`` change."""
    parser.add_argument(
        "--preset",
        metavar="NAME",
        help="scenario to start from: paper (no gravity, reduced order), bench (weight of the "
        "shank, drive on its bus), leg (bench, and the full order of the cylinder with friction), "
        "wearer (leg, and a wearer with zero-torque control) or protected (leg, and protection "
        "against faults)",
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
        type=place,
        required=True,
        help=f"directory for {files}; made when missing, files of the same name are replaced",
    )


def add_page(parser: argparse.ArgumentParser) -> None:
    """Add ``--out FILE.html`` and ``--open``, which writes a page and shows it in a browser."""
    parser.add_argument(
        "--out",
        metavar="FILE.html",
        type=place,
        required=True,
        help="file of the page; an earlier file is replaced",
    )
    parser.add_argument(
        "--open", dest="browser", action="store_true", help="show the page in this system's browser"
    )


def add_html(parser: argparse.ArgumentParser) -> None:
    """Add ``--html``, which requests the report as an HTML page too."""
    parser.add_argument(
        "--html",
        action="store_true",
        help="write the report as one HTML page too, with tables, pictures and scenario",
    )


def place(text: str) -> Path:
    """Parse the path of a file or directory. Refuse the empty text, which ``Path`` accepts."""
    if text:
        return Path(text)
    raise argparse.ArgumentTypeError("is empty; must be a path, such as results")


def decimal(text: str) -> float:
    """Parse a finite decimal number. Refuse ``nan`` and ``1_0``, which `float` accepts."""
    if NUMBER.fullmatch(text) and math.isfinite(value := float(text)):
        return value
    raise argparse.ArgumentTypeError(
        f"{shown(text)!r} must be a finite number in the digits 0-9, without unit"
    )


def integer(text: str) -> int:
    """Parse an integer of at most nine digits."""
    if re.fullmatch(r"[-+]?[0-9]{1,9}", text):
        return int(text)
    raise argparse.ArgumentTypeError(f"{shown(text)!r} must be an integer in the digits 0-9")
