"""RK4 on random full-order plants: which steps are right, which are refused, which are wrong.

The pump and the valves of each plant are 0.1 to 100 times as large as the default. The oracle is
the exact hold at a hundredth of its default tolerance. It gives the largest |λ| at the ticks, and
RK4 then runs with steps h of several h |λ|. A run is right if each signal agrees within 1e-3 of the
signal's range. A refused run is repeated with the step that its message names. For 20 plants the
oracle is compared with Drake's implicit integrator.

python benchmarks/rk4_stability.py [plants] [first seed]
"""

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np

from diagramc.native.runner import Runner, Snapshots
from kneexo.diagrams import available_signals
from kneexo.errors import SimulationError, UnstableStepError
from kneexo.parameters import Scenario
from kneexo.parameters.presets import with_preset
from kneexo.simulation.compiled import compile_scenario, scenario_run
from kneexo.simulation.engines import simulate

DURATION_S = 0.35
SIGNALS = ("rod_extension", "rod_velocity", "load_pressure", "chamber_pressures", "rod_force")
ANGLES = (0.2, 0.5, 1.0, 2.2, 4.0, 15.0, 60.0)
"""Products of step and largest |λ| of a plant."""
TOLERANCE = 1e-3


def random_scenario(seed: int) -> Scenario:
    """Return a walking leg in zero torque, or a leg without wearer, with a random plant."""
    rng = np.random.default_rng(seed)
    pump, makeup, relief = 10.0 ** rng.uniform(-1.0, 2.0, 3)
    friction_n, air = rng.choice([0.0, 15.0]), rng.choice([0.0, 0.015])
    name = rng.choice(["leg", "wearer"])
    scenario = Scenario.model_validate(with_preset(str(name), {}))
    order, displacement = scenario.plant.full_order, scenario.plant.pump.displacement_m3_per_rad
    values = {
        "plant.pump.displacement_m3_per_rad": displacement * pump,
        "plant.full_order.makeup_conductance_m3_per_s_pa": (
            order.makeup_conductance_m3_per_s_pa * makeup
        ),
        "plant.full_order.relief_conductance_m3_per_s_pa": (
            order.relief_conductance_m3_per_s_pa * relief
        ),
        "plant.full_order.dead_volume_m3": order.dead_volume_m3 * 10.0 ** rng.uniform(-0.5, 0.5),
        "plant.full_order.coulomb_friction_n": float(friction_n),
        "plant.full_order.entrained_air": float(air),
        "simulation.duration_s": DURATION_S,
        "reference.amplitude_deg": 10.0,
        "reference.frequency_hz": float(rng.uniform(0.3, 2.0)),
    }
    if name == "wearer":
        law = scenario.controller
        values |= {
            "controller.mode": "zero_torque",
            "wearer.motion": "prescribed",
            "controller.proportional_rad_s_per_n": law.proportional_rad_s_per_n / pump,
            "controller.integral_rad_s2_per_n": law.integral_rad_s2_per_n / pump,
        }
    return scenario.changed(values)


@dataclass(frozen=True)
class Plant:
    """A compiled scenario, its signals by the oracle, and its largest |λ| in 1/s."""

    scenario: Scenario
    signals: np.ndarray
    fastest_per_s: float

    def error(self, integrator: str = "rk4", **options: float) -> float:
        """Return the largest error of a run, relative to the range of the signal."""
        signals = run(self.scenario, integrator, **options)
        spans = np.maximum(np.ptp(self.signals, axis=0), 1e-9 * np.abs(self.signals).max(axis=0))
        return float((np.abs(signals - self.signals).max(axis=0) / spans).max())


def run(scenario: Scenario, integrator: str, **options: float) -> np.ndarray:
    """Return the signals of a run, (samples, elements)."""
    model = compile_scenario(scenario)
    parameters, state, inputs = scenario_run(scenario, model)
    names = [name for name in SIGNALS if name in model.outputs]
    records = model.simulate(
        parameters,
        state,
        scenario.duration_s,
        inputs=inputs,
        outputs=names,
        integrator=integrator,
        **options,
    )
    return np.hstack([records[name] for name in names])


