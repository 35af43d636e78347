"""Sampled loops against Drake's Simulator, from sample to sample and in the response to a sine."""

import itertools
import math

import numpy as np
import pytest
from linear_cases import SCENARIOS, T, distance
from pydrake.systems.analysis import InitializeParams, ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from kneexo.analysis.linear.sampled_loop import linearize_loop
from kneexo.diagrams import make_closed_loop
from kneexo.parameters import EncoderParameters, SineReference, StepReference


def at_rest(scenario, angle_deg):
    """The scenario with a constant reference and without the quantizer."""
    return scenario.model_copy(
        update={
            "encoder": EncoderParameters(quantized=False),
            "reference": StepReference(start_deg=angle_deg, end_deg=angle_deg),
        }
    )


def fixed_step(diagram, step, scheme="runge_kutta5"):
    """Simulator at a fixed step.

    The fifth order changes the 447 Hz mode by (ωh)⁶/720 a step: 3e-9 at 40 µs, 7e-7 at 0.1 ms,
    where RK3 at 20 µs changes it by (ωh)⁴/24 = 4e-7.
    """
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, scheme, step)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    return simulator


def perturbations(scenario):
    """Small steps of all states, by their units.

    |x⃛_d − 2λë − λ²ė| of Eq. 27 has a kink where the loop rests; s stays below Φ/1000.
    """
    plant = [1e-4, 1e-7, 1e-5, 1e-3]  # krad/s, m, m/s, MPa
    if scenario.controller.kind == "pid":
        controller = [1e-2, 1e-3, 1e-6]  # rad/s, rad/s, rad
    else:
        estimator = {"observer": [1e-7, 1e-5, 1e-3], "difference": [1e-7, 1e-5], "exact": []}
        controller = [1e-2, *estimator[scenario.estimator.kind]]  # rad/s; m, m/s, m/s²
    return np.diag([*plant, *controller, *[1e-2] * scenario.bus.latency_samples])


def monodromy_by_differences(scenario, angle_deg=40.0, step=4e-5):
    """Map of all states over one sample by Drake's Simulator, around where the loop rests.

    ``AdvanceTo(T)`` from t = 0 makes the update at 0 and leaves that at T undone. States in the
    order of the Context; the update of the estimator by initialization is suppressed.
    """
    diagram = make_closed_loop(at_rest(scenario, angle_deg), signals=(), external_reference=True)
    simulator = fixed_step(diagram, step)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("knee_reference").FixValue(
        context, [math.radians(angle_deg), 0.0, 0.0, 0.0]
    )
    simulator.Initialize()
    groups = [
        context.get_discrete_state(i).size() for i in range(context.num_discrete_state_groups())
    ]
    n = context.num_continuous_states()
    bounds = list(itertools.pairwise([n, *(n + np.cumsum(groups)).tolist()]))

    def state():
        discrete = [context.get_discrete_state(i).CopyToVector() for i in range(len(groups))]
        return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])

    def sample(start):
        context.SetTime(0.0)
        context.SetContinuousState(start[:n])
        for index, (low, high) in enumerate(bounds):
            context.SetDiscreteState(index, start[low:high])
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.AdvanceTo(T)
        return state()

    rest = state()
    if scenario.plant.load.kind == "knee":  # the load shifts the rest: let it settle
        for _ in range(600):
            rest = sample(rest)
    return np.array(
        [
            (sample(rest + delta) - sample(rest - delta)) / (2.0 * delta.sum())
            for delta in perturbations(scenario)
        ]
    ).T


def compare_with_differences(loop, monodromy):
    """Largest difference of the matrices, each row by its largest element."""
    scale = np.abs(monodromy).max(axis=1, keepdims=True)
    return (np.abs(monodromy - loop.monodromy) / scale).max()


RARE = ("pid_tuned", "can_1", "difference")


