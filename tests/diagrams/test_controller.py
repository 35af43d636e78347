"""The controller as one diagram, and controllers of the user's own in its place."""

import functools
import importlib.util
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, ZeroOrderHold

import kneexo
from diagramc import InputTable
from kneexo.analysis import linearize_loop, simulate, track
from kneexo.diagrams import SIGNALS, make_closed_loop, make_controller
from kneexo.errors import ParameterError, SimulationError
from kneexo.law.decision import known_to_controller
from kneexo.parameters import ExactParameters, PidParameters, PlantParameters, Scenario
from kneexo.parameters.paths import changed
from kneexo.studies.assessment import assess
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


BACKSTEPPING = backstepping.BACKSTEPPING
LIMIT_RAD_S = Scenario().command_limit_rad_s
SHORT = changed(Scenario(), {"simulation.duration_s": 0.3})


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
    table = InputTable(middles, rows[:, :, None])
    state = model.initialized(model.parameters(), model.state(), table)
    alone = model.simulate(model.parameters(), state, 0.4, inputs=table)
    # Other sums in other machine code: rounding is all that may differ.
    np.testing.assert_allclose(
        alone["motor_speed_command"][:, 0], run["motor_speed_command_rad_s"], atol=1e-9
    )


# ------------------------------------------------------------------------- the user's own


def test_our_controller_as_one_of_the_user_is_ours():
    """It reads the encoder, so kneexo adds no coordinates and no observer, but the same signals."""
    scenario = SHORT.with_law(ours)
    parts = make_controller(scenario).GetSystems()
    assert [system.get_name() for system in parts] == ["law", "limit"]
    own, default = track(scenario, all_signals=True), track(SHORT, all_signals=True)
    np.testing.assert_equal(asdict(own.metrics), asdict(default.metrics))  # nan in a short run
    assert own.run.data.keys() == default.run.data.keys()
    for column, values in default.run.data.items():
        np.testing.assert_array_equal(own.run[column], values)
    assert linearize_loop(scenario).margins() == linearize_loop().margins()


def test_a_law_is_made_for_what_its_controller_may_know():
    scenario = Scenario(
        plant=changed(PlantParameters(), {"cylinder.mass_kg": 1.8}),
        nominal=PlantParameters(),
        initial_offset_m=0.001,
    )
    known = []

    def making(scenario):
        known.append(scenario)
        return SlidingModeController()

    make_controller(scenario.with_law(making))
    assert all(k == known_to_controller(scenario.with_law(making)) for k in known)
    assert known[0].plant == PlantParameters()
    assert (known[0].initial_offset_m, known[0].nominal) == (0.0, None)


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


def test_a_system_takes_the_place_of_the_reference():
    still = ConstantVectorSource([np.radians(10.0), 0.0, 0.0, 0.0])
    model = kneexo.compile(make_closed_loop(reference=still))
    state = model.initialized(model.parameters(), model.state())
    run = model.simulate(model.parameters(), state, 0.5, record_period_s=0.002)
    assert np.ptp(run["knee_angle"]) < np.radians(0.1)


def test_a_law_of_ones_own_gets_estimates():
    """Our law as somebody's own, between our coordinates and behind our observer."""
    own = SHORT.with_law(SlidingModeController)
    parts = {system.get_name() for system in make_controller(own).GetSystems()}
    assert parts == {"coordinates", "rod_reference", "law", "estimator", "limit"}
    ours = simulate(SHORT)
    for column, values in simulate(own).data.items():
        np.testing.assert_allclose(values, ours[column], rtol=1e-9, atol=1e-9)


def reading(encoder_reading, knee_reference):
    return 900.0 * (1.2 - encoder_reading) + 10.0 * knee_reference[0]


def reading_too(encoder_reading, knee_angle, knee_reference):
    return reading(encoder_reading, knee_reference) + 0.0 * knee_angle


def reading_with_floats(encoder_reading, knee_reference):
    return float(reading(encoder_reading, knee_reference))


@functools.cache
def run_of_reading():
    return simulate(SHORT, law=reading)


def test_a_function_may_read_the_encoder_itself():
    run = run_of_reading()
    assert np.ptp(run["encoder_reading_rad"]) > 0.02
    assert "measured_knee_angle_rad" not in run.data
    held = 900.0 * (1.2 - run["encoder_reading_rad"]) + 10.0 * run["knee_reference_rad"]
    # A sample sees the state before its update.
    np.testing.assert_allclose(run["motor_speed_command_rad_s"][1:], held[:-1], atol=1e-9)


@pytest.mark.parametrize(("form", "parts"), [(reading_too, 3), (reading_with_floats, 1)])
def test_it_does_the_same_beside_coordinates_and_as_python(form, parts):
    scenario = SHORT.with_law(form)
    assert len(make_controller(scenario).GetSystems()) == parts
    angle = simulate(scenario)["knee_angle_rad"]
    np.testing.assert_allclose(angle, run_of_reading()["knee_angle_rad"], rtol=0.0, atol=1e-7)


def reading_the_state(encoder_reading, rod_state, knee_reference):
    return 1e4 * (0.2 - rod_state[0])


