"""Types and ranges of arguments, and the messages for wrong ones."""

import math

import numpy as np
import pytest

from diagramc import ParameterError
from diagramc.arguments import names, number, positive


def test_a_text_is_one_name_and_names_keep_their_order():
    assert names("inputs", "torque") == ("torque",)
    assert names("inputs", (name for name in ("b", "a"))) == ("b", "a")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (None, "inputs = None: must be a list of names"),
        (3, "inputs = 3: must be a list of names"),
        ([3], "inputs: has 3; must be names"),
        (["a\x00", "a\x00"], r"inputs: has 'a\x00' twice; give each name once"),
    ],
)
def test_names_of_another_type_are_refused(value, message):
    with pytest.raises(ParameterError) as caught:
        names("inputs", value)
    assert str(caught.value) == message


def test_a_long_name_is_shortened():
    with pytest.raises(ParameterError) as caught:
        names("inputs", ["x" * 5000] * 2)
    assert len(str(caught.value)) < 400


def test_real_numbers_of_any_type_become_floats():
    for value in (2, 2.0, np.float32(2.0), np.int64(2)):
        result = positive("step_s", value, "s")
        assert (result, type(result)) == (2.0, float)
    assert number("tolerance", math.inf, "", ">= 0", lambda x: x >= 0.0) == math.inf


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("1", "step_s = '1': must be a number, finite and > 0"),
        (True, "step_s = True: must be a number, finite and > 0"),
        (1j, "step_s = 1j: must be a number, finite and > 0"),
        (0, "step_s = 0 s: must be finite and > 0"),
        (math.nan, "step_s = nan s: must be finite and > 0"),
    ],
    ids=lambda value: str(value)[:10],
)
def test_other_values_are_refused(value, message):
    with pytest.raises(ParameterError) as caught:
        positive("step_s", value, "s")
    assert str(caught.value) == message


def test_an_integer_beyond_the_largest_float_is_refused():
    for value in (10**400, -(10**400)):
        with pytest.raises(ParameterError, match=r"tolerance = .* … 0+: must be a number, >= 0"):
            number("tolerance", value, "", ">= 0", lambda x: x >= 0.0)
