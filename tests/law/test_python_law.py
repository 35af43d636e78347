"""Control laws of the user in closed loop: compiled, or called as Python beside the plant."""

import math
import subprocess
import sys

import numpy as np
import pytest
from pydrake.symbolic import Expression
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LinearSystem

from kneexo.analysis import linearize_loop, track
from kneexo.analysis.batches import batch
from kneexo.analysis.tracking.reduced_tracking import track_basic_metrics
from kneexo.errors import LinearizationError, ParameterError, SimulationError
from kneexo.geometry.linkage import encoder_angle
from kneexo.law import FunctionLaw
from kneexo.law.decision import why_python
from kneexo.law.python_law import sign_hint
from kneexo.parameters import (
    ExactParameters,
    LawParameters,
    SampledReference,
    Scenario,
    SimulationParameters,
)
from kneexo.simulation import simulate
from kneexo.systems.knee_reference import start_angle_rad

SHORT = Scenario(simulation=SimulationParameters(duration_s=0.3))
K, K_I = 8e4, 2e5


def law(rod_extension, rod_reference, k=K):
    return k * (rod_reference[0] - rod_extension)


def law_with_branch(rod_extension, rod_reference, k=K):
    error = rod_reference[0] - rod_extension
    return k * error if error > 0.0 else -k * -error


def pi(rod_extension, rod_reference, state=(0.0,), k=K):
    error = rod_reference[0] - rod_extension
    return k * error + state[0], [state[0] + 0.002 * K_I * error]


def pi_with_floats(rod_extension, rod_reference, state=(0.0,), k=K):
    command, (integral,) = pi(rod_extension, rod_reference, state, k)
    return float(command), [integral]


class HiddenPi:
    def __init__(self):
        self.integral = 0.0

    def __call__(self, rod_extension, rod_reference):
        error = rod_reference[0] - rod_extension
        command = K * error + self.integral
        self.integral += 0.002 * K_I * error
        return command


class SystemPi(LeafSystem):
    """The same law as a Drake system of floats only."""

    def __init__(self):
        LeafSystem.__init__(self)
        self.rod = self.DeclareVectorInputPort("rod_extension", 1)
        self.reference = self.DeclareVectorInputPort("rod_reference", 4)
        self.DeclareDiscreteState(2)
        self.DeclarePeriodicDiscreteUpdateEvent(0.002, 0.0, self.update)
        self.DeclareVectorOutputPort("motor_speed_command", 1, self.command, {self.xd_ticket()})

    def update(self, context, state):
        integral = context.get_discrete_state(0)[1]
        error = self.reference.Eval(context)[0] - self.rod.Eval(context)[0]
        state.set_value(0, [K * error + integral, integral + 0.002 * K_I * error])

    def command(self, context, output):
        output.SetAtIndex(0, context.get_discrete_state(0)[0])


def angles(scenario, law):
    return simulate(scenario, law=law)["knee_angle_rad"]


@pytest.mark.slow
def test_a_law_in_python_moves_the_knee_as_the_compiled_law_does() -> None:
    """All forms of one law give the same motion within the tolerance of the integrator."""
    assert not why_python(SHORT.with_law(pi))
    expected = angles(SHORT, pi)
    assert np.ptp(expected) > 1e-3
    for form in (pi_with_floats, HiddenPi(), SystemPi, SystemPi()):
        assert why_python(SHORT.with_law(form))
        for _ in range(2):  # each run begins with the first state
            np.testing.assert_allclose(angles(SHORT, form), expected, rtol=0.0, atol=1e-7)
    np.testing.assert_array_less(1e-4, np.abs(angles(SHORT, law) - expected).max())


def test_laws_in_python_do_not_disturb_each_other() -> None:
    """They share the compiled plant, but each has its own gains and states."""

    def with_gain(rod_extension, rod_reference, ki=0.0, k=K):
        return law_with_branch(rod_extension, rod_reference, k + ki)

    def with_state(rod_extension, rod_reference, state=(0.0, 0.0), k=K):
        return law_with_branch(rod_extension, rod_reference, k), state

    bench = Scenario.preset("bench").changed({"simulation.duration_s": 0.1})
    expected = angles(bench, law_with_branch)
    for form in (with_gain, with_state, law_with_branch):
        assert angles(bench, form).tolist() == expected.tolist()


