"""Check the linear analysis against closed forms, Drake's Simulator and python-control.

    python benchmarks/validate_linearization.py

Prints the table "what | required | found"; all cores, some minutes. Responses are those to a
sine so small that the loop stays linear, simulated from 0.05 to 300 Hz without the quantizer, and
compared between the samples too.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import control
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import InitializeParams, ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from kneexo.analysis import SampledLoop, linearize_loop, linearize_plant
from kneexo.diagrams import make_closed_loop
from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    KneeLoadParameters,
    PidParameters,
    PlantParameters,
    Scenario,
    SineReference,
    SlidingModeParameters,
    StepReference,
)
from kneexo.studies.paper import EQ_27_EXACT_STATES
from kneexo.sweeps import parallel_map

MID_DEG = 40.0
LOG_S = 0.2e-3
FREQUENCIES_HZ = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 150.0, 200.0, 240.0)
SCENARIOS = {
    "SMC": Scenario(),
    "PID": Scenario(controller=PidParameters()),
    "PID tuned": Scenario(
        controller=PidParameters(
            proportional_per_s=11.89, integral_per_s2=380.5, derivative=0.02, filter_s=0.01915
        )
    ),
    "SMC, CAN 1 sample": Scenario(bus={"latency_samples": 1}),
    "SMC, CAN 2 samples": Scenario(bus={"latency_samples": 2}),
    "SMC, differences": Scenario(estimator=DifferenceParameters()),
    "SMC, exact states": Scenario(
        estimator=ExactParameters(), controller=EQ_27_EXACT_STATES["10000"].controller
    ),
    "SMC, weight": Scenario(plant=PlantParameters(load=KneeLoadParameters())),
}
RESPONSES = [
    *itertools.product(("SMC", "PID"), FREQUENCIES_HZ),
    ("SMC", 300.0),  # beyond the Nyquist frequency
    *itertools.product(("PID tuned", "SMC, CAN 2 samples", "SMC, differences"), (2.0, 20.0, 100.0)),
    ("SMC, weight", 2.0),
    ("SMC, weight", 20.0),
]


def row(what: str, required: str, found: object) -> None:
    """Print one row of the table."""
    print(f"{what} | {required} | {found}", flush=True)


def nearest(values: NDArray, value: complex) -> complex:
    """The element of ``values`` next to ``value``."""
    return values[np.argmin(np.abs(values - value))]


# ---------------------------------------------------------------------------------- plant


def pole_error() -> float:
    """Largest relative error of the poles other than zero, over 200 random plants."""
    generator = np.random.default_rng(2020)
    worst = 0.0
    for _ in range(200):
        leak = 10.0 ** generator.uniform(-13, -12, 3)
        mass, damping, stiffness = generator.uniform((1.0, 0.0, 10.0), (3.0, 300.0, 1e3))
        bulk, lag = 10.0 ** generator.uniform(7.5, 9.3), 10.0 ** generator.uniform(-3, -1)
        plant = PlantParameters(
            pump=BldcPumpParameters(
                lag_s=lag,
                internal_leakage_m3_per_s_pa=leak[0],
                external_leakage_m3_per_s_pa=leak[1],
            ),
            cylinder=CylinderParameters(
                mass_kg=mass,
                damping_n_s_per_m=damping,
                stiffness_n_per_m=stiffness,
                bulk_modulus_pa=bulk,
                leakage_m3_per_s_pa=leak[2],
            ),
        )
        area = math.pi / 4.0 * (0.020**2 - 0.5 * 0.010**2)
        h, c_t = 4.0 * bulk / 41_233e-9, leak[2] + leak[0] + 0.5 * leak[1]
        polynomial = [
            mass,
            damping + mass * h * c_t,
            stiffness + damping * h * c_t + h * area**2,
            stiffness * h * c_t,
        ]
        expected = [*np.roots(polynomial), -1.0 / lag]
        poles = linearize_plant(plant, knee_angle_deg=MID_DEG).poles
        # The slow pole, −K C_t/Ā², drowns in the rounding of the fast ones: of these alone.
        worst = max(worst, *(abs(nearest(poles, p) / p - 1.0) for p in expected if abs(p) > 0.1))
    return worst


# -------------------------------------------------------------------------- by simulation


def at_rest(scenario: Scenario) -> Scenario:
    """The scenario with a constant reference and without the quantizer."""
    return scenario.model_copy(
        update={
            "encoder": EncoderParameters(quantized=False),
            "reference": StepReference(start_deg=MID_DEG, end_deg=MID_DEG),
            "initial_offset_m": 0.0,
        }
    )


def fixed_step(diagram: object, step_s: float) -> Simulator:
    """Drake's Simulator with RK5, which changes the 447 Hz mode by (ωh)⁶/720 a step."""
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, "runge_kutta5", step_s)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    return simulator


