"""The version of diagramc, which is the version of kneexo too."""

__version__ = "0.3.0"
