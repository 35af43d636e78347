"""The parser of the command line, and its completion in shells."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from typing import Any, NoReturn

from kneexo.command_line import arguments
from kneexo.command_line.export import add_exports
from kneexo.command_line.outcome import Outcome, Request
from kneexo.command_line.single_runs import add_single_runs
from kneexo.command_line.studies import add_studies
from kneexo.command_line.utilities import add_utilities
from kneexo.command_line.view import add_view
from kneexo.errors import escaped, shortened
from kneexo.studies.catalogue import STUDIES
from kneexo.version import __version__

LONGEST_LINE = 1200
"""Largest number of characters of a message on stderr. A longer message is shortened."""

EPILOG = """\
examples:
  kneexo reproduce --out results       every figure and number of the paper
  kneexo simulate --out run            the paper's default scenario
  kneexo simulate my.yaml --out run    a scenario of your own
  kneexo params --yaml > my.yaml       a complete scenario file to edit
  kneexo linearize --out margins       stability margins of the sampled loop
  kneexo bandwidth --out response      frequency response, small to large signal
  kneexo robustness --out robust       worst cases over an uncertainty set
  kneexo study contest --out contest   sliding mode against PID, tuned alike
  kneexo size --out size               what a faster knee would take
  kneexo diagram --out pictures        the block diagram
  kneexo export fmu --out knee.fmu     the controller for another simulator

Exit codes: 0 success, 2 wrong input or a run that failed (one line says why),
130 interrupted, 143 terminated.
"""
"""The examples below ``kneexo --help``."""


class _Parser(argparse.ArgumentParser):
    """A parser whose error messages quote arguments escaped and shortened."""

    def error(self, message: str) -> NoReturn:
        """Print usage and message, and exit with code 2."""
        super().error(shortened(escaped(message), LONGEST_LINE))


def parsed(arguments: Sequence[str]) -> Request:
    """Return the request for the words after ``kneexo``. Exit with code 2 if a word is wrong."""
    options = _parser().parse_args(arguments)
    request: Request = options.request(options)
    return request


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="kneexo",
        description="Polycentric knee exoskeleton with electro-hydraulic actuator, on Drake: "
        "reproduces Lee et al. 2020 and simulates designs of your own.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kneexo {__version__}")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    reproduction, *studies = STUDIES.values()
    add_studies(subparsers, [reproduction])
    add_single_runs(subparsers)
    add_studies(subparsers, studies)
    add_view(subparsers)
    add_exports(subparsers)
    add_utilities(subparsers)
    _add_completion(subparsers)
    return parser


def _add_completion(subparsers: Any) -> None:
    summary = "print what completes commands, options and files in a shell"
    parser = subparsers.add_parser(
        "completion",
        help=summary,
        description=f'{summary.capitalize()}: eval "$(kneexo completion bash)" in ~/.bashrc.',
        formatter_class=arguments.HelpFormatter,
    )
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="the shell")
    parser.set_defaults(
        request=lambda options: Request(partial(completion, options.shell), uses_drake=False)
    )


def completion(shell: str) -> Outcome:
    """Return a script by which bash, zsh or tcsh completes commands, options and files."""
    import shtab

    parser = _parser()
    _complete_paths(parser, shtab.FILE, shtab.DIRECTORY)
    return Outcome(shtab.complete(parser, shell) + "\n")


def _complete_paths(parser: argparse.ArgumentParser, file: object, directory: object) -> None:
    """Mark the arguments of a parser and its subparsers whose values are files or directories.

    `shtab` reads the marks ``file`` and ``directory``.
    """
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                _complete_paths(sub, file, directory)
        elif action.metavar == "DIR":
            vars(action)["complete"] = directory
        elif action.metavar == "RUN" or str(action.metavar).endswith((".yaml", ".html", ".fmu")):
            vars(action)["complete"] = file