def monodromy(scenario: Scenario) -> NDArray:
    """Map of all states over one sample by central differences, at 20 µs."""
    diagram = make_closed_loop(at_rest(scenario), signals=(), external_reference=True)
    simulator = fixed_step(diagram, 2e-5)
    context = simulator.get_mutable_context()
    diagram.GetInputPort("knee_reference").FixValue(context, [math.radians(MID_DEG), 0, 0, 0])
    simulator.Initialize()
    n = context.num_continuous_states()
    groups = range(context.num_discrete_state_groups())

    def state() -> NDArray:
        discrete = [context.get_discrete_state(i).CopyToVector() for i in groups]
        return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])

    def sample(start: NDArray) -> NDArray:
        context.SetTime(0.0)
        context.SetContinuousState(start[:n])
        position = n
        for index in groups:
            size = context.get_discrete_state(index).size()
            context.SetDiscreteState(index, start[position : position + size])
            position += size
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.AdvanceTo(scenario.controller.sample_time_s)
        return state()

    # krad/s, m, m/s, MPa; then by controller and estimator.
    if scenario.controller.kind == "pid":
        steps = [1e-4, 1e-7, 1e-5, 1e-3, 1e-2, 1e-3, 1e-6]
    else:
        estimator = {"observer": [1e-7, 1e-5, 1e-3], "difference": [1e-7, 1e-5], "exact": []}
        steps = [1e-4, 1e-7, 1e-5, 1e-3, 1e-2, *estimator[scenario.estimator.kind]]
    steps += [1e-2] * scenario.bus.latency_samples
    rest = state()
    columns = [
        (sample(rest + step) - sample(rest - step)) / (2.0 * step.sum()) for step in np.diag(steps)
    ]
    jacobian = np.array(columns).T
    if scenario.controller.kind == "pid" and not scenario.controller.integral_per_s2:
        jacobian = np.delete(np.delete(jacobian, n + 1, axis=0), n + 1, axis=1)
    return jacobian


def response_ratio(item: tuple[str, float]) -> complex:
    """Simulated over predicted response of the knee angle to a small sine."""
    name, frequency = item
    scenario = SCENARIOS[name]
    loop = linearize_loop(scenario, knee_angle_deg=MID_DEG)
    settle, window = times(item)
    # Inside the boundary layer, whose s grows with f², and the motor's acceleration limit.
    amplitude = min(1e-2, 1e-3 * (20.0 / frequency) ** 2)
    reference = SineReference(
        mean_deg=MID_DEG, amplitude_deg=amplitude, frequency_hz=min(frequency, 250.0)
    )
    inner = make_closed_loop(
        at_rest(scenario).model_copy(update={"reference": reference}), signals=()
    )
    builder = DiagramBuilder()
    builder.AddSystem(inner)
    sink = LogVectorOutput(inner.GetOutputPort("knee_angle"), builder, publish_period=LOG_S)
    simulator = fixed_step(builder.Build(), 1e-4 if frequency > 20.0 else 2e-4)
    source = inner.GetSubsystemByName("reference")
    context = source.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    source.set_parameter(context, "frequency_hz", frequency)
    simulator.AdvanceTo(settle + window)
    log, count = sink.FindLog(simulator.get_context()), round(window / LOG_S)
    time, angle = log.sample_times()[-count:], log.data()[0, -count:] - math.radians(MID_DEG)
    # Fitted along: what is left of the transient, and the images of the samples.
    rates = [frequency, *(abs(500.0 * k + i * frequency) for k in (1, 2) for i in (1, -1))]
    phases = 2.0 * math.pi * np.array(rates)[:, None] * time
    basis = [np.cos(phases), np.sin(phases), [np.ones(count)], [time - time[0]]]
    weight = np.hanning(count + 1)[:-1]
    rows = np.concatenate(basis) * weight
    fit = np.linalg.lstsq(rows.T, weight * angle, rcond=None)[0]
    response = -(fit[0] - 1j * fit[len(rates)]) / math.radians(amplitude)
    return complex(response / loop.output_response(frequency)[0])


