"""Memory for the records of runs."""

from __future__ import annotations

import math
import weakref
from collections import deque
from contextlib import suppress

import numpy as np

from ..run_data import Array


class BufferPool:
    """Memory that is used again once no array refers to it.

    To get fresh memory for a record from the system takes as long as the run that fills it.
    """

    def __init__(self, most: int) -> None:
        """``most``: largest number of elements that the pool holds while nobody uses them."""
        self._most = most
        self._unused: deque[Array] = deque()

    def array(self, shape: tuple[int, ...]) -> Array:
        """Return an array that is not initialized."""
        size = math.prod(shape)
        memory = self._memory(size)
        # Every view of the record has `root` as its base, so `root` lives as long as any view.
        root = np.frombuffer(memory.data, dtype=float, count=size)
        weakref.finalize(root, self._take_back, memory).atexit = False
        return root.reshape(shape)

    def _memory(self, size: int) -> Array:
        for _ in range(len(self._unused)):
            with suppress(IndexError):  # another thread has emptied the pool
                memory = self._unused.popleft()
                if size <= memory.size <= 2 * size + 1024:
                    return memory
                self._unused.append(memory)
        return np.empty(max(size, 1))

    def _take_back(self, memory: Array) -> None:
        self._unused.append(memory)
        with suppress(IndexError):
            while sum(unused.size for unused in list(self._unused)) > self._most:
                self._unused.popleft()


RECORDS = BufferPool(8_000_000)
"""Memory of the records of all models: at most 64 MB are unused."""
