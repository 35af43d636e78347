"""Fits a compiled model to logs of a real machine, and says how far to trust the result."""
