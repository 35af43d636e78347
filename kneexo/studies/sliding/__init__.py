"""Eq. 27's sliding mode at 2 ms."""
