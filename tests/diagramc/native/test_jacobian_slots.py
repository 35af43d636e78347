"""The choice of a Jacobian for one lane."""

import numpy as np
import pytest

from diagramc.native.ir import Module
from diagramc.native.jacobian_slots import SLOTS, Memory, define_choose_slot
from diagramc.native.llvm import Library, compile_text
from diagramc.native.types import POINTER

SIZE = 3
AT = Memory(SIZE)


class Chooser:
    """The memory of a lane, and ``choose(candidate)``, which returns the slot."""

    def __init__(self):
        module = Module()
        choose_slot = define_choose_slot(module, SIZE)
        f = module.function("choose", dict.fromkeys(("x", "memory"), POINTER), internal=False)
        f.call(choose_slot, f.arguments["x"], f.arguments["memory"])
        self.library = Library(compile_text(module.text()))
        self.memory = np.full(AT.size, np.nan)
        self.memory[: AT.head] = 0.0

    def choose(self, candidate, change=(0.0, 0.0, 0.0), rest=(1.0, 1.0, 1.0)):
        self.memory[AT.candidate : AT.candidate + SIZE**2] = candidate.T.ravel()
        self.memory[AT.change : AT.change + SIZE] = change
        self.memory[AT.rest : AT.rest + SIZE] = rest
        x = np.array([1.0, -3.0, 0.0])
        self.library.function("choose", 2)(x.ctypes.data, self.memory.ctypes.data)
        return int(self.memory.view(np.int64)[AT.slot])

    def jacobian(self, slot):
        first = AT.slots + slot * AT.slot_size
        return self.memory[first : first + SIZE**2].reshape(SIZE, SIZE).T


@pytest.fixture
def chooser():
    return Chooser()


def matrix(number):
    return np.random.default_rng(number).normal(size=(SIZE, SIZE))


def test_the_oldest_jacobian_is_replaced_and_an_equal_one_is_used_again(chooser):
    away = {"change": (1e3, 1e3, 1e3)}
    slots = [chooser.choose(matrix(n), **away) for n in range(SLOTS + 1)]
    assert slots == [*range(SLOTS), 0]
    assert chooser.choose(matrix(2), **away) == 2
    for slot, number in enumerate((SLOTS, 1, 2, 3)):
        np.testing.assert_array_equal(chooser.jacobian(slot), matrix(number))


@pytest.mark.parametrize(("share", "slot"), [(0.09, 0), (0.11, 1)])
def test_a_jacobian_stays_that_explains_little_of_the_remainder(chooser, share, slot):
    """Sums over the states of |(candidate - current) change| and |rest|, divided by 1 + |x|."""
    chooser.choose(matrix(0))
    change, rest = np.array([0.3, -0.2, 0.5]), np.array([0.4, 2.0, -0.1])
    scale = 1.0 + np.array([1.0, 3.0, 0.0])
    explained = np.sum(np.abs((matrix(1) - matrix(0)) @ change) / scale)
    rest *= explained / share / np.sum(np.abs(rest) / scale)
    assert chooser.choose(matrix(1), change, rest) == slot


def test_an_infinite_slope_counts_as_zero(chooser):
    candidate = matrix(0)
    candidate[1, 2], candidate[0, 0] = np.inf, np.nan
    chooser.choose(candidate)
    expected = np.where(np.isfinite(candidate), candidate, 0.0)
    np.testing.assert_array_equal(chooser.jacobian(0), expected)
