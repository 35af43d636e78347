"""Equilibria of diagrams, and their linear models: continuous, sampled, mixed and multirate."""
