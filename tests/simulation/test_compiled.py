"""Every structure against Drake, and the numbers that a scenario gives it."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagramc import Reduction
from diagramc.diagram_equations import equations_key
from diagramc.equations.contexts import parameters_of, state_of
from diagramc.equations.reader import read_equations
from diagramc.equations.tree import Node
from kneexo.diagrams import SIGNALS, make_closed_loop
from kneexo.errors import LinkageError, ParameterError, SimulationError
from kneexo.geometry.rod_polynomial import completed
from kneexo.parameters import (
    G1,
    G3,
    BldcPumpParameters,
    CylinderParameters,
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    FullCylinderParameters,
    KneeLoadParameters,
    KneeParameters,
    PlantParameters,
    RampReference,
    SampledReference,
    Scenario,
    SimulationParameters,
    SineReference,
    SlidingModeParameters,
    StepReference,
)
from kneexo.parameters.fields.quantity import Parameters
from kneexo.simulation import compiled, simulate_compiled
from kneexo.simulation.compiled import (
    scenario_diagram,
    scenario_inputs,
    scenario_run,
    scenario_values,
    structure_key,
)
from kneexo.simulation.engines import simulate
from kneexo.studies.paper import IDEAL_SMC, PID_FEEDFORWARD, PID_TUNED
from kneexo.systems.knee_reference import make_knee_reference

FREE = EncoderParameters(quantized=False)
LOADED = PlantParameters(
    load=KneeLoadParameters(knee_torque_n_m=1.0, disturbance_amplitude_n=20.0),
    cylinder=CylinderParameters(stiffness_n_per_m=100.0),
)
FULL = FullCylinderParameters(coulomb_friction_n=20.0, entrained_air=0.01)
STRUCTURES = {
    "smc": Scenario(encoder=FREE),
    "quantized": Scenario(),
    "loaded": Scenario(encoder=FREE, plant=LOADED),
    "polynomial, nominal": Scenario(
        encoder=FREE,
        plant=PlantParameters(rod_map="polynomial"),
        nominal=PlantParameters(
            linkage={"phi_rad": G1.phi_rad + 0.01}, cylinder=CylinderParameters(bore_m=0.021)
        ),
    ),
    "ideal motor, difference": Scenario(
        encoder=FREE,
        plant=PlantParameters(ideal_motor=True),
        estimator=DifferenceParameters(),
        controller=SlidingModeParameters(phi_m_s2=80.0),
        reference=StepReference(time_s=0.01),
    ),
    "signum, exact": Scenario(
        estimator=ExactParameters(),
        encoder=FREE,
        controller=SlidingModeParameters(switching="signum"),
    ),
    "can 2, ramp": Scenario(
        encoder=FREE,
        bus={"latency_samples": 2},
        reference=RampReference(time_s=0.01, rate_deg_s=200.0),
    ),
    "pid": Scenario(encoder=FREE, controller=PID_TUNED),
    "cia402": Scenario(bus={"kind": "cia402", "latency_samples": 0}),
    "pid, cia402, 2 samples": Scenario(
        encoder=FREE,
        controller=PID_TUNED,
        bus={"kind": "cia402", "velocity_unit_rpm": 0.1, "latency_samples": 2},
    ),
    "pid, can 1, samples": Scenario(
        encoder=FREE,
        controller=PID_FEEDFORWARD,
        bus={"latency_samples": 1},
        reference=SampledReference(times_s=(0.02, 0.05, 0.07, 0.1), angles_deg=(30, 31, 29, 30)),
    ),
    "full order": Scenario(
        encoder=FREE,
        plant=PlantParameters(
            full_order=FULL,
            load=KneeLoadParameters(),
            pump=BldcPumpParameters(external_leakage_m3_per_s_pa=1e-13),
        ),
        initial_offset_m=-0.001,  # else 10 samples from rest are all rounding
    ),
    "ramped sine at 5 ms": Scenario(
        encoder=FREE,
        controller=SlidingModeParameters(sample_time_s=0.005),
        reference=SineReference(frequency_hz=1.0, ramp_s=0.05),
    ),
    "inertia, full order": Scenario(
        encoder=FREE,
        plant=PlantParameters(load=KneeLoadParameters(inertia_kg_m2=0.064), full_order=FULL),
        controller=PID_FEEDFORWARD,
        reference=SineReference(frequency_hz=1.0),
        initial_offset_m=-0.001,
    ),
    "impedance, active wearer, slip, noise": Scenario(
        encoder=FREE,
        plant=PlantParameters(load=KneeLoadParameters()),
        wearer={"kind": "leg", "motion": "active", "cuff": {"slip_torque_n_m": 0.1}},
        controller={"kind": "torque", "mode": "impedance"},
        load_cell={"quantized": False, "noise_n": 2.0, "seed": 1},
        reference=SineReference(frequency_hz=1.0),
    ),
    "assist, active wearer, samples, moment": Scenario(
        encoder=FREE,
        plant=PlantParameters(load=KneeLoadParameters()),
        wearer={
            "kind": "leg",
            "motion": "active",
            "effort": 0.8,
            "moment": {"times_s": (0, 0.03, 10), "moments_n_m": (5, -20, 3)},
        },
        controller={"kind": "torque", "mode": "assist"},
        load_cell={"quantized": False, "dropout_start_s": 0.0301, "dropout_s": 0.02},
        reference=SampledReference(times_s=(0.0, 0.05, 0.1), angles_deg=(30, 31, 29)),
        simulation=SimulationParameters(duration_s=10.0),
    ),
    "assist as needed, passive wearer": Scenario(
        encoder=FREE,
        plant=PlantParameters(load=KneeLoadParameters(thigh_inclination_rad=1.5)),
        wearer={"kind": "leg", "motion": "passive"},
        controller={"kind": "torque", "mode": "assist_as_needed", "band_rad": 0.0},
        load_cell={"quantized": False},
        reference=StepReference(time_s=0.01),
    ),
    "continuous": IDEAL_SMC.model_copy(update={"initial_offset_m": -0.01}),
}
"""Every choice that changes the equations, in some combination."""

QUICK = ("loaded", "pid, can 1, samples")


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=() if c in QUICK else pytest.mark.slow) for c in STRUCTURES]
)
def test_every_structure_agrees_with_drake(case, compiled_run):
    # The same integrator and step: what is left is rounding, which the controller's gain on
    # differences (1/T² = 4e4) and the stiff modes amplify.
    period = STRUCTURES[case].controller.sample_time_s
    step = 1e-5 if case in {"continuous", "full order"} else 2e-4
    duration = 10.0 * period if step < 2e-4 else 40.0 * period
    settings = SimulationParameters(duration_s=duration, integrator="runge_kutta3", step_s=step)
    scenario = STRUCTURES[case].model_copy(update={"simulation": settings})
    drake = simulate(scenario)
    model, (parameters, state, inputs) = compiled_run(scenario)
    run = model.simulate(
        parameters,
        state,
        duration,
        integrator="runge_kutta3",
        step_s=step,
        record_period_s=period,
        inputs=inputs,
    )
    np.testing.assert_array_equal(run.time_s, drake.time_s)
    names = [name for name in SIGNALS if name in model.outputs]
    assert names == [name for name, first in SIGNALS.items() if first[0] in drake.data]
    for name in names:
        for i, column in enumerate(SIGNALS[name]):
            ours, theirs = run[name][:, i], drake[column]
            scale = np.max(np.abs(theirs))
            if name == "encoder_reading" and case == "quantized":
                scale = 1.0  # exactly the same count, up to the rounding of one division
            assert np.max(np.abs(ours - theirs)) <= 1e-9 * scale, column


@pytest.mark.parametrize("case", STRUCTURES)
def test_parameters_and_initial_state_are_those_of_the_diagram(case, compiled_run):
    scenario = STRUCTURES[case]
    _, (parameters, state, _) = compiled_run(scenario)
    diagram = make_closed_loop(scenario, signals=())
    simulator = Simulator(diagram)
    simulator.Initialize()
    root, context = Node(diagram), simulator.get_context()
    np.testing.assert_array_equal(parameters, parameters_of(root, context))
    initialized = state_of(root, context)
    np.testing.assert_array_equal(state.continuous, initialized.continuous)
    # Polynomials in degrees are summed in another order.
    np.testing.assert_allclose(state.discrete, initialized.discrete, rtol=1e-13, atol=1e-14)


# ------------------------------------------------------------------- nothing is baked in

WITHOUT_EFFECT = {
    "plant.pump.rated_power_w": "figure of merit",
    "plant.cylinder.pressure_rating_pa": "figure of merit",
    "polynomial.q_deg_mm": "Eq. 11, which no system uses",
}
EVERYTHING = {
    "default": Scenario(),
    "loaded full order": Scenario(
        encoder=FREE, plant=LOADED.model_copy(update={"full_order": FULL})
    ),
    "pid": STRUCTURES["pid"],
    "step": Scenario(reference=StepReference(), estimator=STRUCTURES["smc"].estimator),
    "ramp": STRUCTURES["can 2, ramp"],
    "samples": STRUCTURES["pid, can 1, samples"],
    "cia402": STRUCTURES["cia402"],
    "impedance": STRUCTURES["impedance, active wearer, slip, noise"],
    "assist": STRUCTURES["assist, active wearer, samples, moment"],
}


def quantities(parameters, path=()):
    """Paths and values of all plain numbers, and tuples of them."""
    for name in type(parameters).model_fields:
        value = getattr(parameters, name)
        if isinstance(value, Parameters):
            yield from quantities(value, (*path, name))
        elif isinstance(value, float | tuple) and not isinstance(value, bool) and name != "faults":
            yield (*path, name), value


def changed(parameters, path, value):
    """A copy with one value changed, not validated."""
    name, *rest = path
    if rest:
        value = changed(getattr(parameters, name), rest, value)
    return parameters.model_copy(update={name: value})


def nudged(value):
    if isinstance(value, tuple):
        return tuple(0.9999 * v for v in value)
    return 0.9999 * value if value else 1e-4


def numbers(scenario):
    """All that a compiled run gets from a scenario besides its structure."""
    start = tuple(compiled.scenario_start(scenario).items())
    inputs = scenario_inputs(scenario)
    table = (inputs.breaks.tobytes(), inputs.coefficients.tobytes())
    return tuple(scenario_values(scenario).items()), start, table


@pytest.mark.parametrize("case", EVERYTHING)
def test_every_quantity_changes_the_numbers_or_the_structure(case):
    base = completed(EVERYTHING[case])
    before, key = numbers(base), structure_key(base)
    inert = set()
    for path, value in quantities(base):
        if path[0] == "simulation":
            continue
        other = changed(base, path, nudged(value))
        if (numbers(other), structure_key(other)) == (before, key):
            inert.add(".".join(path))
    unused = set() if base.encoder.quantized else {"encoder.phase_rad"}
    if base.reference.kind == "samples":
        unused |= {"reference.clipped_deg", "reference.shift_s"}  # what was done to the samples
    if base.controller.kind == "pid" and base.estimator.kind == "observer":
        unused |= {"estimator.time_constant_s"}
    if not base.has_load_cell:
        unused |= {".".join(("load_cell", *path)) for path, _ in quantities(base.load_cell)}
    elif base.wearer.cuff.slip_torque_n_m is None:
        unused |= {"wearer.cuff.slip_damping_n_m_s_per_rad"}
    assert inert == set(WITHOUT_EFFECT) | unused


@pytest.mark.parametrize(
    "case", ["ramp", *(pytest.param(c, marks=pytest.mark.slow) for c in EVERYTHING if c != "ramp")]
)
def test_no_quantity_is_baked_into_the_equations(case):
    base = EVERYTHING[case]
    other = base
    for path, value in quantities(base):
        if path[-1] != "sample_time_s":
            other = changed(other, path, nudged(value))
    assert structure_key(other) == structure_key(base)
    assert numbers(other) != numbers(base)
    inputs = ("knee_reference",) if case == "samples" else ()
    keys = [
        equations_key(read_equations(scenario_diagram(scenario), inputs))
        for scenario in (base, other)
    ]
    assert keys[0] == keys[1]


def test_the_believed_plant_is_part_of_the_structure():
    base = Scenario()
    assert structure_key(base) == structure_key(Scenario(nominal=base.plant))
    other = Scenario(nominal=PlantParameters(linkage=G3))
    assert structure_key(other) != structure_key(base)


def test_choices_change_the_structure():
    keys = {structure_key(scenario) for scenario in STRUCTURES.values()}
    assert len(keys) == len(STRUCTURES)
    for path, value in (
        (("bus", "latency_samples"), 1),
        (("encoder", "counts_per_revolution"), 512),
        (("encoder", "quantized"), False),
        (("controller", "switching"), "signum"),
        (("controller", "sample_time_s"), 0.001),
        (("estimator",), ExactParameters()),
        (("plant", "ideal_motor"), True),
        (("plant", "load"), KneeLoadParameters()),
        (("plant", "full_order"), FullCylinderParameters()),
        (("reference",), StepReference()),
    ):
        other = changed(Scenario(), path, value)
        assert structure_key(other) != structure_key(Scenario()), path
    longer = Scenario(simulation=SimulationParameters(duration_s=1.0))
    assert structure_key(longer) == structure_key(Scenario())


# -------------------------------------------------------------------- reference and faults


def test_table_of_a_sampled_reference_is_that_of_drake(compiled_run):
    scenario = STRUCTURES["pid, can 1, samples"]
    source = make_knee_reference(scenario.reference)
    context = source.CreateDefaultContext()
    _, (_, _, inputs) = compiled_run(scenario)
    for time in (0.0, 0.02, 0.03, 0.05, 0.0699, 0.07, 0.1, 0.11):
        context.SetTime(time)
        expected = source.get_output_port().Eval(context)
        np.testing.assert_allclose(inputs.value(time), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("scenario", "error"),
    [
        (Scenario(initial_offset_m=0.1), ParameterError),
        (
            Scenario(
                plant=PlantParameters(knee=KneeParameters(flexion_max_deg=80.0)),
                reference=SampledReference(times_s=(0, 1, 2, 3), angles_deg=(0, 79, 79, 0)),
            ),
            ParameterError,
        ),
        (
            Scenario(plant=PlantParameters(linkage=G1.model_copy(update={"a_4_m": 0.001}))),
            LinkageError,
        ),
    ],
)
def test_faults_are_those_of_the_diagram(scenario, error, compiled_run):
    with pytest.raises(error) as drake:
        make_closed_loop(scenario)
    model, _ = compiled_run(Scenario())
    with pytest.raises(error) as ours:
        scenario_run(scenario, model)
    assert str(ours.value) == str(drake.value)


@pytest.mark.slow
def test_a_known_structure_needs_no_diagram_and_no_symbolic_work():
    code = (
        "from kneexo.parameters import Scenario\n"
        "from kneexo.parameters.paths import changed\n"
        "from kneexo.simulation import compiled, simulate_compiled\n"
        "def refuse(*_args, **_options):\n"
        "    raise AssertionError('not needed')\n"
        "compiled.read_equations = compiled.make_closed_loop = refuse\n"
        "for mass in (1.6, 3.0):\n"
        "    values = {'plant.cylinder.mass_kg': mass, 'simulation.duration_s': 0.05}\n"
        "    run = simulate_compiled(changed(Scenario(), values), signals=['rod_velocity'])\n"
        "    print(repr(run['rod_velocity_m_s'][-1]))\n"
    )
    short = changed(Scenario(), ("simulation", "duration_s"), 0.05)
    simulate_compiled(short, signals=["rod_velocity"])
    line = [sys.executable, "-c", code]
    told = subprocess.run(line, check=True, capture_output=True, text=True).stdout
    velocities = told.splitlines()
    assert velocities[0] != velocities[1]


def test_a_model_that_was_pickled_runs_alike(compiled_run):
    model, (parameters, state, _) = compiled_run(Scenario())
    copy = pickle.loads(pickle.dumps(model))
    runs = [each.simulate(parameters, state, 0.1) for each in (model, copy)]
    np.testing.assert_array_equal(*(run["rod_velocity"] for run in runs))


@pytest.mark.parametrize("integrator", ["exact_hold", "radau3"])
def test_an_output_that_is_not_finite_ends_a_run(integrator):
    # So short a coupler (which validation refuses) closes for some angles of the encoder only.
    plant = PlantParameters(ideal_motor=True)
    short = G1.model_copy(update={"a_3_m": 2e-6})
    broken = Scenario(
        plant=plant.model_copy(update={"linkage": short}),
        estimator=ExactParameters(),
        controller=SlidingModeParameters(continuous=True),
        simulation=SimulationParameters(duration_s=0.1, integrator=integrator),
    )
    with pytest.raises(SimulationError, match=r"^t = \S+ s: measured_knee_angle(_rad)? is not"):
        simulate(broken)
    simulate(broken, signals=("rod_extension",))  # which does not depend on it


def test_records_have_whole_numbers_of_sample_times():
    sample_time_s = 0.005
    run = simulate(
        Scenario(
            controller=SlidingModeParameters(sample_time_s=sample_time_s),
            simulation=SimulationParameters(duration_s=1.0),
        ),
        signals=("knee_angle",),
    )
    np.testing.assert_array_equal(run.time_s, sample_time_s * np.arange(201))


def test_interpolations_of_samples_share_a_model():
    samples = {"times_s": (0.0, 0.1, 0.2), "angles_deg": (20.0, 20.2, 20.1)}
    time = np.arange(0.0, 0.1001, 0.002)
    keys = set()
    for interpolation in ("cubic", "pchip", "linear"):
        reference = SampledReference(**samples, interpolation=interpolation)
        scenario = Scenario(reference=reference, simulation=SimulationParameters(duration_s=0.1))
        keys.add(structure_key(scenario))
        run = simulate_compiled(scenario, signals=["knee_reference"])
        curve = make_knee_reference(reference)
        context = curve.CreateDefaultContext()
        expected = []
        for t in run.time_s:
            context.SetTime(t)
            expected.append(curve.get_output_port().Eval(context)[0])
        assert run.time_s == pytest.approx(time)
        assert run["knee_reference_rad"] == pytest.approx(expected, abs=1e-14)
    assert len(keys) == 1


FAULTS = {
    "encoder": ("frozen", "offset", "drift", "scale", "noise", "dropped", "late"),
    "command": ("offset", "scale", "late", "frozen"),
    "plant.cylinder.leakage_m3_per_s_pa": ("value",),
    "plant.pump.speed_limit_rad_s": ("value",),
}
SIZES = {"frozen": 0.0, "dropped": 0.5, "late": 4.0, "scale": 0.7, "drift": 3.0, "noise": 0.3}


def assert_faulty_runs_are_whole_runs(monkeypatch, rng, preset, integrator, count):
    """Faults of one kind at random times; some of the runs fail.

    All runs go on from states before a fault, and then all begin at t = 0.
    """
    place = str(rng.choice(list(FAULTS)))
    kind = str(rng.choice(FAULTS[place]))
    size = {"encoder": 5.0, "command": 300.0}.get(place, 1e-12)
    size = 100.0 if place.endswith("speed_limit_rad_s") else SIZES.get(kind, size)
    varied = kind in ("offset", "noise", "drift", "value")
    base = Scenario.preset(preset).changed({"simulation.duration_s": 1.2})
    scenarios = [
        base.changed(
            {
                "faults": [
                    {
                        "place": place,
                        "kind": kind,
                        "size": size * (float(rng.uniform(0.5, 1.5)) if varied else 1.0),
                        "start_s": round(float(rng.uniform(0.0, 1.0)), 3),
                        "duration_s": rng.choice([None, 0.1]),
                    }
                ]
            }
        )
        for _ in range(count)
    ]
    compiled._healthy.clear()
    means = [Reduction("mean", "knee_angle", after_s=after) for after in (0.0, 0.3, 1.1)]

    def run_together():
        return compiled.simulate_together(
            scenarios, None, integrator, reductions=[means] * len(scenarios)
        )

    runs = run_together()
    assert any(samples for *_, samples in compiled._healthy)
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "_before_faults", lambda model, scenario, run, *others: run[1])
        whole = run_together()
    for run, expected in zip(runs, whole, strict=True):
        assert type(run) is type(expected)
        if isinstance(expected, SimulationError):
            assert str(run) == str(expected)
            continue
        np.testing.assert_array_equal(run.reduced.view(np.int64), expected.reduced.view(np.int64))
        for name, values in expected.columns.items():
            np.testing.assert_array_equal(run[name].view(np.int64), values.view(np.int64), name)


def test_faulty_runs_are_those_from_the_start(monkeypatch):
    rng = np.random.default_rng(3)
    assert_faulty_runs_are_whole_runs(monkeypatch, rng, "paper", "exact_hold", 3)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["paper", "bench", "leg", "wearer", "protected"])
def test_200_faulty_runs_are_those_from_the_start(monkeypatch, preset):
    """40 runs of each preset, alone and in lanes."""
    rng = np.random.default_rng(11)
    for count, integrator in ((19, "exact_hold"), (3, "exact_hold"), (18, "rosenbrock")):
        assert_faulty_runs_are_whole_runs(monkeypatch, rng, preset, integrator, count)
