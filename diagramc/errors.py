"""The errors that the compiler raises for wrong input or a failed run. Each message is one line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType


def escaped(text: str) -> str:
    r"""Return the text with escapes, such as ``\n``, in place of characters that do not print."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str, most: int = 120) -> str:
    """Replace the middle of a text by " … " if the text has more than ``most`` characters."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]} … {text[-(most // 2) + 3 :]}"


def shown(name: object) -> str:
    """Return the name of a file or setting, for a message: one line of at most 300 characters."""
    return shortened(escaped(str(name)), 300)


class Error(Exception):
    """Base of all errors that the compiler raises on purpose. The message becomes one line."""

    def __init__(self, message: str = "") -> None:
        super().__init__(escaped(message))


class ParameterError(Error, ValueError):
    """A parameter is unknown, has the wrong type, or is outside its range."""


class SimulationError(Error, RuntimeError):
    """A simulation diverged or left its range. The message tells the time and the signal.

    ``time_s`` is the time at which a compiled run ended, and ``state`` maps the name of each state
    to its value at the end. Other runs leave ``time_s`` nan and ``state`` empty.
    """

    time_s: float = math.nan
    state: Mapping[str, float] = MappingProxyType({})


class StiffnessError(SimulationError):
    """The equations are too stiff for an integrator that controls its error."""


class UnstableStepError(SimulationError):
    """The steps of a Runge-Kutta integrator are too long for the fastest mode.

    ``step_s`` is a step that works, in s.
    """

    step_s: float = math.nan


class OutputError(Error, OSError):
    """A result cannot be written, or a cache entry cannot be deleted."""


class ResultError(Error, KeyError):
    """A result has nothing of the requested name. The message gives the names that it has."""

    __str__ = Exception.__str__  # a KeyError shows its message in quotation marks


class CompilationError(Error, TypeError):
    """A diagram cannot be compiled. The message names the subsystem and the port."""


class DifferenceError(CompilationError):
    """The equations of a leaf system differ from the leaf called with numbers."""


class LinearizationError(Error, ArithmeticError):
    """A diagram has no linear model or no equilibrium. The message names the state or signal."""


class NoEquilibriumError(LinearizationError):
    """The search for an equilibrium ends at a point that is none, because of ``fault``."""

    def __init__(self, message: str, fault: str = "") -> None:
        """Store the message, and the part of it that says what does not rest."""
        super().__init__(message)
        self.fault = fault
