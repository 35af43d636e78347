"""Reads the equations of a Drake diagram into one graph, and rewrites the graph for speed."""
