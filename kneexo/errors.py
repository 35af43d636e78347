"""The errors that kneexo raises for wrong input or a failed run. Each message is one line.

The module ``diagramc.errors`` defines the errors of the compiler, which are imported here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

from diagramc import (
    CompilationError as CompilationError,
    DifferenceError as DifferenceError,
    Error,
    LinearizationError as LinearizationError,
    NoEquilibriumError as NoEquilibriumError,
    OutputError as OutputError,
    ParameterError as ParameterError,
    ResultError as ResultError,
    SimulationError as SimulationError,
    StiffnessError as StiffnessError,
    UnstableStepError as UnstableStepError,
    escaped as escaped,
    shortened as shortened,
    shown as shown,
)

KneexoError = Error
"""Base of all errors of kneexo and of its compiler."""


class ScenarioError(ParameterError):
    """A scenario file is faulty. The message says file, line, path, value, unit and range."""


class LinkageError(KneexoError, ValueError):
    """A four-bar linkage cannot be assembled, or is not one-to-one over the range of motion."""


class PackageError(KneexoError, ImportError):
    """A required package is not installed. The message gives the name of the package."""


class WorkerError(KneexoError, RuntimeError):
    """A worker process died, or no workers can be started or reached."""


@contextmanager
def failure_noted(
    row: dict[str, Any], name: str = "failure", kind: type[Error] = KneexoError
) -> Iterator[None]:
    """Context manager that stores the message of an error in ``row[name]`` and does not raise it.

    A sweep then continues after a scenario fails. Only errors of the given ``kind`` are stored.
    Without an error ``row[name]`` becomes an empty text. An error leaves the other values of
    ``row`` as they are, for example nan.
    """
    row[name] = ""
    try:
        yield
    except kind as error:
        row[name] = str(error).removeprefix("Scenario: ")  # a refused value has its own path


def close_names(name: str, names: Iterable[str], cutoff: float = 0.6, most: int = 4) -> list[str]:
    """Return at most ``most`` names that are similar to ``name``, the most similar first.

    A name is also similar if ``name`` is one of its words, as ``mass`` is in ``segment_mass_kg``.
    ``cutoff`` is the least similarity of other names, between 0 and 1.
    """
    folded = {other.casefold(): other for other in names}
    searched = name.casefold()
    alike = get_close_matches(searched, folded, n=most, cutoff=cutoff)
    begins = [other for other in folded if other.startswith(f"{searched}_")]
    has = [other for other in folded if len(searched) > 2 and f"_{searched}_" in f"_{other}_"]
    return [folded[other] for other in dict.fromkeys([*alike[:1], *begins, *has, *alike])][:most]


def question(names: Iterable[str]) -> str:
    """Return ``; did you mean a, b or c?``. The text is empty without names."""
    listed = listed_names(names)
    return f"; did you mean {listed}?" if listed else ""


def listed_names(names: Iterable[str]) -> str:
    """Return ``a, b or c``. The text is empty without names."""
    *others, last = [*names] or [""]
    return f"{', '.join(others)} or {last}" if others else last
