"""The errors that kneexo raises for wrong input or a failed run; each message is one line.

The errors that the compiler raises too are defined in `kneexo.compiler.errors`.
"""

from __future__ import annotations

from kneexo.compiler.errors import (
    CompilationError as CompilationError,
    Error,
    OutputError as OutputError,
    ParameterError as ParameterError,
    SimulationError as SimulationError,
    StiffnessError as StiffnessError,
    escaped as escaped,
    shortened as shortened,
    shown as shown,
)

KneexoError = Error
"""Base of all errors of kneexo and of its compiler."""


class ScenarioError(ParameterError):
    """A scenario file cannot be read: says file, line, path, value, unit and range."""


class LinkageError(KneexoError, ValueError):
    """A four-bar linkage cannot be assembled, or is not one-to-one over the range of motion."""


class LinearizationError(KneexoError, ArithmeticError):
    """There is no equilibrium, or no linear loop, where a linearization was asked for."""


class PackageError(KneexoError, ImportError):
    """A package that something needs is not installed: says which."""


class WorkerError(KneexoError, RuntimeError):
    """A worker process died, or workers cannot be had."""
