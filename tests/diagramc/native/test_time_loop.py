"""Runs in lanes against the same runs alone, bit by bit, failures included."""

import signal
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from diagramc import InputTable, Reduction, ResumableState, State
from diagramc.diagram_equations import equations_key
from diagramc.equations.equations import Equations, Limit, Update
from diagramc.equations.graph import Graph
from diagramc.errors import SimulationError
from diagramc.model import CompiledModel, Simulation
from diagramc.native import runner as runner_module
from diagramc.native.arguments import INTEGRATORS, OUTSIDE
from diagramc.native.machine_code import MachineCode
from diagramc.native.runner import Runner, Snapshots

property_test = settings(max_examples=12, derandomize=True)
COUNTS = (1, 3, 7, 8, 9, 17)
RATES = ((0.004, 0.0), (0.010, 0.015))


def model_of(equations):
    return CompiledModel(MachineCode(equations_key(equations), equations))


def sources(graph, **counts):
    return SimpleNamespace(
        **{kind: [graph.source(kind, i) for i in range(count)] for kind, count in counts.items()}
    )


def mixed():
    """An oscillator with a cubic damping that may be negative, sampled at two rates."""
    g = Graph()
    s = sources(g, state=2, discrete=3, parameter=3, input=2)
    (x, v), (d, e, n), (p, q, r) = s.state, s.discrete, s.parameter
    scaled = g.multiply(x, g.constant(1000.0)), g.multiply(v, g.constant(40.0))
    counts = [g.node("floor", value) for value in scaled]
    inner = [g.node("cos", g.node("sin", g.multiply(r, count))) for count in counts]
    costly, *tables = (g.node("tanh", g.node("sin", value)) for value in inner)
    tables.append(g.node("tanh", g.node("tan", inner[0])))
    force = g.add(g.multiply(q, v, v, v), g.multiply(g.constant(-1.0), p, x), d, s.input[0])
    forward = g.where(g.node("gt", v, g.zero), g.multiply(v, r), g.zero)
    return Equations(
        graph=g,
        parameters=["p", "q", "r"],
        states=["plant.x", "plant.v"],
        discrete=["a", "b", "c"],
        inputs={"force": 1, "command": 1},
        derivatives=[v, g.subtract(force, forward)],
        initial_discrete=[s.input[1], x, n],
        updates=[
            Update(*RATES[0], ((0, g.subtract(s.input[1], costly)), (2, g.add(n, g.one, costly)))),
            Update(*RATES[1], ((1, g.add(e, g.multiply(x, g.source("time")))),)),
        ],
        outputs={"x": [x, v], "held": [d, e, n], "costly": [costly, g.source("time"), *tables]},
        limits=[
            Limit("plant", g.subtract(g.constant(2.0), g.node("abs", x))),
            Limit("counter", g.subtract(g.constant(8.0), e)),
        ],
    )


def without_states():
    """A counter of samples, driven by an input and the time."""
    g = Graph()
    s = sources(g, discrete=2, parameter=1, input=1)
    (d, e), (p,), (u,) = s.discrete, s.parameter, s.input
    wave = g.node("sin", g.multiply(p, g.source("time")))
    return Equations(
        graph=g,
        parameters=["p"],
        discrete=["d", "e"],
        inputs={"u": 1},
        initial_discrete=[d, e],
        updates=[Update(0.003, 0.001, ((0, g.add(d, u, wave)), (1, g.node("floor", d))))],
        outputs={"y": [d, e, wave]},
        limits=[Limit("counter", g.subtract(g.constant(3.0), d))],
    )


def without_discrete():
    """Three states of which one chatters about zero with a strength of its parameter."""
    g = Graph()
    s = sources(g, state=3, parameter=2, input=1)
    (x, y, z), (p, q), (u,) = s.state, s.parameter, s.input
    sign = g.where(g.node("gt", x, g.zero), g.one, g.constant(-1.0))
    return Equations(
        graph=g,
        parameters=["p", "q"],
        states=["x", "y", "z"],
        inputs={"u": 1},
        derivatives=[
            g.subtract(g.node("sin", z), g.multiply(p, sign)),
            g.add(g.multiply(q, y, y), g.node("cos", x)),
            g.add(u, g.multiply(g.constant(-3e3), z)),
        ],
        outputs={"y": [x, y, z]},
    )


MODELS = {"mixed": mixed, "without states": without_states, "without discrete": without_discrete}
SLOW_MODELS = [pytest.param(n, marks=pytest.mark.slow) for n in ("mixed", "without discrete")]
QUICK = {("mixed", "rk4"), *(("without states", integrator) for integrator in INTEGRATORS)}
RUNS = [
    pytest.param(name, integrator, marks=() if (name, integrator) in QUICK else pytest.mark.slow)
    for name in MODELS
    for integrator in INTEGRATORS
]


