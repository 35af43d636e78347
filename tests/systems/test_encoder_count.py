"""The count of the encoder against Drake's `RotaryEncoders` and the floor of its definition."""

import math

import numpy as np
import pytest
from pydrake.systems.sensors import RotaryEncoders

from diagramc.testing import check_leaf
from kneexo.parameters import EncoderParameters
from kneexo.systems import EncoderCount


def test_conversions_agree():
    check_leaf(EncoderCount(0.1), {"encoder_reading": (-9.0, 9.0)})


@pytest.mark.parametrize("counts_per_revolution", [256, 1000, 4096, 65_536])
def test_each_reading_has_its_count(counts_per_revolution):
    """Angles are counts and a half, so that the floor is known; readings are those of Drake."""
    resolution = EncoderParameters(counts_per_revolution=counts_per_revolution).resolution_rad
    encoder, system = RotaryEncoders([counts_per_revolution]), EncoderCount(resolution)
    contexts = encoder.CreateDefaultContext(), system.CreateDefaultContext()
    random = np.random.default_rng(1)
    numbers = {*range(-20, 20), *random.integers(-(10**6), 10**6, 300).tolist()}
    for number in numbers:
        angle = (number + 0.5) / counts_per_revolution * 2.0 * math.pi
        encoder.get_input_port().FixValue(contexts[0], [angle])
        reading = encoder.get_output_port().Eval(contexts[0])
        system.get_input_port().FixValue(contexts[1], reading)
        assert system.get_output_port().Eval(contexts[1])[0] == number
