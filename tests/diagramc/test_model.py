"""Compiled models at full speed: integrators, several sample times, faults."""

import numpy as np
import pydrake.symbolic as symbolic
import pytest
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import (
    DiagramBuilder,
)
from pydrake.systems.primitives import (
    FirstOrderLowPassFilter,
    Sine,
    SymbolicVectorSystem,
    ZeroOrderHold,
)

from diagramc import Reduction, State, compile_by_key, compile_diagram, simulate_with_feedback
from diagramc.errors import ResultError, SimulationError, UnstableStepError
from diagramc.model import CompiledModel
from diagramc.native.runner import Runner

# ------------------------------------------------------------------- diagrams of the user


def test_several_sample_periods_and_offsets_agree_with_drake(multirate):
    diagram = multirate
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 1e-3)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.AdvanceTo(0.5)
    model = compile_diagram(diagram)
    assert set(model.sample_times_s) == {0.004, 0.010}
    for integrator, tolerance in (("runge_kutta3", 1e-12), ("exact_hold", 1e-4)):
        run = model.simulate(
            model.parameters(),
            model.state(),
            0.5,
            record_period_s=0.002,
            integrator=integrator,
            step_s=1e-3,
        )
        for name in ("y", "sampled", "held"):
            log = diagram.GetSubsystemByName(f"log_{name}").FindLog(simulator.get_context())
            np.testing.assert_allclose(run.time_s, log.sample_times(), rtol=0, atol=1e-12)
            np.testing.assert_allclose(run[name].T, log.data(), rtol=0, atol=tolerance)
    final = model.state(simulator.get_context())
    np.testing.assert_allclose(run.final.continuous, final.continuous, atol=1e-3)


def test_a_model_by_key_builds_its_diagram_only_when_it_must():
    diagrams = []

    def make_diagram():
        x = Variable("x")
        lag = SymbolicVectorSystem(state=[x], dynamics=[-3.0 * x], output=[x])
        diagrams.append(diagram_of(("lag", lag)))
        return diagrams[-1]

    for _ in range(2):  # the second model finds its code
        model = compile_by_key(f"{__name__}: lag", make_diagram, inputs=())
        assert model.state_names == ("lag.x[0]",)
    assert len(diagrams) <= 1


# --------------------------------------------------------------------- records, batches


@pytest.mark.parametrize("period_s", [0.005, 0.002, 0.1 / 3.0])
@pytest.mark.parametrize("integrator", ["exact_hold", "rk4"])
def test_times_of_samples_are_whole_multiples(period_s, integrator):
    t = Variable("t")
    diagram = diagram_of(
        ("clock", SymbolicVectorSystem(time=t, output=[t])),
        ("hold", ZeroOrderHold(period_s, 1)),
        connect=[("clock", "hold")],
    )
    model = compile_diagram(diagram)
    run = model.simulate(model.parameters(), model.state(), 300 * period_s, integrator=integrator)
    expected = period_s * np.arange(301)
    np.testing.assert_array_equal(run.time_s, expected)
    np.testing.assert_array_equal(run["out"][1:, 0], expected[:-1])  # the clock, a sample ago


@pytest.mark.parametrize(
    ("integrator", "tolerance"),
    [("exact_hold", 2e-6), ("rk4", 2e-6), ("runge_kutta3", 5e-4), ("rosenbrock", 3e-5)],
)
def test_records_at_chosen_times(servo, integrator, tolerance):
    model, parameters, state = servo
    way = {"integrator": integrator, "step_s": 1.1e-5}
    # At 0.01 ms RK4 resolves the mode of the oil to 1e-7; the records stand where it steps anyhow.
    fine = model.simulate(
        parameters, state, 0.2, record_period_s=5e-5, integrator="rk4", step_s=1e-5
    )
    places = np.array([0, 1, 39, 40, 41, 41, 1234, 4000])
    times = 5e-5 * places
    run = model.simulate(parameters, state, 0.2, record_times_s=times, **way)
    np.testing.assert_array_equal(run.time_s, times)
    plain = model.simulate(parameters, state, 0.2, **way)
    np.testing.assert_array_equal(run.final.continuous, plain.final.continuous)
    for name in model.outputs:
        scale = 1e-12 + np.max(np.abs(fine[name]))
        np.testing.assert_allclose(run[name], fine[name][places], rtol=0, atol=tolerance * scale)
        np.testing.assert_array_equal(run[name][[0, 3]], plain[name][[0, 1]])
    # A command changes right after its instant.
    command = run["command"][:, 0]
    assert command[3] == command[2] != command[4]
    assert model.simulate(parameters, state, 0.2, record_times_s=[])["position"].shape == (0, 1)