@pytest.fixture(scope="module")
def models():
    return {name: model_of(make()) for name, make in MODELS.items()}


def random_runs(model, seed, count):
    """Parameters, states, durations and inputs; some runs diverge or leave their limits."""
    rng = np.random.default_rng(seed)
    size = len(model.parameter_names)
    parameters = rng.uniform(0.5, 2.0, (count, size)) * 10.0 ** rng.uniform(-1.0, 2.0, size)
    parameters[:, 1:2] = rng.choice([-1.0, 0.0, 3.0, 100.0], (count, min(size - 1, 1)))
    states = [
        State(rng.normal(size=len(model.state_names)), rng.normal(size=len(model.discrete_names)))
        for _ in range(count)
    ]
    if model.state_names and rng.random() < 0.5:
        states[rng.integers(count)].continuous[-1] = rng.choice([np.nan, np.inf, 1e200])
    durations = rng.choice([0.0, 0.002, 0.012, 0.05, 0.09, 0.1, 0.2], count)
    tables = []
    for _ in range(count):
        breaks = np.sort(rng.choice(1000, rng.integers(4), replace=False)) * 1e-4
        if rng.random() < 0.5:  # at instants
            breaks = np.unique(np.round(breaks * 1e3)) * 1e-3
        shape = (breaks.size + 1, sum(model.inputs.values()), rng.integers(1, 4))
        tables.append(InputTable(breaks, rng.normal(size=shape)))
    return parameters, states, durations, tables


def alone(model, parameters, state, duration, table, **options):
    try:
        return model.simulate(parameters, state, duration, inputs=table, **options)
    except SimulationError as error:
        return error


def assert_same_run(run, expected):
    assert type(run) is type(expected)
    if isinstance(expected, SimulationError):
        assert str(run) == str(expected)
        return
    assert list(run.outputs) == list(expected.outputs)
    for name, values in expected.outputs.items():
        np.testing.assert_array_equal(run[name].view(np.int64), values.view(np.int64))
    np.testing.assert_array_equal(run.time_s, expected.time_s)
    np.testing.assert_array_equal(run.reduced, expected.reduced)
    for ours, theirs in (
        (run.final.continuous, expected.final.continuous),
        (run.final.discrete, expected.final.discrete),
    ):
        np.testing.assert_array_equal(ours.view(np.int64), theirs.view(np.int64))


def assert_as_alone(model, runs, **options):
    parameters, states, durations, tables = runs
    batch = model.simulate_batch(
        parameters, states, durations, inputs=tables, failures="return", threads=1, **options
    )
    for run, *arguments in zip(batch, parameters, states, durations, tables, strict=True):
        assert_same_run(run, alone(model, *arguments, **options))
    return batch


ENDS = {
    "is not finite": {("mixed", "without discrete"): INTEGRATORS},
    "left its limits": {("mixed", "without states"): INTEGRATORS},
    "cannot hold its tolerance": {("without discrete",): ("exact_hold",)},
}
"""Errors of which models and integrators the random runs must show."""


@pytest.mark.parametrize(("name", "integrator"), RUNS)
def test_runs_in_lanes_are_the_runs_alone(models, name, integrator):
    texts = []

    @property_test
    @given(
        seed=st.integers(0, 2**32 - 1),
        count=st.sampled_from(COUNTS),
        record_period_s=st.sampled_from((0.01, 0.03)),
    )
    def check(seed, count, record_period_s):
        options = {"integrator": integrator, "step_s": 7e-4, "record_period_s": record_period_s}
        batch = assert_as_alone(models[name], random_runs(models[name], seed, count), **options)
        texts.extend(str(run) for run in batch if isinstance(run, SimulationError))

    check()
    for text, cases in ENDS.items():
        for names, integrators in cases.items():
            if name in names and integrator in integrators:
                assert any(text in end for end in texts), text


