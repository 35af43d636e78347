"""The parser of the command line, and its completion in shells."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from kneexo.command_line import arguments
from kneexo.command_line.export import add_exports
from kneexo.command_line.new import add_new
from kneexo.command_line.outcome import Outcome
from kneexo.command_line.play import add_play
from kneexo.command_line.request import Request
from kneexo.command_line.single_runs import add_single_runs
from kneexo.command_line.studies import add_studies
from kneexo.command_line.utilities import add_utilities
from kneexo.command_line.view import add_view
from kneexo.errors import close_names, escaped, question, shortened, shown
from kneexo.studies.catalogue import STUDIES
from kneexo.version import __version__

LONGEST_LINE = 1200
"""Largest number of characters of a message on stderr. A longer message is shortened."""

EPILOG = """\
examples:
  kneexo reproduce --out results       every figure and number of the paper
  kneexo simulate --out run            the paper's default scenario
  kneexo simulate my.yaml --out run    a scenario of your own
  kneexo play --out knee.html --open   sliders and curves in the browser
  kneexo new my.yaml                   a short scenario file to change
  kneexo linearize --out margins       stability margins of the sampled loop
  kneexo study bandwidth --out speed   frequency response, small to large signal
  kneexo study robustness --out worst  worst cases over an uncertainty set
  kneexo study contest --out contest   sliding mode against PID, tuned alike
  kneexo size --out size               what a faster knee would take
  kneexo design --out linkage          a linkage for a wearer's knee
  kneexo fit log.csv my.yaml --out fit the scenario that fits a log
  kneexo diagram --out pictures        the block diagram
  kneexo export fmu --out knee.fmu     the controller for another simulator

Exit codes: 0 success, 2 wrong input or a run that failed (one line says why),
130 interrupted, 143 terminated.
"""
"""The examples below ``kneexo --help``."""

FILES = (".yaml", ".csv", ".html", ".fmu", ".json", ".py")
"""Ends of the metavars of arguments that are files, which a shell completes."""

RENAMED = {
    "bandwidth": "study bandwidth",
    "robustness": "study robustness",
    "cache": "setup cache",
    "completion": "setup completion",
}
"""Old names of commands, with the names that replace them."""


class _FirstHelpFormatter(argparse.RawDescriptionHelpFormatter, arguments.HelpFormatter):
    """Keeps the lines of description and examples."""


class _Parser(argparse.ArgumentParser):
    """A parser whose error messages are one line."""

    _words: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does. Keep the words for the message about a missing argument."""
        self._words = args or ()
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print a message on one line, which names the help, and exit with code 2.

        If a required argument is missing and another argument is misspelt, the message names the
        misspelt one.
        """
        if "are required" in message:
            for word in self._words:
                if word[:2] == "--" and not self._get_option_tuples(word) and word != "--":
                    message = _unknown_argument(word, self)
                    break
        line = shortened(escaped(message), LONGEST_LINE)
        self.exit(2, f"kneexo: {line}; see {self.prog} --help\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a command or choice that ``action`` does not have, and suggest the nearest."""
        if action.choices is not None and value not in action.choices:
            names = [str(choice) for choice in action.choices]
            line = f"{shown(value)!r} is unknown{question(close_names(str(value), names, most=1))}"
            raise argparse.ArgumentError(action, f"{line}; known: {', '.join(names)}")


def parsed(arguments: Sequence[str]) -> Request:
    """Return the request for the words after ``kneexo``. Exit with code 2 if a word is wrong."""
    parser = _parser()
    if arguments and (name := RENAMED.get(arguments[0])):
        parser.error(f"'kneexo {arguments[0]}' is now 'kneexo {name}'")
    request = Request()
    unknown = parser.parse_known_args(arguments, request)[1]
    if unknown:
        request.parser.error(_unknown_argument(unknown[0], request.parser))
    return request


def _unknown_argument(text: str, parser: argparse.ArgumentParser) -> str:
    """Return the message about an argument that the parser of a command does not know."""
    word = text.partition("=")[0]
    if word == "--resume":
        return "--resume is gone: a study always goes on from finished pieces without --restart"
    close = close_names(word, parser._option_string_actions, most=1)
    return f"{shown(word)}: unknown argument{question(close)}"


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="kneexo",
        description="Polycentric knee exoskeleton with electro-hydraulic actuator, on Drake:\n"
        "reproduces Lee et al. 2020 and simulates designs of your own.",
        epilog=EPILOG,
        formatter_class=_FirstHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kneexo {__version__}")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    reproduction, *studies = STUDIES.values()
    add_studies(subparsers, [reproduction])
    add_new(subparsers)
    add_single_runs(subparsers)
    add_studies(subparsers, studies)
    add_play(subparsers)
    add_view(subparsers)
    add_exports(subparsers)
    _add_completion(add_utilities(subparsers))
    return parser


def _add_completion(setup: Any) -> None:
    summary = "print what completes commands, options and files in a shell"
    parser = setup.add_parser(
        "completion",
        help=summary,
        description=f'{summary.capitalize()}: eval "$(kneexo setup completion bash)" in ~/.bashrc.',
        formatter_class=arguments.HelpFormatter,
    )
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="the shell")
    parser.set_defaults(run=completion, parser=parser, uses_drake=False)


def completion(request: Request) -> Outcome:
    """Return a script by which bash, zsh or tcsh completes commands, options and files."""
    import shtab

    parser = _parser()
    _complete_paths(parser, shtab.FILE, shtab.DIRECTORY)
    return Outcome(shtab.complete(parser, request.shell) + "\n")


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
        elif action.metavar == "RUN" or str(action.metavar).endswith(FILES):
            vars(action)["complete"] = file
