"""Memory for the records of runs. Later runs reuse the memory."""

from __future__ import annotations

import math
import weakref
from collections import deque
from contextlib import suppress

import numpy as np

from ..run_data import Array


class BufferPool:
    """A pool of memory blocks. A block is used again once no array refers to the block.

    To get fresh memory for a record from the operating system takes as long as the run that fills
    the record.
    """

    def __init__(self, most: int) -> None:
        """``most``: number of unused doubles above which the pool frees its oldest blocks."""
        self._most = most
        self._unused: deque[Array] = deque()

    def array(self, shape: tuple[int, ...]) -> Array:
        """Return an array of uninitialized doubles, in an unused block or else in a new block."""
        size = math.prod(shape)
        memory = self._memory(size)
        # Every view of the record has `root` as its base, so `root` lives as long as any view.
        root = np.frombuffer(memory.data, dtype=float, count=size)
        # Not at the end of the process, where no record needs the memory again.
        weakref.finalize(root, self._take_back, memory).atexit = False
        return root.reshape(shape)

    def _memory(self, size: int) -> Array:
        for _ in range(len(self._unused)):
            with suppress(IndexError):  # another thread has emptied the pool
                memory = self._unused.popleft()
                # A short record does not hold back the memory of a long one.
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
"""Memory for the records of all models; the unused part is at most 64 MB."""