@pytest.mark.parametrize(("name", "integrator"), RUNS)
def test_records_at_given_times_in_lanes_are_those_alone_and_do_not_change_the_run(
    models, name, integrator, monkeypatch
):
    """Records at samples are those of a run on the grid; calls of one tick have the same bits."""
    model, both = models[name], []

    @settings(property_test, max_examples=6)
    @given(seed=st.integers(0, 2**32 - 1), count=st.sampled_from(COUNTS))
    def check(seed, count):
        parameters, states, durations, tables = random_runs(model, seed, count)
        grid = 0.002 * np.arange(round(durations.max() / 0.002) + 1)
        inside = np.random.default_rng(seed).uniform(0.0, durations.max(), 30)
        times = np.sort(np.append(inside, grid[grid <= durations.max()]))
        options = {"integrator": integrator, "step_s": 7e-4, "record_period_s": 0.002}
        monkeypatch.setattr(runner_module, "_FIRST_PIECE", seed % 2 * 160_000)
        batch = model.simulate_batch(
            *(parameters, states, durations),
            **options | {"inputs": tables, "record_times_s": times, "failures": "return"},
        )
        monkeypatch.undo()
        for run, *arguments in zip(batch, parameters, states, durations, tables, strict=True):
            own = times[times <= arguments[2] * (1.0 + 1e-12)]
            assert_same_run(run, alone(model, *arguments, **options, record_times_s=own))
            plain = alone(model, *arguments, **options)
            if isinstance(run, Simulation) and isinstance(plain, Simulation):
                both.append(run)
                at = np.searchsorted(run.time_s, plain.time_s)
                records = {key: values[at] for key, values in run.outputs.items()}
                assert_same_run(Simulation(plain.time_s, records, run.final), plain)

    check()
    assert both


@pytest.mark.parametrize("lanes", [1, 8])
@pytest.mark.parametrize(("name", "integrator"), RUNS)
def test_pieces_of_a_run_are_the_whole_run(models, name, integrator, lanes):
    model, outcomes = models[name], set()
    runner = Runner(
        model.code, lanes=lanes, integrator=integrator, step_s=7e-4, record_period_s=0.03
    )

    def run(piece, seed):
        parameters, states, durations, tables = random_runs(model, seed, lanes)
        x = np.array([state.continuous for state in states]).T.copy()
        d = np.array([state.discrete for state in states]).T.copy()
        last = (durations / runner.timing.tick).round().astype(np.int64)
        rows = int(last.max()) // runner.timing.record_every + 1
        record = np.zeros((lanes, runner.columns.size, rows))
        snapshots = None
        if lanes == 1:
            ticks = np.arange(-1, last[0], 2)
            sizes = len(x), len(d)
            snapshots = Snapshots(ticks, *(np.zeros((ticks.size, size)) for size in sizes))
        runner.piece = piece
        status = runner.restart(parameters).run(x, d, 0, last, tables, record, snapshots)
        outcomes.update(status[:, 0])
        return [status, x, d, record, *(vars(snapshots).values() if snapshots else ())]

    for seed in range(12):
        whole = run(10**9, seed)
        for piece in (1, 3):
            for ours, theirs in zip(run(piece, seed), whole, strict=True):
                np.testing.assert_array_equal(ours.view(np.int64), theirs.view(np.int64))
    assert len(outcomes) > 1  # some fail


@pytest.mark.parametrize(("name", "integrator"), RUNS)
def test_runs_that_go_on_are_the_whole_runs(models, name, integrator):
    """The cuts are at random ticks, so the lanes of a call begin again at several ticks."""
    model, rng, resumed = models[name], np.random.default_rng(7), 0
    element = {"mixed": "x[1]", "without states": "y[0]", "without discrete": "y[0]"}[name]
    kinds = ("integral", "variation", "maximum", "last_time")
    options = {
        "outputs": list(model.outputs),
        "reductions": [Reduction(kind, element, after_s=0.004) for kind in kinds],
        "integrator": integrator,
        "step_s": 7e-4,
        "failures": "return",
        "threads": 1,
    }
    for seed in range(8):
        parameters, states, durations, inputs = random_runs(model, seed, int(rng.choice(COUNTS)))
        options |= {"inputs": inputs, "record_period_s": float(rng.choice([0.01, 0.03]))}
        whole = model.simulate_batch(parameters, states, durations, **options)
        shares = rng.choice([0.0, 0.1, 0.4, 0.8, 1.0], (2, durations.size))
        for cuts in durations * np.sort(shares, axis=0):
            parts = model.simulate_batch(parameters, states, cuts, resumable=True, **options)
            states = [
                state if isinstance(part, SimulationError) else part.final
                for part, state in zip(parts, states, strict=True)
            ]
        resumed += sum(isinstance(state, ResumableState) for state in states)
        runs = model.simulate_batch(parameters, states, durations, **options)
        for run, expected in zip(runs, whole, strict=True):
            assert_same_run(run, expected)
    assert resumed > 20


