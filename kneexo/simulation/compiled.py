"""Compiles and runs the closed loop of a scenario.

The *structure* of a scenario is the part that decides the form of the equations. Scenarios of the
same structure share one compiled model, whose machine code is cached on disk. All other numbers of
a scenario become parameters and initial states of the model. The lists of parts in
`kneexo.diagrams` give these numbers, so that a run builds no diagram.
"""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache, partial
from hashlib import sha256
from threading import RLock
from typing import Any, get_origin

import numpy as np

from diagramc import (
    ROUGH_STEP_S,
    STEP_S,
    CompiledModel,
    InputTable,
    Reduction,
    Simulation,
    State,
    compile_by_key,
    input_table,
    simulate_with_feedback,
    stack_tables,
)
from kneexo.common.result import Array
from kneexo.diagrams.closed_loop import (
    chosen_signals,
    loop_values,
    make_closed_loop,
    make_open_loop,
    plant_start,
)
from kneexo.diagrams.controller import (
    controller_parts,
    users_systems,
)
from kneexo.diagrams.faults import fault_structure
from kneexo.diagrams.part import full_name
from kneexo.diagrams.plant import scenario_plant_parts
from kneexo.diagrams.wearer import moment_of, moment_spline
from kneexo.errors import CompilationError, KneexoError
from kneexo.law.call import argument_sizes
from kneexo.law.decision import (
    decide,
    held_command,
    law_inputs,
    makers_called_once,
    users_law,
    why_python,
)
from kneexo.law.leaves import COMMAND_AND_STATE, LAW_COMMAND
from kneexo.law.python_law import SIGNAL_OF, PythonLaw, commands_at_points
from kneexo.law.trace import (
    replay,
)
from kneexo.parameters import (
    Law,
    LawParameters,
    MomentTable,
    SampledReference,
    Scenario,
)
from kneexo.parameters.fields.fields import models_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.simulation.run import Run
from kneexo.simulation.sources import fingerprint
from kneexo.systems import knee_reference

_MADE_CONSTANT = ("sample_time_s",)  # numbers that the leaf systems turn into constants
_SEED = "seed"  # decides by its presence, not by its number


# ------------------------------------------------------------------------------ structure


def structure(parameters: Parameters) -> tuple[tuple[str, Any], ...]:
    """Return names and values of the fields that decide the form of a scenario's equations.

    These fields are choices, whole numbers (counts, delays), the structures of nested parameters,
    and sample times. A sample time belongs to the structure, because leaf systems turn it into a
    constant of the equations. Other floats and tuples do not belong to the structure.
    """
    fields: list[tuple[str, Any]] = []
    values = vars(parameters)
    for name, nested in _structural_fields(type(parameters)):
        value = values[name]
        if name == _SEED:
            fields.append((name, value is not None))
        elif nested and value is not None:
            fields.append((name, structure(value)))
        elif name in _MADE_CONSTANT or not isinstance(value, float):
            fields.append((name, value))
    return tuple(fields)


@cache
def _structural_fields(kind: type[Parameters]) -> tuple[tuple[str, bool], ...]:
    """Return the name of each field that `structure` reads, and True for nested parameters."""

    def structural(annotation: Any) -> bool:
        if isinstance(annotation, type) and issubclass(annotation, Parameters):
            return bool(_structural_fields(annotation))
        return annotation is not float and get_origin(annotation) is not tuple

    return tuple(
        (name, bool(models_of(field)))
        for name, field in kind.model_fields.items()
        if name in _MADE_CONSTANT or structural(field.annotation)
    )


