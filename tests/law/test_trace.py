"""The user's law as a leaf system: structure, scalar conversion, numbers, bad input."""

import math
from collections import deque
from fractions import Fraction
from threading import Lock

import numpy as np
import pydrake.math as drake_math
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, if_then_else
from pydrake.systems.analysis import Simulator

from kneexo.errors import ParameterError, SimulationError
from kneexo.law import FunctionLaw, FunctionLaw_, HeldCommand, LinearLaw
from kneexo.law.call import call_law
from kneexo.law.trace import HIDES_STATE, replay, trace
from kneexo.parameters import Law, LawParameters


def proportional(rod_extension, rod_reference, gain=1e3):
    return gain * (rod_reference[0] - rod_extension)


def integrating(rod_extension, time_s, state=(1.0,), gain=10.0):
    return state[0] + 0.1 * time_s, [state[0] + gain * rod_extension]


def with_math(rod_extension, rod_reference, gain=1e3):
    return gain * math.sin(rod_reference[0] - rod_extension)


def started(system, **inputs):
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)
    simulator.Initialize()
    return simulator


def command_of(simulator):
    system = simulator.get_system()
    return system.GetOutputPort("motor_speed_command").Eval(simulator.get_context())[0]


def test_the_command_is_held_for_a_sample_and_limited() -> None:
    limit = 50.0
    system = FunctionLaw(LawParameters(function=proportional, command_limit_rad_s=limit))
    simulator = started(system, rod_extension=[0.03], rod_reference=[0.05, 0.0, 0.0, 0.0])
    assert command_of(simulator) == 0.0
    simulator.AdvanceTo(0.001)
    assert command_of(simulator) == pytest.approx(20.0, rel=1e-12)
    system.GetInputPort("rod_extension").FixValue(simulator.get_mutable_context(), [0.15])
    simulator.AdvanceTo(0.0019)
    assert command_of(simulator) == pytest.approx(20.0, rel=1e-12)
    simulator.AdvanceTo(0.0021)
    assert command_of(simulator) == -limit


def test_state_time_and_gains() -> None:
    system = FunctionLaw(LawParameters(function=integrating, values={"gain": 4.0}))
    simulator = started(system, rod_extension=[0.5])
    # u_k = x_k + 0.1 t_k with x_0 = 1 and x_{k+1} = x_k + 4 · 0.5
    for sample, expected in enumerate((1.0, 3.0 + 0.0002, 5.0 + 0.0004)):
        simulator.AdvanceTo(0.002 * sample + 0.001)
        assert command_of(simulator) == pytest.approx(expected, rel=1e-12)


def test_derivatives_against_mathematics() -> None:
    system = FunctionLaw_[AutoDiffXd](LawParameters(function=proportional))
    context = system.CreateDefaultContext()
    error = 0.02
    system.GetInputPort("rod_extension").FixValue(context, [AutoDiffXd(0.03, [1.0, 0.0])])
    reference = [AutoDiffXd(0.03 + error, [0.0, 1.0]), *[AutoDiffXd(0.0, [0.0, 0.0])] * 3]
    system.GetInputPort("rod_reference").FixValue(context, reference)
    updated = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0)[0]
    np.testing.assert_allclose(updated.derivatives(), [-1e3, 1e3], rtol=1e-8)


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (None, "returns None; must return the motor speed in rad/s, one number"),
        ("fast", "must return the motor speed"),
        (True, "must return the motor speed"),
        ([1.0, 2.0], "must return the motor speed"),
        (np.ma.masked, "must return the motor speed"),
        (np.timedelta64(3, "s"), "must return the motor speed"),
        (math.nan, "must be finite"),
    ],
)
def test_a_wrong_result_is_one_line(result, message: str) -> None:
    system = FunctionLaw(LawParameters(function=lambda rod_extension: result))
    simulator = started(system, rod_extension=[0.0])
    with pytest.raises((ParameterError, SimulationError)) as caught:
        simulator.AdvanceTo(0.001)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("result", [1.0, (1.0,), (1.0, [1.0, 2.0]), (1.0, ["x"])])
def test_a_law_with_state_returns_command_and_state(result) -> None:
    system = FunctionLaw(LawParameters(function=lambda rod_extension, state=(0.0,): result))
    simulator = started(system, rod_extension=[0.0])
    with pytest.raises(ParameterError, match=r"must return \(command, next_state\), with 1"):
        simulator.AdvanceTo(0.001)


