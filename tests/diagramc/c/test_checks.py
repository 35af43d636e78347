"""Types of the arguments of exports."""

import math

import numpy as np
import pytest

from diagramc.c.checks import distinct_names, require_positive, require_type
from diagramc.errors import CompilationError


def test_numbers_of_numpy_are_numbers():
    for value in (1, 0.5, np.float64(0.5), np.float32(0.5), np.int64(3)):
        require_positive("t", value, "s")


@pytest.mark.parametrize(
    "value", [0, -1.0, math.nan, math.inf, 10**400, True, np.True_, "1", None, 1j]
)
def test_no_positive_number(value):
    with pytest.raises(CompilationError, match=r"^t = .*: must be finite and > 0 s$"):
        require_positive("t", value, "s")


def test_a_string_is_one_name():
    assert distinct_names("inputs", "uv") == ("uv",)
    assert distinct_names("inputs", iter(["u", "v"])) == ("u", "v")


def test_a_long_value_is_one_short_line():
    with pytest.raises(CompilationError, match=r"^a = 'x\\n.*: must be a number$") as error:
        require_type("a", "x\n" * 5000, int, "a number")
    assert len(str(error.value)) < 200
