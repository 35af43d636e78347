"""Command line of kneexo (``kneexo --help``): its parser, its exit codes and lines on stderr."""

from __future__ import annotations

import argparse
import codecs
import io
import json
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from kneexo import system
from kneexo.command_line import commands
from kneexo.errors import KneexoError, WorkerError, escaped, shortened, shown
from kneexo.files.table import NUMBER
from kneexo.interruption import Terminated, interrupt_later, sigterm_raises
from kneexo.studies.catalogue import PAPER, STUDIES, Study
from kneexo.user_code import cause_of, place_in_user_code
from kneexo.version import __version__

FIRST_STEPS = """\
kneexo simulates a polycentric knee exoskeleton with electro-hydraulic actuator. Try:

  kneexo view --out knee.html          a knee that moves, in a browser
  kneexo simulate --out run            how well it follows its reference
  kneexo reproduce --out results       every figure and number of the paper

kneexo --help lists all commands.
"""
"""What ``kneexo`` without arguments prints."""

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


_LONGEST_LINE = 1200
"""Largest number of characters of a message."""


class _Parser(argparse.ArgumentParser):
    """A parser whose error messages escape and shorten the arguments that they quote."""

    def error(self, message: str) -> NoReturn:
        """Print usage and message, and exit with code 2."""
        super().error(shortened(escaped(message), _LONGEST_LINE))


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Shows the defaults that tell something."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, False, []):
            return action.help
        return super()._get_help_string(action)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    # Before numpy is there: on matrices as small as ours, threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Before Matplotlib is there: it refuses a name that it does not know, and we only write files.
    os.environ["MPLBACKEND"] = "Agg"
    if matplotlib := sys.modules.get("matplotlib"):
        matplotlib.use("Agg")
    codecs.register_error("kneexo", _escaped)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="kneexo")
    with sigterm_raises():
        options = argparse.Namespace()
        try:
            try:
                return _run(options, arguments)
            except Exception as error:  # of any library: an interrupt may be behind it
                if (interrupt := _interrupt_behind(error)) is None:
                    raise
                raise interrupt from None
            finally:
                if sys.stdout is not None:  # None when it was closed
                    sys.stdout.flush()
        except KeyboardInterrupt as interrupt:
            return _interrupted(interrupt, options)
        except ImportError as error:
            library, unloaded, _ = str(error).partition(": cannot open shared object file")
            if not unloaded:
                raise
            return _fail(f"this system lacks {library}; install the package that has it")
        except OSError as error:
            if sys.stdout is not None:  # what it still holds would fail again at exit
                with suppress(OSError):  # a stream without a file descriptor
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            if isinstance(error, BrokenPipeError):  # the reader went away, as with `| head`
                return 0
            with suppress(OSError):
                where = f"{shown(error.filename)}: " if error.filename else ""
                _fail(f"{where}{error.strerror or error}")
            return 2


def _fail(line: str, code: int = 2) -> int:
    """Print one line on stderr; returns the exit code."""
    print(_one_line(line), end="", file=sys.stderr)
    return code


def _interrupt_behind(error: BaseException) -> KeyboardInterrupt | None:
    """The interrupt that caused an error: extension modules put another error in its place.

    Some, such as pydantic's, keep no more of it than its name in their text.
    """
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return cause
        for interrupt in (KeyboardInterrupt, Terminated):
            if f"{interrupt.__name__}:" in str(cause):
                return interrupt()
        cause = cause.__cause__ or cause.__context__
    return None


