"""Wearer."""