def test_records_at_chosen_times_and_reductions_are_refused(servo):
    model, parameters, state = servo
    with pytest.raises(ValueError, match="reductions: need a record period"):
        model.simulate_batch(
            parameters[None],
            state,
            0.2,
            record_times_s=[0.1],
            reductions=[Reduction("maximum", "position")],
        )


@pytest.mark.parametrize("times", [[0.1, 0.05], [-1e-3], [0.3], [np.nan]])
def test_records_outside_the_run_or_out_of_order_are_refused(servo, times):
    model, parameters, state = servo
    with pytest.raises(ValueError, match=r"record_times_s: must ascend within 0 … 0\.2 s"):
        model.simulate(parameters, state, 0.2, record_times_s=times)


def varied(model, parameters, count):
    rows = np.tile(parameters, (count, 1))
    rows[:, model.parameter_names.index("arm.mass_kg")] *= np.linspace(0.5, 2, count)
    return rows


def test_a_batch_is_its_runs_one_by_one(servo):
    model, parameters, state = servo
    durations = [0.02, 0.1, 0.0, 0.05, 0.1, 0.04, 0.1, 0.06, 0.08]  # 8 lanes, then one
    rows = varied(model, parameters, len(durations))
    alone = [
        model.simulate(row, state, duration)["velocity"]
        for row, duration in zip(rows, durations, strict=True)
    ]
    assert not np.array_equal(alone[1], alone[4])
    for threads in (1, 3):
        batch = model.simulate_batch(rows, state, durations, threads=threads)
        for run, expected in zip(batch, alone, strict=True):
            np.testing.assert_array_equal(run["velocity"], expected)
    last_positions = model.simulate_batch(
        rows, [state] * 9, durations, reduce=lambda run: run.final.continuous[1], outputs=[]
    )
    assert last_positions == [run.final.continuous[1] for run in batch]
    assert model.simulate_batch(rows[:0], state, 0.1) == []


def test_a_run_may_record_nothing_but_time(servo):
    model, parameters, state = servo
    run = model.simulate(parameters, state, 0.01, record_period_s=0.002, outputs=())
    assert repr(run) == "Simulation(6 records of nothing)"
    with pytest.raises(ResultError, match=r"^output 'x': was not recorded; recorded outputs: none"):
        run["x"]


def test_single_runs_with_equal_settings_share_a_runner(servo, monkeypatch):
    made = []

    def counted(code, **settings):
        made.append(settings)
        return Runner(code, **settings)

    monkeypatch.setattr("diagramc.model.Runner", counted)
    compiled, parameters, state = servo
    model = CompiledModel(compiled.code)
    rows = varied(compiled, parameters, 3)
    fresh = [CompiledModel(compiled.code).simulate(row, state, 0.1)["velocity"] for row in rows]
    made.clear()
    for row, expected in zip(rows, fresh, strict=True):
        run = model.simulate(row, state, 0.1)
        np.testing.assert_array_equal(run["velocity"], expected)
        with pytest.raises(SimulationError):
            model.simulate(row, State(np.nan * state.continuous, state.discrete), 0.1)
    assert len(made) == 1
    model.simulate(parameters, state, 0.1, integrator="rk4")
    model.simulate(parameters, state, 0.1, outputs=["velocity"])  # beyond the two that are kept
    model.simulate(parameters, state, 0.1, integrator="rk4")
    assert [settings.get("integrator") for settings in made] == [None, "rk4", None]
    model.simulate(parameters, state, 0.1)
    assert len(made) == 4


