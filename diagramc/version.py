"""The version of diagramc, which is the version of kneexo too."""

__version__ = "0.2.0"
