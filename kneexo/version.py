"""The version of kneexo."""

__version__ = "0.2.0"