def test_failures_of_a_batch_are_raised_or_returned(servo):
    model, parameters, state = servo
    broken = state.continuous.copy()
    broken[0] = np.nan
    states = [state, State(broken, state.discrete), state]
    rows = [parameters] * 3
    with pytest.raises(SimulationError, match="is not finite"):
        model.simulate_batch(rows, states, 0.1)
    good, bad, _ = model.simulate_batch(rows, states, 0.1, failures="return")
    assert isinstance(bad, SimulationError)
    assert good["position"].size == 51
    with pytest.raises(ValueError, match="failures = 'ignore': must be one of raise, return"):
        model.simulate_batch(rows, states, 0.1, failures="ignore")
    for threads in (0, -1, 1.5, True):
        with pytest.raises(
            ValueError, match=f"threads = {threads}: must be an integer >= 1, or None"
        ):
            model.simulate_batch([parameters], state, 0.1, threads=threads)
    for reductions in ("maximum", 3, None, [3]):
        with pytest.raises(ValueError, match="reductions: must be a sequence of Reduction"):
            model.simulate_batch([parameters], state, 0.1, reductions=reductions)
    with pytest.raises(ValueError, match="states: has 3 for 2 runs"):
        model.simulate_batch(rows[:2], states, 0.1)
    with pytest.raises(ValueError, match="duration_s: has 2 for 3 runs"):
        model.simulate_batch(rows, states, [0.1, 0.1])


# ------------------------------------------------------------------ other people's diagrams


def diagram_of(*systems, connect=(), out=None):
    """A diagram of (name, system) in a chain of ports (from, to), with one output."""
    builder = DiagramBuilder()
    added = {name: builder.AddNamedSystem(name, system) for name, system in systems}
    for source, target in connect:
        builder.Connect(added[source].get_output_port(0), added[target].get_input_port(0))
    builder.ExportOutput(added[out or systems[-1][0]].get_output_port(0), "out")
    return builder.Build()


def test_a_forcing_faster_than_the_records_is_seen_by_the_exact_hold():
    # 20 Hz repeats five times in half of the sample time of 0.1 s.
    diagram = diagram_of(
        ("sine", Sine(1.0, 2.0 * np.pi * 20.0, 0.5 * np.pi, 1)),
        ("filter", FirstOrderLowPassFilter(0.5)),
        ("hold", ZeroOrderHold(0.1, 1)),
        connect=[("sine", "filter"), ("filter", "hold")],
    )
    model = compile_diagram(diagram)
    hold, rk4 = (
        model.simulate(model.parameters(), model.state(), 1.0, integrator=integrator, step_s=1e-4)
        for integrator in ("exact_hold", "rk4")
    )
    assert np.max(np.abs(rk4["out"])) < 0.1
    np.testing.assert_allclose(hold["out"], rk4["out"], rtol=0, atol=1e-6)