def times(item: tuple[str, float]) -> tuple[float, float]:
    """Time to settle, and a window of at least two whole periods of sine and sampling, in s."""
    name, frequency = item
    loop = linearize_loop(SCENARIOS[name], knee_angle_deg=MID_DEG)
    rate = -math.log(abs(loop.eigenvalues[0])) / loop.sample_time_s
    return math.ceil(120.0 / rate) / 10.0, max(0.4, 2.0 / frequency)


def growth_error() -> float:
    """Relative error of the growth rate of the unstable loop with exact states at 40 deg."""
    scenario = EQ_27_EXACT_STATES["13000"]
    value = linearize_loop(scenario, knee_angle_deg=MID_DEG).eigenvalues[0]
    inner = make_closed_loop(at_rest(scenario), signals=())
    builder = DiagramBuilder()
    builder.AddSystem(inner)
    dt = scenario.controller.sample_time_s
    sink = LogVectorOutput(inner.GetOutputPort("load_pressure"), builder, publish_period=dt)
    simulator = fixed_step(builder.Build(), 4e-5)
    simulator.AdvanceTo(2.4)
    log = sink.FindLog(simulator.get_context())
    time, pressure = log.sample_times(), log.data()[0]
    amplitudes, centres = [], np.arange(1.3, 2.3, 0.1)
    for centre in centres:
        rows = np.abs(time - centre) < 0.05
        shift = time[rows] - centre
        mode = np.exp(1j * np.angle(value) * shift / dt)
        basis = np.stack([mode.real, mode.imag, np.ones_like(shift), shift], axis=1)
        fit = np.linalg.lstsq(basis, pressure[rows], rcond=None)[0]
        amplitudes.append(math.hypot(fit[0], fit[1]))
    growth = np.polyfit(centres, np.log(amplitudes), 1)[0]
    return abs(growth * dt / math.log(abs(value)) - 1.0)


# ------------------------------------------------------------------------ python-control


def margin_errors(loop: SampledLoop) -> tuple[float, float, float]:
    """Relative errors of the margins and disk margins; distance to the unit circle at them."""
    m, dt = loop.margins(), loop.sample_time_s
    system = loop.to_control()
    f = np.geomspace(0.05, 0.4999 / dt, 6000)
    response = system(np.exp(2j * math.pi * f * dt))
    gain, phase, *_ = control.stability_margins(control.FRD(response, 2 * np.pi * f, smooth=True))
    fine = m.disk_margin_frequency_hz * (1.0 + np.linspace(-0.03, 0.03, 2001))
    f = np.sort(np.concatenate([f, fine[fine < 0.5 / dt]]))
    disk, disk_gain, disk_phase = control.disk_margins(system, 2 * np.pi * f, skew=0.0)
    at_gain = np.exp(2j * math.pi * m.gain_margin_frequency_hz * dt)
    at_phase = np.exp(2j * math.pi * m.phase_margin_frequency_hz * dt)
    turn = np.exp(-1j * math.radians(m.phase_margin_deg))
    scaled = replace(loop.loop, b=m.gain_margin * loop.loop.b)
    on_circle = (
        abs(nearest(scaled.closed_eigenvalues(), at_gain) - at_gain),
        abs(nearest(np.linalg.eigvals(system.A - turn * system.B @ system.C), at_phase) - at_phase),
    )
    return (
        max(abs(m.gain_margin / gain - 1.0), abs(m.phase_margin_deg / phase - 1.0)),
        max(
            abs(m.disk_margin / disk - 1.0),
            abs(20.0 * math.log10(m.disk_gain_margin) / disk_gain - 1.0),
            abs(m.disk_phase_margin_deg / disk_phase - 1.0),
        ),
        max(on_circle),
    )