def _interrupted(interrupt: KeyboardInterrupt, options: argparse.Namespace) -> int:
    if isinstance(interrupt, Terminated):
        return _fail(f"terminated; {commands.left(options)}", 143)
    return _fail(f"interrupted; {commands.left(options)}", 130)


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """Characters that a stream's encoding lacks, as JSON writes them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


def _run(options: argparse.Namespace, arguments: Sequence[str] | None) -> int:
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments:
        print(FIRST_STEPS, end="")
        return 0
    _parser().parse_args(arguments, options)
    if _needs_drake(options):
        if line := system.lacking():  # Drake itself would print a page
            return _fail(line)
        with interrupt_later():  # Drake would print a page about an interrupt of its first import
            import pydrake  # noqa: F401  (for that alone)
    format_before = warnings.formatwarning
    warnings.formatwarning = _one_line
    try:
        options.run(options)
    except KneexoError as error:
        scenario = shown(getattr(options, "scenario", None) or "")
        where = f"{scenario}: " if scenario and scenario not in str(error) else ""
        pieces = commands.kept(options) if isinstance(error, WorkerError) else ""
        return _fail(f"{where}{error}{pieces and f'; {pieces}'}")
    except MemoryError:
        workers = ", or the processes with --workers" if hasattr(options, "workers") else ""
        return _fail(f"out of memory; reduce simulation.duration_s{workers}")
    except (Exception, SystemExit) as error:
        of_user = isinstance(error, SystemExit) or place_in_user_code(error) is not None
        if not of_user or isinstance(error, OSError | ImportError) or _interrupt_behind(error):
            raise
        return _fail(f"{cause_of(error)}; correct that code")
    finally:
        warnings.formatwarning = format_before
    return 0


def _needs_drake(options: argparse.Namespace) -> bool:
    """Whether a command imports Drake; of `params`, only the list of all settings does."""
    if options.command == "params":
        return not (options.scenario or options.yaml or options.schema)
    return options.command not in ("cache", "completion")


def _one_line(message: Warning | str, *_: Any, **__: Any) -> str:
    return f"kneexo: {shortened(escaped(str(message)), _LONGEST_LINE)}\n"


# ----------------------------------------------------------------------------------- parser


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
    _add_studies(subparsers, [reproduction])
    _add_single_runs(subparsers)
    _add_studies(subparsers, studies)
    _add_view(subparsers)
    _add_exports(subparsers)
    _add_utilities(subparsers)
    return parser


def _add_studies(subparsers: Any, studies: Iterable[Study]) -> None:
    groups = {"": subparsers}
    for study in studies:
        group, _, name = study.command.rpartition(" ")
        if group not in groups:
            what = "compare controllers, or the full order with the reduced one"
            sub = subparsers.add_parser(group, help=what, formatter_class=_HelpFormatter)
            groups[group] = sub.add_subparsers(title="studies", required=True, metavar="STUDY")
        run = partial(commands.sweep, study)
        sub = _command(groups[group], name, run, study.summary, study.detail)
        if study.setup:
            _add_scenario(sub, study.setup)
        _add_engine(sub)
        _add_out(sub, "figures (PNG, PDF), results (JSON) and report (Markdown)")
        _add_html(sub)
        label = study.label or study.command
        listed = f"`kneexo params` lists them with their defaults after '{label}:'"
        _add_set(sub, f"a setting, by its dotted name; {listed}", "settings")
        if study.uncertain:
            sub.add_argument(
                "--uncertainty",
                metavar="FILE.yaml",
                help="values by dotted path, each {low, high, scale} or {options}; left out: the "
                "default set (see `kneexo params`)",
            )
        where = sub.add_mutually_exclusive_group()
        where.add_argument(
            "--workers", type=_integer, metavar="N", help="processes; left out: one for each core"
        )
        where.add_argument(
            "--dask",
            metavar="tcp://HOST:PORT",
            help="run on the workers of this Dask cluster instead; they need the same version of "
            "kneexo (pip install 'kneexo[cluster]')",
        )
        if study.resumable:
            _add_restart(sub)


def _add_single_runs(subparsers: Any) -> None:
    sub = _command(subparsers, "simulate", commands.simulate, "run one scenario")
    _add_scenario(sub)
    _add_engine(sub)
    _add_values(sub)
    _add_out(sub, "signals.csv, metrics.json, scenario.yaml and tracking.png, .pdf")
    _add_html(sub)

    sub = _command(
        subparsers,
        "linearize",
        commands.linearize,
        "poles, margins and small-signal bandwidths of plant and sampled loop",
        "At a posture; the quantizer is bypassed.",
    )
    _add_scenario(sub)
    _add_values(sub)
    sub.add_argument(
        "--knee-angle",
        type=_decimal,
        default=40.0,
        metavar="DEG",
        help="posture, knee angle in deg",
    )
    _add_out(sub, "linearization.json; loop, nyquist and poles as PNG and PDF")
    _add_html(sub)


def _add_view(subparsers: Any) -> None:
    sub = _command(
        subparsers,
        "view",
        commands.view,
        "show runs in three dimensions: an HTML page with a time slider",
        "The page is one file that any browser opens, without network. Several runs stand beside "
        "each other. The cylinder's colour is its pressure, the grey shank is the reference.",
    )
    sub.add_argument(
        "runs",
        nargs="*",
        metavar="RUN",
        help=f"scenario files to run, or directories that `kneexo simulate` wrote; left out: "
        f"{PAPER}",
    )
    _add_values(sub)
    sub.add_argument(
        "--out",
        metavar="FILE.html",
        type=Path,
        required=True,
        help="the page; replaces a page of an earlier view",
    )
    sub.add_argument("--open", action="store_true", help="show the page in this system's browser")


def _add_exports(subparsers: Any) -> None:
    what = "write the controller, the plant or the closed loop for use outside Python"
    group = subparsers.add_parser("export", help=what, formatter_class=_HelpFormatter)
    forms = group.add_subparsers(title="forms", required=True, metavar="FORM")
    sub = _command(
        forms,
        "c",
        commands.export_c,
        "write C99 for a microcontroller",
        "With the parameters as one struct, test vectors from the compiled closed loop, a harness "
        "that replays them, Makefile, CMakeLists.txt and a README that shows how to call it.",
    )
    _add_target(sub, "encoder count")
    sub.add_argument(
        "--precision", choices=("double", "float"), default="double", help="type of all numbers"
    )
    sub.add_argument(
        "--look-up",
        action="store_true",
        help="take what depends on the encoder count alone from a table: faster, and more exact "
        "in float; the parameters behind it are fixed then",
    )
    sub.add_argument(
        "--vectors-s", type=_decimal, metavar="S", help="time of the test vectors in s; left out: 2"
    )
    _add_out(sub, "the files, which no other files may share")

    sub = _command(
        forms,
        "fmu",
        commands.export_fmu,
        "write a functional mock-up unit for co-simulation in other simulators",
        "With C sources and, where there is a C compiler, the binary of this machine. Numbers of "
        "the scenario are parameters of the FMU.",
    )
    _add_target(sub, "encoder reading (rad)")
    sub.add_argument(
        "--fmi", type=_integer, choices=(2, 3), default=3, help="version of the FMI standard"
    )
    sub.add_argument(
        "--out",
        metavar="FILE.fmu",
        type=Path,
        required=True,
        help="file, or directory for knee_controller.fmu, knee_plant.fmu or knee_loop.fmu; an "
        "FMU that kneexo made is replaced",
    )


def _add_target(sub: argparse.ArgumentParser, measured: str) -> None:
    _add_scenario(sub)
    _add_values(sub)
    sub.add_argument(
        "--what",
        choices=("controller", "plant", "loop"),
        default="controller",
        help=f"the controller, from {measured} and knee reference to motor speed command; the "
        "plant with its encoder; or both as closed loop",
    )
    sub.add_argument(
        "--step-s",
        type=_decimal,
        metavar="S",
        help="largest step of RK4 of plant and loop in s; left out: from the plant's fastest mode, "
        "at most 0.0002",
    )


def _add_utilities(subparsers: Any) -> None:
    sub = _command(
        subparsers,
        "params",
        commands.params,
        "list every parameter with value, unit, range and provenance",
        "Without a scenario file also the settings of all studies. With --schema, editors complete "
        "and check scenario files: save the schema as kneexo.schema.json and begin a file with "
        "the line '# yaml-language-server: $schema=kneexo.schema.json'.",
    )
    _add_scenario(sub)
    form = sub.add_mutually_exclusive_group()
    form.add_argument("--yaml", action="store_true", help="print a complete scenario file instead")
    form.add_argument(
        "--schema", action="store_true", help="print the JSON schema of scenario files instead"
    )

    sub = _command(
        subparsers,
        "diagram",
        commands.diagram,
        "draw the block diagram of a scenario",
        "Always writes closed_loop.dot; also SVG and PNG when Graphviz is installed.",
    )
    _add_scenario(sub)
    _add_out(sub, "closed_loop.dot, .svg and .png")

    sub = _command(
        subparsers,
        "cache",
        commands.cache,
        "show or delete the compiled models that are kept on disk",
        "They stand in KNEEXO_CACHE_DIR, else in kneexo below XDG_CACHE_HOME, else in "
        "~/.cache/kneexo. KNEEXO_CACHE_SIZE_MB limits their total size in MiB; left out: 512.",
    )
    sub.add_argument("--clear", action="store_true", help="delete all of them")

    what = "print what completes commands, options and files in a shell"
    sub = subparsers.add_parser(
        "completion",
        help=what,
        description=f'{what.capitalize()}: eval "$(kneexo completion bash)" in ~/.bashrc.',
        formatter_class=_HelpFormatter,
    )
    sub.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="the shell")
    sub.set_defaults(run=_print_completion, command="completion")


def _print_completion(options: argparse.Namespace) -> None:
    import shtab

    parser = _parser()
    _complete_paths(parser, shtab.FILE, shtab.DIRECTORY)
    print(shtab.complete(parser, options.shell))


def _complete_paths(parser: argparse.ArgumentParser, file: object, directory: object) -> None:
    """Tell `shtab` what completes the options and arguments that are files or directories."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                _complete_paths(sub, file, directory)
        elif action.metavar == "DIR":
            vars(action)["complete"] = directory
        elif action.metavar == "RUN" or str(action.metavar).endswith((".yaml", ".html", ".fmu")):
            vars(action)["complete"] = file


