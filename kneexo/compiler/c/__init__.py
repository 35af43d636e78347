"""Equations as C99."""