@pytest.mark.parametrize(
    "name",
    [
        "pid",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("smc", "can_2", "other_plant", *RARE)),
    ],
)
def test_monodromy_is_that_of_the_simulator(loops, name):
    monodromy = monodromy_by_differences(SCENARIOS[name])
    if name == "pid":  # the unused integral, which stays zero
        assert np.abs(monodromy[5]).max() == 0.0
        monodromy = np.delete(np.delete(monodromy, 5, axis=0), 5, axis=1)
    assert compare_with_differences(loops[name], monodromy) < 1e-6
    # Multiple eigenvalues near zero (delays) amplify the rounding of the differences.
    values = np.linalg.eigvals(monodromy)
    expected = loops[name].eigenvalues
    large = np.abs(expected) > 0.05
    assert distance(values[np.abs(values) > 0.05], expected[large]) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "step", "rows", "eigenvalues"),
    [("exact", 4e-5, 1e-6, 1e-6), ("weight", 1e-4, 2e-5, 1e-5)],  # weight: 20 steps of 7e-7
)
def test_monodromy_beside_the_rest_is_that_of_the_simulator(loops, name, step, rows, eigenvalues):
    # Table 1 and the load put the rest a little off the start.
    monodromy = monodromy_by_differences(SCENARIOS[name], step=step)
    assert compare_with_differences(loops[name], monodromy) < rows
    assert distance(np.linalg.eigvals(monodromy), loops[name].eigenvalues) < eigenvalues


def small_sine(scenario, frequency_hz, amplitude_deg, settle_s, window_s, step=1e-4):
    """Fundamental of the knee angle over that of the reference, by Drake's Simulator.

    The window holds whole periods of the sine and of the sampling. The samples' images at
    500k ± f Hz are fitted along, under a Hann window that keeps out what is left of the transient.
    """
    reference = SineReference(
        mean_deg=40.0, amplitude_deg=amplitude_deg, frequency_hz=min(frequency_hz, 250.0)
    )
    inner = make_closed_loop(
        at_rest(scenario, 40.0).model_copy(update={"reference": reference}), signals=()
    )
    builder = DiagramBuilder()
    builder.AddSystem(inner)
    sink = LogVectorOutput(inner.GetOutputPort("knee_angle"), builder, publish_period=0.2e-3)
    simulator = fixed_step(builder.Build(), step)
    source = inner.GetSubsystemByName("reference")
    context = source.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    source.set_parameter(context, "frequency_hz", frequency_hz)  # also beyond the parameter's range
    simulator.AdvanceTo(settle_s + window_s)
    log = sink.FindLog(simulator.get_context())
    count = round(window_s / 0.2e-3)
    time, angle = log.sample_times()[-count:], log.data()[0, -count:] - math.radians(40.0)
    rates = {frequency_hz, *(abs(500.0 * k + i * frequency_hz) for k in (1, 2) for i in (1, -1))}
    phases = 2.0 * math.pi * np.array([frequency_hz, *sorted(rates - {frequency_hz})])[:, None]
    basis = [np.cos(phases * time), np.sin(phases * time), [np.ones(count)], [time - time[0]]]
    weight = np.hanning(count + 1)[:-1]
    rows = np.concatenate(basis) * weight
    fit = np.linalg.lstsq(rows.T, weight * angle, rcond=None)[0]
    return -(fit[0] - 1j * fit[len(rates)]) / math.radians(amplitude_deg)


# Amplitudes stay inside the boundary layer, whose s grows with f², and below the motor's
# acceleration limit, 100 rad/s of sudden command. The first case is quick enough for the gate.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frequency_hz", "amplitude_deg", "settle_s", "window_s"),
    [
        ("smc", 20.0, 1e-3, 0.5, 0.1),
        ("smc", 100.0, 1e-4, 0.5, 0.1),
        ("smc", 0.5, 1e-2, 1.0, 4.0),
        ("smc", 2.0, 1e-2, 0.6, 1.0),
        ("smc", 8.0, 1e-3, 0.6, 0.5),
        ("smc", 240.0, 1e-5, 0.6, 0.4),
        ("smc", 300.0, 1e-5, 0.6, 0.4),
        ("pid", 8.0, 1e-3, 1.0, 1.0),
        ("pid_tuned", 2.0, 1e-3, 2.0, 1.0),
        ("difference", 20.0, 1e-4, 0.6, 0.3),
        ("can_2", 40.0, 1e-4, 0.6, 0.3),
        ("weight", 8.0, 1e-3, 0.6, 0.5),
    ],
)
def test_the_response_to_a_small_sine_is_that_of_the_simulator(
    name, frequency_hz, amplitude_deg, settle_s, window_s
):
    scenario = SCENARIOS[name]
    expected = linearize_loop(scenario).output_response(frequency_hz)[0]
    ratio = small_sine(scenario, frequency_hz, amplitude_deg, settle_s, window_s) / expected
    assert abs(ratio) == pytest.approx(1.0, abs=1e-3)
    assert math.degrees(np.angle(ratio)) == pytest.approx(0.0, abs=0.1)
