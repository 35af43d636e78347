"""Writes equations as C99: functions, test vectors and build files."""