def test_a_law_follows_a_value_that_changes_between_two_runs() -> None:
    """The scenario is kept; the law reads a value that is not its own."""
    gains = {"k": 8e4}

    def reads(rod_extension, rod_reference):
        return gains["k"] * (rod_reference[0] - rod_extension)

    scenario = SHORT.with_law(reads)
    first = simulate(scenario)["knee_angle_rad"]
    gains["k"] = 2e4
    second = simulate(scenario)["knee_angle_rad"]
    assert np.abs(second - first).max() > 1e-4
    assert second.tolist() == angles(SHORT, reads).tolist()


def system_that_starts_moving():
    """Return a system whose command decays from 300 rad/s, its default discrete state."""
    builder = DiagramBuilder()
    decay = builder.AddSystem(LinearSystem([[0.99]], [[0.0]], [[1.0]], [[0.0]], 0.002))
    decay.configure_default_state([300.0])
    builder.ExportInput(decay.get_input_port(), "rod_extension")
    builder.ExportOutput(decay.get_output_port(), "motor_speed_command")
    return builder.Build()


def test_a_drake_system_starts_at_its_default_state() -> None:
    assert not why_python(SHORT.with_law(system_that_starts_moving))
    command = simulate(SHORT, law=system_that_starts_moving)["motor_speed_command_rad_s"]
    np.testing.assert_allclose(command[:3], [300.0, 297.0, 294.03], rtol=1e-12)


@pytest.mark.parametrize(
    ("form", "duration_s"),
    [
        (pi_with_floats, 0.05),
        *(pytest.param(form, 0.3, marks=pytest.mark.slow) for form in (pi, SystemPi)),
    ],
)
def test_the_engines_agree_for_a_law(form, duration_s):
    ours = SHORT.changed({"simulation.duration_s": duration_s})
    drake = ours.with_steps(2e-4).with_engine("drake")
    np.testing.assert_allclose(angles(drake, form), angles(ours, form), rtol=0.0, atol=1e-6)


def test_margins_of_a_law() -> None:
    """Twice the gain is twice the loop; a branch on floats changes nothing."""
    frequencies = [0.1, 1.0, 10.0]
    loop = linearize_loop(law=law).loop_response(frequencies)
    double = linearize_loop(Scenario().with_law(law, values={"k": 2.0 * K}))
    np.testing.assert_allclose(double.loop_response(frequencies), 2.0 * loop, rtol=1e-9)
    branch = linearize_loop(law=law_with_branch)
    np.testing.assert_allclose(branch.loop_response(frequencies), loop, rtol=1e-9)


@pytest.mark.slow
def test_margins_of_a_law_with_state() -> None:
    """A law that needs floats, and a system, have the loop of the law that compiles."""
    frequencies = [0.1, 1.0, 10.0]
    loop = linearize_loop(law=law).loop_response(frequencies)
    exact = linearize_loop(law=pi).loop_response(frequencies)
    for form in (pi_with_floats, SystemPi):
        floats = linearize_loop(law=form).loop_response(frequencies)
        np.testing.assert_allclose(floats, exact, rtol=1e-6)
    integral = 0.002 * K_I / (np.exp(2j * np.pi * 0.1 * 0.002) - 1.0)
    np.testing.assert_allclose(exact[0] / loop[0], (K + integral) / K, rtol=1e-6)


def test_laws_without_a_linear_loop_say_so() -> None:
    with pytest.raises(LinearizationError, match="hides state"):
        linearize_loop(law=HiddenPi())
    with pytest.raises(LinearizationError, match="or let the law act on the error"):
        linearize_loop(law=lambda rod_extension: 5.0)
    with pytest.raises(LinearizationError, match="returns nan as command; must be finite"):
        linearize_loop(law=lambda rod_extension: math.nan * math.floor(rod_extension))


def law_of_all(rod_extension, rod_reference, estimated_state, knee_angle, knee_reference, time_s):
    return (
        K * (rod_reference[0] - rod_extension)
        + 100.0 * rod_reference @ [1.0, 2.0, 3.0, 4.0]
        + 50.0 * estimated_state @ [1.0, 2.0, 0.3]
        + 3000.0 * (knee_angle - knee_reference[0])
        + 3.0 * knee_reference @ [1.0, 2.0, 3.0, 4.0]
        + 11.0 * time_s
    )