def structure_key(scenario: Scenario) -> str:
    """Return a text that is the same for all scenarios that can share a compiled model.

    The text contains the structure and a digest of the source
    files that make the equations.
    """
    fields = dict(structure(scenario))
    if scenario.nominal is None:
        fields["nominal"] = fields["plant"]
    fields.pop("simulation", None)  # decides how a loop is run, not its equations
    fields.pop("polynomial", None)  # has only numbers, also where it is left out
    fields["faults"] = fault_structure(scenario)
    if not scenario.has_load_cell:
        del fields["load_cell"]
    if isinstance(scenario.reference, SampledReference):
        fields["reference"] = scenario.reference.kind  # the samples enter by an open input
    if users_systems(scenario):
        fields["parts"] = tuple((name, key) for name, (key, _) in _users_keys(scenario).items())
    law = scenario.controller
    if isinstance(law, LawParameters):
        decision = decide(scenario)
        if decision.why_python:
            fields["controller"] = "python", law.sample_time_s, decision.inputs
        else:
            # ``parts`` has the key of a law that is a system. The limit of its command is a
            # constant of the equations.
            key = decision.trace.key if decision.trace else str(scenario.command_limit_rad_s)
            fields["controller"] = law.sample_time_s, key
    return _key(tuple(fields.items()))


def _users_keys(scenario: Scenario) -> dict[str, tuple[str, str]]:
    """Return what `Part.key` says of each Drake system of the user, by its place."""
    if not users_systems(scenario):
        return {}
    parts = (*scenario_plant_parts(scenario), *controller_parts(scenario, held_command(scenario)))
    return {part.name: part.key() for part in parts if part.key is not None}


def why_not_compiled(scenario: Scenario) -> str:
    """Return which parts of the user have no symbolic equations, and why.

    Drake's Simulator makes the runs of such a scenario. The text is empty if all parts have
    equations. Raises the errors of `make_closed_loop` for a part that does not fit.
    """
    return "; ".join(filter(None, (why for _, why in _users_keys(scenario).values())))


@lru_cache
def _key(fields: tuple[Any, ...]) -> str:
    return json.dumps([fields, fingerprint()])


def scenario_diagram(scenario: Scenario) -> Any:
    """Build the diagram of the closed loop; an input port replaces a reference with samples.

    An input port replaces a biological moment too. The input port ``law_command`` replaces a law
    that runs as Python.
    """
    external = isinstance(scenario.reference, SampledReference)
    return make_closed_loop(
        scenario,
        signals=(),
        external_reference=external,
        external_moment=True,
        law=held_command(scenario),
    )


def compile_scenario(scenario: Scenario = Scenario()) -> CompiledModel:
    """Compile the closed loop of a scenario.

    All scenarios that differ only in numbers get the same model. `scenario_run` returns the
    parameters, the state and the inputs of a scenario for this model. A law that is called as
    Python becomes the open input ``law_command`` of the model.
    """
    _require_symbolic(scenario)
    return _model(structure_key(scenario), scenario)


def _require_symbolic(scenario: Scenario) -> None:
    """Raise `CompilationError` for a part of the user without equations.

    The structures of two such parts may be equal although their equations differ.
    """
    if reason := why_not_compiled(scenario):
        raise CompilationError(reason)


def _model(key: str, scenario: Scenario) -> CompiledModel:
    def make() -> CompiledModel:
        # Raise the errors of a wrong scenario here, before the diagram is built.
        knee_reference.require_reference_in_range(scenario.reference, scenario.plant.knee)
        scenario_values(scenario)
        scenario_start(scenario)
        decision = decide(scenario)
        inputs = [LAW_COMMAND] if decision.why_python else []
        inputs += ["knee_reference"] if scenario.reference.kind == "samples" else []
        inputs += [] if moment_of(scenario) is None else ["biological_moment"]
        outputs = [_COMMAND_AND_STATE] if decision.trace and not decision.why_python else []
        return compile_by_key(key, partial(_diagram, key, scenario), inputs=inputs, outputs=outputs)

    return _models.of(key, make)


