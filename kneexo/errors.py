"""The errors that kneexo raises for wrong input or a failed run. Each message is one line.

The module ``kneexo.compiler.errors`` defines the errors of the compiler, which are imported here.
"""

from __future__ import annotations

from kneexo.compiler import (
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
    """A scenario file is faulty. The message says file, line, path, value, unit and range."""


class LinkageError(KneexoError, ValueError):
    """A four-bar linkage cannot be assembled, or is not one-to-one over the range of motion."""


class LinearizationError(KneexoError, ArithmeticError):
    """A linearization fails: there is no equilibrium or no linear loop at the requested posture."""


class PackageError(KneexoError, ImportError):
    """A required package is not installed. The message gives the name of the package."""


class WorkerError(KneexoError, RuntimeError):
    """A worker process died, or no workers can be started or reached."""