def test_quotients_of_whole_numbers_are_those_of_drake():
    n = Variable("n")
    quotient = symbolic.floor(n / 49.0)
    model = compile_diagram(
        SymbolicVectorSystem(state=[n], dynamics=[n + 1.0], output=[quotient], time_period=0.1)
    )
    run = model.simulate(model.parameters(), model.state(), 10.0)
    np.testing.assert_array_equal(run["y0"][:, 0], np.arange(101) // 49)


def test_a_table_of_whole_numbers_in_a_model_without_samples():
    x = Variable("x")
    level = symbolic.floor(10.0 * x)
    for _ in range(4):
        level = symbolic.cos(symbolic.sin(symbolic.tanh(level)))
    model = compile_diagram(
        SymbolicVectorSystem(state=[x], dynamics=[Expression(1.0)], output=[level])
    )
    starts = 0.005 + 0.1 * np.arange(8)
    runs = model.simulate_batch(
        np.empty((8, 0)), [State([x_0], []) for x_0 in starts], 1.0, record_period_s=0.01
    )
    for x_0, run in zip(starts, runs, strict=True):
        exact = np.floor(10.0 * (x_0 + run.time_s))
        for _ in range(4):
            exact = np.cos(np.sin(np.tanh(exact)))
        np.testing.assert_allclose(run["y0"][:, 0], exact, rtol=1e-12)


def test_a_root_at_zero_has_no_slope_and_yet_a_solution():
    # The slope of the root is infinite where it starts.
    x, t = Variable("x"), Variable("t")
    flow = symbolic.sqrt(symbolic.abs(symbolic.sin(t) - x))
    model = compile_diagram(SymbolicVectorSystem(time=t, state=[x], dynamics=[flow], output=[x]))
    hold, rk4 = (
        model.simulate(
            model.parameters(),
            model.state(),
            1.0,
            record_period_s=0.01,
            integrator=integrator,
            step_s=1e-4,
        )["y0"]
        for integrator in ("exact_hold", "rk4")
    )
    assert rk4[-1, 0] > 0.3
    np.testing.assert_allclose(hold, rk4, rtol=0, atol=1e-4)


@pytest.mark.parametrize(("period", "offset"), [(0.05, 0.07), (0.05, 0.02)])
def test_offsets_beyond_a_period(period, offset):
    diagram = diagram_of(
        ("sine", Sine(1.0, 10.0, 0.3, 1)),
        ("hold", ZeroOrderHold(period, 1, offset_sec=offset)),
        connect=[("sine", "hold")],
    )
    model = compile_diagram(diagram)
    run = model.simulate(model.parameters(), model.state(), 0.4)
    simulator = Simulator(diagram)
    context = simulator.get_context()
    for time, value in zip(run.time_s, run["out"][:, 0], strict=True):
        simulator.AdvanceTo(time)  # stops before the updates at this time
        assert value == pytest.approx(diagram.GetOutputPort("out").Eval(context)[0], abs=1e-12)


# ------------------------------------------------------------------- what does not compile


def test_wrong_arguments_are_named(servo):
    model, parameters, state = servo
    with pytest.raises(ValueError, match="integrator = 'euler'"):
        model.simulate(parameters, state, 0.01, integrator="euler")
    for name in ("step_s", "tolerance"):
        for value in (0.0, -1e-4, np.nan, np.inf):
            with pytest.raises(ValueError, match=rf"{name} = {value}: must be finite and > 0"):
                model.simulate(parameters, state, 0.01, **{name: value})
    with pytest.raises(ValueError, match="output 'angle' is unknown"):
        model.simulate(parameters, state, 0.01, outputs=["angle"])
    for duration in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"duration_s = .* s: must be finite and >= 0"):
            model.simulate(parameters, state, duration)


# -------------------------------------------------------------------------- failed runs


@pytest.fixture(scope="module")
def logarithm():
    """Model with the outputs ``pair``, x and ln(a − t), and ``held``, the same held for 20 ms."""
    t, x, a = (Variable(name) for name in "txa")
    pair = [x, symbolic.log(a - t)]
    system = SymbolicVectorSystem(time=t, state=[x], parameter=[a], dynamics=[-x], output=pair)
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", system)
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.02, 2))
    builder.Connect(source.get_output_port(), hold.get_input_port())
    builder.ExportOutput(source.get_output_port(), "pair")
    builder.ExportOutput(hold.get_output_port(), "held")
    return compile_diagram(builder.Build())


def message(model, a, **options):
    """The error of a run of 0.1 s of the `logarithm`; empty where it has none."""
    state = State(np.ones(1), np.zeros(2))
    try:
        model.simulate([a], state, 0.1, **{"record_period_s": 0.01} | options)
    except SimulationError as error:
        return str(error)
    return ""