def test_held_command() -> None:
    system = HeldCommand(0.01, ("rod_extension", "estimated_state"))
    assert system.GetInputPort("estimated_state").size() == 3
    simulator = started(system, law_command=[7.0])
    assert command_of(simulator) == 0.0
    simulator.AdvanceTo(0.005)
    assert command_of(simulator) == 7.0
    assert system.ToSymbolic() is not None


# ------------------------------------------------------------------------------ tracing


class Integrator:
    def __init__(self):
        self.integral = 0.0

    def __call__(self, rod_extension):
        self.integral += rod_extension
        return self.integral


def reason(function) -> str:
    law = Law(function)
    return trace(law, len(law.arguments.initial_state)).why_not_compiled


def test_what_traces_is_compiled() -> None:
    assert reason(proportional) == ""
    assert reason(integrating) == ""
    assert reason(lambda knee_angle: np.sin(np.array([knee_angle]))) == ""


def test_what_does_not_trace_says_why() -> None:
    assert "branches on a value" in reason(lambda rod_extension: max(rod_extension, 0.0))
    assert "needs plain numbers" in reason(with_math)
    assert "raises ZeroDivisionError" in reason(lambda rod_extension: 1 / 0)
    assert "changes when it is called" in reason(Integrator())


def test_a_trace_that_differs_from_numbers_is_refused() -> None:
    """A function that looks at the type of its argument would compile to something else."""

    def sly(rod_extension):
        return 2.0 * rod_extension if isinstance(rod_extension, Expression) else rod_extension

    assert "differ from calls with numbers" in reason(sly)


def equal_to_true(rod_extension):
    return 2.0 if (rod_extension > 0.1385) == True else 1.0  # noqa: E712


def matched(rod_extension):
    match rod_extension > 0.1385:
        case True:
            return 2.0
    return 1.0


def converted(rod_extension):
    try:
        return 2.0 if float(rod_extension) > 0.1385 else 1.0
    except TypeError:
        return 1.0


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (equal_to_true, "branches on a value (line "),
        (matched, "differ from calls"),
        (converted, "differ from calls"),
    ],
)
def test_equations_are_compared_over_the_whole_stroke(function, why: str) -> None:
    assert why in reason(function)


def test_two_right_ways_by_type_are_compiled() -> None:
    def sine(rod_extension):
        try:
            return math.sin(rod_extension)
        except TypeError:
            return np.sin(rod_extension)

    assert reason(sine) == ""
    assert reason(lambda time_s: drake_math.sqrt(10.0 - time_s)) == "", "it fails above 10 s"


def test_a_deep_law_is_read_with_each_part_once() -> None:
    """As a tree the equations have 2⁴⁰ leaves."""

    def deep(rod_extension):
        x = rod_extension
        for _ in range(40):
            x = x * x + x
        return x

    law = Law(deep)
    assert trace(law, 0).why_not_compiled == ""
    assert trace(law, 0) is trace(law, 0)


def replayed(function, *columns):
    """Trace a law, replay samples of a made-up run, and return why it is then not compiled."""
    law = Law(function)
    assert trace(law, len(columns) - 1).why_not_compiled == ""
    replay(law, np.column_stack(columns), len(columns) - 1)
    return trace(law, len(columns) - 1).why_not_compiled


def test_samples_of_a_run_show_what_no_point_of_comparison_shows() -> None:
    def rarely(rod_extension):
        is_number = not isinstance(rod_extension, Expression)
        return 7.0 if is_number and 0.1 < rod_extension < 0.1 + 1e-6 else 1e3 * rod_extension

    x = np.linspace(0.05, 0.08, 1000)
    assert replayed(rarely, x) == ""
    x[500:520] = 0.1 + 5e-7
    law = Law(rarely)
    trace(law, 0).replayed = False
    assert "differ from calls" in replayed(rarely, x)


def test_the_extremes_of_a_run_are_replayed() -> None:
    def bounded(rod_extension):
        is_number = not isinstance(rod_extension, Expression)
        return 1e3 * (min(rod_extension, 0.2) if is_number else rod_extension)

    x = np.full(1000, 0.1)
    x[707] = 0.3
    assert "differ" in replayed(bounded, x)


