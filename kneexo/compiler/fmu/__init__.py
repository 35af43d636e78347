"""Equations as a functional mock-up unit (FMU)."""
