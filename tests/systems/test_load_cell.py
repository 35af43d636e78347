import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagramc import compile_diagram
from diagramc.testing import check_leaf
from kneexo.errors import ParameterError, SimulationError
from kneexo.parameters import LoadCellParameters
from kneexo.systems import LoadCell
from kneexo.systems.load_cell import next_seeds

T = 0.002
PLAIN = {"quantized": False}


def generator(seed):
    """Algorithm AS 183 in whole numbers."""
    x, y, z = (
        word % (m - 1) + 1
        for word, m in zip(
            np.random.SeedSequence(seed).generate_state(3).tolist(),
            (30269, 30307, 30323),
            strict=True,
        )
    )
    while True:
        yield 2.0 * (x / 30269 + y / 30307 + z / 30323 - 1.5)
        x, y, z = 171 * x % 30269, 172 * y % 30307, 170 * z % 30323


def readings(parameters, times, force=0.0):
    """Reading and age just before the update at each time, a multiple of the sample time."""
    system = LoadCell(LoadCellParameters(**parameters), initial_force_n=force)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    port = system.GetInputPort("rod_force").FixValue(context, force)
    assert port is not None
    simulator.Initialize()
    result = []
    for time in times:
        simulator.AdvanceTo(time)
        result.append(system.GetOutputPort("measured_force").Eval(context))
    return np.array(result)


@pytest.mark.parametrize("missing", [False, True])
def test_conversions_agree_and_keep_arguments_and_changes(missing):
    numbers = {"offset_n": 3.0, "filter_s": 0.004, "noise_n": 2.0, "seed": 5, "quantized": False}
    if missing:
        numbers |= {"dropout_s": 50.0, "dropout_start_s": 0.01}

    state = [(-600.0, 600.0), (0.0, 0.02), *[(1000.0, 1003.0)] * 3]
    ranges = {
        "rod_force": (-800.0, 800.0),
        "continuous_state": (-0.4, 0.4),
        "discrete_state": state,
    }
    check_leaf(LoadCell(LoadCellParameters(**numbers)), ranges)


def test_low_pass_and_offset():
    system = LoadCell(LoadCellParameters(filter_s=0.02, offset_n=3.0, quantized=False))
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("rod_force").FixValue(context, 100.0)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    simulator.AdvanceTo(0.03)
    value, age = system.GetOutputPort("measured_force").Eval(context)
    assert value == pytest.approx(3.0 + 100.0 * (1.0 - math.exp(-1.5)), rel=1e-6)
    assert age == 0.0


@pytest.mark.parametrize(("force", "reading"), [(1e4, 500.0), (-1e4, -500.0), (123.0, 123.0)])
def test_range(force, reading):
    assert readings({"range_n": 500.0, **PLAIN}, [0.01], force)[0, 0] == pytest.approx(reading)


@pytest.mark.parametrize(("force", "reading"), [(7.4, 7.5), (7.6, 7.5), (-7.4, -7.5), (1.2, 0.0)])
def test_quantization_rounds_to_the_nearest_step(force, reading):
    assert readings({"resolution_n": 2.5}, [0.01], force)[0, 0] == reading


def test_noise_is_that_of_as_183_and_is_new_in_each_sample():
    times = T * np.arange(1, 40) + 0.5 * T
    noise = readings({"noise_n": 3.0, "seed": 7, **PLAIN}, times, 50.0)[:, 0] - 50.0
    expected = generator(7)
    next(expected)
    next(expected)  # AdvanceTo(3 ms) has made the updates at 0 and 2 ms
    # 50 N and 3 N leave ten digits.
    np.testing.assert_allclose(noise, [3.0 * next(expected) for _ in times], rtol=0, atol=1e-11)
    other = readings({"noise_n": 3.0, "seed": 8, **PLAIN}, times, 50.0)[:, 0] - 50.0
    assert abs(np.corrcoef(noise, other)[0, 1]) < 0.6


def test_generators_are_exact_in_single_precision():
    double, single = next_seeds([30268.0, 30306.0, 30322.0]), [30268, 30306, 30322]
    for _ in range(5000):
        pairs = zip(((30269, 171), (30307, 172), (30323, 170)), single, strict=True)
        products = [(np.float32(m), np.float32(a) * np.float32(state)) for (m, a), state in pairs]
        half = np.float32(0.5)
        single = [product - m * np.floor((product + half) / m) for m, product in products]
        assert [float(state) for state in single] == double
        double = next_seeds(double)


def test_missing_readings_repeat_the_last_one_and_age():
    # The amplifier follows at once; the readings of 10, 12 and 14 ms are missing.
    parameters = {"dropout_start_s": 0.009, "dropout_s": 0.006, "filter_s": 1e-5, **PLAIN}
    system = LoadCell(LoadCellParameters(**parameters))
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    seen = []
    for index in range(10):
        system.GetInputPort("rod_force").FixValue(context, 10.0 * (index + 1))
        simulator.AdvanceTo(T * index + 0.0019)
        seen.append(system.GetOutputPort("measured_force").Eval(context).tolist())
    # The force changes 0.1 ms before a sample: the last reading, at 8 ms, is 50 N.
    values, ages = np.transpose(seen)  # default accuracy of Drake's integrator
    assert ages == pytest.approx([0, 0, 0, 0, 0.002, 0.004, 0.006, 0, 0, 0])
    assert values[:4] == pytest.approx([10.0, 20.0, 30.0, 40.0], rel=0.01)
    assert values[4:7] == pytest.approx([50.0] * 3, rel=0.01)
    assert values[7:] == pytest.approx([80.0, 90.0, 100.0], rel=0.01)


@pytest.mark.slow
def test_compiled_noise_is_bit_equal_to_drakes():
    system = LoadCell(LoadCellParameters(noise_n=3.0, seed=7))
    model = compile_diagram(system, inputs=["rod_force"])
    parameters = model.parameters()
    run = model.simulate(
        parameters, model.initialized(parameters, model.state()), 0.1, outputs=["measured_force"]
    )
    expected = readings({"noise_n": 3.0, "seed": 7}, run.time_s[1:])[:, 0]
    np.testing.assert_array_equal(run["measured_force"][1:, 0], expected)
    assert len(np.unique(expected)) > 5


def test_noise_without_seed_is_refused_in_one_line():
    with pytest.raises(
        ParameterError, match=r"noise_n = 2 N: seed must be given, .*; add seed: 1\Z"
    ):
        LoadCellParameters(noise_n=2.0)


def test_a_rate_that_is_not_finite_is_an_error():
    system = LoadCell()
    context = system.CreateDefaultContext()
    system.GetInputPort("rod_force").FixValue(context, math.nan)
    with pytest.raises(SimulationError, match="force_rate = nan is not finite"):
        system.EvalTimeDerivatives(context)