def test_a_function_must_not_fail_at_a_sample() -> None:
    def raising(rod_extension):
        if not isinstance(rod_extension, Expression) and rod_extension > 0.1:
            raise ValueError
        return rod_extension

    assert replayed(raising, np.linspace(0.0, 0.1, 10)) == ""
    trace(Law(raising), 0).replayed = False
    assert "differ" in replayed(raising, np.linspace(0.0, 0.11, 10))


class Late:
    """A law that changes after more calls than the comparison makes."""

    def __init__(self):
        self.calls = 0

    def __call__(self, rod_extension):
        self.calls += 1
        return (1.0 if self.calls < 10_000 else 2.0) * rod_extension


class LateCounter:
    def __init__(self):
        self.calls = 0

    def __call__(self, rod_extension):
        self.calls += not isinstance(rod_extension, Expression) and rod_extension > 0.2
        return (1.0 if self.calls < 30 else 2.0) * rod_extension


def test_hidden_state_that_samples_show() -> None:
    x = np.full(200, 0.3)
    assert "changes when it is called" in replayed(LateCounter(), x)
    counter = LateCounter()
    with pytest.raises(ParameterError, match="hides state"):
        replayed(lambda rod_extension: counter(rod_extension), x)


def with_flag(rod_extension, state=(0.0,), gain=10.0):
    return (gain * rod_extension if state[0] else 0.0), [1.0 - state[0]]


@pytest.mark.parametrize(
    "branch",
    [
        lambda rod_extension: 1.0 if rod_extension else 2.0,
        lambda rod_extension, knee_angle: rod_extension and knee_angle,
        lambda rod_extension: rod_extension or 1.0,
        lambda rod_extension: float(not rod_extension),
        lambda rod_extension: float(any([rod_extension])),
        lambda rod_extension, state=(0.0,): ({0.0: 1.0}.get(state[0], 2.0), [0.0]),
    ],
)
def test_a_branch_on_a_value_is_never_traced(branch) -> None:
    assert "branches on a value (line " in reason(branch) or "needs plain numbers" in reason(branch)


def test_a_table_that_a_counter_reads_is_never_traced() -> None:
    """The symbolic call takes the first row; calls with small states do so too."""

    def looks_up(rod_extension, state=(0.0,)):
        try:
            row = int(state[0])
        except TypeError:
            row = 0
        return (1.0, 2.0, 3.0, 4.0, 5.0)[row % 5], [state[0] + 1.0]

    assert reason(looks_up)


def test_a_branch_on_a_state_follows_its_value_in_derivatives() -> None:
    system = FunctionLaw_[AutoDiffXd](LawParameters(function=with_flag))
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_extension").FixValue(context, [AutoDiffXd(0.5, [1.0])])
    for flag, expected in ((0.0, 0.0), (1.0, 5.0)):
        context.SetDiscreteState([AutoDiffXd(0.0), AutoDiffXd(flag)])
        updated = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0)[0]
        assert updated.value() == expected


def test_a_linear_law_updates_by_its_matrix() -> None:
    """(dx/dt, u⁺, z⁺) = M (1, x, z, y) with the inputs y = (rod, θ_d and three derivatives)."""
    system = LinearLaw(0.01, ("rod_extension", "rod_reference"), 1, 1)
    simulator = started(system, rod_extension=[2.0], rod_reference=[3.0, 4.0, 5.0, 6.0])
    context = simulator.get_mutable_context()
    rate, command, state = [3.0] + 7 * [0.0], [7.0, 0.25, 0.5, 1.0, 10.0] + 3 * [0.0], [1.0] * 8
    system.set_matrix(context, [rate, command, state])
    context.SetContinuousState([20.0])
    context.SetDiscreteState([100.0, 8.0])
    simulator.AdvanceTo(0.005)
    updated = context.get_discrete_state_vector().CopyToVector()
    assert updated.tolist() == [7.0 + 5.0 + 4.0 + 2.0 + 30.0, 1.0 + 20.0 + 8.0 + 2.0 + 18.0]
    assert command_of(simulator) == updated[0]
    assert context.get_continuous_state_vector()[0] == pytest.approx(20.015, rel=1e-12)


def relay(rod_extension, rod_reference):
    return if_then_else(rod_reference[0] - rod_extension > 0, 500.0, -500.0)


