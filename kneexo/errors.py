"""The errors that kneexo raises for wrong input or a failed run; each message is one line."""


class KneexoError(Exception):
    """Base of every error that kneexo raises on purpose."""


class ParameterError(KneexoError, ValueError):
    """A parameter is unknown, has the wrong type, or is outside its range."""


class ScenarioError(ParameterError):
    """A scenario file cannot be read: says file, line, path, value, unit and range."""


class LinkageError(KneexoError, ValueError):
    """A four-bar linkage cannot be assembled, or is not one-to-one over the range of motion."""


class SimulationError(KneexoError, RuntimeError):
    """A simulation diverged or left its range: says the time and the signal."""


class StiffnessError(SimulationError):
    """The exact hold cannot follow: the derivatives jump too often."""


class OutputError(KneexoError, OSError):
    """A result cannot be written."""


class LinearizationError(KneexoError, ArithmeticError):
    """There is no equilibrium, or no linear loop, where a linearization was asked for."""


class CompilationError(KneexoError, TypeError):
    """A diagram cannot be compiled: says which subsystem and port."""


class PackageError(KneexoError, ImportError):
    """A package that something needs is not installed: says which."""


class WorkerError(KneexoError, RuntimeError):
    """A worker process died, or workers cannot be had."""
