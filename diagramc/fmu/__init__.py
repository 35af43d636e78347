"""Writes a model in C as a functional mock-up unit (FMU) for co-simulation."""
