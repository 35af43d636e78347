"""Robustness to uncertain parameters."""
