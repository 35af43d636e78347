"""Compiled models at full speed: integrators, several sample times, faults."""

import numpy as np
import pydrake.math as drake_math
import pytest
import scipy.linalg
from pydrake.common import RandomDistribution
from pydrake.common.value import Value
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem, LeafSystem_
from pydrake.systems.primitives import (
    Gain,
    LinearSystem,
    LogVectorOutput,
    RandomSource,
    Saturation,
    Sine,
    ZeroOrderHold,
)
from pydrake.systems.scalar_conversion import TemplateSystem

import kneexo
from kneexo.analysis.simulation import simulate
from kneexo.compilation import (
    InputTable,
    State,
    compile_diagram,
    compile_scenario,
    scenario_run,
    simulate_compiled,
)
from kneexo.compilation.model import _timing
from kneexo.diagrams import make_closed_loop
from kneexo.errors import CompilationError, SimulationError
from kneexo.parameters import (
    BldcPumpParameters,
    EncoderParameters,
    PlantParameters,
    SampledReference,
    Scenario,
    SimulationParameters,
    SineReference,
)

FREE = EncoderParameters(quantized=False)
TARGET_M = 1e-6 * 0.15  # a millionth of the stroke


def scenario_of(duration_s, **fields):
    settings = SimulationParameters(duration_s=duration_s, integrator="runge_kutta3", step_s=2e-4)
    return Scenario(encoder=FREE, simulation=settings, **fields)


# -------------------------------------------------------------------------- integrators


def test_runge_kutta3_is_that_of_drake():
    scenario = scenario_of(3.0)
    drake = simulate(scenario)
    ours = simulate_compiled(scenario, integrator="runge_kutta3", step_s=2e-4)
    np.testing.assert_array_equal(ours.time_s, drake.time_s)
    assert list(ours.data) == list(drake.data)
    for column, values in drake.data.items():
        error = np.max(np.abs(ours[column] - values))
        assert error <= 1e-9 * np.max(np.abs(values)), column
    assert ours.settings.integrator == "runge_kutta3"
    assert ours.settings.step_s == 2e-4


def test_runge_kutta3_stretches_its_last_step_as_drake_does():
    # 2 ms are 4 steps of 0.499 ms and 0.8 % of one: Drake stretches the last; of 0.4 ms they are 5.
    for step in (0.499e-3, 0.4e-3):
        settings = SimulationParameters(duration_s=0.1, integrator="runge_kutta3", step_s=step)
        scenario = Scenario(encoder=FREE, simulation=settings)
        drake, ours = (
            simulate(scenario),
            simulate_compiled(scenario, integrator="runge_kutta3", step_s=step),
        )
        for column in ("load_pressure_pa", "rod_velocity_m_s"):
            scale = np.max(np.abs(drake[column]))
            np.testing.assert_allclose(ours[column], drake[column], rtol=0, atol=1e-9 * scale)


