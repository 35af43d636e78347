"""The version of kneexo."""

__version__ = "0.1.0"
