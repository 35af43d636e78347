"""Reductions inside the time loop against the same reductions of records, bit by bit."""

import itertools
import math

import numpy as np
import pytest
from pydrake.symbolic import Variable, log, sin
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import SymbolicVectorSystem, ZeroOrderHold

from diagramc import REDUCTIONS, Reduction, State, compile_diagram
from diagramc.errors import SimulationError
from diagramc.native import reductions as native
from diagramc.native.runner import Runner
from diagramc.native.timing import timing

RUNS = 11
DURATIONS_S = np.linspace(0.0, 0.5, RUNS)
AFTER_S = np.linspace(0.3, 0.0, RUNS)


@pytest.fixture(scope="module")
def model():
    """An oscillator with the outputs ``state``, x and v, and ``held``, x held for 30 ms."""
    t, x, v, a = (Variable(name) for name in ("t", "x", "v", "a"))
    system = SymbolicVectorSystem(
        time=t,
        state=[x, v],
        parameter=[a],
        dynamics=[v, -a * x - 0.3 * v + sin(9.0 * t)],
        output=[x, v],
    )
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", system)
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.03, 2))
    builder.Connect(source.get_output_port(), hold.get_input_port())
    builder.ExportOutput(source.get_output_port(), "state")
    builder.ExportOutput(hold.get_output_port(), "held")
    return compile_diagram(builder.Build())


def runs_of(model, count=RUNS, **options):
    parameters = np.linspace(20.0, 400.0, RUNS)[:count, None]
    state = State(np.array([0.3, -1.0]), np.zeros(2))
    durations = DURATIONS_S[:count]
    return model.simulate_batch(parameters, state, durations, record_period_s=0.004, **options)


def plain(kind, time, values, bound):
    """The reduction of samples by plain sums in the order of the samples."""
    total = 0.0
    if kind in ("variation", "integral"):
        for before, after in itertools.pairwise(values):
            total += abs(after - before) if kind == "variation" else (after + before) * 0.5
        return total * (0.004 if kind == "integral" else 1.0)
    reached = [t for t, value in zip(time, values, strict=True) if value >= bound]
    if kind == "count":
        return len(reached)
    if len(values) == 0 or (kind.endswith("time") and not reached):
        return math.nan
    if kind in ("mean", "rms"):
        for value in values:
            total += value * value if kind == "rms" else value
        return total / len(values) if kind == "mean" else math.sqrt(total / len(values))
    return {
        "maximum": max(values),
        "minimum": min(values),
        "first_time": reached[0] if reached else math.nan,
        "last_time": reached[-1] if reached else math.nan,
    }[kind]


@pytest.mark.parametrize("count", [3, RUNS])
def test_each_kind_is_the_same_reduction_of_the_records(model, count):
    rng = np.random.default_rng(0)
    chosen, samples = [], []
    for kind in (*REDUCTIONS, *REDUCTIONS[::-1]):
        after_s, bound = AFTER_S[:count], rng.normal(0.0, 0.2, count)
        minus, magnitude = rng.choice([None, "held[1]"]), bool(rng.integers(2))
        chosen.append(Reduction(kind, "state[0]", minus, magnitude, after_s, bound))
        samples.append((after_s, bound, minus, magnitude))
    records = runs_of(model, count)
    reduced = runs_of(model, count, reductions=chosen)
    empty = 0
    for run, (record, ours) in enumerate(zip(records, reduced, strict=True)):
        assert ours.outputs == {}
        for n, (after_s, bound, minus, magnitude) in enumerate(samples):
            values = record["state"][:, 0] - (record["held"][:, 1] if minus else 0.0)
            used = record.time_s >= after_s[run] - 1e-9
            values = (np.abs(values) if magnitude else values)[used]
            expected = plain(chosen[n].kind, record.time_s[used], values.tolist(), bound[run])
            np.testing.assert_array_equal(ours.reduced[n], expected, err_msg=chosen[n].kind)
            empty += values.size == 0
    assert empty > 0  # some runs end before their first sample


