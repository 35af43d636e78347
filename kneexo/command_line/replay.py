"""The command ``replay``, which repeats a run from its file and makes a test of it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kneexo.command_line import arguments
from kneexo.command_line.outcome import Outcome
from kneexo.errors import ParameterError, ResultError, escaped, shortened, shown
from kneexo.files.writing import create_files
from kneexo.user_code import user_code
from kneexo.version import __version__

if TYPE_CHECKING:
    from kneexo.compiler import RunEnd

_SCENARIO_TEST = '''\
"""A run that failed, written by ``kneexo replay``.

The test is expected to fail until the fault is mended. Then remove the mark ``xfail``: from then on
the test guards the mended code.
"""

from pathlib import Path

import pytest

from kneexo.errors import KneexoError
from kneexo.sweeps.failure import read_failure


@pytest.mark.xfail(
    raises=KneexoError,
    strict=True,
    reason={reason},
)
def {name}():
    failure = read_failure(Path(__file__).with_suffix(".json"), same_law=False)
    failure.simulate()
'''

_DIAGRAM_TEST = '''\
"""A run that failed, written by ``kneexo replay``.

The test is expected to fail until the fault is mended. Then remove the mark ``xfail``: from then on
the test guards the mended code.
"""

import runpy
from pathlib import Path

import pytest

from kneexo.compiler import SimulationError, compile_diagram, read_run

FILE = Path(__file__).parent / {file}


@pytest.mark.xfail(
    raises=SimulationError,
    strict=True,
    reason={reason},
)
def {name}():
    run = read_run(Path(__file__).with_suffix(".json"))
    diagram = runpy.run_path(str(FILE))[{maker}]()
    run.simulate(compile_diagram(diagram, inputs=run.input_ports))
'''


def add_replay(subparsers: Any) -> None:
    """Add the command ``replay`` to the parser."""
    parser = arguments.add_command(
        subparsers,
        "replay",
        replay,
        "repeat a failed run from its file, bit for bit, and make a test of it",
        "Fails if the run does not end with the same error, at the same time, in the same state. "
        "The file names a control law of yours, whose file is then imported.",
    )
    parser.add_argument(
        "path",
        metavar="FAILURE.json",
        type=arguments.place,
        help="a file of a study, of BatchRow.write_failure or of RecordedRun.write",
    )
    parser.add_argument(
        "--diagram",
        metavar="FILE.py:NAME",
        help="for a run of a diagram of yours: the function without arguments that makes it",
    )
    parser.add_argument(
        "--test",
        metavar="test_NAME.py",
        type=arguments.place,
        help="write a test for pytest, with the run beside it as test_NAME.json; files that exist "
        "are never replaced",
    )


def replay(path: Path, diagram: str | None, test: Path | None) -> Outcome:
    """Repeat the run of a file, and say whether it ends as it did. Write a test if requested."""
    if test is not None and not (test.suffix == ".py" and test.stem.isidentifier()):
        raise ParameterError(f"--test {shown(test)}: the name must be test_NAME.py")
    if test is not None and not test.stem.startswith("test_"):
        raise ParameterError(f"--test {shown(test)}: the name must begin with test_ for pytest")
    if diagram is None:
        from kneexo.sweeps.failure import read_failure

        try:
            failure = read_failure(path)
        except ParameterError as error:
            other = "; a run of a diagram needs --diagram FILE.py:NAME"
            raise ParameterError(f"{error}{other * ('must be a file' in str(error))}") from None
        again, recorded = failure.replay(), failure.end
    else:
        from kneexo.compiler import compile_diagram, read_run

        run = read_run(path)
        file, maker = _file_and_name(diagram)
        model = compile_diagram(_made(diagram, file, maker), inputs=run.input_ports)
        again, recorded = run.replay(model), run.end
    if not again.same:
        raise ResultError("; ".join([f"{shown(path)}: {again.difference}", *again.changes]))
    text = f"{again}\n"
    files = []
    if test is not None:
        data = test.with_suffix(".json")
        if diagram is None:
            code = _SCENARIO_TEST.format(name=test.stem, reason=_reason(recorded))
            create_files({test: code, data: failure.text(test.parent)})
        else:
            place = os.path.relpath(file.resolve(), test.parent.resolve())
            code = _DIAGRAM_TEST.format(
                name=test.stem, reason=_reason(recorded), file=repr(place), maker=repr(maker)
            )
            create_files({test: code, data: run.text()})
        files = [str(test), str(data)]
        text += f"{shown(test)} repeats it: pytest {shown(test)}\n"
    document = {
        "kneexo": __version__,
        "end": again.end.plain(),
        "same": again.same,
        "changes": again.changes,
        "files": files,
    }
    return Outcome(text, json.dumps(document) + "\n")


def _reason(end: RunEnd) -> str:
    """Return the message of a failed run as the source of a Python text, in one line."""
    if not end.error:
        raise ParameterError("--test: the run of the file does not fail, there is nothing to mend")
    return repr(shortened(escaped(end.message), 76))


def _file_and_name(text: str) -> tuple[Path, str]:
    """Return the file and the name of ``FILE.py:NAME``; raise `ParameterError` for other texts."""
    place, _, name = text.rpartition(":")
    if not place.endswith(".py") or not name.isidentifier():
        raise ParameterError(f"--diagram {shown(text)}: must be FILE.py:NAME")
    if not Path(place).is_file():
        raise ParameterError(f"--diagram {shown(text)}: there is no file {shown(place)}")
    return Path(place), name


def _made(text: str, file: Path, name: str) -> Any:
    """Return the diagram that the function ``name`` in ``file`` makes."""
    import runpy

    with user_code(f"--diagram {shown(text)}: the file fails"):
        values = runpy.run_path(str(file))
    if not callable(values.get(name)):
        known = [key for key, value in values.items() if callable(value) and key[:1] != "_"]
        listed = shortened(", ".join(known), 200) or "none"
        raise ParameterError(f"--diagram {shown(text)}: has no such function; it has {listed}")
    with user_code(f"--diagram {shown(text)}: the function fails"):
        return values[name]()
