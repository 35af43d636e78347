"""Faults: a signal that goes wrong, and parameters that change during a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import pydrake.math as drake_math

from kneexo.parameters.device.torque import AS_183
from kneexo.parameters.task.fault import LATEST, LOSING, FaultParameters
from kneexo.systems._leaf import NamedLeaf, discrete_state, leaf_template, where_positive
from kneexo.systems.drive import nearest_integer
from kneexo.systems.load_cell import next_seeds, unit_noise

# Not infinite, because Context parameters, also those of exported C, must be finite.
FOREVER_S = 1e9
"""Duration in s of a fault that does not end."""

_CLOCK = ("start_s", "duration_s", "lead_s", "threshold", "direction")
_RANDOM = ("noise", "dropped")
_SAME = 0.01
"""Part of a sample by which a time may be early, because times are rounded in single precision."""


def context_values(
    parameters: FaultParameters, lead_s: float = 0.0, resolution: float = 1.0
) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `FaultySignal`.

    Parameters
    ----------
    parameters
        The fault.
    lead_s
        Time in s by which the clock starts before ``start_s``. A reader at a sample sees the state
        before the update, so a reading needs one sample time. The command needs 0.
    resolution
        Size of one count in the unit of the signal, for the kind bit_flip.
    """
    above = parameters.above is not None
    size = 2.0**parameters.size if parameters.kind == "bit_flip" else parameters.si_size
    values = {
        "start_s": parameters.begin_s,
        "duration_s": FOREVER_S if parameters.duration_s is None else parameters.duration_s,
        "lead_s": lead_s,
        "threshold": (parameters.above if above else parameters.below) or 0.0,
        "direction": 1.0 if above else -1.0,
        "size": size,
        "resolution": resolution,
    }
    if parameters.kind in _RANDOM:
        seeds = enumerate(parameters.generator_seeds, 1)
        values |= {f"seed_{index}": seed for index, seed in seeds}
    return values


class _Fault(NamedLeaf):
    """Clock of a fault: the number of samples since it began, which counts as 1; zero before.

    c_{k+1} = c_k + 1 if c_k > 0, 1 if t_k + t_lead ≥ t_s and the trigger is positive, else 0.
    The fault is active while 0 < c and (c − 1) T < T_f. Whole numbers are exact in single
    precision.
    """

    _trigger: Any = None

    def _declare_clock(
        self, sample_time_s: float, trigger: tuple[int, int] | None, others: int
    ) -> None:
        """Declare trigger, clock with ``others`` more discrete states, and output ``active``."""
        self._sample_time = sample_time_s
        if trigger is not None:
            size, self._column = trigger
            self._trigger = self.DeclareVectorInputPort("trigger", size)
        self._declare_update(sample_time_s, 1 + others, self._update)
        self._declare_output("active", 1, lambda c: [self._active(c)], self.xd_ticket())

    def _active(self, context: Any) -> Any:
        clock = discrete_state(context)[0]
        rest = self.parameters(context).duration_s - (clock - 1.0 + _SAME) * self._sample_time
        return where_positive(clock, where_positive(rest, 1.0, 0.0), 0.0)

    def _next_clock(self, context: Any) -> Any:
        p, clock = self.parameters(context), discrete_state(context)[0]
        since = context.get_time() + p.lead_s - p.start_s + _SAME * self._sample_time
        begun = where_positive(since, 1.0, 0.0)
        if self._trigger is not None:
            distance = p.direction * (self._trigger.Eval(context)[self._column] - p.threshold)
            begun = where_positive(distance, begun, 0.0)
        return where_positive(clock, clock + 1.0, begun)

    def _update(self, context: Any) -> list[Any]:
        return [self._next_clock(context)]