def test_a_run_goes_on_with_the_settings_of_the_run_before_alone(models):
    model = models["without states"]
    (values,), (state,), _, _ = random_runs(model, 3, 1)
    final = model.simulate(values, state, 0.012, resumable=True).final
    with pytest.raises(ValueError, match="record period"):
        model.simulate(values, final, 0.02, record_period_s=0.004)
    with pytest.raises(ValueError, match="must not end before"):
        model.simulate(values, final, 0.011)
    with pytest.raises(ValueError, match="record_times_s"):
        model.simulate(values, final, 0.02, record_times_s=[0.015])


@pytest.mark.parametrize("threads", [1, 2])
def test_an_interrupt_ends_a_run_of_hours(models, threads):
    model, state = models["without states"], State(np.empty(0), np.zeros(2))

    def interrupt(number, frame):
        raise InterruptedError

    def run_for_hours():
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        model.simulate_batch(
            np.zeros((16, 1)), state, 1e9, outputs=(), integrator="rk4", threads=threads
        )

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        with pytest.raises(InterruptedError):
            run_for_hours()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_run_that_ends_outside_its_limits_between_two_records(models):
    # The last instant of the first run is no record, and no event of a run that goes on.
    model = models["without states"]
    parameters = np.ones((8, 1))
    states = [State(np.empty(0), np.array([2.9, 0.0]))] * 8
    table = InputTable(coefficients=np.full((1, 1, 1), 0.2))
    durations = np.array([0.004, *[0.0] * 6, 0.1])
    runs = parameters, states, durations, [table] * 8
    batch = assert_as_alone(model, runs, record_period_s=0.05)
    assert not isinstance(batch[0], SimulationError)
    assert str(batch[-1]) == "t = 0.004 s: counter left its limits"


def test_the_last_record_is_held_to_the_limits(models):
    model = models["without states"]
    state = State(np.empty(0), np.array([2.9, 0.0]))
    table = InputTable(coefficients=np.full((1, 1, 1), 0.2))
    error = alone(model, np.ones(1), state, 0.002, table, record_period_s=0.002)
    assert str(error) == "t = 0.002 s: counter left its limits"


def test_the_limit_that_was_left_is_named(models):
    model, states = models["mixed"], []
    for x, e in ((0.0, 9.0), (3.0, 0.0), (0.0, 0.0)):
        states.append(State(np.array([x, 0.0]), np.array([0.0, e, 0.0])))
    states += states[-1:] * 5
    table = InputTable(coefficients=np.zeros((1, 2, 1)))
    runs = np.ones((8, 3)), states, np.full(8, 0.01), [table] * 8
    batch = assert_as_alone(model, runs, integrator="rk4", record_period_s=0.01)
    assert str(batch[0]) == "t = 0 s: counter left its limits"
    assert str(batch[1]) == "t = 0 s: plant left its limits"
    assert not any(isinstance(run, SimulationError) for run in batch[2:])


@pytest.mark.parametrize("lanes", [1, 8])
def test_a_run_outside_its_limits_keeps_the_state_there(models, lanes):
    model = models["without states"]
    runner = Runner(model.code, lanes=lanes, integrator="rk4", record_period_s=0.05)
    runner.restart(np.ones((lanes, 1)))
    x, d = np.empty((0, lanes)), np.zeros((2, lanes))
    d[0, 0] = 3.5
    last = np.full(lanes, round(0.01 / runner.timing.tick))
    tables = [InputTable(coefficients=np.ones((1, 1, 1)))] * lanes
    status = runner.run(x, d, 1, last, tables)
    assert status[0].tolist() == [OUTSIDE, round(0.001 / runner.timing.tick), 0]
    assert d[:, 0].tolist() == [3.5, 0.0]
    assert (d[:, 1:] > 0.0).all()


# ----------------------------------------------------------------------- a plain time loop


