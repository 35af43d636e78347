"""Equations of a Drake diagram, as one graph."""