CASES = {
    "0.1 Hz": scenario_of(5.0),
    "0.21 Hz, saturated": scenario_of(5.0, reference=SineReference(frequency_hz=0.21)),
    "acceleration limited": scenario_of(
        3.0,
        reference=SineReference(frequency_hz=1.0),
        plant=PlantParameters(pump=BldcPumpParameters(acceleration_limit_rad_s2=2e3)),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_exact_hold_is_exact_to_a_millionth_of_the_stroke(case):
    scenario = CASES[case]
    signals = ("rod_extension", "motor_speed", "motor_speed_command", "load_pressure")
    fine = simulate_compiled(scenario, signals=signals, integrator="rk4", step_s=1e-5)
    hold = simulate_compiled(scenario, signals=signals)
    if case != "0.1 Hz":  # the corners are there
        limit = scenario.command_limit_rad_s
        assert np.mean(np.abs(fine["motor_speed_command_rad_s"]) >= limit * (1 - 1e-9)) > 0.05
    assert np.max(np.abs(hold["rod_extension_m"] - fine["rod_extension_m"])) < TARGET_M / 10
    # rk4 itself is off by 1e-3 Pa in the mode of the oil at this step.
    assert np.max(np.abs(hold["load_pressure_pa"] - fine["load_pressure_pa"])) < 1.0


def test_tolerance_of_the_exact_hold_rules_its_error():
    scenario = CASES["acceleration limited"]
    fine = simulate_compiled(scenario, signals=["motor_speed"], integrator="rk4", step_s=2e-6)
    errors = []
    for tolerance in (1e-5, 1e-7, 1e-9):
        run = simulate_compiled(scenario, signals=["motor_speed"], tolerance=tolerance)
        errors.append(np.max(np.abs(run["motor_speed_rad_s"] - fine["motor_speed_rad_s"])))
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.2 * errors[1]


def test_tables_are_the_functions_of_the_matrix_exponential(interpreted):
    model, _ = interpreted(Scenario())
    module = model._module
    size = module.STATE_COUNT
    rng = np.random.default_rng(3)
    a = rng.normal(size=(size, size)) * np.array([1.0, 30.0, 1e3, 3e4])
    tick = 2e-3
    tables = np.empty((module.FINEST + 2, 3, size, size))
    module.fill_tables(a, tick, tables)
    for level in (0, 1, 5, module.FINEST + 1):
        h = tick / 2**level
        block = np.zeros((4 * size, 4 * size))  # phi_k by one exponential (Sidje 1998)
        block[:size, :size] = a * h
        block[: 3 * size, size:] += np.eye(3 * size)
        phi = scipy.linalg.expm(block)[:size]
        phi_1, phi_2, phi_3 = (phi[:, n * size : (n + 1) * size] for n in (1, 2, 3))
        for ours, exact in zip(
            tables[level], (h * phi_1, h * phi_2, h * (phi_2 - 4.0 * phi_3)), strict=True
        ):
            np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-11 * np.abs(exact).max())


# ------------------------------------------------------------------- diagrams of the user


def make_multirate():
    """A sine, held every 4 ms, through a plant, sampled every 10 ms from 5 ms on; nested."""
    inner = DiagramBuilder()
    plant = inner.AddNamedSystem(
        "plant",
        LinearSystem(A=[[0.0, 1.0], [-400.0, -4.0]], B=[[0.0], [400.0]], C=[[1.0, 0.0]], D=[[0.0]]),
    )
    limit = inner.AddNamedSystem("limit", Saturation(min_value=[-0.7], max_value=[0.7]))
    inner.Connect(limit.get_output_port(), plant.get_input_port())
    inner.ExportInput(limit.get_input_port(), "u")
    inner.ExportOutput(plant.get_output_port(), "y")
    inner = inner.Build()
    inner.set_name("inner")
    builder = DiagramBuilder()
    sine = builder.AddNamedSystem("sine", Sine(1.0, 10.0, 0.3, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.004, 1))
    builder.AddNamedSystem("inner", inner)
    sampler = builder.AddNamedSystem("sampler", ZeroOrderHold(0.010, 1, offset_sec=0.005))
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    builder.Connect(sine.get_output_port(0), hold.get_input_port())
    builder.Connect(hold.get_output_port(), inner.get_input_port())
    builder.Connect(inner.get_output_port(), sampler.get_input_port())
    builder.Connect(sampler.get_output_port(), gain.get_input_port())
    for name, system in (("y", inner), ("sampled", gain), ("held", hold)):
        builder.ExportOutput(system.get_output_port(), name)
        log = LogVectorOutput(system.get_output_port(), builder, publish_period=0.002)
        log.set_name(f"log_{name}")
    return builder.Build()


def test_several_sample_periods_and_offsets_agree_with_drake(interpreted_diagram):
    diagram = make_multirate()
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 1e-3)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.AdvanceTo(0.5)
    model = interpreted_diagram(diagram)
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


def test_open_inputs_follow_their_table(interpreted_diagram):
    inner = make_multirate().GetSubsystemByName("inner")
    model = interpreted_diagram(inner, ["u"])
    table = InputTable(np.array([0.1, 0.2]), np.array([[[0.0, 0.0]], [[0.0, 5.0]], [[0.5, 0.0]]]))
    run = model.simulate(model.parameters(), model.state(), 3.0, record_period_s=0.01, inputs=table)
    assert run["y"][10, 0] == 0.0
    assert run["y"][-1, 0] == pytest.approx(0.5, abs=2e-3)  # settled: e^(−2·2.8)
    constant = InputTable(coefficients=np.array([[[9.0]]]))
    run = model.simulate(
        model.parameters(), model.state(), 10.0, record_period_s=1.0, inputs=constant
    )
    assert run["y"][-1, 0] == pytest.approx(0.7, abs=1e-6)  # limited


def test_parameters_are_read_from_a_context_and_used():
    diagram = make_closed_loop(Scenario(encoder=FREE), signals=())
    model = kneexo.compile(diagram)
    context = diagram.CreateDefaultContext()
    cylinder = diagram.GetSubsystemByName("plant").GetSubsystemByName("cylinder")
    cylinder.set_parameter(cylinder.GetMyMutableContextFromRoot(context), "mass_kg", 3.2)
    changed = model.parameters(context)
    index = model.parameter_names.index("plant/cylinder.mass_kg")
    assert changed[index] == 3.2
    assert np.flatnonzero(changed != model.parameters()).tolist() == [index]
    state = model.initialized(changed, model.state())
    runs = [
        model.simulate(p, state, 0.1, outputs=["rod_velocity"])["rod_velocity"]
        for p in (changed, model.parameters())
    ]
    assert np.max(np.abs(runs[0] - runs[1])) > 1e-6


@pytest.mark.parametrize(
    ("periods", "record", "tick", "counts"),
    [
        (((0.002, 0.0),), None, 0.002, [1, 1, 0]),
        (((0.002, 0.0), (0.003, 0.0)), 0.006, 0.001, [6, 2, 0, 3, 0]),
        (((1 / 3, 0.25),), None, 1 / 12, [4, 4, 3]),
        ((), 0.1, 0.1, [1]),
    ],
)
def test_tick_divides_all_times(periods, record, tick, counts):
    timing = _timing(periods, record)
    assert timing.tick == pytest.approx(tick, rel=1e-15)
    assert timing.record_every == counts[0]
    assert timing.periods.tolist() == counts[1::2]
    assert timing.offsets.tolist() == counts[2::2]


