"""The version of kneexo."""

__version__ = "0.3.0"