def test_a_law_reads_the_true_state_of_the_rod_with_the_estimator_exact():
    with pytest.raises(ParameterError, match=r"needs estimator.kind = exact, not observer"):
        simulate(SHORT, law=reading_the_state)
    exact = Scenario(estimator=ExactParameters()).changed({"simulation.duration_s": 0.1})
    run = simulate(exact, law=reading_the_state)
    wanted = np.clip(1e4 * (0.2 - run["rod_extension_m"]), -LIMIT_RAD_S, LIMIT_RAD_S)
    np.testing.assert_allclose(run["motor_speed_command_rad_s"][1:], wanted[:-1], atol=1e-7)
    floats = simulate(
        exact, law=lambda encoder_reading, rod_state: float(1e4 * (0.2 - rod_state[0]))
    )
    np.testing.assert_allclose(floats["knee_angle_rad"], run["knee_angle_rad"], atol=1e-7)


class Measuring(LeafSystem):
    """A law with an output of a name that kneexo's coordinates have too."""

    def __init__(self, coordinate):
        super().__init__()
        self.DeclareVectorInputPort(coordinate, 1)
        for name in ("motor_speed_command", "measured_knee_angle"):
            self.DeclareVectorOutputPort(name, 1, lambda context, output: None)


@pytest.mark.parametrize(
    ("coordinate", "origin"), [("knee_angle", "coordinates"), ("encoder_reading", "law")]
)
def test_a_signal_of_the_controller_comes_from_kneexo_if_kneexo_computes_it(coordinate, origin):
    controller = make_controller(Scenario().with_law(lambda scenario: Measuring(coordinate)))
    port = controller.GetOutputPort("measured_knee_angle")
    system, _ = controller.get_output_port_locator(port.get_index())
    assert system.get_name() == origin


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
        ("math:nothing", "has no attribute 'nothing'; must be module:function on the Python path"),
        (failing, "failing: the function fails: ZeroDivisionError: by hand"),
        (asking_itself, "asking_itself: the function asks for its own controller; must build"),
        (no_system, "no_system: takes a scenario and returns int; must have an argument of"),
        (without_command, "has an input port u of size 1; must be of rod_extension (1)"),
    ],
)
def test_a_law_that_cannot_be_made_raises_one_line(make, message):
    with pytest.raises(ParameterError) as caught:
        track(law=make)
    assert str(caught.value).startswith("law ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("def make(:\n", "SyntaxError: invalid syntax (FILE, line 1)"),
        ("import sys\nsys.exit(5)\n", "SystemExit: 5 (FILE, line 2)"),
        ("raise ValueError('two\\nlines')\n", "ValueError: two (FILE, line 1)"),
        ("import nowhere_else\n", "No module named 'nowhere_else' (FILE, line 1)"),
        ("from .other import x\n", "no known parent package (FILE, line 1)"),
        ("def f(): f()\nf()\n", "RecursionError: maximum recursion depth exceeded (FILE, line 1)"),
    ],
)
def test_a_module_that_fails_is_one_line_with_its_place(tmp_path, monkeypatch, text, told):
    module = tmp_path / "failing_controller.py"
    module.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ParameterError) as caught:
        Scenario().with_law("failing_controller:make")
    line = str(caught.value).replace(str(module), "FILE")
    assert line.startswith("law 'failing_controller:make': the module cannot be imported")
    assert told in line
    assert line.isprintable()


def test_a_maker_that_exits_is_one_line():
    def leaving(scenario):
        sys.exit(5)

    with pytest.raises(ParameterError, match=r"leaving: the function fails: SystemExit: 5"):
        make_controller(Scenario().with_law(leaving))


class Failing(LeafSystem):
    """A law whose output runs a function."""

    def __init__(self, function):
        super().__init__()
        self._function = function
        self.DeclareVectorOutputPort("motor_speed_command", 1, self._calc)

    def _calc(self, context, output):
        self._function()


@pytest.mark.parametrize("error", [ZeroDivisionError("mine"), SystemExit(5), RuntimeError("mine")])
def test_a_law_that_fails_in_a_run_is_one_line_with_its_place(error):
    def fail():
        raise error

    scenario = Scenario().with_law(lambda scenario: Failing(fail)).with_engine("drake")
    told = (
        rf"^t = 0 s: {type(error).__name__}: (mine|5) \(.*test_controller.py, line \d+\); correct"
    )
    with pytest.raises(SimulationError, match=told):
        simulate(scenario)


def test_an_interrupt_of_the_users_code_is_an_interrupt(tmp_path, monkeypatch):
    (tmp_path / "interrupted_controller.py").write_text("raise KeyboardInterrupt\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        Scenario().with_law("interrupted_controller:make")


def test_its_sample_time_is_that_of_the_scenario():
    with pytest.raises(ParameterError, match=r"sample_time_s = 0.004 s: must be 0.002 s"):
        track(Scenario().with_law(ours, sample_time_s=0.004))


def test_a_system_in_a_wrong_place_is_refused():
    with pytest.raises(ParameterError, match=r"kind is smc; .*scenario.with_law\(law\)"):
        make_controller(Scenario(), SlidingModeController())
    with pytest.raises(ParameterError, match="reference: must have one output port of size 4"):
        make_closed_loop(reference=ConstantVectorSource([0.0]))
