"""The controller as one diagram, and controllers of the user's own in its place."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, LinearSystem, ZeroOrderHold

import kneexo
from kneexo.analysis import linearize_loop, simulate, track
from kneexo.analysis.assessment import assess
from kneexo.diagrams import SIGNALS, make_closed_loop, make_controller
from kneexo.diagrams.controller import known_to_controller, require_controller
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import (
    CustomControllerParameters,
    ExactParameters,
    PidParameters,
    PlantParameters,
    Scenario,
)
from kneexo.parameters.paths import changed
from kneexo.systems import SlidingModeController

EXAMPLE = Path(__file__).parents[2] / "examples" / "backstepping.py"
spec = importlib.util.spec_from_file_location("backstepping", EXAMPLE)
backstepping = sys.modules["backstepping"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(backstepping)

CASES = {
    "smc": Scenario(),
    "smc, exact": Scenario(estimator=ExactParameters()),
    "pid": Scenario(controller=PidParameters(integral_per_s2=40.0)),
}


def ours(scenario):
    """The default controller, as if it were the user's."""
    return make_controller(scenario.model_copy(update={"controller": Scenario().controller}))


def custom(make=ours, sample_time_s=0.002, **values):
    return Scenario(
        controller=CustomControllerParameters(make=make, sample_time_s=sample_time_s, values=values)
    )


BACKSTEPPING = backstepping.BACKSTEPPING


# ---------------------------------------------------------------------------- make_controller


@pytest.mark.parametrize("case", CASES)
def test_ports_of_the_controller(case):
    scenario = CASES[case]
    controller = make_controller(scenario)
    inputs = {
        controller.get_input_port(i).get_name(): controller.get_input_port(i).size()
        for i in range(controller.num_input_ports())
    }
    exact = {"rod_state": 3} if case == "smc, exact" else {}
    assert inputs == {"encoder_reading": 1, "knee_reference": 4} | exact
    for i in range(controller.num_output_ports()):
        port = controller.get_output_port(i)
        assert port.size() == len(SIGNALS[port.get_name()])
    assert controller.HasOutputPort("motor_speed_command")
    require_controller(controller)


@pytest.mark.parametrize("case", CASES)
def test_a_controller_alone_repeats_the_commands_of_the_loop(case):
    """Readings and references of a run, fed to the controller alone, give the run's commands."""
    scenario = changed(CASES[case], {"simulation.duration_s": 0.4})
    run = simulate(scenario)
    model = kneexo.compile(
        make_controller(scenario),
        inputs=("encoder_reading", "knee_reference", "rod_state")[
            : 3 if case == "smc, exact" else 2
        ],
    )
    signals = {"encoder_reading": "encoder_reading", "knee_reference": "knee_reference"}
    signals |= {"rod_state": "estimated_state"}
    rows = np.column_stack(
        [run[column] for port in model.inputs for column in SIGNALS[signals[port]]]
    )
    # A sample sees the state before its update: the reading at kT makes the command after it.
    middles = run.time_s[1:] - 0.001
    table = kneexo.compiler.InputTable(middles, rows[:, :, None])
    state = model.initialized(model.parameters(), model.state(), table)
    alone = model.simulate(model.parameters(), state, 0.4, inputs=table)
    # Other sums in other machine code: rounding is all that may differ.
    np.testing.assert_allclose(
        alone["motor_speed_command"][:, 0], run["motor_speed_command_rad_s"], atol=1e-9
    )


# ------------------------------------------------------------------------- the user's own


def test_our_controller_as_a_custom_one_is_ours():
    own, default = track(custom()), track(Scenario())
    assert own.metrics == default.metrics
    for column, values in default.run.data.items():
        np.testing.assert_array_equal(own.run[column], values)
    assert linearize_loop(custom()).margins() == linearize_loop().margins()


def test_a_custom_controller_is_given_what_it_may_know():
    scenario = Scenario(
        plant=changed(PlantParameters(), {"cylinder.mass_kg": 1.8}),
        nominal=PlantParameters(),
        initial_offset_m=0.001,
        controller=custom().controller,
    )
    known = known_to_controller(scenario)
    assert known.plant == PlantParameters()
    assert (known.initial_offset_m, known.nominal) == (0.0, None)


def test_the_example_tracks_and_has_margins():
    tracked = track(BACKSTEPPING)
    assert tracked.run.time_s[1] == 0.001
    assert tracked.metrics.max_error_deg < 0.06  # within 0.6 counts of the encoder
    assert tracked.metrics.saturated_share == 0.0
    loop = linearize_loop(BACKSTEPPING)
    assert loop.sample_time_s == 0.001
    assert loop.stable
    assert 1.4 < loop.margins().disk_margin < 1.6
    figures = assess(BACKSTEPPING)
    assert figures["max_error_deg"] == tracked.metrics.max_error_deg
    assert figures["disk_margin"] == loop.margins().disk_margin


def test_a_loop_without_a_crossing_says_so():
    assert "small-signal bandwidth none below 500 Hz" in str(linearize_loop(BACKSTEPPING))


def test_its_values_reach_the_law_and_not_the_code_of_others():
    errors = [
        track(changed(BACKSTEPPING, {"controller.values.k_1": k})).metrics.rms_error_deg
        for k in (20.0, 5.0, 20.0)
    ]
    assert errors[0] == errors[2] != errors[1]


