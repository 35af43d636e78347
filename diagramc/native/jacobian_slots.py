"""The Jacobians of the exact hold: the memory of a lane, and the choice of a Jacobian."""

from __future__ import annotations

from itertools import accumulate

from .ir import Array, Function, Module
from .phi_functions import Tables, define_store_matrix
from .types import BOOL, DOUBLE, INT, POINTER

SLOTS = 4
"""Number of slots of a lane. A slot stores one Jacobian and the tables of its phi functions.

With several slots, equations that change between a few linear parts, as at a limit or a valve, find
their tables again. The number decides little: 15 s of preset ``leg`` take 18 to 21 ms with 1, 2, 4
or 8 slots.
"""


class Memory:
    """Layout of the memory that the exact hold uses for one lane, in elements of eight bytes.

    ``Memory(size)`` serves ``size`` continuous states. The attribute ``size`` is the number of
    elements of the memory. The other attributes, such as ``slots``, are the indices at which the
    parts of the memory begin. The elements of ``head`` must be zero when a run starts.
    """

    def __init__(self, size: int) -> None:
        self.square = -(-size * size // 8) * 8
        """Number of elements of a Jacobian, filled up with zeros to whole vectors."""
        self.slot_size = self.square + Tables(size).size
        """Number of elements of a slot: a Jacobian, and then its tables."""
        sizes = {
            "filled": 1,  # number of slots that hold a Jacobian
            "made": 1,  # number of Jacobians stored so far
            "slot": 1,  # slot of the current Jacobian
            "excess": 1,  # sum of the errors of finest steps that miss the tolerance
            "candidate": self.square,  # the Jacobian that is tried
            "head": 0,
            "change": size,  # state at the middle of a step minus that at its start
            "rest": size,  # remainder of dx/dt there that the linear part does not explain
            "slots": SLOTS * self.slot_size,
            "tables": Tables(size).size,  # for the states at a given time within a step
        }
        places = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))
        self.filled, self.made, self.slot, self.excess = (places[k] for k in list(sizes)[:4])
        self.candidate, self.head, self.change = (places[k] for k in list(sizes)[4:7])
        self.rest, self.slots, self.tables = (places[k] for k in list(sizes)[7:])
        self.size = -(-sum(sizes.values()) // 8) * 8


def define_choose_slot(module: Module, size: int) -> Function:
    """Define the emitted function ``choose_slot(x, memory)``.

    The function decides whether the exact hold goes on with another Jacobian, for example after a
    step that has failed. ``x``: states of the lane; ``memory``: see `Memory`. The memory has the
    Jacobian at ``x`` as candidate, and the vectors ``change`` and ``rest`` of the step. The current
    Jacobian stays if the candidate explains little of ``rest``, that is, if (candidate - current
    Jacobian) · ``change`` is less than a tenth of ``rest``. Otherwise the candidate becomes the
    current Jacobian. If a slot holds it already, its tables are found again. If not, it replaces
    the oldest Jacobian, whose tables are emptied.
    """
    store_matrix = define_store_matrix(module, size)
    at, wide = Memory(size), DOUBLE.of(8)
    arguments = {"x": POINTER, "memory": POINTER}
    f = module.function("choose_slot", arguments, attributes="noinline cold")
    x, memory = (Array(f.arguments[name], DOUBLE) for name in ("x", "memory"))
    whole = memory.cast(INT)
    filled, current, vectors = whole[at.filled], whole[at.slot], at.square // 8
    slots, candidate = memory.shifted(at.slots), memory.shifted(at.candidate)
    for e in f.each(vectors):
        value = candidate.cast(wide)[e]
        # A root at zero has an infinite slope. Any matrix works, with smaller steps.
        candidate.cast(wide)[e] = f.select((value - value).equals(0.0), value, 0.0)
    with f.when(filled > 0):
        _return_if_explained(f, size, x, memory, slots.shifted(current * at.slot_size))
    for slot in f.loop(filled):
        number = f.coerce(slot, INT)
        jacobian = slots.shifted(number * at.slot_size).cast(wide)
        other = f.variable(f.constant(0, BOOL.of(8)))
        for e in f.each(vectors):
            other.set(other.get() | jacobian[e].differs(candidate.cast(wide)[e]))
        with f.when(~f.any_lane(other.get())):
            whole[at.slot] = number
            f.return_if(f.constant(1, BOOL))
    slot = whole[at.made] % SLOTS
    whole[at.made] = whole[at.made] + 1
    with f.when(filled < SLOTS):
        whole[at.filled] = filled + 1
    jacobian = slots.shifted(slot * at.slot_size)
    for e in f.each(vectors):
        jacobian.cast(wide)[e] = candidate.cast(wide)[e]
    f.call(store_matrix, jacobian.pointer, jacobian.address(at.square))
    whole[at.slot] = slot
    return f


def _return_if_explained(f: Function, size: int, x: Array, memory: Array, jacobian: Array) -> None:
    """Emit a return from ``choose_slot`` if the current ``jacobian`` stays."""
    at = Memory(size)
    candidate, change = memory.shifted(at.candidate), memory.shifted(at.change)
    explained, total_rest = f.variable(f.constant(0.0)), f.variable(f.constant(0.0))
    for i in f.each(size):
        total = f.variable(f.constant(0.0))
        for k in f.each(size):
            place = f.coerce(k, INT) * size + i
            total.set(f.fma(candidate[place] - jacobian[place], change[k], total.get()))
        scale = 1.0 / (1.0 + f.absolute(x[i]))
        explained.set(f.fma(f.absolute(total.get()), scale, explained.get()))
        rest = memory.shifted(at.rest)[i]
        total_rest.set(f.fma(f.absolute(rest), scale, total_rest.get()))
    f.return_if(explained.get() < 0.1 * total_rest.get())
