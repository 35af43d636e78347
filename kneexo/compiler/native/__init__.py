"""Equations as machine code."""
