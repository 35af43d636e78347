"""A failed run of a scenario as a JSON file, from which the run is repeated bit for bit.

The file holds numbers and names, no code. It names a control law of the user as ``FILE.py:NAME``
with the digest of its code.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kneexo.compiler import (
    Replay,
    RunEnd,
    document_text,
    read_document,
    run_versions,
    version_changes,
    write_document,
)
from kneexo.errors import KneexoError, ParameterError, ResultError, shown
from kneexo.parameters import LawParameters, Scenario
from kneexo.result import Result
from kneexo.simulation import Run, simulate
from kneexo.simulation.compiled import structure_key
from kneexo.version import __version__

_KIND = "failed run of a scenario"


@dataclass(frozen=True, repr=False)
class Failure(Result):
    """A scenario whose run fails, and how the run ended. `record_failure` makes it."""

    scenario: Scenario
    end: RunEnd
    versions: Mapping[str, str]
    """Versions of kneexo and Drake, digest of the equations, and the processor."""
    note: Mapping[str, Any]
    """Data of the user, such as the seed of a study and the number of the run."""

    def text(self, directory: str | os.PathLike[str]) -> str:
        """Return the text of the failure's file, which is to lie in ``directory``.

        The path of a file with a control law is relative to this directory. Raises `ParameterError`
        for a law that no file can name, and for a note that is no JSON data.
        """
        folder = Path(directory).resolve()
        data = self.scenario.model_dump(mode="json")
        if isinstance(law := self.scenario.controller, LawParameters):
            file, _, name = law.function.identity().rpartition(":")
            if file.endswith(".py"):
                place = os.path.relpath(Path(file).resolve(), folder)
                data["controller"]["function"] = f"{place}:{name}"
            _scenario(data, folder)  # refuses a law that no file has, such as a lambda
        document = {
            "scenario": data,
            "end": self.end.plain(),
            "versions": dict(self.versions),
            "note": dict(self.note),
        }
        return document_text(_KIND, document)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the failure to a file, replacing an earlier file; errors as in `text`.

        Raises `OutputError` if the file cannot be written.
        """
        write_document(path, self.text(Path(path).parent))

    def simulate(self) -> Run:
        """Repeat the run and return its signals; raise the error of the run if it still fails."""
        return simulate(self.scenario)

    def replay(self) -> Replay:
        """Repeat the run, and compare its end with the recorded end bit for bit."""
        end = _end_of(self.scenario)
        now = _versions(self.scenario)
        return Replay(end, self.end.difference(end), version_changes(self.versions, now))


def record_failure(scenario: Scenario, *, error: str = "", note: Mapping[str, Any] = {}) -> Failure:
    """Repeat a failed run of a sweep, and return its scenario and its end, ready for a file.

    A run alone has the same bits as in a sweep. So any failed run of a sweep can be recorded
    afterwards, by its scenario.

    Parameters
    ----------
    scenario
        The scenario of the failed run.
    error
        The error of this run in the sweep, if it is known.
    note
        JSON data that the file keeps, such as ``{"seed": 1, "run": 4711}``.

    Raises
    ------
    ResultError
        The run does not fail, or its error is not ``error``.
    """
    end = _end_of(scenario)
    if not end.error:
        raise ResultError("the run does not fail: there is no failure to write")
    if error and end.message != error:
        raise ResultError(f"the run alone fails in another way: {end.message}; not {error}")
    return Failure(scenario, end, _versions(scenario), note)


def read_failure(path: str | os.PathLike[str], *, same_law: bool = True) -> Failure:
    """Read a file that `Failure.write` made. A control law of the user is imported from its file.

    ``same_law``: whether the code of the law must be the code at the time of the failure. If
    False, the run uses the law as it is now.

    Raises `ParameterError` if the file cannot be read, is too large or is no such file, and if the
    code of the law has changed.
    """
    document = read_document(path, _KIND)
    try:
        data = document.get("scenario")
        if not isinstance(data, dict):
            raise ParameterError("scenario: must be an object")
        law = data.get("controller")
        if not same_law and isinstance(law, dict) and isinstance(law.get("function"), str):
            law["function"] = law["function"].partition("#")[0]
        scenario = _scenario(data, Path(path).parent)
        end = RunEnd.from_plain(document.get("end"))
    except ParameterError as error:
        raise ParameterError(f"{shown(path)}: {error}") from None
    versions, note = document.get("versions"), document.get("note")
    return Failure(
        scenario,
        end,
        versions if isinstance(versions, dict) else {},
        note if isinstance(note, dict) else {},
    )


def _scenario(data: dict[str, Any], directory: Path) -> Scenario:
    """Return the scenario of JSON data, in which paths of files start at ``directory``."""
    return Scenario.model_validate_json(json.dumps(data), context={"directory": directory})


def _end_of(scenario: Scenario) -> RunEnd:
    try:
        run = simulate(scenario)
    except KneexoError as error:
        return RunEnd.of(error)
    return RunEnd("", "", float(run.time_s[-1]), {})


def _versions(scenario: Scenario) -> dict[str, str]:
    """Return what decides the bits of a run beside the numbers of its scenario."""
    versions = {"kneexo": __version__} | run_versions()
    try:
        key = structure_key(scenario)
    except KneexoError:  # of a controller that Drake's Simulator runs, but nobody can compile
        return versions
    return versions | {"equations": hashlib.sha256(key.encode()).hexdigest()}
