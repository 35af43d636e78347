"""Runs the command line. Each failure gives an exit code and one line on stderr."""

from __future__ import annotations

import codecs
import io
import json
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from kneexo.command_line.delivery import deliver, interrupt_notice, pieces_notice
from kneexo.command_line.parser import LONGEST_LINE, parsed
from kneexo.command_line.request import Request, named_in_errors
from kneexo.common.interruption import Terminated, sigterm_raises
from kneexo.common.user_code import cause_of, place_in_user_code
from kneexo.errors import KneexoError, WorkerError, escaped, shortened, shown

FIRST_STEPS = """\
kneexo simulates a polycentric knee exoskeleton with electro-hydraulic actuator. Try:

  kneexo view --out knee.html          a knee that moves, in a browser
  kneexo simulate --out run            how well it follows its reference
  kneexo new my.yaml                   a knee of your own to change
  kneexo reproduce --out results       every figure and number of the paper

kneexo --help lists all commands.
"""
"""The text that ``kneexo`` without arguments prints."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code.

    ``arguments`` are the words after ``kneexo``, by default the words with which this process was
    started.
    """
    _prepare_libraries()
    _prepare_streams()
    words = sys.argv[1:] if arguments is None else arguments
    request: Request | None = None
    with sigterm_raises():
        try:
            try:
                if not words:
                    print(FIRST_STEPS, end="")
                    return 0
                request = parsed(words)
                return _run(request)
            except Exception as error:  # of any library: an interrupt may be behind it
                if (interrupt := _interrupt_behind(error)) is None:
                    raise
                raise interrupt from None
            finally:
                # None if it was closed outside; the user's code can close it too
                if sys.stdout is not None and not sys.stdout.closed:
                    sys.stdout.flush()
        except KeyboardInterrupt as interrupt:
            return _interrupted(interrupt, request)
        except ImportError as error:
            library, unloaded, _ = str(error).partition(": cannot open shared object file")
            if not unloaded:
                raise
            return _fail(f"this system lacks {library}; install the package that has it")
        except OSError as error:
            return _failed_output(error)


def _prepare_libraries() -> None:
    """Set one BLAS thread and a Matplotlib backend without windows.

    Called before NumPy and Matplotlib are imported.
    """
    # On matrices as small as ours, threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # We only write files, and Matplotlib refuses a name that it does not know.
    os.environ["MPLBACKEND"] = "Agg"
    if matplotlib := sys.modules.get("matplotlib"):
        matplotlib.use("Agg")


def _prepare_streams() -> None:
    """Make stdout and stderr write escapes for characters that their encoding lacks."""
    codecs.register_error("kneexo", _escaped)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="kneexo")


def _escaped(error: UnicodeError) -> tuple[str, int]:
    """Handle a codec error: return JSON escapes of the characters, and the index after them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


def _run(request: Request) -> int:
    """Run the command of ``request``; return the exit code.

    An error becomes one line on stderr if its cause is the input, a lack of memory, or the user's
    code. Any other error is raised.
    """
    format_before = warnings.formatwarning
    warnings.formatwarning = _one_line
    try:
        with named_in_errors(request.scenario):
            return deliver(request)
    except KneexoError as error:
        pieces = pieces_notice(request) if isinstance(error, WorkerError) else ""
        return _fail(f"{error}{pieces and f'; {pieces}'}")
    except MemoryError:
        workers = ", or the processes with --workers" if "workers" in request else ""
        return _fail(f"out of memory; reduce simulation.duration_s{workers}")
    except (Exception, SystemExit) as error:
        in_user_code = isinstance(error, SystemExit) or place_in_user_code(error) is not None
        is_ours = isinstance(error, OSError | ImportError) or _interrupt_behind(error) is not None
        if is_ours or not in_user_code:
            raise
        return _fail(f"{cause_of(error)}; correct that code")
    finally:
        warnings.formatwarning = format_before


def _fail(line: str, code: int = 2) -> int:
    """Print one line on stderr; return the exit code ``code``."""
    print(_one_line(line), end="", file=sys.stderr)
    return code


def _failed_output(error: OSError) -> int:
    """Print why a file or stream cannot be written, and return the exit code 2.

    If the reader of a pipe has closed the pipe, as with ``| head``, print nothing and return 0.
    """
    if sys.stdout is not None:  # what stdout still holds would fail again at exit
        with suppress(OSError):  # a stream without a file descriptor
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return 0
    with suppress(OSError):
        where = f"{shown(error.filename)}: " if error.filename else ""
        _fail(f"{where}{error.strerror or error}")
    return 2


def _interrupted(interrupt: KeyboardInterrupt, request: Request | None) -> int:
    """Print where results are. Return the exit code: 130 for Ctrl-C, 143 for SIGTERM."""
    notice = "nothing was written" if request is None else interrupt_notice(request)
    if isinstance(interrupt, Terminated):
        return _fail(f"terminated; {notice}", 143)
    return _fail(f"interrupted; {notice}", 130)


def _interrupt_behind(error: BaseException) -> KeyboardInterrupt | None:
    """Return the `KeyboardInterrupt` that caused an error, or None.

    Extension modules replace an interrupt by another error. In some modules, such as pydantic's,
    only the message of this error names the interrupt.
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


def _one_line(message: Warning | str, *_: Any, **__: Any) -> str:
    """Return a warning as one line. Replaces `warnings.formatwarning`."""
    return f"kneexo: {shortened(escaped(str(message)), LONGEST_LINE)}\n"
