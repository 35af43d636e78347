"""Waiting for other processes."""

import time


def wait_for(condition, seconds=60.0):
    """The value of a condition as soon as it is true. Raises `TimeoutError` if it stays false."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError(condition)
        time.sleep(0.01)
    return value
