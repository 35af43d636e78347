"""How runs end, and the comparison of the ends of a run and of its repetition."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from .errors import Error, SimulationError, escaped, shortened
from .json_files import mapping_of, number_of, numbers_of, text_of
from .native.llvm import processor


@dataclass(frozen=True)
class RunEnd:
    """How a run ended.

    ``error`` is the name of the error's class. ``error`` and ``message`` are empty if the run
    succeeded. ``time_s`` is the time of the end in s, and ``state`` maps the name of each state to
    its value at the end. If they are unknown, ``time_s`` is nan and ``state`` is empty.
    """

    error: str
    message: str
    time_s: float
    state: Mapping[str, float]

    @classmethod
    def of(cls, error: Error) -> RunEnd:
        """Return the end of a run that raised ``error``."""
        time_s, state = math.nan, dict[str, float]()
        if isinstance(error, SimulationError):
            time_s, state = error.time_s, dict(error.state)
        return cls(type(error).__name__, str(error), time_s, state)

    @classmethod
    def from_plain(cls, data: Any) -> RunEnd:
        """Return the end whose `plain` data are ``data``; raise `ParameterError` for other data."""
        entries = mapping_of("end", data)
        return cls(
            text_of("end.error", entries.get("error")),
            text_of("end.message", entries.get("message")),
            number_of("end.time_s", entries.get("time_s"), finite=False),
            numbers_of("end.state", entries.get("state"), finite=False),
        )

    def plain(self) -> dict[str, Any]:
        """Return the end as JSON data, in which texts stand for numbers that are not finite."""
        state = {name: _plain(value) for name, value in self.state.items()}
        return asdict(self) | {"time_s": _plain(self.time_s), "state": state}

    def difference(self, other: RunEnd) -> str:
        """Return in one line how ``other`` differs; an empty text if all bits are equal."""
        if (self.error, self.message) != (other.error, other.message):
            return f"the run now ends with {_sentence(other)}, not with {_sentence(self)}"
        if repr(self.time_s) != repr(other.time_s):
            return f"the run now ends at t = {other.time_s!r} s, not at t = {self.time_s!r} s"
        if self.state.keys() != other.state.keys():
            return "the run now has other states"
        for name, value in self.state.items():
            if repr(value) != repr(other.state[name]):  # also for nan and for -0.0
                return f"{name} now ends at {other.state[name]!r}, not at {value!r}"
        return ""


def _sentence(end: RunEnd) -> str:
    return f"{end.error}: {shortened(end.message, 200)}" if end.error else "success"


@dataclass(frozen=True)
class Replay:
    """The repetition of a run: how it ended, and how that differs from the recorded end."""

    end: RunEnd
    difference: str
    """The first difference between the ends in one line; empty if all bits are equal."""
    changes: tuple[str, ...]
    """What changed since the file was written, such as the version of Drake, one line each."""

    @property
    def same(self) -> bool:
        """True if the run ended with the same error, at the same time, in the same state."""
        return not self.difference

    def __str__(self) -> str:
        """Return the end, the comparison with the recorded end, and the changes, a line each."""
        end = self.end.message or f"t = {self.end.time_s:.6g} s: the run succeeds"
        same = "same end" + (", with the same bits of all states" if self.end.state else "")
        return "\n".join([end, self.difference or same, *self.changes])


def _plain(value: float) -> float | str:
    return value if math.isfinite(value) else repr(value)


def run_versions() -> dict[str, str]:
    """Return what decides the bits of a run beside its equations: versions, and the processor."""
    target = processor()
    digest = hashlib.sha256(target.key.encode()).hexdigest()[:8]
    return {"drake": version("drake"), "processor": f"{target.name}, {digest}"}


def version_changes(then: Any, now: Mapping[str, str]) -> tuple[str, ...]:
    """Return a line for each text of ``now`` that differs from that in ``then``.

    ``then`` are the `run_versions` that a file had, or any other JSON data of a damaged file.
    """
    before = then if isinstance(then, Mapping) else {}
    return tuple(
        f"{name} changed since the file was written: {_short(before.get(name))}, now {_short(text)}"
        for name, text in now.items()
        if before.get(name) != text
    )


def _short(text: Any) -> str:
    return shortened(escaped(str(text)), 24)