def test_records_and_reductions_in_one_run(model):
    both = runs_of(model, outputs=["held"], reductions=[Reduction("maximum", "state[1]")])
    for run, record in zip(both, runs_of(model), strict=True):
        np.testing.assert_array_equal(run["held"], record["held"])
        assert run.reduced.tolist() == [record["state"][:, 1].max()]
        np.testing.assert_array_equal(run.final.continuous, record.final.continuous)


@pytest.mark.parametrize("lanes", [1, 8])
def test_pieces_of_a_run_reduce_each_sample_once(model, lanes):
    chosen = [Reduction(kind, "state[0]", bound=0.1) for kind in REDUCTIONS]
    runner = Runner(model.code, lanes=lanes, outputs=(), record_period_s=0.004, reductions=chosen)
    last = np.full(lanes, round(0.2 / runner.timing.tick))
    times = runner.timing.record_times(int(last[0]))

    def run(piece):
        runner.piece = piece
        runner.restart(np.linspace(20.0, 400.0, lanes)[:, None])
        zeros = np.zeros((lanes, len(chosen)))
        runner.reducer.restart(zeros.astype(np.int64), zeros + 0.1)
        x, d = np.full((2, lanes), 0.3), np.zeros((2, lanes))
        record = np.empty((lanes, 0, times.size))
        assert not runner.run(x, d, 0, last, [model.no_inputs] * lanes, record)[:, 0].any()
        return runner.reducer.results(last // runner.timing.record_every + 1, times, 0.004)

    whole = run(10**9)
    assert (whole[:, REDUCTIONS.index("count")] > 1).all()
    for piece in (1, 2, 6):  # the next pieces are longer, and all ends of 2 and 6 are records
        np.testing.assert_array_equal(run(piece), whole)


def test_a_reduced_output_that_is_not_finite_is_named():
    t, a = Variable("t"), Variable("a")
    system = SymbolicVectorSystem(time=t, parameter=[a], output=[t, log(a - t), a, log(a - t)])
    model = compile_diagram(system)
    state = State(np.empty(0), np.empty(0))
    bounds = np.linspace(0.05, 0.2, 9)
    for element in ("y0[0]", "y0[1]"):  # the whole port is checked, as in a record
        runs = model.simulate_batch(
            bounds[:, None],
            state,
            0.1,
            reductions=[Reduction("mean", element), Reduction("count", "y0[2]", bound=bounds)],
            record_period_s=0.01,
            failures="return",
        )
        for n, time in enumerate(("0.05", "0.07", "0.09")):
            assert str(runs[n]).startswith(f"t = {time} s: y0[1] is not finite")
        assert not isinstance(runs[-1], SimulationError)
        mean = 0.05 if element == "y0[0]" else np.log(0.2 - np.arange(11) * 0.01).mean()
        assert runs[-1].reduced == pytest.approx([mean, 11.0], rel=1e-13)  # a >= a counts


def test_wrong_reductions_are_named(model):
    with pytest.raises(ValueError, match=r"element 'state' is unknown; known: state\[0\], state"):
        runs_of(model, reductions=[Reduction("mean", "state")])
    with pytest.raises(ValueError, match=r"'x' is unknown; known"):
        runs_of(model, reductions=[Reduction("mean", "state[0]", minus="x")])
    with pytest.raises(ValueError, match=r"bound: has the shape \(3,\) for 11 runs"):
        runs_of(model, reductions=[Reduction("count", "state[0]", bound=np.zeros(3))])


def test_starts_and_bounds_of_all_runs():
    grid = timing(((0.1, 0.0),), None)
    chosen = [
        Reduction("count", "y", after_s=0.3 - 1e-10, bound=2.0),
        Reduction("count", "y", after_s=np.array([0.0, 0.11]), bound=np.array([1.0, -1.0])),
        Reduction("count", "y", after_s=9.0),
    ]
    begins, bounds = native.starts_and_bounds(chosen, grid, 2)
    assert begins.tolist() == [[3, 0, 90], [3, 2, 90]]
    assert bounds.tolist() == [[2.0, 1.0, 0.0], [2.0, -1.0, 0.0]]