def oracle(scenario: Scenario, tolerance: float = 1e-10) -> Plant:
    """Return the signals and the largest |λ| of a scenario by the exact hold."""
    signals = run(scenario, "exact_hold", tolerance=tolerance)
    model = compile_scenario(scenario)
    parameters, state, inputs = scenario_run(scenario, model)
    runner = Runner(model.code, outputs=(), tolerance=tolerance).restart(parameters[None])
    ticks = np.arange(round(scenario.duration_s / runner.timing.tick))
    x, d = (values[:, None].copy() for values in (state.continuous, state.discrete))
    snapshots = Snapshots(ticks, np.empty((ticks.size, len(x))), np.empty((ticks.size, len(d))))
    runner.run(x, d, 0, ticks[-1:] + 1, [inputs], snapshots=snapshots)
    return Plant(scenario, signals, runner.fastest_per_s(snapshots, inputs))


def drake_error(scenario: Scenario, step_s: float = 2e-5, duration_s: float = 0.02) -> float:
    """Return the largest difference of the oracle from Drake's implicit integrator radau3.

    The difference is relative to the range of the signal. Drake takes seconds for 20 ms.
    """
    scenario = scenario.changed({"simulation.duration_s": duration_s})
    values = {"simulation.integrator": "radau3", "simulation.step_s": step_s}
    names = [name for name in SIGNALS if name in available_signals(scenario)]
    runs = [
        simulate(scenario.changed(changes), signals=names).data
        for changes in ({"simulation.tolerance": 1e-10}, values)
    ]
    ours, drake = (np.column_stack(list(data.values())) for data in runs)
    spans = np.maximum(np.ptp(ours, axis=0), 1e-9 * np.abs(ours).max(axis=0))
    return float((np.abs(ours - drake).max(axis=0) / spans).max())


def outcome(plant: Plant, angle: float) -> tuple[str, str]:
    """Return what RK4 does at h |λ| = ``angle``, in a word, and the error or the end as text."""
    tick_s, step_s = plant.scenario.controller.sample_time_s, angle / plant.fastest_per_s
    if angle > 1.1 * plant.fastest_per_s * tick_s / np.ceil(tick_s / step_s):
        return "no such step", "-"  # a tick has a whole number of steps
    try:
        error = plant.error(step_s=step_s)
        return ("right" if error <= TOLERANCE else "wrong"), f"{error:.1e}"
    except UnstableStepError as unstable:
        first_s = unstable.step_s
    except SimulationError as error:
        return "other end", str(error)
    try:
        error = plant.error(step_s=first_s)
        return "refused" if error <= TOLERANCE else "refused, then wrong", f"refused, {error:.1e}"
    except UnstableStepError:
        return "refused twice", "refused twice"


def main(plants: int, first: int) -> None:
    """Print the outcomes of each plant by h |λ|, then the counts."""
    counts: dict[float, Counter[str]] = {angle: Counter() for angle in ANGLES}
    for seed in range(first, first + plants):
        try:
            plant = oracle(random_scenario(seed))
        except SimulationError as error:
            print(f"{seed}: {error}")
            continue
        outcomes = [outcome(plant, angle) for angle in ANGLES]
        for angle, (word, _) in zip(ANGLES, outcomes, strict=True):
            counts[angle][word] += 1
        texts = "; ".join(text for _, text in outcomes)
        print(f"{seed}: |λ| = {plant.fastest_per_s:.3g} 1/s: {texts}", flush=True)
    for seed in range(first, first + min(plants, 20)):
        print(f"{seed}: Drake differs by {drake_error(random_scenario(seed)):.1e}", flush=True)
    for angle, words in counts.items():
        print(f"h |λ| = {angle:g}: {dict(words)}")


if __name__ == "__main__":
    main(*map(int, (sys.argv[1:] + ["200", "0"][len(sys.argv) - 1 :])))