def law_of_all_with_floats(
    rod_extension, rod_reference, estimated_state, knee_angle, knee_reference, time_s
):
    return float(
        law_of_all(
            rod_extension, rod_reference, estimated_state, knee_angle, knee_reference, time_s
        )
    )


@pytest.mark.parametrize(
    "estimator", [None, pytest.param(ExactParameters(), marks=pytest.mark.slow)]
)
def test_every_input_reaches_a_law_in_python(estimator) -> None:
    scenario = SHORT if estimator is None else SHORT.model_copy(update={"estimator": estimator})
    assert not why_python(scenario.with_law(law_of_all))
    assert why_python(scenario.with_law(law_of_all_with_floats))
    np.testing.assert_allclose(
        angles(scenario, law_of_all_with_floats), angles(scenario, law_of_all), rtol=0.0, atol=1e-7
    )


@pytest.mark.slow
def test_a_sampled_reference_reaches_a_law_in_python() -> None:
    times = np.linspace(0.0, 0.3, 31)
    reference = SampledReference(
        times_s=tuple(times), angles_deg=tuple(20.0 + 5.0 * np.sin(10.0 * times))
    )
    scenario = SHORT.model_copy(update={"reference": reference})
    np.testing.assert_allclose(
        angles(scenario, pi_with_floats), angles(scenario, pi), rtol=0.0, atol=1e-7
    )


def test_the_first_run_says_once_why_the_law_is_slow(capsys) -> None:
    def slow(rod_extension, rod_reference):
        return max(-500.0, K * (rod_reference[0] - rod_extension))

    for _ in range(2):
        simulate(SHORT, law=slow)
    (line,) = (text for text in capsys.readouterr().err.splitlines() if "slow" in text)
    assert "runs as Python" in line
    assert "the function branches on a value (line " in line
    assert "docs/your_controller.md" in line


def weaker_near_the_reference():
    """Return a law whose equations leave out a branch that only a run reaches."""

    def weaker(rod_extension, rod_reference):
        error = rod_reference[0] - rod_extension
        is_number = not isinstance(error, Expression)
        return (0.5 if is_number and rod_extension > 0.1 and abs(error) < 2e-5 else 1.0) * K * error

    return weaker


def test_equations_that_differ_in_a_run_are_replaced_by_the_function(capsys) -> None:
    law, same = weaker_near_the_reference(), weaker_near_the_reference()
    assert why_python(SHORT.with_law(law)) == ""
    metrics = track_basic_metrics(SHORT.with_law(law))
    assert "differ from calls" in why_python(SHORT.with_law(law))
    run = simulate(SHORT, law=same)
    recorded = zip(run["measured_rod_extension_m"], run["rod_reference_m"], strict=True)
    commands = [same(x, [reference]) for x, reference in recorded]
    limited = np.clip(commands, -SHORT.command_limit_rad_s, SHORT.command_limit_rad_s)
    np.testing.assert_allclose(run["motor_speed_command_rad_s"][1:], limited[:-1], rtol=1e-9)
    assert metrics == track_basic_metrics(SHORT.with_law(same))
    assert len([t for t in capsys.readouterr().err.splitlines() if "differ from calls" in t]) == 1


def test_the_command_is_limited() -> None:
    step = SHORT.model_copy(update={"initial_offset_m": -0.02})
    unlimited = LawParameters(function=law, command_limit_rad_s=1e9)
    for form in (law, law_with_branch, lambda: FunctionLaw(unlimited), SystemPi):
        run = simulate(step, law=form)
        peak = np.abs(run["motor_speed_command_rad_s"]).max()
        assert peak == pytest.approx(step.command_limit_rad_s, rel=1e-12)


def test_a_drake_system_that_converts_is_compiled_and_held() -> None:
    """A system without discrete state is held for a sample, as a function is."""

    def system():
        return FunctionLaw(LawParameters(function=law))

    assert not why_python(SHORT.with_law(system))
    np.testing.assert_array_equal(angles(SHORT, system), angles(SHORT, law))
    loop = linearize_loop(law=system)
    assert loop.margins() == linearize_loop(law=law).margins()


