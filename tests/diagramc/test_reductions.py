"""The definition of a reduction: what it refuses."""

import numpy as np
import pytest

from diagramc import REDUCTIONS, Reduction


def test_an_unknown_kind_is_refused_with_all_kinds():
    with pytest.raises(ValueError, match=r"kind = 'max': must be one of maximum, minimum, mean"):
        Reduction("max", "y")
    assert len(set(REDUCTIONS)) == len(REDUCTIONS)


@pytest.mark.parametrize("name", ["after_s", "bound"])
@pytest.mark.parametrize("value", [np.nan, np.inf, np.array([0.0, np.nan]), "a", None])
def test_a_number_that_is_not_finite_is_refused(name, value):
    with pytest.raises(ValueError, match=f"{name}: must be finite"):
        Reduction("count", "y", **{name: value})
