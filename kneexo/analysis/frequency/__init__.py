"""Frequency response: sines of a run, bandwidth, limit by the speed of the motor."""