def test_a_law_that_raises_names_its_line() -> None:
    def faulty(rod_extension):
        return 1.0 / math.floor(rod_extension)

    with pytest.raises(ParameterError, match=r"fails: ZeroDivisionError.*test_python_law.py, line"):
        simulate(SHORT, law=faulty)


def test_a_law_that_becomes_infinite_names_time_and_signal() -> None:
    def infinite(rod_extension, time_s):
        return math.inf if time_s > 0.1 else 0.0

    with pytest.raises(SimulationError, match=r"t = 0.102 s: law .* returns inf as command; must"):
        simulate(SHORT, law=infinite)
    with pytest.raises(SimulationError, match=r"t = 0 s: law .* returns nan as command") as caught:
        simulate(SHORT, law=lambda rod_extension: math.nan * math.floor(rod_extension))
    assert "wrong sign" not in str(caught.value)


@pytest.mark.parametrize("form", [law, law_with_branch, pi])
def test_the_message_names_a_wrong_sign(form) -> None:
    scenario = Scenario(simulation=SimulationParameters(duration_s=3.0))
    with pytest.raises(SimulationError, match="has the wrong sign: a positive command drives"):
        track(scenario.with_law(form, values={"k": -K}))


def test_the_message_names_a_wrong_sign_of_a_law_that_reads_the_encoder() -> None:
    """θ_4 falls with the knee angle. The law jumps at the reading of the start, with its offset."""
    scenario = Scenario().changed({"encoder.mounting_error_rad": 0.05})
    angle = start_angle_rad(scenario.reference)
    at_start = encoder_angle(scenario.plant.linkage, angle) - scenario.encoder.offset_rad

    def jumping(encoder_reading, gain=1e9):
        return gain * (encoder_reading - float(at_start))

    wrong, right = (scenario.with_law(jumping, values={"gain": g}) for g in (1e9, -1e9))
    assert "has the wrong sign" in sign_hint(wrong)
    assert sign_hint(right) == ""


def test_a_divergence_of_a_right_sign_is_no_wrong_sign() -> None:
    scenario = Scenario(simulation=SimulationParameters(duration_s=3.0))
    with pytest.raises(SimulationError) as caught:
        track(scenario.with_law(lambda rod_extension: 400.0))
    assert "wrong sign" not in str(caught.value)


MADE = []


def proportional_system(gain):
    def made(rod_extension, rod_reference):
        return gain * (rod_reference[0] - rod_extension)

    return FunctionLaw(LawParameters(function=made))


def maker(gain):
    def make():
        MADE.append(gain)
        return proportional_system(gain)

    return make


def test_makers_of_one_name_are_two_laws() -> None:
    runs = [simulate(SHORT.with_law(maker(gain)))["knee_angle_rad"] for gain in (9e3, 3e2, 9e3)]
    assert np.array_equal(runs[0], runs[2])
    assert np.ptp(runs[0] - runs[1]) > 1e-4


GAIN = 9e3


def make_by_global():
    return proportional_system(GAIN)


def test_a_maker_is_asked_anew_in_each_call_and_once_in_a_batch(monkeypatch) -> None:
    scenario = SHORT.with_law(make_by_global)
    before = simulate(scenario)["knee_angle_rad"]
    monkeypatch.setitem(globals(), "GAIN", 3e2)
    assert np.array_equal(
        simulate(scenario)["knee_angle_rad"], simulate(SHORT.with_law(maker(3e2)))["knee_angle_rad"]
    )
    assert np.ptp(before - simulate(scenario)["knee_angle_rad"]) > 1e-4
    counts = []
    for count in (1, 4):
        MADE.clear()
        offsets = {"initial_offset_m": np.linspace(0.0, 1e-3, count)}
        batch(SHORT.with_law(maker(3e2)), offsets, progress=False)
        counts.append(len(MADE))
    assert counts[0] == counts[1]


@pytest.mark.slow
def test_a_script_that_names_its_own_law_runs_once(tmp_path) -> None:
    path = tmp_path / "my script.py"
    path.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout == "START __main__\nTrue\n"


SCRIPT = """
print("START", __name__, flush=True)
import kneexo as kx

def law(rod_extension, rod_reference):
    return 1.3e5 * (rod_reference[0] - rod_extension)

s = kx.Scenario().changed({"simulation.duration_s": 0.1})
r = kx.track(s, law=f"{__file__}:law")
print(r.scenario.controller.function.target is law)
"""
