"""Open inputs in machine code against the input table in Python, at breaks and between them."""

import numpy as np
import pytest
from pydrake.systems.primitives import PassThrough

from diagramc import InputTable, State, compile_diagram
from diagramc.native.arguments import INPUT
from diagramc.native.ir import Array, Module
from diagramc.native.llvm import Library, compile_text
from diagramc.native.open_inputs import define_inputs
from diagramc.native.types import DOUBLE, POINTER


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


def test_rates_are_derivatives_of_the_polynomials():
    table = InputTable(
        [0.5, 1.0], np.random.default_rng(1).integers(-4, 5, (3, 2, 4)).astype(float)
    )
    module = Module()
    evaluate = define_inputs(module, 2, rates=True)
    f = module.function("run", dict.fromkeys(("t", "table", "u"), POINTER), internal=False)
    time = Array(f.arguments["t"], DOUBLE)[0]
    f.call(evaluate, time, f.arguments["table"], f.arguments["u"])
    run = Library(compile_text(module.text())).function("run", 3)
    addresses = {name: getattr(table, name).ctypes.data for name in ("breaks", "coefficients")}
    numbers = {"break_count": 2, "powers": 4} | addresses
    argument, u = np.array([numbers[name] for name in INPUT]), np.empty(4)
    rates = InputTable(table.breaks, table.coefficients[..., 1:] * np.arange(1.0, 4.0))
    for t in (0.25, 0.5, 0.75, 1.0, 1.5):
        run(np.array([t]).ctypes.data, argument.ctypes.data, u.ctypes.data)
        np.testing.assert_array_equal(u, [*table.value(t), *rates.value(t)])  # no rounding