def test_a_system_takes_the_place_of_controller_and_reference():
    scenario = changed(Scenario(), {"simulation.duration_s": 1.0})
    known = scenario.model_copy(update={"controller": BACKSTEPPING.controller})
    angle = _angle(make_closed_loop(scenario, controller=backstepping.make(known)))
    named = track(changed(BACKSTEPPING, {"simulation.duration_s": 1.0})).run
    np.testing.assert_array_equal(angle, named["knee_angle_rad"][::2])  # recorded every 2 ms
    still = ConstantVectorSource([np.radians(10.0), 0.0, 0.0, 0.0])
    held = _angle(make_closed_loop(scenario, reference=still))
    assert np.ptp(held) < np.radians(0.1)


def _angle(loop):
    """The knee angle of a closed loop in rad, recorded every 2 ms for 1 s."""
    model = kneexo.compile(loop)
    state = model.initialized(model.parameters(), model.state())
    return model.simulate(model.parameters(), state, 1.0, record_period_s=0.002)["knee_angle"][:, 0]


def test_a_law_of_ones_own_gets_estimates():
    """Our law as somebody's own, between our coordinates and behind our observer."""
    scenario = changed(Scenario(), {"simulation.duration_s": 1.0})
    loop = make_closed_loop(scenario, controller=make_controller(scenario, SlidingModeController()))
    ours = simulate(scenario)["knee_angle_rad"]
    np.testing.assert_allclose(_angle(loop), ours, rtol=1e-9, atol=1e-9)


# ------------------------------------------------------------------------------- bad input


def failing(scenario):
    raise ZeroDivisionError("by hand")


def without_command(scenario):
    return ZeroOrderHold(0.002, 1)


def asking_itself(scenario):
    return make_controller(scenario)


def no_system(scenario):
    return 42


@pytest.mark.parametrize(
    ("make", "message"),
    [
        ("nowhere:make", "no module named 'nowhere'; must be module:function on the Python path"),
        ("math:nothing", "has no attribute 'nothing'; must be module:function on the Python path"),
        (failing, "ZeroDivisionError: by hand"),
        (
            asking_itself,
            "the function asks for its own controller; must build it, or ask for one of another",
        ),
        (no_system, "int is not a Drake system"),
        (without_command, "has an input port u of size 1; must be of encoder_reading (1)"),
    ],
)
def test_a_wrong_controller_raises_one_line(make, message):
    with pytest.raises(ParameterError) as caught:
        track(custom(make))
    assert "controller.make = " in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("def make(:\n", "SyntaxError: invalid syntax (FILE, line 1)"),
        ("x = 1\n1 / 0\n", "ZeroDivisionError: division by zero (FILE, line 2)"),
        ("import sys\nsys.exit(5)\n", "SystemExit: 5 (FILE, line 2)"),
        ("raise ValueError('two\\nlines')\n", "ValueError: two (FILE, line 1)"),
        ("import nowhere_else\n", "No module named 'nowhere_else' (FILE, line 1)"),
        ("from .other import x\n", "no known parent package (FILE, line 1)"),
        (
            "import json\njson.loads('[')\n",
            "Expecting value: line 1 column 2 (char 1) (FILE, line 2)",
        ),
        ("def f(): f()\nf()\n", "RecursionError: maximum recursion depth exceeded (FILE, line 1)"),
    ],
)
def test_a_module_that_fails_is_one_line_with_its_place(tmp_path, monkeypatch, text, told):
    module = tmp_path / "failing_controller.py"
    module.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ParameterError) as caught:
        make_controller(custom("failing_controller:make"))
    line = str(caught.value).replace(str(module), "FILE")
    assert line.startswith("controller.make = 'failing_controller:make': the module cannot be imp")
    assert told in line
    assert line.isprintable()


def test_a_maker_that_exits_is_one_line():
    with pytest.raises(ParameterError, match=r"'sys:exit': the function fails: SystemExit: Scenar"):
        make_controller(custom("sys:exit"))


class Failing(LeafSystem):
    """A controller whose output runs a function."""

    def __init__(self, function):
        super().__init__()
        self._function = function
        self.DeclareVectorOutputPort("motor_speed_command", 1, self._calc)

    def _calc(self, context, output):
        self._function()


@pytest.mark.parametrize("error", [ZeroDivisionError("mine"), SystemExit(5), RuntimeError("mine")])
def test_a_controller_that_fails_in_a_run_is_one_line_with_its_place(monkeypatch, error):
    def fail():
        raise error

    monkeypatch.setitem(globals(), "failing_run", lambda scenario: Failing(fail))
    scenario = custom(f"{__name__}:failing_run")
    scenario = changed(scenario, {"simulation.integrator": "radau3"})
    told = (
        rf"^t = 0 s: {type(error).__name__}: (mine|5) \(.*test_controller.py, line \d+\); correct"
    )
    with pytest.raises(SimulationError, match=told):
        simulate(scenario)


def test_an_interrupt_of_the_users_code_is_an_interrupt(tmp_path, monkeypatch):
    (tmp_path / "interrupted_controller.py").write_text("raise KeyboardInterrupt\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        make_controller(custom("interrupted_controller:make"))


def test_its_sample_time_is_that_of_the_scenario():
    with pytest.raises(ParameterError, match=r"sample_time_s = 0.004 s: must be 0.002 s"):
        track(custom(ours, 0.004))


@pytest.mark.parametrize("make", ["", "make", "a.b", "a:", ":b", "a:b c", ".a:b", "a..b:c"])
def test_make_has_module_and_function(make):
    with pytest.raises(ParameterError, match="must be module:function"):
        custom(make)


def test_a_system_without_the_ports_is_refused():
    lag = LinearSystem(-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), 0.0)
    with pytest.raises(ParameterError, match="controller: has an input port u0 of size 1"):
        make_closed_loop(controller=lag)
    with pytest.raises(ParameterError, match="reference: must have one output port of size 4"):
        make_closed_loop(reference=ConstantVectorSource([0.0]))