def stability_boundary() -> float:
    """k/Φ in 1/s at which the loop with exact states loses stability."""
    low, high = 5e3, 3e4
    for _ in range(40):
        middle = 0.5 * (low + high)
        phi = math.sqrt(1.8 / 1.4) * 2.8e5 / middle
        scenario = Scenario(
            estimator=ExactParameters(), controller=SlidingModeParameters(phi_m_s2=phi)
        )
        low, high = (
            (middle, high)
            if linearize_loop(scenario, knee_angle_deg=MID_DEG).stable
            else (low, middle)
        )
    return low


def main() -> None:
    """Print the table."""
    print("what | required | found")
    row("plant poles against the closed form, relative", "<= 1e-9", f"{pole_error():.1e}")
    for name, scenario in SCENARIOS.items():
        if scenario.plant.load.kind == "knee":
            continue  # its start is not its rest
        loop, simulated_map = linearize_loop(scenario, knee_angle_deg=MID_DEG), monodromy(scenario)
        scale = np.abs(simulated_map).max(axis=1, keepdims=True)
        row(
            f"{name}: map of one sample against Drake's Simulator, each row by its largest",
            "<= 1e-6",
            f"{(np.abs(simulated_map - loop.monodromy) / scale).max():.1e}",
        )
        values = loop.eigenvalues[np.abs(loop.eigenvalues) > 0.05]
        simulated = np.linalg.eigvals(simulated_map)
        row(
            f"{name}: eigenvalues against those of the simulated map",
            "<= 1e-6",
            f"{max(abs(nearest(simulated, value) - value) for value in values):.1e}",
        )
        margins, disk, circle = margin_errors(loop)
        row(f"{name}: gain and phase margin against python-control", "<= 1e-6", f"{margins:.1e}")
        row(f"{name}: disk margins against python-control", "<= 1e-6", f"{disk:.1e}")
        row(f"{name}: at its margins, eigenvalue off the unit circle", "<= 1e-6", f"{circle:.1e}")
    row("exact states: largest stable k/Φ (1/s)", "1.0e4 … 1.3e4", f"{stability_boundary():.1f}")
    row("exact states, k/Φ = 1.3e4: growth rate, relative", "<= 1e-2", f"{growth_error():.1e}")
    ratios = parallel_map(
        response_ratio,
        RESPONSES,
        workers=None,
        description="sines",
        weight=lambda item: sum(times(item)),
    )
    for (name, frequency), ratio in zip(RESPONSES, ratios, strict=True):
        row(
            f"{name}: response at {frequency:g} Hz against Drake's Simulator",
            "<= 0.1 %, 0.1 deg",
            f"{100.0 * abs(abs(ratio) - 1.0):.1e} %, {abs(math.degrees(np.angle(ratio))):.1e} deg",
        )
    row(
        f"all {len(ratios)} responses",
        "<= 0.1 %, 0.1 deg",
        f"{100.0 * max(abs(abs(r) - 1.0) for r in ratios):.1e} %, "
        f"{max(abs(math.degrees(np.angle(r))) for r in ratios):.1e} deg",
    )


if __name__ == "__main__":
    main()
