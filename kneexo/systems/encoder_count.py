"""The count of the encoder, which Drake's `RotaryEncoders` gives as an angle."""

from __future__ import annotations

from typing import Any

from kneexo.systems._leaf import NamedLeaf, leaf_template
from kneexo.systems.drive import nearest_integer


class EncoderCount(NamedLeaf):
    """Computes the whole number of counts of an encoder from its reading.

    n = round(θ/q_θ), with the resolution q_θ. The reading θ is a whole number of counts up to
    rounding errors, so n is the count of the encoder.

    =================  ====  ====  ==================================
    input port         size  unit
    =================  ====  ====  ==================================
    encoder_reading    1     rad   θ, the output of `RotaryEncoders`
    **output port**
    encoder_count      1     1     n
    =================  ====  ====  ==================================

    Stateless, without Context parameters. The derivative is zero, as with `RotaryEncoders`.
    """

    def __init__(self, resolution_rad: float) -> None:
        self._resolution_rad = resolution_rad
        self._reading = self.DeclareVectorInputPort("encoder_reading", 1)
        self._declare_output("encoder_count", 1, self._calc_count, self._reading)

    def _calc_count(self, context: Any) -> list[Any]:
        return [nearest_integer(self._reading.Eval(context)[0] / self._resolution_rad)]


EncoderCount_ = leaf_template(EncoderCount)
"""Template of `EncoderCount` classes by scalar type of Drake."""
