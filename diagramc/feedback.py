"""Runs of a compiled model in which a Python function sets an open input at each sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .model import CompiledModel, Simulation
from .model_base import not_finite
from .native.arguments import OK
from .native.runner import Runner
from .run_data import Array, InputTable, State, slices


def simulate_with_feedback(
    model: CompiledModel,
    parameters: Array,
    state: State,
    duration_s: float,
    feedback: Callable[[float, Mapping[str, Array]], Any],
    *,
    feedback_input: str,
    feedback_outputs: Sequence[str],
    sample_period_s: float,
    outputs: Sequence[str] | None = None,
    inputs: InputTable | None = None,
    **options: Any,
) -> Simulation:
    """Run a model; call a Python function once a sample, and hold its result as an open input.

    At each sample before the end, the function gets the time in s and the values that the output
    ports have before the updates at the sample. The updates already see the result of the function.
    A sample costs about 20 µs and the time that the function takes.

    Parameters
    ----------
    model, parameters, state, duration_s, options
        As in `CompiledModel.simulate`.
    feedback
        Function of the time in s and a dictionary from the name of each port of
        ``feedback_outputs`` to its values. The function returns the values of the open input.
    feedback_input
        Name of the open input.
    feedback_outputs
        Names of the output ports whose values the function gets. The ports must not depend on the
        open input at the same time.
    sample_period_s
        Time between two calls, and between two records, in s.
    outputs
        Names of the output ports to record; all by default.
    inputs
        All open inputs; the values of ``feedback_input`` in this table are ignored.

    Raises
    ------
    SimulationError, ParameterError
        As in `CompiledModel.simulate`. Also if the function returns a number that is not finite.
    ValueError
        A port of ``feedback_outputs`` depends on the only open input at the same time.
    """
    direct = model.feedthrough.intersection(feedback_outputs)
    if direct and set(model.inputs) == {feedback_input}:
        raise ValueError(
            f"{', '.join(sorted(direct))}: depends on {feedback_input} at the same time"
        )
    recorded = tuple(model.outputs if outputs is None else outputs)
    names = tuple(dict.fromkeys((*recorded, *feedback_outputs)))
    runner = Runner(model.code, outputs=names, record_period_s=sample_period_s, **options)
    table = inputs or model.no_inputs
    table = InputTable(table.breaks, table.coefficients.copy())
    held = table.coefficients[:, slices(model.inputs)[feedback_input]]
    held[:] = 0.0
    columns, width = slices({name: model.outputs[name] for name in names}), runner.columns.size
    x, d = (values.reshape(-1, 1).copy() for values in (state.continuous, state.discrete))
    last = np.zeros(1, dtype=np.int64)
    row = np.empty((1, width, 1))
    rows_of_parameters = model.checked_parameters(np.asarray(parameters, dtype=float)[None])
    every = runner.timing.record_every
    samples = int(duration_s / runner.timing.tick * (1.0 + 1e-12)) // every + 1
    last_tick = (samples - 1) * every
    runner.restart(rows_of_parameters, np.array([last_tick]))
    runner.bind(x, d, last, row)
    record = np.empty((samples, width))

    def run(tick: int, until: int, *, record_rows: int) -> None:
        """Advance x and d from a tick to another, and record ``record_rows`` rows in ``row``."""
        last[0] = until
        status = runner.call_once(tick, until, record_rows, [table])[0].tolist()
        if status[0] != OK or until == last_tick:
            final = State(x[:, 0].copy(), d[:, 0].copy())
            if error := model.fault(status, runner, rows_of_parameters[0], final):
                raise error

    for sample in range(samples):
        tick = sample * every
        # From the tick to itself: the run only records, with the states before the updates.
        run(tick, tick, record_rows=1)
        record[sample] = values = row[0, :, 0]
        if sample == samples - 1:
            break
        time_s = runner.timing.times(tick)
        read = {name: values[columns[name]].copy() for name in feedback_outputs}
        held[:, :, 0] = feedback(time_s, read)
        if not np.isfinite(held[0, :, 0]).all():
            raise not_finite(time_s, feedback_input)
        run(tick, tick + every, record_rows=0)
    times = runner.timing.times(np.arange(samples) * every)
    data = {name: record[:, columns[name]] for name in recorded}
    return Simulation(times, data, State(x[:, 0].copy(), d[:, 0].copy()))
