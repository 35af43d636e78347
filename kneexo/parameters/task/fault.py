"""Parameters of a fault: the place that fails, how it fails, and when."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import model_validator

from kneexo.errors import close_names, question, shown
from kneexo.parameters.device.plant import RPM
from kneexo.parameters.device.torque import generator_seeds
from kneexo.parameters.fields.quantity import Parameters, choice, quantity

Kind = Literal[
    "frozen", "offset", "drift", "scale", "noise", "dropped", "late", "bit_flip", "value"
]  # fmt: skip
"""Kinds of faults. A parameter has the kind ``value`` alone."""


OPERATOR_INPUTS = ("emergency_stop", "reset")
"""Buttons of the protection. A fault of the kind ``value`` and the size 1 presses one."""

FAULTY_SIGNALS = {
    "encoder": math.pi / 180.0,
    "load_cell": 1.0,
    "command": RPM,
    **dict.fromkeys(OPERATOR_INPUTS, 1.0),
}
"""The signals that can be faulty, each with the SI units of one unit of a fault's size.

The encoder's reading has sizes in deg, the load cell's in N, and the speed command in rpm.
"""

_UNITS = {"encoder": "deg", "load_cell": "N", "command": "rpm"}
_AMOUNTS = ("offset", "drift", "noise", "value")
"""Kinds of a signal with a size in the unit of the signal."""

LOSING = ("frozen", "dropped")
"""Kinds that lose samples, so that the last one stays."""

LATEST = 10
"""Largest number of samples by which a signal can be late."""

_LARGEST = {"encoder": 1e4, "load_cell": 1e6, "command": 1e6}
"""Largest magnitude of an amount, in the unit of the signal."""

_SIZES = {
    "scale": (-100.0, 100.0),
    "dropped": (1e-6, 1.0),
    "late": (1.0, LATEST),
    "bit_flip": (0.0, 15.0),
}
"""Least and largest size of a fault, by kind."""


class FaultParameters(Parameters):
    """A fault: a place, a kind, a size, and a trigger.

    The ``place`` is one of `FAULTY_SIGNALS`, or the dotted path of a parameter of the scenario. The
    fault begins at ``start_s``. With ``signal`` it begins at the first sample from ``start_s`` on
    at which the signal is above or below the threshold. With ``mttf_s`` it begins after ``start_s``
    by a random time. It begins once, and ends after ``duration_s``.
    """

    place: str = choice(
        "encoder",
        "encoder, load_cell or command; emergency_stop or reset, which a fault presses; or the "
        "path of a number of plant, wearer or load_cell, as "
        "plant.pump.internal_leakage_m3_per_s_pa",
    )
    kind: Kind = choice(
        "frozen",
        "frozen: the last value stays; offset: plus the size; drift: plus the size each second; "
        "scale: times the size; noise: plus random numbers of this standard deviation; dropped: "
        "this share of samples repeats the value before; late: by this number of samples; "
        "bit_flip: of the bit with this number in the encoder count; value: the signal, or the "
        "parameter at the path, has this value",
    )
    size: float = quantity(
        0.0,
        "by place",
        "assumption: none; in the unit that the kind and the place have",
        ge=-1e12,
        le=1e12,
    )
    start_s: float = quantity(
        10.0, "s", "assumption: after the transient of the start", ge=0, le=1e5
    )
    duration_s: float | None = quantity(
        None, "s", "assumption: for ever, if left out", ge=1e-5, le=1e5
    )
    signal: str | None = choice(
        None, "left out: none; a column of signals.csv that is compared with above or below"
    )
    above: float | None = quantity(
        None, "by signal", "given by the user: upper threshold, if any", ge=-1e12, le=1e12
    )
    below: float | None = quantity(
        None, "by signal", "given by the user: lower threshold, if any", ge=-1e12, le=1e12
    )
    mttf_s: float | None = quantity(
        None,
        "s",
        "given by the user: mean time to failure, if any; the time from start_s to the fault is "
        "exponentially distributed",
        gt=0,
        le=1e12,
    )
    seed: int = quantity(
        0, "1", "assumption: selects noise, dropped samples and time to failure", ge=0, le=2**31 - 1
    )

    @property
    def si_size(self) -> float:
        """Size in SI units. Factors, shares, counts and values of parameters stay as they are."""
        if self.kind in _AMOUNTS:
            return self.size * FAULTY_SIGNALS.get(self.place, 1.0)
        return self.size

    @property
    def size_unit(self) -> str:
        """Unit of a size that is an amount of the signal, such as deg; otherwise an empty text."""
        unit = _UNITS.get(self.place, "") if self.kind in _AMOUNTS else ""
        return f"{unit}/s" if self.kind == "drift" else unit

    @property
    def begin_s(self) -> float:
        """Time in s at which the fault begins, or from which on its signal starts it.

        With ``mttf_s`` M it is ``start_s`` − M ln(1 − U), with a uniform random number U that
        place, kind and seed select.
        """
        if self.mttf_s is None:
            return self.start_s
        sequence = np.random.SeedSequence([self.seed, *f"{self.place} {self.kind}".encode()])
        share = float(sequence.generate_state(1, np.uint64)[0] / 2.0**64)
        return self.start_s - self.mttf_s * math.log1p(-share)

    @property
    def end_s(self) -> float:
        """End in s of a fault that begins at ``begin_s``; inf without ``duration_s``."""
        return math.inf if self.duration_s is None else self.begin_s + self.duration_s

    def permanent(self, start_s: float) -> FaultParameters:
        """Return the fault that begins at ``start_s``, or later by its signal, and does not end."""
        return self.changed({"start_s": start_s, "duration_s": None, "mttf_s": None})

    @property
    def generator_seeds(self) -> tuple[float, ...]:
        """Initial states of the generators of random numbers."""
        return generator_seeds(self.seed)

    @model_validator(mode="after")
    def _consistent(self) -> FaultParameters:
        if "." not in self.place and self.place not in FAULTY_SIGNALS:
            near = question(close_names(self.place, FAULTY_SIGNALS))
            raise ValueError(
                f"place = {shown(self.place)}: must be {', '.join(FAULTY_SIGNALS)}, or the path of "
                f"a number{near}"
            )
        if self.place not in _UNITS and self.kind != "value":
            raise ValueError(
                f"kind = {self.kind} at place = {shown(self.place)}: must be value, except for "
                f"{', '.join(_UNITS)}"
            )
        if self.place in OPERATOR_INPUTS and self.size != 1.0:
            raise ValueError(f"size = {self.size:g} at place = {self.place}: must be 1")
        if self.kind == "bit_flip" and self.place != "encoder":
            raise ValueError(f"kind = bit_flip at place = {self.place}: must be at the encoder")
        unit = f" {self.size_unit}".rstrip()
        subject = f"size = {self.size:g}{unit} of kind = {self.kind}"
        if self.kind == "frozen" and self.size:
            raise ValueError(f"{subject}: must be left out")
        neutral = {"offset": 0.0, "drift": 0.0, "noise": 0.0, "scale": 1.0}.get(self.kind)
        if self.size == neutral:
            raise ValueError(f"{subject}: has no effect; give another size")
        largest = _LARGEST.get(self.place, math.inf) if self.kind in _AMOUNTS else math.inf
        low, high = _SIZES.get(self.kind, (0.0 if self.kind == "noise" else -largest, largest))
        whole = self.kind not in ("late", "bit_flip") or self.size == round(self.size)
        if not (low <= self.size <= high and whole):
            what = "" if whole else "a whole number, "
            raise ValueError(f"{subject}: must be {what}{low:g} … {high:g}{unit}")
        if (self.signal is None) != (self.above is None and self.below is None):
            raise ValueError("signal: must have above or below, and a threshold must have a signal")
        if self.above is not None and self.below is not None:
            raise ValueError("above, below: must be one of both, not both")
        return self