class FaultySignal(_Fault):
    """A signal that is wrong while the fault is active.

    With the signal u, the size s, the time t since the fault began and the last healthy value u_h:

    ========  ====================================================================
    kind      output while the fault is active
    ========  ====================================================================
    frozen    u_h
    offset    u + s
    drift     u + s t
    scale     s u
    value     s
    noise     u + s n_k, with n_k of `unit_noise`
    dropped   the output before in a random share s of the samples, else u
    late      u of s samples ago
    bit_flip  u ± 2^s q, the bit s of the count u/q is flipped
    ========  ====================================================================

    ===============  ====  ====  ====================================================
    input port       size  unit
    ===============  ====  ====  ====================================================
    signal           n     any   u; the fault changes its first element
    trigger          m     any   only with ``trigger``
    **output port**
    active           1     1     1 while the fault is active, else 0
    signal           n     any   u with the fault
    lost             1     1     1 if the output is an old one, else 0; only frozen and dropped
    ===============  ====  ====  ====================================================

    Discrete states, updated every ``sample_time_s``: the clock of the fault; u_h, or the last
    output for the kind dropped; three states of a generator for the kinds noise and dropped; and
    the last samples for the kind late. ``Simulator.Initialize()`` sets the generator to the seeds.
    Context parameters by name: ``start_s`` (t_s), ``duration_s`` (T_f), ``lead_s`` (t_lead),
    ``size`` (s in SI units, 2^s for bit_flip), ``resolution`` (q), ``threshold``, ``direction`` and
    the seeds. The trigger is positive if direction · (trigger − threshold) > 0. Source: an
    assumption. Lee et al. 2020 do not model faults.

    Parameters
    ----------
    parameters
        The fault.
    sample_time_s
        Time T between two samples in s.
    lead_s, resolution
        As in `context_values`.
    size
        Number n of elements of the signal.
    trigger
        Size of the port ``trigger`` and the index of the element that is compared, or None.
    """

    def __init__(
        self,
        parameters: FaultParameters = FaultParameters(),
        sample_time_s: float = 0.002,
        lead_s: float = 0.0,
        resolution: float = 1.0,
        size: int = 1,
        trigger: tuple[int, int] | None = None,
    ) -> None:
        self._declare_parameters(context_values(parameters, lead_s, resolution))
        self._kind = parameters.kind
        self._random = parameters.kind in _RANDOM
        self._signal = self.DeclareVectorInputPort("signal", size)
        others = 0
        if self._random:
            others = len(AS_183)
        elif self._kind == "late":
            others = LATEST
        self._declare_clock(sample_time_s, trigger, 1 + others)
        if self._random:
            self._declare_initialization(self._initialize)
        self._output = self._declare_output(
            "signal", size, self._calc_signal, self._signal, self.xd_ticket()
        )
        if self._kind in LOSING:
            self._declare_output("lost", 1, self._calc_lost, self.xd_ticket())

    def _calc_signal(self, context: Any) -> list[Any]:
        first, *rest = self._signal.Eval(context)
        return [where_positive(self._active(context), self._faulty(context, first), first), *rest]

    def _calc_lost(self, context: Any) -> list[Any]:
        _, _, *seeds = discrete_state(context)
        active = self._active(context)
        if self._kind == "dropped":
            drops = self.parameters(context).size - _uniform(seeds)
            return [where_positive(drops, active, 0.0)]
        return [active]

    def _faulty(self, context: Any, value: Any) -> Any:
        p = self.parameters(context)
        clock, last, *others = discrete_state(context)
        if self._kind == "late":
            for age, sample in enumerate(others):
                value = where_positive(p.size - 0.5 - age, sample, value)
            return value
        if self._kind == "frozen":
            return last
        if self._kind == "offset":
            return value + p.size
        if self._kind == "drift":
            return value + p.size * (clock - 1.0) * self._sample_time
        if self._kind == "scale":
            return p.size * value
        if self._kind == "value":
            return p.size
        if self._kind == "noise":
            return value + p.size * unit_noise(others)
        if self._kind == "dropped":
            return where_positive(p.size - _uniform(others), last, value)
        count = nearest_integer(value / p.resolution)
        bit = drake_math.floor(count / p.size) - 2.0 * drake_math.floor(0.5 * count / p.size)
        return value + p.resolution * p.size * (1.0 - 2.0 * bit)

    def _initialize(self, context: Any) -> list[Any]:
        return [0.0, 0.0, *self.parameters(context)[-len(AS_183) :]]

    def _update(self, context: Any) -> list[Any]:
        _, last, *others = discrete_state(context)
        healthy = self._output.Eval(context)[0]
        if self._kind != "dropped":  # which repeats the value of the sample before
            healthy = where_positive(self._active(context), last, self._signal.Eval(context)[0])
        if self._kind == "late":
            others = [self._signal.Eval(context)[0], *others[:-1]]
        if self._random:
            others = next_seeds(others)
        return [self._next_clock(context), healthy, *others]


def _uniform(seeds: Sequence[Any]) -> Any:
    """Return a random number in 0…1 from the states of AS 183 (Wichmann and Hill 1982)."""
    total = sum(seed / m for (m, _), seed in zip(AS_183, seeds, strict=True))
    return total - drake_math.floor(total)


def offset_values(parameters: FaultParameters, offsets: Mapping[str, float]) -> dict[str, float]:
    """Return a dictionary {name: value} of the Context parameters of `ParameterFault`."""
    clock = context_values(parameters)
    return {name: clock[name] for name in _CLOCK} | {
        f"offset_{index}": offset for index, offset in enumerate(offsets.values())
    }


class ParameterFault(_Fault):
    """Offsets of Context parameters of another system while a fault is active.

    ===============  ====  ====  ====================================================
    input port       size  unit
    ===============  ====  ====  ====================================================
    trigger          m     any   only with ``trigger``
    **output port**
    active           1     1     1 while the fault is active, else 0
    offsets          n     any   changes of the parameters, for the port ``fault``
    ===============  ====  ====  ====================================================

    The discrete state is the clock of the fault. Context parameters by name: ``start_s``,
    ``duration_s``, ``lead_s``, ``threshold``, ``direction``, and ``offset_0``, ``offset_1``, … in
    the order of ``offsets``. Source: an assumption. Lee et al. 2020 do not
    model faults.

    Parameters
    ----------
    parameters
        The fault.
    offsets
        Names of the changed Context parameters of the other system, and their changes, faulty minus
        healthy value.
    sample_time_s
        Time between two samples in s.
    trigger
        As in `FaultySignal`.
    """

    def __init__(
        self,
        parameters: FaultParameters = FaultParameters(),
        offsets: Mapping[str, float] = MappingProxyType({"size": 0.0}),
        sample_time_s: float = 0.002,
        trigger: tuple[int, int] | None = None,
    ) -> None:
        self._declare_parameters(offset_values(parameters, offsets))
        self._declare_clock(sample_time_s, trigger, 0)
        self._size = len(offsets)
        self._declare_output("offsets", self._size, self._calc_offsets, self.xd_ticket())

    def _calc_offsets(self, context: Any) -> list[Any]:
        active = self._active(context)
        return [active * offset for offset in self.parameters(context)[-self._size :]]


FaultySignal_ = leaf_template(FaultySignal)
"""Template of `FaultySignal` classes by scalar type of Drake."""
ParameterFault_ = leaf_template(ParameterFault)
"""Template of `ParameterFault` classes by scalar type of Drake."""
