"""The closed loop with AutoDiffXd and Expression against the closed loop with float."""

import numpy as np
import pytest
from loop_cases import OBSERVER, PERIOD, PID, UNQUANTIZED, sliding_mode
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Expression

from kneexo.diagrams import make_closed_loop
from kneexo.parameters import (
    BldcPumpParameters,
    CylinderParameters,
    DifferenceParameters,
    EncoderParameters,
    ExactParameters,
    KneeLoadParameters,
    PlantParameters,
    RampReference,
    Scenario,
    SlidingModeParameters,
    StepReference,
)

# -------------------------------------------------------------- conversion to other scalars

VARIED = PlantParameters(
    pump=BldcPumpParameters(lag_s=0.012, external_leakage_m3_per_s_pa=1e-13),
    cylinder=CylinderParameters(mass_kg=1.7, damping_n_s_per_m=3.0, stiffness_n_per_m=50.0),
    load=KneeLoadParameters(
        segment_mass_kg=2.0,
        thigh_inclination_rad=0.4,
        knee_torque_n_m=1.0,
        disturbance_amplitude_n=3.0,
    ),
)
STEP = StepReference(start_deg=30.0, end_deg=32.0, time_s=0.01)
RAMP = RampReference(start_deg=30.0, end_deg=33.0, time_s=0.01, rate_deg_s=5.0)
CONVERTED = {
    "smc": {"controller": sliding_mode(), "estimator": OBSERVER},
    "smc, signum": {"controller": SlidingModeParameters(switching="signum")},
    "smc, cia402": {"controller": sliding_mode(), "bus": {"kind": "cia402"}},
    "smc, step, can": {"reference": STEP, "bus": {"latency_samples": 1}},
    "difference": {"controller": sliding_mode(500.0), "estimator": DifferenceParameters()},
    "exact, ramp": {"controller": sliding_mode(80.0), "estimator": ExactParameters()}
    | {"reference": RAMP},
    "pid": {"controller": PID},
    "pid, ramp, can": {"controller": PID, "reference": RAMP, "bus": {"latency_samples": 3}},
    "continuous": {
        "controller": SlidingModeParameters(continuous=True, lambda_per_s=11.0),
        "estimator": ExactParameters(),
        "initial_offset_m": 0.002,
    },
}
QUANTIZED = [EncoderParameters(counts_per_revolution=8192), UNQUANTIZED]


def running_context(diagram, fixed_step, jitter, seed=0):
    """A Context after 25 samples with its state shaken by ``jitter`` and its inputs fixed."""
    simulator = fixed_step(diagram, "radau3", PERIOD)
    context = simulator.get_mutable_context()
    for name in ("disturbance_force", "knee_torque"):
        if diagram.HasInputPort(name):
            diagram.GetInputPort(name).FixValue(context, [2.5])
    simulator.AdvanceTo(25.4 * PERIOD)
    rng = np.random.default_rng(seed)

    def shaken(vector):
        values = vector.CopyToVector()
        return values + jitter * rng.uniform(-1.0, 1.0, values.size)

    context.SetContinuousState(shaken(context.get_continuous_state_vector()))
    for group in range(context.num_discrete_state_groups()):
        context.SetDiscreteState(group, shaken(context.get_discrete_state(group)))
    return context


def all_values(diagram, context):
    """Derivatives, next discrete state and all outputs as floats, whatever the scalar."""
    values = {"derivatives": diagram.EvalTimeDerivatives(context).CopyToVector()}
    if context.num_discrete_state_groups():
        update = diagram.EvalUniquePeriodicDiscreteUpdate(context)
        for group in range(update.num_groups()):
            values[f"discrete {group}"] = update.get_vector(group).CopyToVector()
    for index in range(diagram.num_output_ports()):
        port = diagram.get_output_port(index)
        values[port.get_name()] = port.Eval(context)
    return {name: as_float(value) for name, value in values.items()}


def as_float(values):
    if isinstance(values[0], Expression):
        return np.array([value.Evaluate() for value in values])
    return np.array([value if isinstance(value, float) else value.value() for value in values])


def assert_same(values, expected):
    """Equal to 1e-12 of the largest element: the same operations, rounded alike."""
    assert values.keys() == expected.keys()
    for name, value in expected.items():
        scale = np.max(np.abs(value))
        np.testing.assert_allclose(
            values[name], value, rtol=0.0, atol=1e-12 * scale, err_msg=name, strict=True
        )


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=() if c == "difference" else pytest.mark.slow) for c in CONVERTED],
)
def test_other_scalars_give_the_same_values_at_random_contexts(case, fixed_step):
    for encoder in QUANTIZED:
        scenario = Scenario(**{"plant": VARIED, "encoder": encoder} | CONVERTED[case])
        diagram = make_closed_loop(scenario)
        conversions = diagram.ToAutoDiffXd(), diagram.ToSymbolic()
        # A small jitter leaves the command within its limit, a large one does not.
        for jitter in (1e-5, 1e-2):
            context = running_context(diagram, fixed_step, jitter)
            expected = all_values(diagram, context)
            assert expected["load_pressure"] != 0.0
            for converted in conversions:
                other = converted.CreateDefaultContext()
                other.SetTimeStateAndParametersFrom(context)
                converted.FixInputPortsFrom(diagram, context, other)
                assert_same(all_values(converted, other), expected)


