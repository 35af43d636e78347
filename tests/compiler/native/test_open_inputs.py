"""Open inputs in machine code against the input table in Python, at breaks and between them."""

import numpy as np
import pytest
from pydrake.systems.primitives import PassThrough

from kneexo.compiler import InputTable, State, compile_diagram


@pytest.mark.parametrize("breaks", [0, 1, 2, 3])
def test_machine_code_has_the_values_of_the_table(breaks):
    rng = np.random.default_rng(breaks)
    model = compile_diagram(PassThrough(2), inputs=["u"])
    # Breaks at records, where a value belongs to the segment on the right except at the last one.
    table = InputTable(
        0.25 * np.arange(1, breaks + 1), rng.integers(-4, 5, (breaks + 1, 2, 3)).astype(float)
    )
    run = model.simulate(
        model.parameters(),
        State(np.empty(0), np.empty(0)),
        1.0,
        inputs=table,
        record_period_s=0.125,
        integrator="rk4",
    )
    expected = [table.value(time) for time in run.time_s]  # powers of two: no rounding
    np.testing.assert_array_equal(run["y"], expected)