class Counting:
    """A law with a state that hides, which compares a NumPy scalar as pydrake 1.58 does not."""

    def __init__(self):
        self.calls = 0

    def __call__(self, rod_extension, rod_reference):
        self.calls += 1
        return if_then_else(rod_reference[0] - rod_extension > 0, 1.0, -1.0) * self.calls


def test_an_object_with_if_then_else_counts_each_sample_once() -> None:
    law = Law(Counting())
    assert "changes" in trace(law, 0).why_not_compiled
    function = law.copy_of_target()
    arguments = {"rod_extension": np.array([0.1]), "rod_reference": np.array([0.2, 0.0, 0.0, 0.0])}
    assert [call_law(law, function, arguments) for _ in range(3)] == [[1.0], [2.0], [3.0]]


def test_if_then_else_gives_numbers() -> None:
    assert reason(relay) == ""
    for function in (relay, lambda rod_extension: if_then_else(rod_extension > 1.0, 500.0, -500.0)):
        system = FunctionLaw(LawParameters(function=function))
        ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
        simulator = started(system, **{p.get_name(): [0.1, 0, 0, 0][: p.size()] for p in ports})
        simulator.AdvanceTo(0.001)
        assert command_of(simulator) == -500.0


def test_a_branch_on_a_choice_follows_the_choice() -> None:
    def two_choices(rod_extension):
        return 5.0 if if_then_else(rod_extension > 0.2, 1.0, 0.0) else -5.0

    system = FunctionLaw(LawParameters(function=two_choices))
    simulator = started(system, rod_extension=[0.1])
    simulator.AdvanceTo(0.001)
    assert command_of(simulator) == -5.0
    assert "branches on a value" in reason(two_choices)


def test_equal_equations_have_one_key_and_others_another() -> None:
    def key(function):
        law = Law(function)
        return trace(law, len(law.arguments.initial_state)).key

    def scaled(factor):
        return lambda rod_extension, gain=1.0: gain * factor * rod_extension

    twice = key(scaled(2.0))
    assert key(scaled(Fraction(2))) == twice
    assert twice == key(lambda rod_extension, gain=5.0: gain * rod_extension * 2)
    for other in (Fraction(2, 3), 2.0000000000000004):
        assert key(scaled(other)) not in ("", twice)
    assert key(with_math) == ""
    assert key(lambda rod_extension, k=1.0: k) != key(lambda rod_extension, c=1.0: c)
    assert key(lambda rod_extension, state=(0.0,): (state[0], state)) != key(
        lambda rod_extension, time_s, state=(0.0,): (time_s, [time_s])
    )


def test_a_law_is_traced_anew_when_its_values_change() -> None:
    gains = {"k": 1.0}
    law = Law(lambda rod_extension: gains["k"] * rod_extension)
    before = trace(law, 0)
    assert trace(law, 0) is before
    gains["k"] = 2.0
    assert trace(law, 0).key != before.key
    gains["k"] = 1.0
    assert trace(law, 0).key == before.key


def test_hidden_state() -> None:
    assert reason(proportional) != HIDES_STATE
    assert reason(lambda rod_extension: math.nan) != HIDES_STATE
    assert reason(Integrator()) == HIDES_STATE
    assert reason(Late()) == HIDES_STATE
    calls = []

    def remembers(rod_extension):
        calls.append(rod_extension)
        return 0.0

    with pytest.raises(ParameterError, match=r"hides state: .* must take the argument state"):
        reason(remembers)
    random = np.random.default_rng()
    with pytest.raises(ParameterError, match="hides state"):
        reason(lambda rod_extension: random.normal())
    last = deque([0.0] * 99)

    def late(rod_extension):
        last.append(rod_extension)
        return last.popleft()

    with pytest.raises(ParameterError, match="hides state"):
        reason(late)
    hits = []

    def above(rod_extension):
        if rod_extension > 0.12:
            hits.append(rod_extension)
        return 1.0 if len(hits) < 10_000 else 2.0

    for _ in range(2):
        with pytest.raises(ParameterError, match="hides state"):
            reason(above)


def test_an_object_that_cannot_be_copied_is_one_line() -> None:
    class Locked:
        def __init__(self):
            self.lock = Lock()

        def __call__(self, rod_extension):
            return rod_extension

    with pytest.raises(
        ParameterError, match=r"Locked: the object cannot be copied for a run: Type"
    ):
        reason(Locked())
