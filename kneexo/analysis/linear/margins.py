"""Stability margins of a sampled loop: gain, phase, delay and disk margins."""

from __future__ import annotations

import math
from dataclasses import dataclass

from diagramc import LoopMargins, Transfer, margins
from kneexo.common.result import Result
from kneexo.parameters.criteria import SOUND_DISK_MARGIN


@dataclass(frozen=True, repr=False)
class Margins(Result, LoopMargins):
    """Stability margins of a sampled loop, broken at the motor speed command.

    `diagramc.LoopMargins` describes the numbers. Only frequencies up to the Nyquist
    frequency count.
    """


def stability_margins(loop: Transfer) -> Margins:
    """Return gain, phase, delay and disk margins of a loop as `diagramc.margins` does."""
    return Margins(**vars(margins(loop)))


def soundness(disk_margin: float, least: float = SOUND_DISK_MARGIN) -> str:
    """Return the verdict on a disk margin: sound, small margin, or unstable for nan."""
    if math.isnan(disk_margin):
        return "unstable"
    return "sound" if disk_margin >= least else "small margin"
