"""Shared by the tests of sweeps: an executor without processes."""

import math
import pickle
from concurrent.futures import BrokenExecutor, Executor, Future

import pytest


class AtOnce(Executor):
    """Runs what is submitted at once, as another process would: nothing is shared."""

    def __init__(self, most=math.inf):
        self.units = []
        self.most = most

    def submit(self, function, *arguments):
        if len(self.units) >= self.most:
            raise BrokenExecutor("no worker left\nto speak of")
        called, given, items = pickle.loads(pickle.dumps((function, *arguments)))
        future = Future()
        future.set_result(called(given, items))
        self.units.append(len(items))
        return future


@pytest.fixture(scope="session")
def at_once():
    """The class of executors that work at once."""
    return AtOnce