def test_sample_times_without_common_divisor_are_refused():
    with pytest.raises(CompilationError, match="no common divisor"):
        _timing(((0.002, 0.0), (0.002 * np.sqrt(2.0), 0.0)), None)
    with pytest.raises(ValueError, match="record_period_s is needed"):
        _timing((), None)


# ------------------------------------------------------------------- what does not compile


class Opaque(LeafSystem):
    """A leaf without scalar conversion."""

    def __init__(self, abstract):
        LeafSystem.__init__(self)
        self.set_name("opaque")
        if abstract:
            self.DeclareAbstractOutputPort("out", lambda: Value(1), lambda c, v: None)


def named_diagram(system, name):
    builder = DiagramBuilder()
    builder.AddNamedSystem(name, system)
    for index in range(system.num_output_ports()):
        builder.ExportOutput(system.get_output_port(index))
    return builder.Build()


@TemplateSystem.define("Tall_")
def Tall_(T):
    class Impl(LeafSystem_[T]):
        """An output whose tree has 2¹⁵ leaves."""

        def _construct(self, *, converter=None):
            LeafSystem_[T].__init__(self, converter)
            self.DeclareVectorOutputPort("out", 1, self._calc)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, converter=converter)

        def _calc(self, context, out):
            value = context.get_time()
            for _ in range(15):
                value = drake_math.sin(value) + drake_math.cos(value)
            out.SetAtIndex(0, value)

    return Impl


@pytest.mark.parametrize(
    ("diagram", "words"),
    [
        (
            lambda: make_closed_loop(
                Scenario(reference=SampledReference(times_s=(0, 1, 2), angles_deg=(0, 9, 0)))
            ),
            ("reference", "output port y0", "no symbolic form"),
        ),
        (
            lambda: named_diagram(RandomSource(RandomDistribution.kUniform, 1, 0.1), "noise"),
            ("noise", "RandomSource", "does not convert"),
        ),
        (lambda: named_diagram(Opaque(abstract=True), "opaque"), ("opaque", "Opaque")),
        (lambda: named_diagram(Gain(1.0, 1), "gain"), ("gain", "output port y0")),
        (
            lambda: named_diagram(Tall_[float](), "tall"),
            ("tall", "output port out", "more than 20000 nodes"),
        ),
    ],
    ids=["sampled", "random", "opaque", "unconnected", "tall"],
)
def test_what_does_not_compile_is_named_in_one_line(diagram, words):
    with pytest.raises(CompilationError) as error:
        compile_diagram(diagram())
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_wrong_arguments_are_named():
    model = compile_scenario(Scenario(encoder=FREE))
    parameters, state, _ = scenario_run(Scenario(encoder=FREE), model)
    with pytest.raises(ValueError, match="integrator = 'euler'"):
        model.simulate(parameters, state, 0.01, integrator="euler")
    with pytest.raises(ValueError, match="output 'angle' is unknown"):
        model.simulate(parameters, state, 0.01, outputs=["angle"])
    with pytest.raises(ValueError, match="parameters has the shape"):
        model.simulate(parameters[1:], state, 0.01)


# -------------------------------------------------------------------------- failed runs


def test_a_run_that_leaves_the_range_says_what_drake_says():
    scenario = Scenario(  # too slow a motor to turn in time
        encoder=FREE,
        reference=SineReference(mean_deg=45.0, amplitude_deg=44.9, frequency_hz=0.15),
        plant=PlantParameters(pump=BldcPumpParameters(acceleration_limit_rad_s2=500.0)),
        simulation=SimulationParameters(duration_s=5.0, integrator="runge_kutta3", step_s=5e-4),
    )
    with pytest.raises(SimulationError) as drake:
        simulate(scenario)
    with pytest.raises(SimulationError) as ours:
        simulate_compiled(scenario)
    # Drake looks after every step of 0.5 ms, the compiled run at the control instants.
    times = [float(str(e.value).split()[2]) for e in (drake, ours)]
    assert 0.0 <= times[1] - times[0] <= 0.002
    head, tail = (str(ours.value).split("= ")[n] for n in (1, 2))
    assert "knee: knee_angle" in head
    assert tail.split(" ", 1)[1] == str(drake.value).split("= ")[2].split(" ", 1)[1]


@pytest.mark.parametrize("integrator", ["exact_hold", "rk4"])
def test_a_state_that_is_not_finite_ends_the_run(integrator):
    scenario = Scenario(encoder=FREE)
    model = compile_scenario(scenario)
    parameters, state, _ = scenario_run(scenario, model)
    bad = State(state.continuous * np.array([np.nan, 1.0, 1.0, 1.0]), state.held)
    with pytest.raises(SimulationError, match=r"plant/motor\.x\[0\] is not finite"):
        model.simulate(parameters, bad, 0.1, integrator=integrator)


def test_a_step_that_is_too_large_ends_the_run():
    with pytest.raises(SimulationError, match="reduce the"):
        simulate_compiled(scenario_of(1.0), integrator="rk4", step_s=2e-3)