def _decimal(text: str) -> float:
    """Return a finite number. `float` also accepts nan, ``1_0`` and digits of other scripts."""
    if NUMBER.fullmatch(text) and math.isfinite(value := float(text)):
        return value
    raise argparse.ArgumentTypeError(f"{shown(text)!r} must be a finite number in the digits 0-9")


def _integer(text: str) -> int:
    if re.fullmatch(r"[-+]?[0-9]{1,9}", text):
        return int(text)
    raise argparse.ArgumentTypeError(f"{shown(text)!r} must be an integer in the digits 0-9")


def _command(
    group: Any, name: str, run: Callable[..., None], text: str, detail: str = ""
) -> argparse.ArgumentParser:
    sub: argparse.ArgumentParser = group.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}. {detail}".strip(),
        formatter_class=_HelpFormatter,
    )
    sub.add_argument("--json", action="store_true", help="print the result as JSON")
    sub.set_defaults(run=run, command=name)
    return sub


def _add_html(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--html",
        action="store_true",
        help="write the report as one HTML page too, with tables, pictures and scenario",
    )


def _add_out(sub: argparse.ArgumentParser, files: str) -> None:
    sub.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        required=True,
        help=f"directory for {files}; made when missing, files of the same name are replaced",
    )


def _add_scenario(sub: argparse.ArgumentParser, default: str = PAPER) -> None:
    sub.add_argument(
        "scenario",
        nargs="?",
        metavar="SCENARIO.yaml",
        help=f"scenario file; left out: {default}",
    )


def _add_engine(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--engine",
        choices=("compiled", "drake"),
        help="run on compiled equations, or through Drake's Simulator, a thousand times "
        "slower; left out: as the integrator in the scenario says",
    )


def _add_set(sub: argparse.ArgumentParser, what: str, dest: str) -> None:
    sub.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest=dest,
        help=f"{what}. VALUE is YAML: 3, [1, 2]. May be given several times",
    )


def _add_values(sub: argparse.ArgumentParser) -> None:
    what = "a value of the scenario, such as plant.cylinder.mass_kg=1.7, in place of the file's"
    _add_set(sub, f"{what}; `kneexo params SCENARIO.yaml` lists them", "values")


def _add_restart(sub: argparse.ArgumentParser) -> None:
    before = sub.add_mutually_exclusive_group()
    before.add_argument(
        "--resume",
        action="store_true",
        help="go on from the finished pieces that an interrupted run left in the directory; "
        "always so without --restart",
    )
    before.add_argument(
        "--restart", action="store_true", help="delete these finished pieces and begin anew"
    )