def plain_run(interpreted, equations, run, duration, tick, step, every):
    """Records of the outputs, and the last state or the text of the error: events, then RK4."""
    parameters, state, table = run
    x, d = state.continuous.copy(), state.discrete.copy()

    def values(nodes, time, x, d):
        return np.array(
            interpreted(
                equations.graph,
                nodes,
                time=[time],
                state=x,
                discrete=d,
                parameter=parameters,
                input=table.value(time),
            ),
            dtype=float,
        )

    def rate(time, x):
        return values(equations.derivatives, time, x, d)

    def fault(time, x, d, row=()):
        """The text of the error for a state or an output that is not finite, the state first."""
        labels = [
            f"{name}[{i}]" if len(nodes) > 1 else name
            for name, nodes in equations.outputs.items()
            for i in range(len(nodes))
        ]
        names = (*equations.states, *equations.discrete, *labels)
        finite = np.isfinite(np.concatenate([x, d, row]))
        return None if finite.all() else f"t = {time:.6g} s: {names[np.argmin(finite)]} is not fini"

    outputs = [node for nodes in equations.outputs.values() for node in nodes]
    records = []
    last = round(duration / tick)
    for number in range(last + 1):
        time = number * tick
        new = d.copy()
        for update in equations.updates:
            since = number - round(update.offset_s / tick)
            if since >= 0 and since % round(update.period_s / tick) == 0 and number < last:
                places, nodes = zip(*update.values, strict=True)
                new[list(places)] = values(nodes, time, x, d)
        fires = not np.array_equal(new, d, equal_nan=True)
        if number % every == 0:
            records.append(values(outputs, time, x, d))
        if number % every == 0 or fires:
            for limit in equations.limits:
                if not values([limit.margin], time, x, d)[0] >= 0.0:
                    return records, f"t = {time:.6g} s: {limit.system} left its limits"
        if number % every == 0 and not np.isfinite(records[-1]).all():
            return records, fault(time, x, d, records[-1])
        d = new
        if number == last or not x.size:
            continue
        steps = max(1, int(np.ceil(tick / step - 1e-9)))
        h = tick / steps
        for i in range(steps):
            t = time + i * h
            k1 = rate(t, x)
            k2 = rate(t + h / 2, x + h / 2 * k1)
            k3 = rate(t + h / 2, x + h / 2 * k2)
            k4 = rate(t + h, x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if not np.isfinite(x).all():
            return records, fault((number + 1) * tick, x, d)
    return records, fault(last * tick, x, d) or np.concatenate([x, d])


@pytest.mark.parametrize("name", ["without states", *SLOW_MODELS])
def test_runs_are_those_of_a_plain_loop(models, interpreted, name):
    model, equations = models[name], MODELS[name]()
    tick = {"mixed": 0.001, "without states": 0.001, "without discrete": 0.01}[name]
    ends = set()
    for seed in range(20):
        step = (3e-4, 2.5e-4)[seed % 2]
        parameters, states, durations, tables = random_runs(model, seed, 1)
        x = states[0].continuous
        x[x == 1e200] = np.inf  # sine and cosine of huge numbers amplify roundings
        run, duration = (parameters[0], states[0], tables[0]), max(durations[0], 0.05)
        ours = alone(
            model, *run[:2], duration, run[2], record_period_s=0.01, integrator="rk4", step_s=step
        )
        every = round(0.01 / tick)
        with np.errstate(all="ignore"):
            records, end = plain_run(interpreted, equations, run, duration, tick, step, every)
        ends.add(type(end))
        if isinstance(end, str):
            assert str(ours).startswith(end)
            continue
        final = np.concatenate([ours.final.continuous, ours.final.discrete])
        np.testing.assert_allclose(final, end, rtol=1e-9, atol=1e-9)
        outputs = np.hstack(list(ours.outputs.values()))
        np.testing.assert_allclose(outputs, records, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours.time_s, 0.01 * np.arange(len(records)), atol=1e-12)
    assert len(ends) == 2


@pytest.mark.parametrize("count", [2, 3, 4])
def test_tables_of_two_counts_lie_apart(models, interpreted, count):
    # 4096 lines of one value would end within line 1366 of three values, at these lines.
    model = models["mixed"]
    assert model.layout.memos == (3, 1)
    state = State(np.array([1.3663, (count + 0.5) / 40.0]), np.zeros(3))
    run = np.array([0.0, 0.0, 1.0]), state, InputTable(coefficients=np.zeros((1, 2, 1)))
    ours = model.simulate(
        *run[:2], 0.003, inputs=run[2], record_period_s=0.001, integrator="rk4", step_s=1e-3
    )
    records, _ = plain_run(interpreted, mixed(), run, 0.003, 0.001, 1e-3, 1)
    outputs = np.hstack(list(ours.outputs.values()))
    np.testing.assert_allclose(outputs, records, rtol=1e-9, atol=1e-9)


def test_initialization_sees_states_and_inputs(models):
    model = models["mixed"]
    state = State(np.array([0.25, 0.5]), np.array([1.0, 2.0, 3.0]))
    table = InputTable(np.array([0.5]), np.array([[[1.0], [7.0]], [[2.0], [8.0]]]))
    after = model.initialized(np.ones(3), state, table)
    np.testing.assert_array_equal(after.discrete, [7.0, 0.25, 3.0])
    np.testing.assert_array_equal(after.continuous, state.continuous)
