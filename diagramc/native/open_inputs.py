"""Emits the function that evaluates the open inputs of one run at a time."""

from __future__ import annotations

from .arguments import INPUT
from .ir import Array, Function, Module
from .types import DOUBLE, INT, POINTER


def define_inputs(module: Module, size: int, *, rates: bool = False) -> Function:
    """Define the emitted function ``evaluate_inputs(t, table, u)``, like `InputTable.value`.

    The function writes one lane's open inputs at the time ``t`` in s to ``u``. Each break belongs
    to the segment that begins there. If there are several breaks, the last one belongs to the
    segment that ends there. ``size`` is the number of elements of all open inputs. With ``rates``
    the function is called ``evaluate_inputs_and_rates``, and writes the time derivatives of the
    inputs behind the inputs.
    """
    arguments = {"t": DOUBLE, "table": POINTER, "u": POINTER}
    f = module.function("evaluate_inputs" + "_and_rates" * rates, arguments)
    t, table = f.arguments["t"], Array(f.arguments["table"], INT)
    count, powers = table[INPUT.index("break_count")], table[INPUT.index("powers")]
    breaks, coefficients = (
        Array(f.pointer(table[INPUT.index(name)]), DOUBLE) for name in ("breaks", "coefficients")
    )
    low, high = f.variable(f.constant(0, INT)), f.variable(count)
    with f.forever() as loop:  # the number of breaks that are not after t
        loop.stop_if(low.get() >= high.get())
        middle = (low.get() + high.get()) >> 1
        before = breaks[middle] <= t
        low.set(f.select(before, middle + 1, low.get()))
        high.set(f.select(before, high.get(), middle))
    segment, start = low, f.variable(f.constant(0.0))
    with f.when(segment.get() > 0):
        last = (segment.get() > 1) & segment.get().equals(count)
        at_end = last & t.equals(breaks[segment.get() - 1])
        segment.set(f.select(at_end, segment.get() - 1, segment.get()))
        start.set(breaks[segment.get() - 1])
    s, u = t - start.get(), Array(f.arguments["u"], DOUBLE)
    # Before the first break the powers count from t = 0.
    for i in f.each(size):
        first = (segment.get() * size + i) * powers
        value, power = f.variable(f.constant(0.0)), f.variable(powers)
        rate = f.variable(f.constant(0.0))
        with f.forever() as loop:
            loop.stop_if(power.get() <= 0)
            power.set(power.get() - 1)
            if rates:
                rate.set(rate.get() * s + value.get())
            value.set(value.get() * s + coefficients[first + power.get()])
        u[i] = value.get()
        if rates:
            u[f.coerce(i, INT) + size] = rate.get()
    return f
