"""Writes the equations of a diagram as C99, with test vectors and build files."""