NOT_FINITE = "is not finite; reduce the step or check the parameters"


def test_a_recorded_output_that_is_not_finite_ends_the_run(logarithm):
    for a, time in ((-1.0, "0"), (0.0, "0"), (0.015, "0.02"), (0.0999, "0.1")):
        ours = message(logarithm, a, outputs=["pair"])
        assert ours == f"t = {time} s: pair[1] {NOT_FINITE}"
    assert message(logarithm, 0.11, outputs=["pair"]) == ""


def test_a_discrete_state_that_is_not_finite_ends_the_run(logarithm):
    # The hold takes nan at 0.02 s; a record there sees the state before.
    assert message(logarithm, 0.015, outputs=["held"]) == f"t = 0.03 s: hold.0[1] {NOT_FINITE}"
    for options in ({}, {"record_times_s": [0.001]}):
        ours = message(logarithm, 0.015, outputs=[], **options)
        assert ours == f"t = 0.1 s: hold.0[1] {NOT_FINITE}"


def test_a_record_at_a_chosen_time_that_is_not_finite_ends_the_run(logarithm):
    options = {"outputs": ["pair"], "record_times_s": [0.001, 0.0955, 0.0975]}
    assert message(logarithm, 0.0965, **options) == f"t = 0.0975 s: pair[1] {NOT_FINITE}"
    assert message(logarithm, 0.0985, **options) == ""


def test_each_run_of_a_batch_has_its_own_outputs_that_are_not_finite(logarithm):
    latest = np.array([0.2, 0.055, 0.2, 0.3, -1.0, 0.3, 0.3, 0.035, 0.095, 0.2])
    start = State(np.ones(1), np.zeros(2))
    runs = logarithm.simulate_batch(
        latest[:, None], start, 0.1, record_period_s=0.01, failures="return", threads=1
    )
    for a, run in zip(latest, runs, strict=True):
        if a > 0.1:
            np.testing.assert_allclose(run["pair"][:, 1], np.log(a - run.time_s), rtol=1e-12)
        else:
            with pytest.raises(SimulationError) as alone:
                logarithm.simulate(np.array([a]), start, 0.1, record_period_s=0.01)
            assert (str(run), run.time_s) == (str(alone.value), alone.value.time_s)
            assert repr(run.state) == repr(alone.value.state)  # every bit
            assert str(run).startswith(f"t = {max(0.0, np.ceil(100.0 * a) / 100.0):g} s: pair[1] ")


# ------------------------------------------------------------------------ unstable steps


@pytest.fixture(scope="module")
def chamber():
    """A chamber that empties at 1 + u, and a check valve that fills it at λ (-p) where p < 0.

    From p = 1 it empties in a second, then p rests at -1/λ.
    """
    p, per_s, u = Variable("p"), Variable("rate"), Variable("u")
    rate = per_s * symbolic.max(0.0, -p) - 1.0 - u
    leaf = SymbolicVectorSystem(
        state=[p], parameter=[per_s], input=[u], dynamics=[rate], output=[p]
    )
    builder = DiagramBuilder()
    builder.AddNamedSystem("chamber", leaf)
    builder.ExportInput(leaf.get_input_port(), "u0")
    builder.ExportOutput(leaf.get_output_port(), "y0")
    return compile_diagram(builder.Build(), inputs=["u0"])


def fill(chamber, per_s, **options):
    """Run the chamber for 2 s; return the pressure at the end."""
    start = State(np.ones(1), np.empty(0))
    options = {"integrator": "rk4", "record_period_s": 0.01} | options
    return chamber.simulate(np.array([per_s]), start, 2.0, **options).final.continuous[0]