@pytest.mark.parametrize("convert", ["ToAutoDiffXd", "ToSymbolic"])
@pytest.mark.parametrize("case", CONVERTED)
def test_conversion_keeps_the_parameters_of_the_scenario(case, convert):
    scenario = Scenario(**{"plant": VARIED} | CONVERTED[case])
    diagram = make_closed_loop(scenario)
    converted = getattr(diagram, convert)()
    given, kept = diagram.CreateDefaultContext(), converted.CreateDefaultContext()
    assert given.num_numeric_parameter_groups() == kept.num_numeric_parameter_groups() > 10
    for group in range(given.num_numeric_parameter_groups()):
        np.testing.assert_array_equal(
            as_float(kept.get_numeric_parameter(group).CopyToVector()),
            given.get_numeric_parameter(group).CopyToVector(),
        )
    np.testing.assert_array_equal(
        as_float(kept.get_continuous_state_vector().CopyToVector()),
        given.get_continuous_state_vector().CopyToVector(),
    )


@pytest.mark.parametrize("convert", ["ToAutoDiffXd", "ToSymbolic"])
def test_changed_context_parameters_are_carried_over(convert, fixed_step):
    diagram = make_closed_loop(Scenario(plant=VARIED))
    context = running_context(diagram, fixed_step, 1e-5)
    before = all_values(diagram, context)
    cylinder = diagram.GetSubsystemByName("plant").GetSubsystemByName("cylinder")
    cylinder.set_parameter(cylinder.GetMyMutableContextFromRoot(context), "mass_kg", 3.4)
    law = diagram.GetSubsystemByName("controller").GetSubsystemByName("law")
    law.set_parameter(law.GetMyMutableContextFromRoot(context), "lambda_per_s", 31.0)
    after = all_values(diagram, context)
    # Twice the mass, half the acceleration, exactly.
    np.testing.assert_allclose(after["derivatives"][2], 0.5 * before["derivatives"][2], rtol=1e-14)
    assert after["sliding_variable"] != pytest.approx(before["sliding_variable"], rel=1e-2)
    converted = getattr(diagram, convert)()
    other = converted.CreateDefaultContext()
    other.SetTimeStateAndParametersFrom(context)
    converted.FixInputPortsFrom(diagram, context, other)
    assert_same(all_values(converted, other), after)


def state_of(context):
    groups = range(context.num_discrete_state_groups())
    return np.concatenate(
        [context.get_continuous_state_vector().CopyToVector()]
        + [context.get_discrete_state(group).CopyToVector() for group in groups]
    )


def next_of(diagram, context, state):
    """Derivatives and next discrete state at ``state``, in one vector."""
    first = context.num_continuous_states()
    context.SetContinuousState(state[:first])
    for group in range(context.num_discrete_state_groups()):
        size = context.get_discrete_state(group).size()
        context.SetDiscreteState(group, state[first : first + size])
        first += size
    update = diagram.EvalUniquePeriodicDiscreteUpdate(context)
    groups = range(update.num_groups())
    return np.concatenate(
        [diagram.EvalTimeDerivatives(context).CopyToVector()]
        + [update.get_vector(group).CopyToVector() for group in groups]
    )


@pytest.mark.parametrize(  # signum, rounding and the continuous controller have no such derivative
    "case", [name for name in CONVERTED if name not in {"continuous", "smc, signum", "smc, cia402"}]
)
def test_autodiff_of_the_discrete_update_equals_central_differences(case, fixed_step):
    scenario = Scenario(**{"plant": VARIED, "encoder": UNQUANTIZED} | CONVERTED[case])
    diagram = make_closed_loop(scenario)
    context = running_context(diagram, fixed_step, 1e-7)
    state = state_of(context)
    command = context.num_continuous_states()
    limit = scenario.controller.command_limit_rad_s
    assert np.all(np.abs(next_of(diagram, context, state)[command:]) < limit)

    converted = diagram.ToAutoDiffXd()
    other = converted.CreateDefaultContext()
    other.SetTimeStateAndParametersFrom(context)
    converted.FixInputPortsFrom(diagram, context, other)
    seeded = next_of(converted, other, InitializeAutoDiff(state)[:, 0])
    gradient = ExtractGradient(seeded.reshape(-1, 1))
    value = next_of(diagram, context, state)
    np.testing.assert_allclose(ExtractValue(seeded)[:, 0], value, rtol=1e-9, atol=1e-12)

    step = 1e-6
    differences = np.array(
        [
            (next_of(diagram, context, state + d) - next_of(diagram, context, state - d))
            / (2.0 * step)
            for d in step * np.eye(state.size)
        ]
    ).T
    # Central differences over 1e-6 leave rounding of 1e-16/1e-6 of the values and a truncation
    # of 1e-12 times a third derivative: 1e-6 of the largest slope of each row.
    scale = np.max(np.abs(differences), axis=1, keepdims=True)
    assert np.max(np.abs(gradient - differences) / scale) < 1e-6
    assert np.all(np.any(gradient != 0.0, axis=1))
