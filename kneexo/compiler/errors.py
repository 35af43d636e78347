"""The errors that the compiler raises for wrong input or a failed run; a message is one line."""

from __future__ import annotations


def escaped(text: str) -> str:
    r"""Return the text on one line. Characters that do not print become escapes, such as ``\n``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str, most: int = 120) -> str:
    """Return the text; if it has more than ``most`` characters, " … " replaces its middle."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]} … {text[-(most // 2) + 3 :]}"


def shown(name: object) -> str:
    """Return the name of a file or setting, for a message: one line of at most 300 characters."""
    return shortened(escaped(str(name)), 300)


class Error(Exception):
    """Base of all errors that the compiler raises on purpose; a message is escaped to one line."""

    def __init__(self, message: str = "") -> None:
        super().__init__(escaped(message))


class ParameterError(Error, ValueError):
    """A parameter is unknown, has the wrong type, or is outside its range."""


class SimulationError(Error, RuntimeError):
    """A simulation diverged or left its range; the message tells the time and the signal."""


class StiffnessError(SimulationError):
    """The integrator exact_hold cannot hold its tolerance: the derivatives jump too often."""


class OutputError(Error, OSError):
    """A result cannot be written, or a cache entry cannot be deleted."""


class CompilationError(Error, TypeError):
    """A diagram cannot be compiled; the message names the subsystem and the port."""