@pytest.mark.parametrize("integrator", ["rk4", "runge_kutta3"])
@pytest.mark.parametrize("product", [3.0, 5.0, 30.0])
def test_a_valve_that_is_too_fast_for_the_steps_ends_the_run(chamber, integrator, product):
    """The wrong run is bounded: the valve opens and closes for ever."""
    per_s = product / 1e-3
    with pytest.raises(UnstableStepError) as caught:
        fill(chamber, per_s, integrator=integrator, step_s=1e-3)
    error = caught.value
    assert 0.99 < error.time_s < 1.1
    assert abs(error.state["chamber.x[0]"]) < 0.2
    assert f"{integrator} with steps of 0.001 s cannot follow chamber.x[0]" in str(error)
    assert f"a mode of {-per_s:.3g} 1/s; set step_s = {error.step_s:.1e}, or use" in str(error)
    assert error.step_s == pytest.approx(
        0.2 * {"rk4": 2.785, "runge_kutta3": 2.513}[integrator] / per_s, rel=1e-3
    )
    assert fill(chamber, per_s, step_s=error.step_s) == pytest.approx(-1.0 / per_s, rel=1e-9)


@pytest.mark.parametrize("product", [0.2, 1.0, 2.5])
def test_a_valve_that_opens_is_no_failure(chamber, product):
    per_s = product / 1e-3
    assert fill(chamber, per_s, step_s=1e-3) == pytest.approx(-1.0 / per_s, rel=1e-6)


def test_each_lane_is_judged_alone(chamber):
    start, options = (
        State(np.ones(1), np.empty(0)),
        {"record_period_s": 0.01, "integrator": "rk4", "step_s": 1e-3},
    )
    rates = np.array([[1e2], [5e3], [2e3], [3e4], [2e2], [4e3], [1e3], [1.5e3], [2e4]])
    durations = np.linspace(1.2, 2.0, len(rates))
    batch = chamber.simulate_batch(rates, start, durations, failures="return", **options)
    for run, row, duration_s in zip(batch, rates, durations, strict=True):
        (alone,) = chamber.simulate_batch([row], start, duration_s, failures="return", **options)
        if isinstance(alone, UnstableStepError):
            assert (str(run), run.state) == (str(alone), alone.state)
        else:
            np.testing.assert_array_equal(run["y0"], alone["y0"])
    assert [isinstance(run, UnstableStepError) for run in batch] == (rates[:, 0] > 2.8e3).tolist()


def test_runs_in_pieces_find_the_unstable_step_too(chamber):
    parameters, start = np.array([4e3]), State(np.full(1, 1e-3), np.empty(0))
    options = {"integrator": "rk4", "step_s": 1e-3}
    system = chamber.as_system(parameters, start, tick_s=0.01, **options)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, [0.0])
    with pytest.raises(UnstableStepError, match="cannot follow chamber"):
        Simulator(system, context).AdvanceTo(0.1)
    with pytest.raises(UnstableStepError, match="cannot follow chamber"):
        simulate_with_feedback(
            *(chamber, parameters, start, 0.1, lambda t, outputs: 0.0),
            feedback_input="u0",
            feedback_outputs=["y0"],
            sample_period_s=0.01,
            **options,
        )


def test_records_between_two_ticks_take_the_steps_that_the_fastest_mode_requires(chamber):
    times, start = np.linspace(1.0, 1.9, 7) + 1e-3, State(np.ones(1), np.empty(0))
    run = chamber.simulate(np.array([1e6]), start, 2.0, record_times_s=times)
    np.testing.assert_allclose(run["y0"], -1e-6, rtol=0, atol=1e-9)


def test_the_fastest_mode_of_a_run(chamber):
    start = State(np.ones(1), np.empty(0))
    options = {"integrator": "rk4", "step_s": 1e-3, "record_period_s": 0.01}
    for duration_s, expected in ((0.5, 0.0), (1.5, 300.0)):  # at first the valve is closed
        assert chamber.fastest_per_s(np.array([300.0]), start, duration_s, **options) == expected
    with pytest.raises(UnstableStepError):
        chamber.fastest_per_s(np.array([3e4]), start, 1.5, **options)
