"""The errors that the compiler raises for wrong input or a failed run; each message is one line."""

from __future__ import annotations


def escaped(text: str) -> str:
    r"""Return the text on one line. Characters that do not print become escapes, such as ``\n``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str, most: int = 120) -> str:
    """Return the text; without its middle if it has more than ``most`` characters."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]} … {text[-(most // 2) + 3 :]}"


def shown(name: object) -> str:
    """Return the name of a file or setting as one line of at most 300 characters for a message."""
    return shortened(escaped(str(name)), 300)


class Error(Exception):
    """Base of every error that is raised on purpose; its message is escaped to one line."""

    def __init__(self, message: str = "") -> None:
        super().__init__(escaped(message))


class ParameterError(Error, ValueError):
    """A parameter is unknown, has the wrong type, or is outside its range."""


class SimulationError(Error, RuntimeError):
    """A simulation diverged or left its range: says the time and the signal."""


class StiffnessError(SimulationError):
    """The exact hold cannot follow: the derivatives jump too often."""


class OutputError(Error, OSError):
    """A result cannot be written."""


class CompilationError(Error, TypeError):
    """A diagram cannot be compiled: says which subsystem and port."""
