"""Machinery of all parameter classes: quantities with units and ranges, names, messages."""
