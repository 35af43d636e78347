"""Exports controller, plant or closed loop of a scenario as an FMU for other simulators."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from diagramc import (
    FMI_VERSIONS,
    CSource,
    Fmu,
    FmuFile,
    FmuParameter,
    context_parameters,
    read_diagram,
    require_platforms,
    source_of,
    write_fmu,
)
from kneexo.diagrams.closed_loop import make_closed_loop, plant_states
from kneexo.errors import KneexoError, ParameterError
from kneexo.export.target import TOOL, Target, make_target, released_step_s, require_step
from kneexo.geometry.rod_polynomial import completed
from kneexo.law.decision import makers_called_once
from kneexo.parameters import LawParameters, Scenario, SlidingModeParameters
from kneexo.parameters.fields.fields import limits_of, source_of as provenance_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.fields.replaced import is_replaced
from kneexo.parameters.paths import changed, value_at
from kneexo.simulation.compiled import scenario_start, scenario_values, structure_key
from kneexo.systems import knee_reference

# Near 1 too, so that a number with a narrow range has values to try.
_FACTORS = (0.1, 0.5, 0.99, 1.01, 2.0, 10.0)
"""Factors by which `parameter_effects` multiplies a number, to see which parameters change."""

_AT_REST = "; the initial state does not follow"

_LONGEST_TUPLE = 8  # coefficients, but no samples


@dataclass(frozen=True)
class KneeFmuFile(FmuFile):
    """Summary of a written FMU of a scenario."""

    scenario_parameters: tuple[str, ...]
    """Names of the FMU parameters that are numbers of the scenario."""


def export_fmu(
    scenario: Scenario,
    path: str | os.PathLike[str],
    what: str = "controller",
    *,
    fmi: int = 3,
    integrator: str = "rk4",
    tolerance: float | None = None,
    step_s: float | None = None,
    platforms: str | Iterable[str] | None = None,
) -> KneeFmuFile:
    """Write controller, plant or loop of a scenario as FMU, with its C sources and binaries.

    Parameters
    ----------
    scenario
        The closed loop.
    path
        The file, whose name ends in ``.fmu``, or its directory. The file in a directory is called
        ``knee_plant.fmu`` for the plant.
    what
        ``controller``, ``plant`` or ``loop``: the part of the scenario to write.
    fmi, integrator, tolerance, step_s
        Version of the standard, and the method for continuous states, as in `make_fmu`.
    platforms
        Platforms of the binaries, as in `diagramc.export_fmu`. None: a binary for this
        machine if it has a C compiler.

    Raises
    ------
    ParameterError, CompilationError
        As in `make_fmu`.
    OutputError
        The file cannot be written.
    """
    file = Path(path)
    if platforms is not None:
        platforms = require_platforms(platforms)
    fmu = make_fmu(
        scenario, what, fmi=fmi, integrator=integrator, tolerance=tolerance, step_s=step_s
    )
    if file.is_dir() or file.suffix != ".fmu":
        file /= f"{fmu.name}.fmu"
    written = write_fmu(file, fmu, platforms)
    names = tuple(name for name in written.parameters if value_at(scenario, name) is not None)
    return KneeFmuFile(**vars(written), scenario_parameters=names)


@makers_called_once()
def make_fmu(
    scenario: Scenario = Scenario(),
    what: str = "controller",
    *,
    fmi: int = 3,
    integrator: str = "rk4",
    tolerance: float | None = None,
    step_s: float | None = None,
) -> Fmu:
    """Return controller, plant or loop of a scenario as FMU.

    The FMU has three kinds of parameters. If a number of the scenario equals one or more Context
    parameters, it is a parameter under its dotted name. Every other Context parameter is a
    parameter under its name in C. Parameters of these two kinds can change during a run. The third
    kind are the initial states of the plant, which are fixed.

    Parameters
    ----------
    scenario
        The closed loop. A law of the user that compiles is allowed.
    what
        ``controller``, ``plant`` or ``loop``: see `make_target`.
    fmi
        Version of the standard: 2 or 3.
    integrator, tolerance
        Method for the continuous states, and its tolerance, as in `make_firmware`.
    step_s
        Largest step of RK4 in s; by default that of `largest_step_s`. A diagram without continuous
        states ignores ``step_s``.

    Raises
    ------
    ParameterError
        ``what``, ``fmi`` or ``step_s`` is wrong. `make_closed_loop` raises this error too.
    CompilationError
        The diagram cannot be exported: see `CSource`.
    """
    if fmi not in FMI_VERSIONS:
        raise ParameterError(f"fmi = {fmi!r}: must be one of {', '.join(map(str, FMI_VERSIONS))}")
    require_step(step_s)
    scenario = completed(scenario)
    target = make_target(scenario, what)
    diagram = read_diagram(target.diagram, inputs=target.inputs)
    if step_s is None and integrator == "rk4":
        step_s = released_step_s(scenario, diagram)
    source = source_of(
        diagram,
        f"knee_{target.what}",
        outputs=[name for name in target.outputs if name not in target.inputs],
        interface=target.interface,
        tick_s=target.tick_s,
        integrator=integrator,
        tolerance=tolerance,
        step_s=step_s,
        subject=f"{target.what} as FMU",
        tool=TOOL,
    )
    return Fmu(
        source,
        [*_tunable(scenario, target, source), *_initial(scenario, source)],
        fmi,
        f"{_DESCRIPTIONS[target.what]} of a polycentric knee exoskeleton",
        _starts(scenario, target, source),
        scenario.duration_s,
    )


_DESCRIPTIONS = {
    "controller": "controller",
    "plant": "electro-hydraulic actuator, linkage, load and encoder",
    "loop": "closed loop",
}

# ------------------------------------------------------------------------------- parameters


def _tunable(scenario: Scenario, target: Target, source: CSource) -> Iterator[FmuParameter]:
    """Yield the tunable FMU parameters: scenario numbers, then other Context parameters."""
    prefix = "controller/" if target.what == "controller" else ""
    names = [f"{prefix}{name}" for name in source.equations.parameters]
    single = dict(zip(names, context_parameters(source), strict=True))
    if target.what == "plant":  # no controller reaches it
        scenario = scenario.model_copy(update={"controller": SlidingModeParameters()})
    law = scenario.controller
    # A maker that takes the scenario would be called a thousand times, so that here the parameters
    # keep the names of the Context.
    is_made = isinstance(law, LawParameters) and law.function.takes_scenario
    effects = {} if is_made else parameter_effects(scenario, names)
    at_rest = _AT_REST if any(_initial(scenario, source)) else ""
    same = {path: effect.same for path, effect in effects.items() if effect.same}
    claims = [name for group in same.values() for name in group]
    set_by_scenario: set[str] = set()
    for path, group in same.items():
        if any(claims.count(name) > 1 for name in group):
            continue
        set_by_scenario |= group
        low, high = limits_of(_field(scenario, path))
        description = f"sets {', '.join(sorted(group))}"
        description += f"; {provenance_of(_field(scenario, path))}"
        description += at_rest * effects[path].start
        fields = tuple(single[name].name for name in names if name in group)
        yield FmuParameter(path, single[min(group)].start, fields, description, low, high)
    for name, parameter in single.items():
        if name in set_by_scenario:
            continue
        origin = [path for path, effect in effects.items() if name in effect.touched]
        description = f"Context parameter {name}"
        description += f", computed from {', '.join(origin)}" if origin else ""
        description += at_rest * any(effects[path].start for path in origin)
        yield replace(parameter, description=description)


@dataclass(frozen=True)
class Effect:
    """What changes when one number of the scenario changes."""

    touched: set[str]
    """Context parameters that change with the number."""
    same: set[str]
    """``touched`` if each of its parameters always equals the number, otherwise empty.

    One parameter of the FMU can then set all of them.
    """
    start: bool
    """Whether the initial state of the plant changes with the number."""


def parameter_effects(scenario: Scenario, names: list[str]) -> dict[str, Effect]:
    """Return a dictionary from the dotted path of a scenario's number to the number's effects.

    The function sets each number to the ends of its range and to several other values, and compares
    the Context parameters ``names`` before and after. Values that the scenario refuses, or that
    change the form of the equations, are skipped. The dictionary lacks numbers that change no
    parameter.
    """
    before, start = scenario_values(scenario), scenario_start(scenario)
    form = structure_key(scenario)
    effects = {}
    for path, value, others in _numbers(scenario):
        touched: set[str] = set()
        same: list[set[str]] = []
        moves = False
        for other in others:
            with suppress(KneexoError):
                with_other = changed(scenario, {path.partition("[")[0]: other})
                if structure_key(with_other) != form:
                    continue
                after = scenario_values(with_other)
                followers = {name for name in names if after[name] != before[name]}
                touched |= followers
                # Equal doubles: a parameter that is only close to the number is computed from it.
                same.append({name for name in followers if after[name] == other})
                moves |= _start(with_other, start) != start
        if touched:
            equal = all(group == touched for group in same)
            equal &= all(before[name] == value for name in touched)
            effects[path] = Effect(touched, touched if equal else set(), moves)
    return effects


def _start(scenario: Scenario, default: dict[str, float]) -> dict[str, float]:
    try:
        return scenario_start(scenario)
    except KneexoError:  # such as a stroke that is too short for it
        return default


def _numbers(parameters: Parameters, path: str = "") -> Iterator[tuple[str, float, list[Any]]]:
    """Yield the path of each number in ``parameters``, its value, and other values to try.

    A number in a tuple has the path ``name[index]``, and the other values to try are whole tuples.
    """
    if is_replaced(parameters):
        return
    for name, field in type(parameters).model_fields.items():
        value = getattr(parameters, name)
        if isinstance(value, Parameters):
            yield from _numbers(value, f"{path}{name}.")
        elif isinstance(value, float) and provenance_of(field):
            low, high = limits_of(field)
            scale = value or 1e-2 * min(high, 1.0)
            numbers = [low, high, *(factor * scale for factor in _FACTORS)]
            others = [n for n in numbers if low <= n <= high and math.isfinite(n) and n != value]
            yield f"{path}{name}", value, others
        elif isinstance(value, tuple) and len(value) <= _LONGEST_TUPLE:
            for i, x in enumerate(value):
                if isinstance(x, Parameters):
                    continue  # a fault keeps its numbers
                tuples = [(*value[:i], factor * x, *value[i + 1 :]) for factor in _FACTORS]
                yield f"{path}{name}[{i}]", x, tuples


def _field(scenario: Scenario, path: str) -> Any:
    parent, _, name = path.rpartition(".")
    holder = value_at(scenario, parent) if parent else scenario
    return type(holder).model_fields[name]


def _initial(scenario: Scenario, source: CSource) -> Iterator[FmuParameter]:
    """Yield a fixed FMU parameter for the start value of each continuous state of the plant."""
    start = math.degrees(knee_reference.start_angle_rad(scenario.reference))
    variables = plant_states(scenario)
    description = f"the scenario starts at rest, the knee at {start:.6g} deg"
    if scenario.initial_offset_m:
        description += f", the rod {scenario.initial_offset_m:g} m further out"
    for i, name in enumerate(source.equations.states):
        if name in variables:
            column, factor = variables[name]
            yield FmuParameter(
                f"initial.{column}",
                factor * float(source.state.continuous[i]),
                (f"initial_x[{i}]",),
                description,
                divisor=factor,
                tunable=False,
            )


def _starts(scenario: Scenario, target: Target, source: CSource) -> dict[str, float]:
    """Return the start value of each input that a port of the closed loop or plant supplies."""
    loop = make_closed_loop(scenario, signals=())
    context = loop.CreateDefaultContext()
    plant = loop.GetSubsystemByName("plant")
    within = plant.GetMyContextFromRoot(context)
    values: dict[str, list[float]] = {}
    for name in target.inputs:
        if loop.HasOutputPort(name):
            values[name] = loop.GetOutputPort(name).Eval(context).tolist()
        elif plant.HasOutputPort(name):
            values[name] = plant.GetOutputPort(name).Eval(within).tolist()
    elements: Mapping[str, Iterator[float]] = {name: iter(row) for name, row in values.items()}
    inputs = [field for field in source.plan.inputs if field.port in elements]
    return {field.name: next(elements[field.port]) for field in inputs}
