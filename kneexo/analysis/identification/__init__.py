"""Fits a scenario to a log of the real machine: `fit.fit`."""