def compile_open_loop(scenario: Scenario) -> CompiledModel:
    """Compile the loop of a scenario without its controller: `make_open_loop`.

    The inputs are ``motor_speed_command`` and, with a wearer, ``knee_reference``. `scenario_run`
    takes this model too, with the inputs.
    """
    _require_symbolic(scenario)
    key, make = f"open loop {structure_key(scenario)}", partial(make_open_loop, scenario)
    inputs = [
        "motor_speed_command",
        *(["knee_reference"] if scenario.wearer.kind != "none" else []),
    ]
    return _models.of(key, lambda: compile_by_key(key, make, inputs=inputs))


_COMMAND_AND_STATE = f"controller/law:{COMMAND_AND_STATE}"
"""Output of the model of a law that is a function, from which `why_python_in_run` reads."""

# Without a limit a process that tries laws of the user keeps the model of each.
MOST_STRUCTURES = 32
"""Largest number of structures whose models and diagrams a process keeps; each has some MiB."""


class Recent(OrderedDict[Any, Any]):
    """Cache of values for the `MOST_STRUCTURES` structures of scenarios that were used last."""

    def of(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the cached value for a structure ``key``, or cache and return ``make()``."""
        with _lock:
            if key not in self:
                self[key] = make()
            self.move_to_end(key)
            if len(self) > MOST_STRUCTURES:
                self.popitem(last=False)
            return self[key]


_lock = RLock()  # threads may run scenarios of one structure
_models = Recent()
_diagrams = Recent()
_healthy = Recent()
"""States before a fault begins: see `_before_faults`."""


def _diagram(key: str, scenario: Scenario) -> Any:
    """Return the `scenario_diagram` that scenarios with the structure ``key`` share.

    The diagram is built once, because Python 3.11 never frees it.
    """
    return _diagrams.of(key, lambda: scenario_diagram(scenario))


def called_code(scenario: Scenario) -> list[Law]:
    """Return the law and the parts of the user that have no equations and are called as Python."""
    parts = scenario.parts.chosen()
    called: list[Law] = [users_law(scenario)] if why_python(scenario) else []
    return called + [parts[name].make for name, (_, why) in _users_keys(scenario).items() if why]


def _text_of(law: Law) -> str:
    return f"{law.digest} {law.name.rpartition(':')[2]}"


def users_code_key(scenario: Scenario) -> str | None:
    """Return a text by which a later process recognizes law and parts of the user in a scenario.

    A part and a compiled law are known by their equations and numbers. `called_code` is known by
    its files, and a law also by the commands that it gives at some points, because the values that
    it reads may come from elsewhere. Returns None for such code whose name in a file does not lead
    to it.
    """
    code = " ".join(_text_of(law) for law in scenario.users_code().values())
    try:
        known = structure_key(scenario)
        if users_systems(scenario):
            known += repr((scenario_values(scenario), scenario_start(scenario)))
        if why_python(scenario):
            known += str(commands_at_points(scenario))
        called = called_code(scenario)
        return " ".join([known, *map(_text_of, called)]) if all(c.digest for c in called) else None
    except KneexoError as error:  # the run will fail alike
        return f"{code} {error}"


# --------------------------------------------------------------- parameters, state, inputs


def scenario_values(scenario: Scenario) -> dict[str, float]:
    """Return a dictionary from the name of a parameter in the compiled model to its value."""
    return {
        full_name(path, name): value
        for path, values in loop_values(scenario, held_command(scenario))
        for name, value in values.items()
    }


def scenario_start(scenario: Scenario) -> dict[str, float]:
    """Return a dictionary from the name of a state in the compiled model to its initial value.

    The dictionary contains the states of the plant and of a Drake system of the user. All other
    states start at zero. Raises `ParameterError` and `LinkageError` as `make_plant` does.
    """
    start = plant_start(scenario)
    law = held_command(scenario)
    for part in controller_parts(scenario, law) if users_systems(scenario) else ():
        path, own = f"controller/{part.name}", dict(part.discrete_start)
        own |= dict(zip(part.state_names, part.start_state(), strict=True))
        start |= {full_name(path, name): value for name, value in own.items()}
    return start


_NO_INPUTS = InputTable()


@lru_cache(maxsize=64)
def reference_table(reference: SampledReference) -> InputTable:
    """Return the input table of a model for a reference with samples and its three derivatives.

    The reference is constant before the first and after the last sample.
    """
    return input_table(knee_reference.sampled_spline(reference), derivatives=3)


def scenario_inputs(scenario: Scenario) -> InputTable:
    """Return the input table of a scenario for its compiled model.

    The inputs are the command of a law in Python, the samples of the reference, and the biological
    moment of the wearer. The command is zero here, because each sample of a run replaces it. Inputs
    that the model does not have are left out.
    """
    return _joint_table(bool(why_python(scenario)), scenario.reference, moment_of(scenario))


@lru_cache(maxsize=64)
def _joint_table(has_law_command: bool, reference: Any, moment: MomentTable | None) -> InputTable:
    """Return one input table of all inputs that a compiled model has.

    They are the command of a law in Python (zero), the reference and the wearer's moment.
    """
    tables = [_NO_INPUTS] if has_law_command else []
    if isinstance(reference, SampledReference):
        tables.append(reference_table(reference))
    if moment is not None:
        tables.append(input_table(moment_spline(moment)))
    if not tables:
        return _NO_INPUTS
    return stack_tables(*tables) if len(tables) > 1 else tables[0]


def scenario_run(
    scenario: Scenario, model: CompiledModel, inputs: InputTable | None = None
) -> tuple[Array, State, InputTable]:
    """Return parameters, initialized state and input table of a scenario for its compiled model.

    Parameters
    ----------
    scenario, model
        The scenario, and a model of its loop or open loop.
    inputs
        Input table of the model. None: that of the reference with samples and of the wearer's
        moment, or an empty table.

    Raises
    ------
    ParameterError, LinkageError
        As in `make_closed_loop`.
    """
    knee_reference.require_reference_in_range(scenario.reference, scenario.plant.knee)
    values, start = scenario_values(scenario), scenario_start(scenario)
    # By name, because a law that runs as Python has values that the model does not have.
    parameters = np.array([values[name] for name in model.parameter_names])
    continuous = np.array([start.get(name, 0.0) for name in model.state_names])
    discrete = np.array([start.get(name, 0.0) for name in model.discrete_names])
    state = State(continuous, discrete)
    if inputs is None:
        moment = moment_of(scenario)
        inputs = _joint_table(LAW_COMMAND in model.inputs, scenario.reference, moment)
    return parameters, model.initialized(parameters, state, inputs), inputs


def why_python_in_run(scenario: Scenario) -> str:
    """Return why the law of a scenario is called as Python in runs, or an empty text: `why_python`.

    The first run of equations that were read off a function is compared with the function, at some
    hundred of its samples. Call this function before results of a compiled law are used.

    Raises `ParameterError` for a law that cannot be run at all.
    """
    reason, inputs, traced = decide(scenario)
    if traced is None or reason or traced.replayed:
        return reason
    if run := _first_run(scenario):
        law, state = scenario.controller, run[_COMMAND_AND_STATE][:, 1:]
        assert isinstance(law, LawParameters)
        record = {name: run[SIGNAL_OF[name]] for name in inputs}
        record |= {"time_s": run.time_s, "state": state}
        for name, gain in law.loaded().values.items():
            record[name] = np.full_like(run.time_s, gain)
        samples = np.column_stack([record[name] for name in argument_sizes(law.function, 0)])
        replay(law.function, samples, state.shape[1])
    return traced.why_not_compiled


def _first_run(scenario: Scenario) -> Simulation | None:
    """Run a loop with a compiled law, and record what the law reads and gives.

    Returns None for a loop that does not run; the run of the user says why.
    """
    outputs = sorted({*(SIGNAL_OF[name] for name in law_inputs(scenario)), _COMMAND_AND_STATE})
    settings = scenario.simulation
    names = ("integrator", "step_s", "tolerance") if settings.compiled else ()
    own = {name: getattr(settings, name) for name in names}
    # RK4 second, as in `serve_runs` where the exact hold fails.
    for options in (own, {"integrator": "rk4", "step_s": ROUGH_STEP_S}):
        options["record_period_s"] = scenario.controller.sample_time_s
        with suppress(KneexoError):
            model = compile_scenario(scenario)
            parameters, state, inputs = scenario_run(scenario, model)
            return model.simulate(
                parameters, state, scenario.duration_s, outputs=outputs, inputs=inputs, **options
            )
    return None


def simulate_compiled(
    scenario: Scenario = Scenario(),
    *,
    signals: Sequence[str] | None = None,
    integrator: str = "exact_hold",
    step_s: float = STEP_S,
    tolerance: float | None = None,
) -> Run:
    """Run the closed loop of ``scenario`` as machine code.

    Only the duration of ``scenario.simulation`` is used. The first run of a structure compiles the
    loop, which takes some seconds. The machine code is cached on disk.

    Parameters
    ----------
    scenario
        The closed loop and the duration of the run.
    signals
        Names in `kneexo.diagrams.SIGNALS` of the signals to log. None: all available signals.
    integrator, step_s, tolerance
        See `CompiledModel.simulate`.

    Raises
    ------
    SimulationError
        The run diverged or left its range.
    ParameterError, LinkageError
        For the same reasons as in `kneexo.diagrams.make_closed_loop`.
    """
    (result,) = simulate_together([scenario], signals, integrator, step_s, tolerance)
    if isinstance(result, KneexoError):
        raise result
    return result


@makers_called_once()
def simulate_together(
    scenarios: Sequence[Scenario],
    signals: Sequence[str] | None = None,
    integrator: str = "exact_hold",
    step_s: float = STEP_S,
    tolerance: float | None = None,
    *,
    reductions: Sequence[Sequence[Reduction]] = (),
) -> list[Run | KneexoError]:
    """Run scenarios that differ only in numbers in one batch; return a run or an error for each.

    `simulate_compiled` describes the arguments. ``reductions`` has the reductions of each scenario,
    which differ only in numbers too. By default no scenario has reductions.
    """
    results: list[Any] = []
    run_arguments = {}
    model = None
    for index, scenario in enumerate(scenarios):
        try:
            if model is None:
                names = chosen_signals(scenario, signals)
                why_python_in_run(scenario)
                model = compile_scenario(scenario)
            run_arguments[index] = scenario_run(scenario, model)
            results.append(None)  # until the run has ended
        except KneexoError as error:
            results.append(error)
    if model is None or not run_arguments:
        return results
    solver = {"integrator": integrator, "step_s": step_s, "error_controlled": False}
    options: dict[str, Any] = {"integrator": integrator, "step_s": step_s, "tolerance": tolerance}
    if LAW_COMMAND in model.inputs:
        for index, arguments in run_arguments.items():
            scenario = scenarios[index]
            result = _python_run(scenario, model, arguments, tuple(names), options)
            results[index] = _run_of(result, scenario, names, solver)
        return results
    parameters, states, inputs = zip(*run_arguments.values(), strict=True)
    options |= {"outputs": tuple(names), "record_period_s": scenarios[0].controller.sample_time_s}
    own = [reductions[index] if reductions else () for index in run_arguments]
    if scenarios[0].faults:
        settings = [options | {"reductions": tuple(each)} for each in own]
        parts = list(zip(run_arguments.values(), settings, strict=True))
        keys = [_key_before_faults(model, *part) for part in parts]
        states = tuple(
            _before_faults(model, scenarios[index], *part, key, keys.count(key) > 1)
            for index, part, key in zip(run_arguments, parts, keys, strict=True)
        )
    runs = model.simulate_batch(
        parameters,
        states,
        [scenarios[index].duration_s for index in run_arguments],
        inputs=inputs,
        reductions=_joined(own),
        **options,
        failures="return",
        # The workers of a sweep occupy the other cores.
        threads=1,
    )
    for index, result in zip(run_arguments, runs, strict=True):
        results[index] = _run_of(result, scenarios[index], names, solver)
    return results


_RunArguments = tuple[Array, State, InputTable]


def _key_before_faults(
    model: CompiledModel, arguments: _RunArguments, options: dict[str, Any]
) -> tuple[Any, ...]:
    """Return a key that scenarios share if they differ in sizes and times of faults only."""
    parameters, state, inputs = arguments
    common = [not name.startswith("fault_") for name in model.parameter_names]
    arrays = (parameters[common], state.continuous, state.discrete, inputs.breaks)
    content = b" ".join(array.tobytes() for array in (*arrays, inputs.coefficients))
    return (model.code.key, sha256(content).digest(), *options.items())


def _before_faults(
    model: CompiledModel,
    scenario: Scenario,
    arguments: _RunArguments,
    options: dict[str, Any],
    key: tuple[Any, ...],
    is_repeated: bool,
) -> State:
    """Return the state from which the run of a scenario goes on, just before its first fault.

    Until then the run is that of all scenarios with its ``key``: see `_key_before_faults`. So it is
    made once, if ``is_repeated`` or when a second such scenario comes, and the latest
    `MOST_STRUCTURES` states are kept. Else, and if it fails, the result is the state at t = 0.
    """
    parameters, state, inputs = arguments
    period_s = scenario.controller.sample_time_s
    ends_s = (scenario.duration_s, *(fault.begin_s for fault in scenario.faults))
    # A reading has a lead of one sample (`context_values`), and times are rounded.
    samples = max(0, math.floor(min(ends_s) / period_s) - 2)
    with _lock:
        known = [made for *other, made in _healthy if (*other,) == key and made <= samples]
        state = _healthy.of((*key, max(known, default=0)), lambda: state)
    if samples in known or not (known or is_repeated):
        return state
    try:
        end_s = samples * period_s
        (run,) = model.simulate_batch(
            [parameters], state, end_s, inputs=inputs, resumable=True, threads=1, **options
        )
    except KneexoError:
        return state
    after: State = _healthy.of((*key, samples), lambda: run.final)
    return after


def _joined(reductions: Sequence[Sequence[Reduction]]) -> list[Reduction]:
    """Return the reductions of all runs of a batch as reductions with one number for each run."""
    return [
        replace(
            same[0],
            after_s=np.array([reduction.after_s for reduction in same]),
            bound=np.array([reduction.bound for reduction in same]),
        )
        for same in zip(*reductions, strict=True)
    ]


def _run_of(
    result: Simulation | KneexoError,
    scenario: Scenario,
    signals: Mapping[str, tuple[str, ...]],
    solver: dict[str, Any],
) -> Run | KneexoError:
    """Return the records of a simulation as a run, whose settings name the ``solver``.

    ``signals`` has the columns of each record. An error is returned unchanged.
    """
    if isinstance(result, KneexoError):
        return result
    data = {
        column: result[name][:, index]
        for name, columns in signals.items()
        for index, column in enumerate(columns)
    }
    settings = scenario.simulation
    if any(getattr(settings, name) != value for name, value in solver.items()):
        settings = settings.model_copy(update=solver)
    return Run(result.time_s, data, settings, result.reduced)


def _python_run(
    scenario: Scenario,
    model: CompiledModel,
    arguments: tuple[Array, State, InputTable],
    names: Sequence[str],
    options: dict[str, Any],
) -> Simulation | KneexoError:
    """Run a scenario whose law is called as Python; return the simulation or its error."""
    parameters, state, inputs = arguments
    try:
        law = PythonLaw(scenario)
        return simulate_with_feedback(
            model,
            parameters,
            state,
            scenario.duration_s,
            law,
            feedback_input=LAW_COMMAND,
            feedback_outputs=law.signals,
            sample_period_s=scenario.controller.sample_time_s,
            outputs=names,
            inputs=inputs,
            **options,
        )
    except KneexoError as error:
        return error
