"""Reduces the samples of outputs to single numbers inside the compiled time loop.

A sample is the value of an output at the time of a record. The samples themselves are not stored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..reductions import REDUCTIONS, Reduction
from ..run_data import Array as Numbers, Integers
from .ir import Array, Function, Module, Operand, Value
from .timing import Timing
from .types import INT, POINTER, Type

_FIELDS = 3
"""Integers in a row of the table: sampled element, subtracted element, 1 for the magnitude."""

_START = {"maximum": -np.inf, "minimum": np.inf, "first_time": np.inf, "last_time": -np.inf}
"""Accumulated value before the first sample, for the kinds where this value is not zero."""


def define_reduce(module: Module, y: Type, names: Sequence[str]) -> Function:
    """Define the emitted function ``reduce(arguments, y, row, present)``.

    The function adds the samples of all lanes at one record to the accumulated values. A second
    function is better than a longer ``run``, because LLVM takes longer for one large function than
    for two.

    Parameters
    ----------
    y
        Type of an output. The argument ``y`` points to all outputs, and behind them to an element
        that is zero.
    names
        Names of the arguments of ``run``, to which ``arguments`` points. ``row`` is the index of
        the record, and ``present`` points to an integer that is 1 in each lane whose sample counts.
    """
    parameters = {"arguments": POINTER, "y": POINTER, "row": INT, "present": POINTER}
    f = module.function("reduce", parameters, attributes="noinline")
    ints = INT.of(y.lanes)
    memory, row = Array(f.arguments["arguments"], INT), f.arguments["row"]

    def array(name: str, type_: Type) -> Array:
        return Array(f.pointer(memory[names.index(name)]), type_)

    outputs = Array(f.arguments["y"], y)
    present = Array(f.arguments["present"], ints)[0].differs(0)
    table, ends = array("reductions", INT), array("reduction_ends", INT)
    begins, bounds, values = array("begins", ints), array("bounds", y), array("reduced", y)
    rows = f.coerce(row, ints)
    number = f.variable(f.constant(0, INT))
    for kind, name in enumerate(REDUCTIONS):
        with f.forever() as loop:
            n = number.get()
            loop.stop_if(n >= ends[kind])
            entry, results = table.shifted(n * _FIELDS), values.shifted(n * 2)
            sample = f.variable(outputs[entry[0]] - outputs[entry[1]])
            with f.when(entry[2].differs(0)):
                sample.set(f.absolute(sample.get()))
            value, before, begin = sample.get(), results[0], begins[n]
            after = _accumulated(
                name, value, before, results[1], rows.equals(begin), rows, bounds[n]
            )
            results[0] = f.select(present & (rows >= begin), after, before)
            results[1] = f.select(present, value, results[1])
            number.set(n + 1)
    return f


def _accumulated(
    kind: str,
    value: Value,
    before: Value,
    previous: Value,
    is_first: Value,
    rows: Value,
    bound: Value,
) -> Value:
    """Emit code that adds a sample to a reduction; return the new accumulated value.

    ``value`` is the sample, ``before`` the accumulated value, ``previous`` the sample before.
    """
    f = value.function
    reached = value >= bound

    def unless_first(term: Value) -> Value:
        return before + f.select(is_first, f.constant(0.0, value.type), term)

    emit: dict[str, Callable[[], Operand]] = {
        "maximum": lambda: f.maximum(before, value),
        "minimum": lambda: f.minimum(before, value),
        "mean": lambda: before + value,
        "rms": lambda: before + value * value,
        "variation": lambda: unless_first(f.absolute(value - previous)),
        "integral": lambda: unless_first((value + previous) * 0.5),
        "count": lambda: before + f.to_double(f.flags(reached)),
        "first_time": lambda: f.select(reached, f.minimum(before, f.to_double(rows)), before),
        "last_time": lambda: f.select(reached, f.to_double(rows), before),
    }
    return f.coerce(emit[kind](), value.type)


class Reducer:
    """Arrays in which the machine code collects the value of each `Reduction` in each lane.

    A lane is the place of one run in the vector registers of the processor. The last axis of
    ``begins``, ``bounds`` and ``values`` is the lane.
    """

    def __init__(
        self, reductions: Sequence[Reduction], elements: Mapping[str, int], lanes: int
    ) -> None:
        """Make the arrays for runs of ``lanes`` lanes.

        ``elements`` maps the name of each element of the outputs to its index.

        Raises `ValueError` for an unknown element.
        """
        kinds = [REDUCTIONS.index(reduction.kind) for reduction in reductions]
        order = np.argsort(kinds, kind="stable")  # the machine code reads them sorted by kind
        self._place = np.argsort(order)
        self._kinds = np.array(kinds, dtype=np.int64)[order]
        rows = [
            (_index(r.output, elements), _index(r.minus, elements), int(r.magnitude))
            for r in (reductions[n] for n in order)
        ]
        self.table = np.array(rows, dtype=np.int64).reshape(-1, _FIELDS)
        """Rows of ``_FIELDS`` integers, one for each reduction."""
        self.used = [n for row in rows for n in row[:2] if n < len(elements)]
        """Indices of the elements that the reductions read."""
        self.ends = np.searchsorted(self._kinds, np.arange(len(REDUCTIONS)), side="right")
        """For each kind, the index behind its last reduction."""
        self._start = np.array([_START.get(REDUCTIONS[kind], 0.0) for kind in self._kinds])
        size = len(reductions)
        self.begins = np.zeros((size, lanes), dtype=np.int64)
        """Row of the first sample that counts, for each reduction and lane."""
        self.bounds = np.zeros((size, lanes))
        self.values = np.zeros((size, 2, lanes))
        """Accumulated value and previous sample, for each reduction and lane."""

    def restart(self, begins: Integers, bounds: Numbers) -> None:
        """Prepare the arrays for new runs.

        ``begins`` (lanes, reductions): row of the first sample that counts; ``bounds`` (lanes,
        reductions): bound of each reduction: see `starts_and_bounds`.
        """
        self.begins[self._place] = begins.T
        self.bounds[self._place] = bounds.T
        self.values[:, 0] = self._start[:, None]

    def results(self, rows: Integers, times: Numbers, period_s: float) -> Numbers:
        """Return the value of each reduction of the runs in all lanes, (lanes, reductions).

        ``rows`` (lanes,): number of samples of each run; ``times``: times of the samples in s;
        ``period_s``: time between two samples.
        """
        samples = np.maximum(rows - self.begins, 0)
        results = self.values[:, 0].copy()
        for n, kind in enumerate(self._kinds):
            name, values = REDUCTIONS[kind], results[n]
            if name.endswith("time"):
                reached = np.isfinite(values)
                values[reached] = times[values[reached].astype(np.int64)]
                values[~reached] = np.nan
            elif name == "integral":
                values *= period_s
            elif name in ("mean", "rms"):
                values[:] = np.divide(values, samples[n], where=samples[n] > 0, out=values)
                results[n] = np.sqrt(values) if name == "rms" else values
            if name not in ("variation", "integral", "count"):
                values[samples[n] == 0] = np.nan
        return results[self._place].T


def starts_and_bounds(
    reductions: Sequence[Reduction], timing: Timing, runs: int
) -> tuple[Integers, Numbers]:
    """Return the row of the first sample and the bound of each reduction, (runs, reductions) each.

    ``timing``: time grid of the samples. Raises `ValueError` if a reduction has a number of values
    that is not the number of runs.
    """
    begins = np.zeros((runs, len(reductions)), dtype=np.int64)
    bounds = np.zeros((runs, len(reductions)))
    for n, reduction in enumerate(reductions):
        for name in ("after_s", "bound"):
            shape = np.shape(getattr(reduction, name))
            if shape not in ((), (runs,)):
                raise ValueError(f"{name}: has the shape {shape} for {runs} runs")
        begins[:, n] = timing.record_after(np.asarray(reduction.after_s) - 1e-9)
        bounds[:, n] = reduction.bound
    return begins, bounds


def _index(element: str | None, elements: Mapping[str, int]) -> int:
    """Return the index of an element of the outputs in the array of all outputs.

    None stands for no element: its index leads to a zero behind the outputs. Raises `ValueError`
    for an unknown element.
    """
    if element is None:
        return len(elements)
    if element not in elements:
        known = ", ".join(elements)
        raise ValueError(f"output element {element!r} is unknown; known: {known}")
    return elements[element]
